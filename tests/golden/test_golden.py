"""What every command answers, pinned: a change of an answer is a change of its file.

`cd tests && python -m golden.write` writes all answers anew; how they are compared: runner.py.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from golden import models
from golden.runner import ANSWERS, CASES, FOLDER, QVBS, answer, differences, run, trimmed

ROOT = FOLDER.parents[1]
FAST = CASES["fast"] | (CASES["qvbs"] if QVBS else {})
FAST |= {
    f"verify-{name}": f"verify certificates/{name}.json {model}"
    for name, (_, model) in CASES["certificates"].items()
}


def agrees(name: str, case: str | list[str], tmp_path: Path) -> None:
    wanted = json.loads((ANSWERS / f"{name}.json").read_text("utf-8"))
    assert differences(wanted, answer(case, tmp_path)) == []


@pytest.mark.parametrize("name", FAST)
def test_the_answer_is_the_pinned_one(name: str, tmp_path: Path) -> None:
    agrees(name, FAST[name], tmp_path)


@pytest.mark.parametrize("name", CASES["certificates"])
def test_a_committed_certificate_holds(name: str, tmp_path: Path) -> None:
    done = run(f"verify certificates/{name}.json {CASES['certificates'][name][1]}", tmp_path)
    assert (done.status, json.loads(done.out)["violations"]) == (0, [])


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES["slow"])
def test_a_long_answer_is_the_pinned_one(name: str, tmp_path: Path) -> None:
    agrees(name, CASES["slow"][name], tmp_path)


@pytest.mark.parametrize("name", CASES["refused"])
def test_what_is_wrong_is_refused(name: str, tmp_path: Path) -> None:
    done = run(CASES["refused"][name], tmp_path)
    assert (done.status, done.out) == (2, "")
    assert done.err.strip()


def test_every_pinned_answer_has_a_command() -> None:
    assert {path.stem for path in ANSWERS.iterdir()} == {*FAST, *CASES["slow"], *CASES["qvbs"]}


def test_the_models_are_still_built_as_they_were_saved(tmp_path: Path) -> None:
    models.write(tmp_path)
    names = {path.name for path in models.FOLDER.iterdir()}
    assert names == {path.name for path in tmp_path.iterdir()}
    for name in names - {"damaged.npz"}:
        old, new = models.FOLDER / name, tmp_path / name
        if name.endswith(".npz"):
            with np.load(old) as before, np.load(new) as after:
                assert set(before) == set(after)
                for key in before:
                    np.testing.assert_array_equal(before[key], after[key], key)
        else:
            assert old.read_bytes() == new.read_bytes(), name


# ---- the reproduction ----------------------------------------------------------------------------


def test_pinned_claims_are_what_the_commands_answer(tmp_path: Path) -> None:
    pinned = tomllib.loads((ROOT / "paper_repro" / "expected.toml").read_text("utf-8"))

    def asked(line: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(run(line, tmp_path).out)
        return found

    tables = asked("info yuan2025")["parameters"]
    claimed = {name.removeprefix("table3."): entry for name, entry in pinned.items()}
    shared = claimed.keys() & tables.keys()
    assert len(shared) > 25
    for name in shared:
        assert float(Fraction(tables[name])) == claimed[name]["value"], name
    for name, line, key in (
        ("return.optimal", "solve yuan2025 --certify", "start_value"),
        ("return.random", "evaluate yuan2025 random", "mean"),
    ):
        found, entry = asked(line), pinned[name]
        allowed = entry["tolerance"] + found["error_bound"]
        assert abs(found[key] - entry["value"]) <= allowed, name


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_quick_reproduction_gives_the_pinned_numbers(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "paper_repro", "--quick", "--out", tmp_path], cwd=ROOT, check=True
    )
    found = json.loads((tmp_path / "numbers.json").read_text("utf-8"))
    pinned = json.loads((FOLDER / "numbers.json").read_text("utf-8"))
    assert [entry["name"] for entry in found] == [entry["name"] for entry in pinned]
    for old, new in zip(pinned, found, strict=True):
        assert differences({"answer": old}, {"answer": trimmed(new)}) == [], old["name"]
