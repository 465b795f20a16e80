"""The values to begin with: zeros, given values, and the values of a given policy."""

import numpy as np
import pytest

from exact_mdp import MDP, ModelError, ShapeError, solve
from exact_mdp.solvers.dynamic.start import given_values, orient_start, read_start_values

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
