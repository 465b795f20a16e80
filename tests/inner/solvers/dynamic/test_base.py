"""What solvers share: settings that are refused, values to begin with, the stopping rule."""

from time import perf_counter
from typing import Any

import numpy as np
import pytest

from exact_mdp import (
    MDP,
    ModelError,
    PolicyIteration,
    ShapeError,
    SolverError,
    Status,
    ValueIteration,
    solve,
)
from exact_mdp.solvers.bounds.bounds import bound_optimal_values
from exact_mdp.solvers.claims import PrecisionWarning
from exact_mdp.solvers.dynamic import base
from exact_mdp.solvers.dynamic.base import (
    StoppingRule,
    check_counts,
    check_tolerance,
    conclude_solution,
    given_values,
    orient_start,
    read_start_values,
)
from exact_mdp.solvers.dynamic.values import Values

SMALL = MDP.from_arrays([[[1]], [[1]]], [[1, 2]], discount="1/2")


@pytest.mark.parametrize("tol", [0, -1, np.inf, np.nan, True, "1e-3"])
def test_a_tolerance_is_positive_and_finite(tol: Any) -> None:
    with pytest.raises(ModelError, match="tol is"):
        check_tolerance("solve", tol)


def test_tolerances_and_counts_that_may_be_given() -> None:
    for tol in (None, 1e-300, 1, 1e300):
        check_tolerance("solve", tol)
    check_counts("solve", a=1, b=10**9)


@pytest.mark.parametrize("count", [0, -1, 1.5, True, "3"])
def test_a_count_is_a_whole_number_from_1_up(count: Any) -> None:
    with pytest.raises(ModelError):
        check_counts("solve", max_iterations=count)


def conclude(status: Status) -> Any:
    """Conclude a search whose values are 3.5 ± …, of the optimum 4."""
    bounds = bound_optimal_values(SMALL, np.array([3.5])).centre_bounds()
    return conclude_solution(
        SMALL, PolicyIteration(), bounds, status=status, iterations=7, started=perf_counter()
    )


def test_a_solution_has_the_middle_of_the_bounds() -> None:
    solution = conclude(Status.CONVERGED)
    assert abs(solution.value[0] - 4) <= solution.state_error[0]
    assert (solution.iterations, solution.method) == (7, "policy-iteration")
    assert solution.policy.rule.tolist() == [1]
    assert solution.regret_bound >= 0
    assert 0 <= solution.seconds < 60


def test_a_search_without_a_proof_raises_and_keeps_its_solution() -> None:
    for status in (Status.ITERATION_LIMIT, Status.NO_BOUND):
        with pytest.raises(SolverError, match="after 7 iterations") as caught:
            conclude(status)
        assert caught.value.status is status
        assert caught.value.solution.iterations == 7


@pytest.mark.parametrize("sense", ["max", "min"])
def test_a_tolerance_beyond_floats_is_in_the_status_and_in_a_warning(sense: str) -> None:
    assert conclude(Status.PRECISION).status is Status.PRECISION
    thirds = MDP.from_arrays([[["1/3", "2/3"], ["1/7", "6/7"]]], [1, 0], "9/10", sense=sense)
    for ask in (
        lambda: ValueIteration(tol=1e-30).solve(thirds),
        lambda: solve(thirds, "value-iteration", tol=1e-30),
    ):
        with pytest.warns(PrecisionWarning) as caught:
            solution = ask()
        assert solution.status is Status.PRECISION
        assert [each.filename for each in caught] == [__file__]


def test_costs_are_solved_as_negated_rewards() -> None:
    costs = MDP.from_arrays([[[1]], [[1]]], [[1, 2]], discount="1/2", sense="min")
    solution = PolicyIteration().solve(costs)
    assert (solution.value.tolist(), solution.policy.rule.tolist()) == ([2.0], [0])


STAY, GO = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 0], [0, 0, 1], [0, 0, 1]]
MODEL = MDP.from_arrays([STAY, GO], [[1, 0], [2, 5], [0, 0]], discount="1/2")


def test_zeros_values_and_policies() -> None:
    assert read_start_values(MODEL, None).tolist() == [0, 0, 0]
    assert read_start_values(MODEL, np.array([1.0, 2.0, 9.0])).tolist() == [1, 2, 0]  # an end: 0
    assert read_start_values(MODEL, [1.0, 2.0, 3.0]).tolist() == [1, 2, 0]
    # Go, go: 0 + 5/2 and 5; stay, stay: 1 / (1 - 1/2) and 2 / (1 - 1/2).
    assert read_start_values(MODEL, [1, 1, 0]) == pytest.approx([2.5, 5, 0])
    assert read_start_values(MODEL, [0, 0, 0]) == pytest.approx([2, 4, 0])
    solution = solve(MODEL)
    assert read_start_values(MODEL, solution).tolist() == solution.value.tolist()


def test_what_is_not_values_is_a_policy() -> None:
    assert given_values(MODEL, [0, 1, 0]) is None
    assert given_values(MODEL, "random") is None
    with pytest.raises(ModelError, match="the policy is mixed"):
        read_start_values(MODEL, "random")


@pytest.mark.parametrize("wrong", [np.zeros(2), np.array([0.0, np.nan, 0.0])])
def test_values_of_another_shape_or_not_finite_are_refused(wrong: np.ndarray) -> None:
    with pytest.raises(ShapeError, match="for 3 states"):
        given_values(MODEL, wrong)


def test_costs_begin_with_negated_values_and_the_same_policy() -> None:
    costs, values = MODEL.with_(sense="min"), np.array([1.0, -2.0, 0.0])
    assert orient_start(costs, None) is None
    assert orient_start(costs, values).tolist() == [-1, 2, 0]
    assert orient_start(costs, "always:1") == "always:1"
    solution = solve(MODEL)
    assert orient_start(costs, solution) is solution.policy
    assert orient_start(MODEL, values) is values
    assert orient_start(MODEL, solution) is solution


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
    values.idle = base.NEAR_ROUNDING
    assert rule.is_reached()
    assert rule.is_stalled
    assert rule.status is Status.PRECISION
    values, rule = search(OPTIMUM + 1, 1e-18)
    values.idle = base.NEAR_ROUNDING - 1
    assert not rule.is_reached()


def test_slow_searches_solve_equations_in_every_second_pass() -> None:
    values, rule = search(np.zeros(2), 1e-9)
    values.passes, values.idle = 3, base.SLOW - 1
    assert not rule.needs_equations()
    values.idle = base.SLOW
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
