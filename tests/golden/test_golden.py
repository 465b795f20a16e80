"""What every command answers, pinned: a change of an answer is a change of its file.

`cd tests && python -m golden.write` writes all answers anew; how they are compared: runner.py.
"""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import run as ask
from golden import sources
from golden.runner import ANSWERS, CASES, QVBS, answer, differences, run

FAST = CASES["fast"] | (CASES["qvbs"] if QVBS else {})
FAST |= {
    f"verify-{name}": f"verify certificates/{name}.json {model}"
    for name, (_, model) in CASES["certificates"].items()
}


def agrees(name: str, case: str | list[str], tmp_path: Path) -> None:
    wanted = json.loads((ANSWERS / f"{name}.json").read_text("utf-8"))
    unlike = differences(wanted, answer(case, tmp_path))
    assert not unlike, "\n".join(["the answer has changed", *unlike])


@pytest.mark.parametrize("name", FAST)
def test_the_answer_is_the_pinned_one(name: str, tmp_path: Path) -> None:
    agrees(name, FAST[name], tmp_path)


@pytest.mark.parametrize("name", CASES["certificates"])
def test_a_certificate_holds_as_committed_and_as_written_now(name: str, tmp_path: Path) -> None:
    line, model = CASES["certificates"][name]
    assert run(line, tmp_path, "--certificate", f"{tmp_path}/new.json").status in (0, 1)
    for path in (f"certificates/{name}.json", "{tmp}/new.json"):
        done = run(f"verify {path} {model}", tmp_path)
        assert (done.status, json.loads(done.out)["violations"]) == (0, []), path
    done = run(f"verify certificates/{name}.json {model} --proven", tmp_path)
    said = json.loads(done.out)
    assert (done.status, said["holds"], said["proven"]) == (0, True, True)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES["slow"])
def test_a_long_answer_is_the_pinned_one(name: str, tmp_path: Path) -> None:
    agrees(name, CASES["slow"][name], tmp_path)


def test_bounds_and_samples_are_compared_as_closely_as_they_claim() -> None:
    def differ(claim: str, value: float, bound: float) -> bool:
        old: dict[str, Any] = {"claim": claim, "mean": 2.0, "error_bound": 1e-5}
        new = old | {"mean": value, "error_bound": bound}
        return bool(differences({"answer": old}, {"answer": new}))

    assert not differ("bounded", 2.0 + 1.5e-5, 1e-5)
    assert differ("bounded", 2.0 + 1.5e-5, 1e-9)
    drawn: dict[str, Any] = {"claim": "estimated", "mean": 2.0}
    assert not differences({"answer": drawn}, {"answer": drawn | {"mean": 2.0 + 1e-12}})
    assert differences({"answer": drawn}, {"answer": drawn | {"mean": 2.0 + 1e-11}})


def test_every_pinned_answer_has_a_command() -> None:
    assert {path.stem for path in ANSWERS.iterdir()} == {*FAST, *CASES["slow"], *CASES["qvbs"]}


def test_every_command_has_a_pinned_answer() -> None:
    """Its report is looked through here: a new command cannot print a number without a claim."""
    listed = re.findall(r"^  ([a-z][\w-]+)  +\w", ask("--help").out, re.M)
    cases = [*FAST.values(), *CASES["slow"].values()]
    lines = [line for case in cases for line in ([case] if isinstance(case, str) else case)]
    assert len(listed) >= 25
    assert {*listed} <= {line.split()[0] for line in lines}


def test_the_models_are_still_built_as_they_were_saved(tmp_path: Path) -> None:
    sources.write(tmp_path)
    for new in tmp_path.iterdir():
        with np.load(sources.FOLDER / new.name) as before, np.load(new) as after:
            assert set(before) == set(after)
            for key in before:
                np.testing.assert_array_equal(before[key], after[key], key)
