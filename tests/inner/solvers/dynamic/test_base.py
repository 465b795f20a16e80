"""The interface of solvers: settings that are refused, and the end of a search."""

from time import perf_counter
from typing import Any

import numpy as np
import pytest

from exact_mdp import MDP, ModelError, PolicyIteration, SolverError, Status, ValueIteration, solve
from exact_mdp.solvers.bounds.bounds import bound_optimal_values
from exact_mdp.solvers.claims import PrecisionWarning
from exact_mdp.solvers.dynamic.base import check_counts, check_tolerance, conclude_solution

MODEL = MDP.from_arrays([[[1]], [[1]]], [[1, 2]], discount="1/2")


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
    bounds = bound_optimal_values(MODEL, np.array([3.5])).centre_bounds()
    return conclude_solution(
        MODEL, PolicyIteration(), bounds, status=status, iterations=7, started=perf_counter()
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
