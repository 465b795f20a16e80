"""Linear programs: both sides of the duality hold the exact optimum."""

from __future__ import annotations

from fractions import Fraction as F

import pytest
from hypothesis import given, settings
from made_models import garnet
from oracle import solve_exact
from strategies import Rows, models

from exact_mdp import LinearProgram, PolicyIteration, Scenario, certify, solve


@settings(max_examples=60)
@given(rows=models())
def test_both_sides_hold_the_exact_optimum(rows: Rows) -> None:
    mdp = rows.model()
    exact, _ = solve_exact(rows.n_states, rows.pairs, rows.discount)
    start = sum((weight * exact[state] for state, weight in mdp.start), F(0))
    run = LinearProgram().solve(mdp).program
    assert run is not None
    assert F(run.lower) <= start <= F(run.upper)
    size = float(max(map(abs, exact)) + max(abs(r) for _, _, r, _ in rows.pairs))
    assert run.gap <= 1e-7 * max(size, 1)


@pytest.mark.parametrize("solver", ["CLARABEL", "HIGHS"])
def test_the_visits_solve_the_dual_of_a_random_model(solver: str) -> None:
    mdp, discount = garnet(120, seed=0, discount=0.95), 0.95
    known, found = solve(mdp, PolicyIteration()), solve(mdp, LinearProgram(solver=solver))
    assert known.policy.tolist() == found.policy.tolist()
    assert abs(known.value - found.value).max() <= known.error_bound + found.error_bound
    run = found.program
    assert run is not None
    assert (run.by, run.variables, run.constraints) == (solver, 120, 360)
    assert run.lower <= found.start_value <= run.upper
    assert run.gap < 1e-11
    # Visits at a constant discount add up to 1 / (1 - γ).
    assert found.occupancy.sum() == pytest.approx(1 / (1 - discount), rel=1e-10)
    assert (found.gaps > -1e-9).all()


def test_the_care_model() -> None:
    mdp = Scenario.load("yuan2025").compile()
    run = LinearProgram().solve(mdp).program
    assert run is not None
    assert F(run.lower) <= certify(mdp).start_value <= F(run.upper)
    assert run.gap < 1e-9
