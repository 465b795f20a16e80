"""The proven checker: it says what `checker` says, reads what the format allows, and runs alone."""

import ast
import json
import subprocess
import sys
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import pytest
from altered_certificates import cases, verdicts
from inner.solvers.exact.test_checker import (
    BAD_CERTIFICATES,
    BAD_MODELS,
    FALSE,
    GOOD,
    HOLD,
    SOUND,
    UNIQUE,
    claim,
    level,
    model,
    proven,
    row,
)

from exact_mdp import MDP, check
from exact_mdp.mdp.io import model_json
from exact_mdp.solvers.exact import checker, codec, verified
from exact_mdp.solvers.exact.verified import Unreadable, holds

ROOT = Path(__file__).resolve().parents[4]
PROGRAM = ROOT / "exact_mdp" / "solvers" / "exact" / "verified.py"


# ---- beside the other checker --------------------------------------------------------------------


@pytest.mark.parametrize("name", HOLD)
def test_right_certificates_hold(name: str) -> None:
    given, proof = proven(name)
    assert verdicts(given, proof) == (0, 0)
    if proof["kind"] == "bounds":
        return
    for change in ({"unique": not proof["unique"]}, {"unique": None}, {"start_value": "0x7/0x5"}):
        assert verdicts(given, proof | change) == (1, 1)


@pytest.mark.parametrize("what", FALSE)
def test_a_false_certificate_does_not_hold(what: str) -> None:
    given, certificate, _ = FALSE[what]
    assert verdicts(given, certificate) == (1, 1)


@pytest.mark.parametrize("what", UNIQUE)
def test_it_says_which_optimum_is_unique(what: str) -> None:
    given, unique, parts = UNIQUE[what]
    value = (parts["g"] if parts.get("kind") == "average" else parts["h"])["top"][0]
    assert verdicts(given, claim(given, value, unique=unique, **parts)) == (0, 0)
    assert verdicts(given, claim(given, value, unique=not unique, **parts)) == (1, 1)


def test_a_second_optimal_pair_may_be_many_steps_away() -> None:
    rows = [row(s, a, [s + 1]) for s in range(30) for a in range(1 + (s == 29))]
    given = model(*rows, row(30, 0, [30]))
    parts = {"h": level(*[0] * 31), "rank": [30 - s for s in range(31)]}
    assert verdicts(given, claim(given, 0, unique=False, **parts)) == (0, 0)
    assert verdicts(given, claim(given, 0, unique=True, **parts)) == (1, 1)


def test_both_checkers_say_the_same_of_300_certificates() -> None:
    """Altered, weakened and random ones; `make proof-compare` takes 20,000."""
    found = [verdicts(given, proof) for _, given, proof in cases(300, seed=1)]
    assert [first for first, second in found if first != second] == []
    assert min(map(found.count, [(0, 0), (1, 1), (2, 2)])) >= 10


# ---- what is read --------------------------------------------------------------------------------


@pytest.mark.parametrize("number", range(len(BAD_MODELS)))
def test_what_is_no_model_is_refused(number: int) -> None:
    given, _ = BAD_MODELS[number]
    assert verdicts(given, SOUND) == (2, 2)


@pytest.mark.parametrize("number", range(len(BAD_CERTIFICATES)))
def test_what_is_no_certificate_is_refused(number: int) -> None:
    certificate, _ = BAD_CERTIFICATES[number]
    assert verdicts(GOOD, certificate) == (2, 2)


@pytest.mark.parametrize("version", [2.0, True, "2", None, 1, 3, [2]])
def test_version_2_is_an_integer(version: Any) -> None:
    assert verdicts(GOOD, SOUND) == (0, 0)
    assert verdicts(GOOD | {"version": version}, SOUND) == (2, 2)
    assert verdicts(GOOD, SOUND | {"version": version}) == (2, 2)


LONG = "0x" + "1" * 100_000


@pytest.mark.parametrize("number", [LONG, "-" + LONG, f"1/{LONG}", "1" * 4300])
def test_numbers_may_have_so_many_digits(number: str) -> None:
    assert verdicts(GOOD, SOUND | {"start_value": number}) == (1, 1)


@pytest.mark.parametrize("number", [LONG + "1", f"{LONG}1/{LONG}", f"1/{LONG}1", "1" * 4301])
def test_longer_numbers_are_refused(number: str) -> None:
    limit = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)  # even where Python would read them
    try:
        for bad in (SOUND | {"start_value": number}, SOUND | {"policy": [number] * 2}):
            assert verdicts(GOOD, bad) == (2, 2)
        assert verdicts(GOOD | {"discount": number}, SOUND) == (2, 2)
        assert verdicts(GOOD | {"states": 16**100_001}, SOUND) == (2, 2)
    finally:
        sys.set_int_max_str_digits(limit)


def test_a_file_with_a_long_integer_is_refused(tmp_path: Path) -> None:
    """Python reads no integer of more than 4,300 digits: the exit status is that of bad input."""
    given, proof = tmp_path / "model.json", tmp_path / "proof.json"
    long = '{"a": ' + "1" * 4301 + "}"
    for texts in ((json.dumps(GOOD), long), (long, json.dumps(SOUND))):
        for path, text in zip((given, proof), texts, strict=True):
            path.write_text(text, "utf-8")
        for main in (checker.main, verified.main):
            assert main([str(given), str(proof)]) == 2


@pytest.mark.parametrize("given", [None, [], "exact-mdp model", 2, {}, {"format": []}, [[]]])
def test_other_content_is_refused(given: Any) -> None:
    assert verdicts(given, SOUND) == verdicts(GOOD, given) == (2, 2)


