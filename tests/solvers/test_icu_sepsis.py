"""ICU-Sepsis, estimated from records: 716 states, 1.5 million transitions, floats on one cycle.

Choudhary, Gupta and Thomas, Reinforcement Learning Conference 2024; the package icu-sepsis is not a
part of this one. The published numbers are means of simulated episodes.
"""

import re
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from cli_runner import run

from exact_mdp import MDP, Policy, check, evaluate, solve

pytest.importorskip("icu_sepsis", reason="the package icu-sepsis is not installed")
gymnasium = pytest.importorskip("gymnasium")

NAME = "icu_sepsis:Sepsis/ICU-Sepsis-v2"
NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "7_an_icu.ipynb"
PUBLISHED = {"random": (0.78, 9.45), "expert": (0.78, 9.22), "optimal": (0.88, 10.99)}


@pytest.fixture(scope="module")
def env() -> Any:
    return gymnasium.make(NAME).unwrapped


@pytest.fixture(scope="module")
def mdp(env: Any) -> MDP:
    return MDP.from_gymnasium(env)


def test_published_numbers(env: Any, mdp: MDP) -> None:
    for name, (survival, length) in PUBLISHED.items():
        policy = Policy.of(mdp, env.expert_policy, kind="policy") if name == "expert" else name
        evaluation = evaluate(mdp, policy)
        assert evaluation.start.error < 1e-11
        assert abs(evaluation.mean - survival) < 0.005 + 1e-9
        assert abs(evaluation.steps - length) < 0.02


def test_the_optimum_is_the_proven_one(mdp: MDP) -> None:
    """Notebook 7 proves it: its test runs `certify` again, and shows the same twelve digits."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    shown = "".join(str(output.get("text", "")) for cell in notebook.cells for output in
                    cell.get("outputs", ()))  # fmt: skip
    found = re.search(r"the optimum is (0\.\d{12})\nviolations found by the checker: \[\]", shown)
    assert found
    start = solve(mdp).start
    assert abs(start.value - float(found[1])) <= start.error + 0.5e-12


def test_actions_that_stand_for_the_mean_of_the_others(mdp: MDP) -> None:
    alike = np.diff(mdp.pair_offsets)[:713] - [
        len({mdp.table.weight[slice(*mdp.table.offsets[l : l + 2])].tobytes() for l in pairs})
        for pairs in (mdp.pairs_of(s) for s in range(713))
    ]
    assert alike.mean() > 20  # of 25 actions


def test_its_matrices_are_the_same_model(env: Any, mdp: MDP) -> None:
    parts = env.dynamics
    bare = MDP.from_arrays(parts["tx_mat"], parts["r_mat"], start=parts["d_0"], layout="sas")
    mine, theirs = evaluate(bare, "random"), evaluate(mdp, "random")
    assert abs(mine.mean - theirs.mean) <= mine.start.error + theirs.start.error


def test_the_commands_take_the_environment(env: Any, mdp: MDP, tmp_path: Path) -> None:
    model, file = f"gymnasium:{NAME}", str(tmp_path / "expert.npy")
    np.save(file, env.expert_policy)
    assert run("info", model, "--json").result["time_limit"] == 500
    done = run("check", model, file, "--kind", "policy", "--max-regret", "1/10", "--json")
    audit = check(mdp, Policy.of(mdp, env.expert_policy, kind="policy"))
    assert (done.status, done.result["regret"]) == (0, float(audit.value.value))
    assert done.result["optimal_value"] == pytest.approx(0.87514169961, abs=1e-11)
