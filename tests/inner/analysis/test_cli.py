"""How the command line prints numbers, and what becomes of errors that are planted in it."""

import errno
import json
import re
from dataclasses import replace
from fractions import Fraction
from math import inf, nan
from pathlib import Path
from typing import Any
from unittest.mock import Mock
from xml.etree import ElementTree

import numpy as np
import pytest
from cli_runner import run, strict
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, Policy, Scenario
from exact_mdp.analysis.gate.junit import Case, write_junit
from exact_mdp.analysis.optimum import of_every_state
from exact_mdp.mdp.report import Report, at_most, decimal, digits_of, number, ratio
from exact_mdp.mdp.table import beside
from exact_mdp.paper_repro.__main__ import main as reproduce
from exact_mdp.paper_repro.agents.__main__ import main as agents
from exact_mdp.solvers.parallel import write_piece


def told(err: str, status: int = 2) -> None:
    assert "Traceback" not in err, err
    assert re.fullmatch(r"[A-Z]\w+: [^\n]+\n  where: [^\n]+\n  fix:   [^\n]+\n", err), (status, err)
    assert len(err) < 3500


FAULTS = {
    "OverflowError": OverflowError("integer division result too large for a float"),
    "RecursionError": RecursionError("maximum recursion depth exceeded"),
    "MemoryError": MemoryError(),
    "ValueError": ValueError("Exceeds the limit (4300 digits) for integer string conversion"),
    "OSError": OSError(errno.EMFILE, "Too many open files"),
    "ImportError": ImportError("no such library"),
    "KeyError": KeyError("a slip"),
}


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_what_is_neither_bad_input_nor_a_failed_check_ends_with_3(
    monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    """A crash is not 1, which says that the policy is bad."""
    monkeypatch.setattr("exact_mdp.analysis.cli.given.read_model", Mock(side_effect=fault))
    done = run("check", "yuan2025", "optimal")
    assert (done.status, done.out) == (3, "")
    told(done.err)


def test_the_other_programs_end_in_the_same_way(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fail = Mock(side_effect=OverflowError("too large"))
    monkeypatch.setattr("exact_mdp.paper_repro.run.run", fail)
    done = CliRunner().invoke(reproduce, ["--quick", "--out", str(tmp_path)])
    assert (done.exit_code, done.stdout) == (3, "")
    told(done.stderr)
    monkeypatch.setattr("exact_mdp.paper_repro.agents.log.read", fail)
    done = CliRunner().invoke(agents, ["run", "--out", str(tmp_path)])
    assert (done.exit_code, done.stdout) == (3, "")
    told(done.stderr)
    done = CliRunner().invoke(agents, ["rnu"])
    assert (done.exit_code, done.stdout) == (2, "")
    told(done.stderr)


def test_an_error_of_the_program_itself_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = Mock(side_effect=ValueError("a mistake"))
    monkeypatch.setattr("exact_mdp.analysis.cli.given.read_model", broken)
    done = run("info", "yuan2025")
    assert (done.status, done.out) == (3, "")
    assert done.err.startswith("ValueError: an error in the program, not in your input: a mis")
    assert "where: exact-mdp info, in analysis/cli/given.py, line " in done.err
    assert "EXACT_MDP_TRACEBACK=1" in done.err
    monkeypatch.setenv("EXACT_MDP_TRACEBACK", "1")
    assert "Traceback (most recent call last)" in run("info", "yuan2025").err


def test_a_solver_that_gives_up_ends_with_3(monkeypatch: pytest.MonkeyPatch) -> None:
    from exact_mdp import SolverError, Status

    give_up = Mock(side_effect=SolverError(Status.NO_BOUND))
    monkeypatch.setattr("exact_mdp.analysis.optimum.solve", give_up)
    done = run("solve", "yuan2025", "--json")
    assert (done.status, done.out) == (3, "")
    assert done.err.startswith("SolverError: double precision cannot bound")


def test_a_solver_that_contradicts_the_proof_ends_with_3(monkeypatch: pytest.MonkeyPatch) -> None:

    from exact_mdp import solvers

    solve = solvers.solve

    def wrong(*words: Any, **settings: Any) -> solvers.Solution:
        found = solve(*words, **settings)
        return replace(found, value=found.value + 1e-6)

    monkeypatch.setattr("exact_mdp.analysis.optimum.solve", wrong)
    done = run("solve", "yuan2025", "--certify", "--json")
    assert (done.status, done.out) == (3, "")
    assert done.err.startswith("Contradiction: exact values differ")


def test_an_interruption_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    stop = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr("exact_mdp.analysis.cli.given.read_model", stop)
    done = run("info", "yuan2025")
    assert (done.status, done.out, done.err.strip()) == (130, "", "stopped by SIGINT")


@pytest.mark.parametrize("off", [Fraction(1, 10**22), -Fraction(1, 10**22), Fraction(1, 3)])
def test_every_number_stands_on_its_own_side(off: Fraction) -> None:
    text = beside(1 + off, Fraction(0), Fraction(1))
    assert text not in ("1", "0")
    top, _, rest = text.replace(" - ", " + -").partition(" + ")
    assert (Fraction(top) + Fraction(rest or "0") > 1) == (off > 0)


def test_long_distributions_and_values_are_left_to_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exact_mdp.analysis.optimum.SHOWN_DIGITS", 100)
    monkeypatch.setattr("exact_mdp.solvers.values.returns.LISTED", 7)
    done = run("solve", "yuan2025", "--certify")
    assert re.search(r"exact start value  a rational of \d+ digits; --json prints it\n", done.out)
    done = run("returns", "yuan2025", "random", "--set", "tasks=[1]")
    assert "(the first 7 of 77; --json prints all)" in done.out
    assert len(done.out.splitlines()) == 19  # with what it is not: medical advice


@given(st.integers(0, 10**30), st.integers(1, 200), st.booleans())
def test_rationals_are_printed_exactly(top: int, bottom: int, negative: bool) -> None:
    value = Fraction(-top if negative else top, bottom)
    assert Fraction(decimal(value)) == Fraction(ratio(value)) == value
    assert ("/" in decimal(value)) == (re.sub("^0+", "", str(bottom)) != "" and not finite(value))


def finite(value: Fraction) -> bool:
    """Return whether a decimal expansion ends: 10^k times the number is whole for some k."""
    return (value * 10 ** value.denominator.bit_length()).denominator == 1


@pytest.mark.parametrize("digits", [1, 602, 603, 4299, 4301, 30_000])
def test_integers_have_all_their_digits(digits: int) -> None:
    text = "".join(str((7 * place + place // 13) % 10) for place in range(1, digits + 1))
    whole = 0
    for start in range(0, digits, 1000):
        part = text[start : start + 1000]
        whole = whole * 10 ** len(part) + int(part)
    assert digits_of(whole) == text.lstrip("0")
    assert digits_of(-whole) == f"-{text.lstrip('0')}"
    assert digits_of(10**digits) == "1" + "0" * digits


@settings(max_examples=50)
@given(st.floats() | st.integers() | st.text() | st.booleans() | st.none())
def test_json_is_strict_and_exact(value: object) -> None:
    found = strict(Report(title="", facts={"x": [value]}).json())["x"][0]
    assert found is None if value != value or value in (inf, -inf) else found == value


def test_json_takes_arrays_and_rationals() -> None:
    found = {"a": np.array([1.5, nan]), 2: (np.int64(3), np.bool_(True)), "q": Fraction(1, 3)}
    expected = {"format": 2, "a": [1.5, None], "2": [3, True], "q": "1/3"}
    assert json.loads(Report(title="", facts=found).json()) == expected


@given(st.floats(0, 1e300))
def test_printed_bounds_hold(error: float) -> None:
    assert Fraction(at_most(error)) >= Fraction(error)
    assert float(at_most(error)) <= 1.1 * error + 1e-320


@given(st.floats(-1e9, 1e9), st.floats(1e-15, 1e9))
def test_printed_numbers_are_as_good_as_their_error(value: float, error: float) -> None:
    assert abs(float(number(value, error)) - value) <= max(error / 2, 1e-9 * abs(value))
    assert re.fullmatch(r"-?[0-9.]+(e[-+][0-9]+)?", number(value, error))


def test_a_piece_whose_numbers_were_changed_is_damaged(tmp_path) -> None:
    """A changed policy was read from beyond an array; others were taken as they were."""
    words = (
        "train",
        "tea",
        "--seeds",
        "1",
        "--learner",
        "epochs=3",
        "--n-jobs",
        "1",
        "--out",
        tmp_path,
    )
    assert run(*words).status == 0
    path = tmp_path / "runs-000000.npz"
    good = path.read_bytes()
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    changes = {"policies": 32767, "last": 32767, "snapshots": -1, "q": 3}
    for name, value in changes.items():
        np.savez(path, **arrays | {name: np.full_like(arrays[name], value)})
        done = run(*words)
        assert (done.status, done.out) == (2, "")
        assert done.err.startswith("ModelError: the file is damaged\n")
    arrays.pop("sha256")
    for name in ("policies", "last"):  # with a digest that agrees
        write_piece(path, arrays | {name: np.full_like(arrays[name], 32767)})
        assert run(*words).status == 2
    path.write_bytes(good)
    assert run(*words).status == 0


def test_what_xml_cannot_hold(tmp_path: Path) -> None:
    nasty = 'a\x00b\x1b[0m<&>"\ud800\uffff ]]> é \U0001f600\n'
    case, path = Case(nasty, "failure", nasty, nasty), tmp_path / "r.xml"
    write_junit(path, nasty, [case], seconds=1, properties={nasty: nasty})
    root = ElementTree.fromstring(path.read_bytes())
    failure = root.find(".//failure")
    assert failure is not None
    assert failure.text == 'a?b?[0m<&>"?? ]]> é \U0001f600\n'
    with pytest.raises(ModelError):
        write_junit(tmp_path / "no" / "r.xml", "s", [case], seconds=0, properties={})


def stale(tmp_path: Path) -> Path:
    path = tmp_path / "gate.xml"
    path.write_text("something else")
    assert run("check", "tea", "optimal", "--junit", path).status == 0
    root = ElementTree.parse(path).getroot()
    assert [root.get(name) for name in ("tests", "failures", "errors")] == ["1", "0", "0"]
    assert [root.find(f".//{name}") for name in ("failure", "error")] == [None, None]
    return path


@pytest.mark.parametrize("fault", [OverflowError("too large"), KeyboardInterrupt()])
def test_so_does_whatever_else_ends_the_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: BaseException
) -> None:
    path = stale(tmp_path)

    def fail(*_: object, **__: object) -> None:
        before = ElementTree.parse(path).find(".//error")  # what a killed process leaves
        assert before is not None
        assert "did not end" in str(before.get("message"))
        raise fault

    monkeypatch.setattr("exact_mdp.analysis.cli.given.read_model", fail)
    assert run("check", "tea", "optimal", "--junit", path).status in (3, 130)
    found = ElementTree.parse(path).find(".//error")
    assert found is not None
    assert "did not end" not in str(found.get("message"))


def as_read(mdp: MDP, folder: Path, policy: object) -> Policy:
    """The policy that a file with a part of the JSON says."""
    (folder / "own.json").write_text(json.dumps(policy), encoding="utf-8")
    return Policy.of(mdp, folder / "own.json")


def test_a_policy_by_status_is_one_that_reads_nothing_else(tmp_path: Path) -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    always = Policy.always(mdp, "directive").choices(mdp)
    late = always.copy()
    late[mdp.space.index(trial=1, status=3)] = 0
    for numbers, by_status in ((always, True), (late, False)):
        found = of_every_state(mdp, [mdp.actions[a] for a in numbers])
        assert (found.keys() == {f"{n:04b}" for n in range(16)}) is by_status
        again = as_read(mdp, tmp_path, found)
        assert (again.weights(mdp) == Policy.from_choices(mdp, numbers).weights(mdp)).all()
