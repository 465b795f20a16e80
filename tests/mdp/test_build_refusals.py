"""Arrays, rows and outcomes that are no model: each is refused, with the place and the remedy."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from exact_mdp.mdp import MDP, ModelError

HALF = Fraction(1, 2)
P = np.array([[[0.5, 0.5, 0.0], [0, 0.25, 0.75], [0, 0, 1]], [[0, 1, 0], [0.5, 0, 0.5], [0, 0, 1]]])
R_PAIR = np.array([[1.0, 2.0], [3.0, -4.0], [0.0, 0.0]])


def spoiled(action: int, state: int, following: int, value: float) -> Any:
    array = P.copy()
    array[action, state, following] = value
    return array


BAD_ARRAYS: dict[str, tuple[Any, Any, Any, str]] = {
    "row sum": (spoiled(1, 1, 0, 0.4), R_PAIR, 0.9, "transition probabilities sum to 0.9, not 1"),
    "row of zeros": (spoiled(0, 2, 2, 0), R_PAIR, 0.9, "sum to 0, not 1"),
    "negative": ([[[1.5, -0.5], [0, 1]]], [0, 0], 0.9, "a probability is -0.5"),
    "nan": (spoiled(0, 0, 0, np.nan), R_PAIR, 0.9, "a probability is nan"),
    "inf": (spoiled(0, 0, 0, np.inf), R_PAIR, 0.9, "a probability is inf"),
    "reward nan": (P, np.where(R_PAIR == 3, np.nan, R_PAIR), 0.9, "a reward is nan"),
    "reward inf": (P, np.where(R_PAIR == 3, -np.inf, R_PAIR), 0.9, "a reward is -inf"),
    "reward word": (P, [["a", "b"]] * 3, 0.9, "not a finite rational"),
    "reward complex": (P, R_PAIR * 1j, 0.9, "complex"),
    "reward ragged": (P, [[1, 2], [3], [4, 5]], 0.9, "different lengths"),
    "reward shape": (P, np.zeros((2, 3)), 0.9, "rewards have shape (2, 3)"),
    "reward scalar": (P, 1.0, 0.9, "rewards have shape ()"),
    "reward nothing": (P, None, 0.9, "not a number"),
    "transitions flat": (P[0], R_PAIR, 0.9, "transitions have shape (3, 3)"),
    "transitions not square": (P[:, :, :2], R_PAIR, 0.9, "transitions have shape (2, 3, 2)"),
    "transitions empty": (np.zeros((0, 0, 0)), np.zeros(0), 0.9, "transitions have shape"),
    "transitions nothing": ([], [], 0.9, "transitions have shape"),
    "transitions ragged": ([[[1.0]], [[0.5, 0.5], [0, 1]]], [0], 0.9, "different lengths"),
    "transitions words": ([[["a"]]], [0], 0.9, "not a finite rational"),
    "transitions complex": (P * 1j, R_PAIR, 0.9, "complex"),
    "mixed kinds": ([sp.csr_array(P[0]), P[1]], R_PAIR, 0.9, "mixes sparse and dense"),
    "sparse sizes": ([sp.eye_array(2), sp.eye_array(3)], [0, 0], 0.9, "shapes"),
    "sparse not square": ([sp.csr_array(np.ones((2, 3)))], [0, 0], 0.9, "shapes"),
    "sparse nan": ([sp.csr_array(np.array([[np.nan]]))], [0], 0.9, "a probability is nan"),
    "sparse complex": ([sp.csr_array(np.array([[1j]]))], [0], 0.9, "complex"),
    "exact row sum": ([[["1/3", "1/3"], [0, 1]]], [0, 0], 0.9, "sum to 0.666666666667, not 1"),
    "exact near miss": (
        [[[Fraction(1, 2), HALF - Fraction(1, 10**30)], [0, 1]]], [0, 0], 0.9, "not 1",
    ),
    "discount above": (P, R_PAIR, 1.1, "discount is 1.1, outside [0, 1]"),
    "discount below": (P, R_PAIR, -0.1, "outside [0, 1]"),
    "discount nan": (P, R_PAIR, float("nan"), "not a finite rational"),
    "discount word": (P, R_PAIR, "high", "not a finite rational"),
    "discount bool": (P, R_PAIR, True, "not a number"),
    "discount nothing": (P, R_PAIR, None, "not a number"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_ARRAYS)
def test_arrays_that_are_no_model(name: str) -> None:
    transition, reward, discount, message = BAD_ARRAYS[name]
    with pytest.raises(ModelError) as caught:
        MDP.from_arrays(transition, reward, discount)
    assert message in caught.value.what


def test_a_row_that_no_policy_uses_is_checked_too() -> None:
    with pytest.raises(ModelError) as caught:
        MDP.from_arrays(spoiled(1, 1, 0, 0.4), R_PAIR, 0.9, actions=["stay", "go"])
    assert caught.value.where == "state (state 1), action go"
    assert "missing outcome" in caught.value.fix


EYE = np.eye(2)
BAD_PAIRS: dict[str, tuple[Any, Any, Any, Any, str]] = {
    "duplicate": ([0, 0, 1], [1, 1, 0], [[1, 0], [1, 0], [0, 1]], [0, 0, 0], "appears twice"),
    "state out of range": ([0, 2], [0, 0], EYE, [0, 0], "state 2 is outside 0 … 1"),
    "state negative": ([0, -1], [0, 0], EYE, [0, 0], "state -1 is outside 0 … 1"),
    "action negative": ([0, 1], [0, -1], EYE, [0, 0], "action -1 is outside"),
    "state without action": ([0, 0], [0, 1], EYE, [0, 0], "a state without action"),
    "no pairs": ([], [], np.zeros((0, 2)), [], "without state-action pairs"),
    "too few actions": ([0, 1], [0], EYE, [0, 0], "2 states and 1 actions"),
    "too few rows": ([0, 1], [0, 0], EYE[:1], [0, 0], "transitions of shape (1, 2)"),
    "flat rows": ([0, 1], [0, 0], [1.0, 1.0], [0, 0], "transitions of shape (2,)"),
    "too few rewards": ([0, 1], [0, 0], EYE, [0], "rewards have shape (1,)"),
    "float states": ([0.0, 1.0], [0, 0], EYE, [0, 0], "pair_state is not a list of whole numbers"),
    "bool actions": ([0, 1], [False, True], EYE, [0, 0], "pair_action is not a list"),
    "square states": ([[0, 1]], [0, 0], EYE, [0, 0], "pair_state is not a list"),
    "nan": ([0, 1], [0, 0], [[np.nan, 1], [0, 1]], [0, 0], "a probability is nan"),
    "empty row": ([0, 1], [0, 0], sp.csr_array(np.diag([1.0, 0])), [0, 0], "sum to 0, not 1"),
}


@pytest.mark.parametrize("name", BAD_PAIRS)
def test_pairs_that_are_no_model(name: str) -> None:
    state, action, transition, reward, message = BAD_PAIRS[name]
    with pytest.raises(ModelError) as caught:
        MDP.from_pairs(state, action, transition, reward)
    assert message in caught.value.what


BAD_OUTCOMES: dict[str, tuple[Any, str]] = {
    "nothing": ([], "without state-action pairs"),
    "no outcome": ([(0, 0, [])], "sum to 0, not 1"),
    "row sum": ([(0, 0, [("1/2", 0, 0)])], "sum to 0.5, not 1"),
    "negative": ([(0, 0, [("3/2", 0, 0), ("-1/2", 0, 1)])], "a probability is -0.5"),
    "next state": ([(0, 0, [(1, 1, 0)])], "a state without action"),
    "next huge": ([(0, 0, [(1, 10**12, 0)])], "a state without action"),
    "state huge": ([(0, 0, [(1, 0, 0)]), (2**62, 0, [(1, 0, 0)])], "a state without action"),
    "next beyond 64 bits": ([(0, 0, [(1, 2**70, 0)])], "right form"),
    "next negative": ([(0, 0, [(1, -1, 0)])], "next state -1 is outside"),
    "duplicate": ([(0, 0, [(1, 0, 0)]), (0, 0, [(1, 0, 1)])], "appears twice"),
    "float state": ([(0.0, 0, [(1, 0, 0)])], "right form"),
    "float next state": ([(0, 0, [(1, 0.5, 0)])], "right form"),
    "short outcome": ([(0, 0, [(1, 0)])], "right form"),
    "short row": ([(0, 0)], "right form"),
    "number for a row": ([7], "right form"),
    "word": ([(0, 0, [("half", 0, 0)])], "not a finite rational"),
    "nothing for a reward": ([(0, 0, [(1, 0, None)])], "not a number"),
    "infinite reward": ([(0, 0, [(1.0, 0, float("inf"))])], "a reward is inf"),
    "reward beyond floats": ([(0, 0, [(1, 0, 10**400)])], "too large"),
    "rational beyond floats among floats": (
        [(0, 0, [(0.5, 0, 10**400), (0.5, 0, 0.5)])],
        "too large for a float",
    ),
    "negative beyond floats": ([(0, 0, [(-(10**400), 0, 0)])], "a probability is -1e400"),
    "sum beyond floats": ([(0, 0, [(10**400, 0, 0)])], "sum to 1e400, not 1"),
    "word for a state": ([(0, 0, [(1, 0, 0)]), ("one", 0, [(1, 0, 0)])], "right form"),
}


@pytest.mark.parametrize("name", BAD_OUTCOMES)
def test_outcomes_that_are_no_model(name: str) -> None:
    listed, message = BAD_OUTCOMES[name]
    with pytest.raises(ModelError) as caught:
        MDP.from_outcomes(listed)
    assert message in caught.value.what


def test_names_that_do_not_fit_are_refused() -> None:
    with pytest.raises(TypeError, match="colour"):
        MDP.from_arrays(P, R_PAIR, 0.9, colour="red")
    with pytest.raises(ModelError, match=r"without action(.|\n)*state d"):
        MDP.from_arrays(P, R_PAIR, 0.9, states=["a", "b", "c", "d"])
    with pytest.raises(ModelError, match="2 state labels"):
        MDP.from_arrays(P, R_PAIR, 0.9, states=["a", "b"])
    with pytest.raises(ModelError):
        MDP.from_arrays(P, R_PAIR, 0.9, actions=["a"])


def test_rows_may_miss_one_by_rounding_alone() -> None:
    third = [1 / 3, 1 / 3, 1 / 3]
    assert MDP.from_arrays([[third] * 3], [0, 0, 0]).n_pairs == 3
    with pytest.raises(ModelError, match="not 1"):
        MDP.from_arrays([[[1 / 3, 1 / 3, 1 / 3 + 1e-8]] * 3], [0, 0, 0])
