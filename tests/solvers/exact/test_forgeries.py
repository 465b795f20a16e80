"""False certificates, each of which a single clause of the checker stops."""

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import exact_mdp
from exact_mdp import MDP, certify, check_certificate, fingerprint, save

END = (1, 0, [(1, 1, 0)])
WAIT_OR_PAY = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, -1)]), END]
CHOICE = [(0, 0, [(1, 1, -1)]), (0, 1, [(1, 1, -1)]), END]
MAY_MISS = [(0, 1, [("1/2", 1, 0), ("1/2", 2, 0)]), END, (2, 0, [(1, 2, 0)])]
NOT_UNIQUE = {"unique": False}, "it says wrongly that the optimum is not unique"
UNIQUE = {"unique": True}, "it says wrongly that the optimum is unique"


def level(*values: int) -> dict[str, Any]:
    return {"top": list(map(hex, values)), "below": ["0x1"], "group": [0] * len(values)}


def until_goal(rows: Any, states: int = 2, **more: Any) -> MDP:
    labels = {"goal": [state == 1 for state in range(states)]}
    return MDP.from_outcomes(rows, labels=labels, **more).until("goal")


FORGED: dict[str, tuple[MDP, dict[str, Any], str]] = {
    "waiting for ever, at discount 1, for 5 that never come": (
        MDP.from_outcomes(WAIT_OR_PAY),
        {"g": None, "h": level(5, 0), "w": None, "rank": [1, 0], "start_value": "0x5/0x1"},
        "the rank does not show that every policy ends",
    ),
    "an end that is worth 5": (
        MDP.from_outcomes([(0, 0, [(1, 1, -1)]), END]),
        {"h": level(4, 5), "start_value": "0x4/0x1"},
        "an end is not worth 0",
    ),
    "a goal that is worth 5": (
        until_goal(WAIT_OR_PAY, sense="min"),
        {"h": level(6, 5), "start_value": "-0x6/0x1"},
        "a state of the goal is not worth 0",
    ),
    "costs that never arrive, called 0": (
        until_goal(WAIT_OR_PAY, sense="min"),
        {"policy": [0, 0], "h": level(0, 0), "start_value": "0x0/0x1"},
        "it is worth more than is claimed",
    ),
    "waiting outside the goal, called 0": (
        until_goal([(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 1)]), END], sense="min"),
        {"policy": [0, 0], "h": level(0, 0), "start_value": "0x0/0x1"},
        "the rank does not show that the goal is reached",
    ),
    "a goal within reach, called out of reach": (
        until_goal([(0, 0, [(1, 1, 1)]), (0, 1, [(1, 0, 0)]), END], sense="min"),
        {"policy": [1, 0], "infinite": [-1, 0], "start_value": "inf"},
        "the order does not show that the goal is missed",
    ),
    "the goal is always reached, called missed for +inf": (
        until_goal([(0, 0, [(1, 1, 1)]), END, (2, 0, [(1, 2, 0)])], 3),
        {"infinite": [1, 0, 1], "order": [1, 0, 0], "start_value": "inf"},
        "the order does not show that the policy is worth +∞",
    ),
    "costs that fall for ever, and a goal out of reach": (
        until_goal([(0, 0, [(1, 0, -1)]), END], sense="min"),
        {"infinite": [1, 0], "start_value": "-inf"},
        "the goal may be out of reach",
    ),
    "costs that fall for ever, and a goal that may be missed": (
        until_goal([(0, 0, [(1, 0, -1)]), *MAY_MISS], 3, sense="min"),
        {"infinite": [1, 0, -1], "start_value": "-inf"},
        "the goal may be out of reach",
    ),
    "costs that fall for ever on the way to a goal, called 0": (
        until_goal([(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, 0)]), END], sense="min", start=[0, 1]),
        {"infinite": [0, 0]},
        "it is worth more than is claimed",
    ),
    "of the way to the goal and one that may miss it, called both": (
        until_goal([(0, 0, [(1, 1, 1)]), *MAY_MISS], 3, sense="min"),
        *NOT_UNIQUE,
    ),
    "levels of a mean reward, below discount 1": (
        MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2"),
        {"g": level(0), "w": level(-4)},
        "g, h, w prove no total of such a model",
    ),
    "two ways to the end, called the only one": (MDP.from_outcomes(CHOICE), *UNIQUE),
    "the only way to the end, called one of two": (
        MDP.from_outcomes([(0, 0, [(1, 1, -1)]), (0, 1, [(1, 1, -2)]), END]),
        *NOT_UNIQUE,
    ),
    "of two that earn 1 in each step for ever, one called the only one": (
        MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 1)])]),
        *UNIQUE,
    ),
    "of one that earns 1 in each step for ever and one that stops, called both": (
        MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 9)]), END]),
        *NOT_UNIQUE,
    ),
    "of a state that misses the goal for +inf, the way there called another": (
        until_goal(WAIT_OR_PAY),
        *NOT_UNIQUE,
    ),
}


def written(folder: Path, mdp: MDP, changes: dict[str, Any], of: str = "proof") -> list[str]:
    """Write a model and its proof, one of them with changes; return both paths."""
    paths = {"model": str(folder / "model.json"), "proof": str(folder / "proof.json")}
    save(mdp, paths["model"])
    certify(mdp).save(paths["proof"])
    content = json.loads(Path(paths[of]).read_text("utf-8"))
    Path(paths[of]).write_text(json.dumps(content | changes), "utf-8")
    return [*paths.values()]