def test_a_certificate_of_another_model_does_not_hold() -> None:
    for change in ({"sense": "min"}, {"sense": []}, {"model": "0" * 64}, {"model": None}):
        assert verdicts(GOOD, SOUND | change) == (1, 1)


def test_kinds_that_the_proof_does_not_cover_are_refused_in_words() -> None:
    for kind in ("weights", None, ["total"]):
        with pytest.raises(
            Unreadable, match="the proof covers total, average, bounds, regret, not "
        ):
            holds(GOOD, SOUND | {"kind": kind})


# ---- hints ---------------------------------------------------------------------------------------


def test_a_wrong_hint_can_only_refuse() -> None:
    """Whatever is said of ends, of states that are reached and of ways, nothing false holds."""
    given = model(row(0, 0, [1], 1), row(0, 1, [1], 1), row(1, 0, [1]))
    proof = claim(given, 1, unique=False, h=level(1, 0), rank=[1, 0])
    m, _ = verified.model_of(given)
    c = verified.certificate_of(proof, m)
    assert c is not None
    hints = verified.hints_of(m, c)
    assert verified.check(m, c, hints)
    false = c._replace(unique=True)
    for change in (
        {"ends": [True, True].__getitem__}, {"ends": [False, False].__getitem__},
        {"reach": [False, True].__getitem__}, {"toward": [-1, -1].__getitem__},
        {"toward": [1, 0].__getitem__}, {"along": [7, 0].__getitem__}, {"target": 1},
        {"second": 0}, {"leaving": 7},
    ):  # fmt: skip
        other = hints._replace(**change)  # type: ignore[arg-type]
        assert not verified.check(m, false, other)
        assert "reach" in change or not verified.check(m, c, other)


# ---- by itself -----------------------------------------------------------------------------------


def alone(*words: Path | str) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "-I", PROGRAM, *words], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout, done.stderr


def test_the_exit_status_says_whether_it_holds(tmp_path: Path) -> None:
    given, proof = tmp_path / "model.json", tmp_path / "proof.json"
    given.write_text(json.dumps(GOOD), "utf-8-sig")
    proof.write_text(json.dumps(SOUND), "utf-8")
    assert alone(given, proof) == (0, "holds\n", "")
    proof.write_text(json.dumps(SOUND | {"start_value": 2}), "utf-8")
    assert alone(given, proof) == (1, "does not hold\n", "")
    proof.write_text(json.dumps(SOUND | {"kind": "weights"}), "utf-8")
    assert alone(given, proof) == (
        2, "", "not checked: the proof covers total, average, bounds, regret, not 'weights'\n"
    )  # fmt: skip


def test_both_checkers_say_in_a_sentence_what_is_shown_of_a_policy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, proof = tmp_path / "model.json", tmp_path / "proof.json"
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    steps = [(s, 0, [("1/3", s, F(1, 10**30 + s)), ("2/3", s + 1, 1)]) for s in range(5)]
    steps += [(0, 1, [(1, 1, 0)]), (5, 0, [(1, 5, 0)])]
    falling = [(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    for table, policy, said in (
        (
            rows,
            {0: {0: F(1, 4), 1: F(3, 4)}},
            "1.142857143 at the start, the best 2; regret 0.857",
        ),
        (steps, {0: 1}, "4.000000000 at the start, the best 5.000000000; regret 1.000000000"),
        (falling, [0, 0], "-inf at the start, the best 0; regret inf"),
    ):
        audit = check(MDP.from_outcomes(table), policy)
        given.write_text(json.dumps(model_json.encode_model(audit.mdp)), "utf-8")
        proof.write_text(json.dumps(codec.build_file_content(audit.certificate)), "utf-8")
        for main in (checker.main, verified.main):
            assert main([str(given), str(proof)]) == 0
            out = capsys.readouterr().out
            assert out.startswith(f"holds: the policy earns {said}")
            assert len(out) < 200
    for describe in (checker.describe, verified.describe):  # numbers that no float holds
        long = {"value": {"start_value": LONG}, "optimum": {"start_value": f"1/{LONG}"}}
        out = describe(long | {"regret": "-inf"})
        assert out.endswith("e+120410 at the start, the best 1.506002409e-120411; regret -inf")


def test_bad_files_are_not_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given, proof = tmp_path / "model.json", tmp_path / "proof.json"
    given.write_text(json.dumps(GOOD), "utf-8")
    for text in ("", "{", "[]", '{"a": 1, "a": 2}', "[" * 100_000, '{"a": 1e999999}', "\0"):
        proof.write_text(text, "utf-8")
        assert verified.main([str(given), str(proof)]) == 2
        assert capsys.readouterr().err.startswith("not checked: ")
    proof.write_bytes(b"\xff\xfe")
    for words in ([str(given), str(proof)], [str(given), str(tmp_path)], [str(given)], []):
        assert verified.main(words) == 2
        assert capsys.readouterr().out == ""


def test_it_imports_nothing_but_the_standard_library() -> None:
    nodes = ast.walk(ast.parse(PROGRAM.read_text("utf-8")))
    names = {
        str(node.module if isinstance(node, ast.ImportFrom) else node.names[0].name)
        for node in nodes
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert {name.partition(".")[0] for name in names} <= sys.stdlib_module_names


def test_what_is_not_generated_is_the_reader() -> None:
    """`make proof` compares the whole; without Coq, this part at least is what the source says."""
    reader = (ROOT / "proof" / "reader.py").read_text("utf-8")
    before, _, rest = reader.partition("# the proven program")
    after = rest.partition("# end of the proven program\n")[2]
    text = PROGRAM.read_text("utf-8")
    head = '"""Generated by proof/to_python.py from proof/theories/Checker.v: do not edit.\n\n'
    assert text.startswith(head + before.removeprefix('"""').rstrip())
    assert text.endswith(after.strip() + "\n")
