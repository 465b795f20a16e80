"""Acyclic models: two forms of one pass, its error bounds, and how repeated blocks are laid out."""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from model_contents import is_acyclic
from oracle import evaluate_exact, solve_exact
from strategies import Rows, exact_values, models

from exact_mdp import MDP, BackwardInduction, solve


def acyclic(rows: Rows, *, floats: bool) -> MDP | None:
    mdp = rows.model(floats=floats)
    return mdp if is_acyclic(mdp) else None


@given(rows=models())
def test_the_bounds_hold_for_the_policy_and_the_optimum(rows: Rows) -> None:
    mdp = acyclic(rows, floats=False)
    if mdp is None:
        return
    found = solve(mdp, BackwardInduction())
    best, _ = solve_exact(rows.n_states, rows.pairs, rows.discount)
    policy = dict(enumerate(found.policy.tolist()))
    worth = evaluate_exact(rows.n_states, rows.pairs, rows.discount, policy)
    for optimum, reached, value, error in zip(
        best, worth, exact_values(found.value), found.state_error.tolist(), strict=True
    ):
        assert abs(optimum - value) <= F(error)
        assert abs(reached - value) <= F(error)
        assert optimum - reached <= F(found.regret_bound)


def test_rows_of_floats_that_sum_to_a_little_more_than_1_mean_halves() -> None:
    """A chain of 400 states whose rows have an excess."""
    p = np.nextafter(0.5, 1) + 2.0**-34
    rows = [(s, 0, [(p, s + 1, 1.0), (p, min(s + 2, 400), 1.0)]) for s in range(400)]
    mdp = MDP.from_outcomes([*rows, (400, 0, [(1.0, 400, 0.0)])])
    value, exact = [F(0)] * 402, F(1, 2)
    for s in range(399, -1, -1):
        value[s] = 2 * exact + exact * (value[s + 1] + value[min(s + 2, 400)])
    found = solve(mdp, BackwardInduction())
    assert all(
        abs(F(float(v)) - exact) <= F(float(e))
        for v, exact, e in zip(found.value, value[:401], found.state_error, strict=True)
    )
    assert found.error_bound < 1e-8


@pytest.mark.parametrize(
    ("row", "joint"),
    [
        ([(F(1), 1, F(1, 10**400))], False),
        ([(F(1), 1, F(-1, 10**400))], False),
        ([(F(1, 2), 1, F(1, 10**400)), (F(1, 2), 1, F(2, 10**400))], True),
        ([(1e-200, 1, 1e-200), (1 - 1e-200, 1, 0.0)], True),
    ],
)
def test_rewards_below_the_range_of_floats_are_allowed_for(
    row: list[tuple[object, int, object]], joint: bool
) -> None:
    end = [(type(row[0][0])(1), 1, type(row[0][2])(0))]
    mdp = MDP.from_outcomes([(0, 0, row), (1, 0, end)])
    assert mdp.table.joint is joint
    exact = sum(F(p) * F(r) for p, _, r in row)
    found = solve(mdp, BackwardInduction())
    assert exact != 0
    assert found.value[0] == 0
    assert abs(exact) <= F(float(found.state_error[0])) < F(1, 10**280)


def test_values_that_are_0_have_no_error() -> None:
    rows = [(0, 0, [(F(1), 1, F(0))]), (1, 0, [(F(1), 1, F(0))])]
    assert solve(MDP.from_outcomes(rows), BackwardInduction()).state_error.tolist() == [0, 0]
