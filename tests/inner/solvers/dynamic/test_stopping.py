"""The stopping rule: a proof within the tolerance, rounding's limit, or no hope."""

import numpy as np
import pytest

from exact_mdp import MDP, PolicyIteration, SolverError, Status
from exact_mdp.solvers.dynamic import stopping
from exact_mdp.solvers.dynamic.stopping import StoppingRule
from exact_mdp.solvers.dynamic.values import Values

# Two states that change places: values 4/3 and 2/3 times (a + b/2, b + a/2).
TURNS = MDP.from_arrays([[[0, 1], [1, 0]]], [1, 4], discount="1/2")
OPTIMUM = np.array([4.0, 6.0])


def search(value: np.ndarray, tol: float | None, **more: bool) -> tuple[Values, StoppingRule]:
    values = Values(TURNS, value)
    values.pass_over_pairs()
    return values, StoppingRule(values, tol, **more)


def test_it_stops_once_the_proven_error_is_within_the_tolerance() -> None:
    values, rule = search(np.zeros(2), 1e-3)
    while True:
        # The residual is 3/2 · 2^-k apart in the two states: half of it over 1 - γ is the error.
        error = (values.search.high - values.search.low) / 2
        assert rule.is_reached() is (error <= 1e-3)
        if rule.status is not None:
            break
        values.apply_backup()
        values.pass_over_pairs()
    assert rule.status is Status.CONVERGED
    assert rule.bounds is not None
    assert rule.bounds.error <= 1e-3
    assert (np.abs(rule.bounds.value - OPTIMUM) <= rule.bounds.state_error).all()
    assert rule.conclude(PolicyIteration(), 0.0).iterations == values.passes


def test_a_polished_search_waits_for_a_policy_that_stays() -> None:
    values, rule = search(OPTIMUM.copy(), None, is_polished=True)
    assert not rule.is_reached()  # near, but no policy has been seen twice
    assert rule.is_near
    assert rule.choose_evaluation_tolerance() == 0.0
    values.pass_over_pairs()
    assert rule.is_reached()


def test_bounds_that_never_fall_are_hopeless() -> None:
    values, rule = search(np.array([0.0, 100.0]), 1e-9)
    values.idle = 200 + 2 * 2 - 1
    assert not rule.is_reached()
    values.idle += 1
    assert rule.is_reached()
    assert rule.status is Status.NO_BOUND
    with pytest.raises(SolverError) as caught:
        rule.conclude(PolicyIteration(), 0.0)
    found = caught.value.solution
    assert found is not None
    assert (np.abs(found.value - OPTIMUM) <= found.state_error).all()


def test_bounds_as_wide_as_rounding_errors_are_its_limit() -> None:
    values, rule = search(OPTIMUM * (1 + 2.0**-52), 1e-18)
    values.idle = stopping.NEAR_ROUNDING
    assert rule.is_reached()
    assert rule.is_stalled
    assert rule.status is Status.PRECISION
    values, rule = search(OPTIMUM + 1, 1e-18)
    values.idle = stopping.NEAR_ROUNDING - 1
    assert not rule.is_reached()


def test_slow_searches_solve_equations_in_every_second_pass() -> None:
    values, rule = search(np.zeros(2), 1e-9)
    values.passes, values.idle = 3, stopping.SLOW - 1
    assert not rule.needs_equations()
    values.idle = stopping.SLOW
    assert rule.needs_equations()
    values.passes, values.idle = 4, 0  # once slow, always slow; but not in even passes
    assert not rule.needs_equations()
    values.passes = 5
    assert rule.needs_equations()


def test_evaluations_aim_at_a_part_of_the_narrowest_gap() -> None:
    values, rule = search(np.array([0.0, 100.0]), 1e-6)
    rule.measure()
    values.search.policy_stays, values.narrowest = False, 8.0
    for idle, part in ((0, 10), (4, 10), (5, 100), (30, 10**27), (500, np.inf)):
        values.idle = idle
        assert rule.choose_evaluation_tolerance() == pytest.approx(
            max(8.0 / part, 1e-6 / 2), rel=1e-12
        )
    values.search.policy_stays = True
    assert rule.choose_evaluation_tolerance() == pytest.approx(1e-6 / 2)
