"""Questions with published answers: exactly, in floats, by every door, +∞ where a run may miss."""

from __future__ import annotations

from dataclasses import replace
from math import inf, isinf
from pathlib import Path

import numpy as np
import pytest
from cases.prism_rewards import MODELS, PUBLISHED, Asked
from cli_runner import run

from exact_mdp import MDP, certify, check, evaluate, solve


def posed(case: Asked) -> MDP:
    """The model whose value is the answer: until a label, or the total of one component."""
    mdp = MODELS[case.model].with_(sense=case.sense)
    if case.until is not None:
        return mdp.until(case.until, case.reward)
    top, bottom = mdp.component(case.reward)
    return mdp.with_(table=replace(mdp.table, gain=top, gain_denominator=bottom))


NAMES = [f"{c.model}-{c.until}-{c.reward}-{c.sense}" for c in PUBLISHED]


@pytest.mark.parametrize("case", PUBLISHED, ids=NAMES)
def test_published_answers(case: Asked) -> None:
    mdp = posed(case)
    proof, solution = certify(mdp), solve(mdp)
    assert proof.start_value == case.value
    assert proof.violations() == []
    assert solution.start.value == pytest.approx(float(case.value))
    if not isinf(case.value):
        low, high = solution.start.interval
        assert low <= case.value <= high
        if np.isfinite(proof.value_float).all():
            assert check(mdp, solution).passed
        assert evaluate(mdp, solution).mean == pytest.approx(float(case.value))


@pytest.mark.parametrize("case", [c for c in PUBLISHED if c.until], ids=lambda c: c.model)
@pytest.mark.parametrize("ending", ["npz", "umb"])
def test_the_same_on_the_command_line(tmp_path: Path, case: Asked, ending: str) -> None:
    path = tmp_path / f"model.{ending}"
    MODELS[case.model].save(path)
    words = ["--until", case.until, "--reward", case.reward, "--start", "0"]
    words += ["--minimize"] if case.sense == "min" else []
    done = run("solve", path, *words, "--certify", "--json", "--certificate", tmp_path / "c.json")
    assert done.result["exact_start_value"] == ("inf" if case.value == inf else str(case.value))
    assert done.result["sense"] == case.sense
    assert done.result["start_value"] == ("inf" if case.value == inf else float(case.value))
    proven = run("verify", tmp_path / "c.json", path, *words, "--json").result
    assert proven["holds"]
    other = run("verify", tmp_path / "c.json", path, "--json")
    assert (other.status, other.result["holds"]) == (1, False)