@pytest.mark.parametrize("what", FORGED)
def test_a_forged_certificate_is_refused(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mdp, changes, sentence = FORGED[what]
    assert check_certificate.main(written(tmp_path, mdp, {})) == 0
    assert check_certificate.main(written(tmp_path, mdp, changes)) == 1
    assert sentence in capsys.readouterr().out


LEAST = until_goal(WAIT_OR_PAY, sense="min")
ONE = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), END])
ROW = {"state": 0, "action": 0, "reward": 1, "denominator": 1, "next": [1], "weight": [1]}
UNREAD: list[tuple[MDP, str, dict[str, Any]]] = [
    *[(LEAST, "model", change) for change in (
        {"unreached": "5"}, {"goal": None, "unreached": "5"}, {"goal": [0]}, {"discount": "1/2"},
    )],
    *[(ONE, "model", change) for change in (
        {"discount": "3/2"}, {"discount": "-1/2"}, {"sense": "most"}, {"states": 3}, {"states": 1},
        {"start": {"0": "1/2"}}, {"start": {"0": "3/2", "1": "-1/2"}}, {"start": {"7": "1"}},
        {"start": {}}, {"start": ["1"]}, {"pairs": []},
    )],
    # weights of 0 and below it, too few of them, a sum that is not the denominator, no such state
    *[(ONE, "model", {"pairs": [ROW | change, ROW | {"state": 1, "reward": 0}]}) for change in (
        {"next": [1, 0], "weight": [1, 0]}, {"next": [1, 0], "weight": [2, -1]}, {"next": [1, 0]},
        {"denominator": 2}, {"next": [2]}, {"next": [-1]}, {"reward": [1, 1]}, {"next": []},
    )],
    # numbers that nothing uses, and ranks below 0
    *[(ONE, "proof", change) for change in (
        {"h": level(1, 0) | {"below": ["0x1", "0x7"]}}, {"rank": [1, -1]}, {"rank": [0, -1]},
    )],
]  # fmt: skip


@pytest.mark.parametrize("mdp, of, change", UNREAD, ids=lambda x: str(x) if type(x) is dict else "")
def test_what_says_nothing_is_not_read(
    mdp: MDP, of: str, change: dict[str, Any], tmp_path: Path
) -> None:
    same = {"h": level(1, 0), "rank": [1, 0]} if mdp is ONE else {}
    assert check_certificate.main(written(tmp_path, mdp, same)) == 0
    files = written(tmp_path, mdp, change, of)
    assert check_certificate.main(files) == alone(*files)[0] == 2


def test_a_start_may_name_states_in_which_no_episode_begins(tmp_path: Path) -> None:
    change = {"start": {"0": "1", "1": "0"}}
    files = written(tmp_path, ONE, change, "model")
    assert check_certificate.main(files) == alone(*files)[0] == 0


# ---- the checker by itself -----------------------------------------------------------------------

CHECKER = Path(exact_mdp.__file__).parent / "solvers" / "exact" / "checker.py"


def alone(*words: Path | str) -> tuple[int, str]:
    """Run the checker without the package; return its status and what it says."""
    done = subprocess.run(
        [sys.executable, "-I", CHECKER, *words], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout + done.stderr


def test_a_start_that_mixes_both_infinities_has_no_value(tmp_path: Path) -> None:
    """The proof of one start is none of the other, whatever start value is written into it."""
    one = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (1, 0, [(1, 1, -1)])])
    both = one.with_(start={0: "1/2", 1: "1/2"})
    model, proof = map(Path, written(tmp_path, one, {}))
    assert alone(model, proof) == (0, "holds\n")
    content = json.loads(proof.read_text("utf-8"))
    both.save(model)
    for value in ("0x0/0x1", "inf", "-inf"):
        forged = content | {"model": fingerprint(both), "start_value": value}
        proof.write_text(json.dumps(forged), "utf-8")
        status, said = alone(model, proof)
        assert (status, "start value" in said) == (1, True)


def test_files_that_are_none_are_not_checked(tmp_path: Path) -> None:
    model, proof = map(Path, written(tmp_path, ONE, {}))
    text = proof.read_text("utf-8")
    for content, what in {
        '["exact-mdp certificate", 2]': "not", "[]": "not", "1": "not", "{}": "not",
        '{"a": 1, "a": 2}': "'a' is written twice",
        text[:-9]: "proof.json: Unterminated",
        text.replace('"rank"', '"ranks"'): "keys missing, or too many: rank, ranks",
        text.replace('"total"', '"front"'): "see exact-mdp verify",
    }.items():  # fmt: skip
        proof.write_text(content, "utf-8")
        status, said = alone(model, proof)
        assert (status, said.startswith("not checked: "), what in said) == (2, True, True)
    assert alone(proof, proof)[0] == alone(model)[0] == 2


def test_it_can_be_read_in_one_sitting_and_imports_nothing() -> None:
    text = CHECKER.read_text("utf-8")
    imported = {
        str(node.module if isinstance(node, ast.ImportFrom) else node.names[0].name)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert {name.partition(".")[0] for name in imported} <= sys.stdlib_module_names
    assert len(text.splitlines()) <= 400
