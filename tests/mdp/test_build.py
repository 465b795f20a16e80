"""Models from arrays, rows and outcomes: all forms agree, and what is no model is refused.

And what a model is called, where it starts, how it is changed; nothing else changes it.
"""

from __future__ import annotations

import pickle
from collections import defaultdict
from fractions import Fraction
from inspect import signature
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import laws

import exact_mdp
from exact_mdp import (
    MDP,
    DistributionError,
    ModelError,
    NegativeError,
    Scenario,
    ShapeError,
    StateSpace,
)

HALF = Fraction(1, 2)
P = np.array([[[0.5, 0.5, 0.0], [0, 0.25, 0.75], [0, 0, 1]], [[0, 1, 0], [0.5, 0, 0.5], [0, 0, 1]]])
R_PAIR = np.array([[1.0, 2.0], [3.0, -4.0], [0.0, 0.0]])


# ---- random exact models ----------------------------------------------------------------------

positive = st.integers(1, 30)
rewards = st.fractions(-50, 50, max_denominator=40)
wide = st.fractions(0, 1).map(lambda x: x + Fraction(1, 3**50))


@st.composite
def rows(draw: st.DrawFn, gains: st.SearchStrategy[Fraction] = rewards) -> list[Any]:
    """Rows for `from_outcomes`: 1 to 4 states, 1 to 3 actions each, exact numbers."""
    states = draw(st.integers(1, 4))
    listed = []
    for state in range(states):
        for action in draw(st.sets(st.integers(0, 2), min_size=1)):
            size = draw(st.integers(1, 4))
            weights = [draw(positive) for _ in range(size)]
            outcomes = [
                (Fraction(w, sum(weights)), draw(st.integers(0, states - 1)), draw(gains))
                for w in weights
            ]
            listed.append((state, action, outcomes))
    return listed


def law_of(outcomes: list[Any]) -> dict[tuple[int, Fraction], Fraction]:
    law: dict[tuple[int, Fraction], Fraction] = defaultdict(Fraction)
    for probability, following, reward in outcomes:
        law[following, reward] += probability
    return dict(law)


@given(rows(), st.randoms(use_true_random=False))
def test_outcomes_are_kept_exactly_in_any_order(listed: list[Any], random: Any) -> None:
    shuffled = list(listed)
    random.shuffle(shuffled)
    mdp = MDP.from_outcomes(shuffled, "9/10")
    assert laws(mdp) == {(s, str(a)): law_of(outcomes) for s, a, outcomes in listed}
    assert mdp.discount_exact == Fraction(9, 10)


@given(rows(st.one_of(rewards, wide)))
def test_every_float_is_its_rational_rounded_once(listed: list[Any]) -> None:
    mdp = MDP.from_outcomes(listed)
    chance, gain = mdp.table.probabilities().tolist(), mdp.table.gains().tolist()
    first = mdp.table.offsets.tolist()
    dense = mdp.transition.toarray()
    for pair in range(mdp.n_pairs):
        row = mdp.table.row(pair)
        span = slice(first[pair], first[pair + 1])
        assert chance[span] == [float(p) for p, _, _ in row]
        assert gain[span] == [float(r) for _, _, r in row]
        assert mdp.reward[pair] == float(sum(p * r for p, _, r in row))
        for state in range(mdp.n_states):
            assert dense[pair, state] == float(sum(p for p, n, _ in row if n == state))


@given(rows())
def test_rows_and_outcomes_agree(listed: list[Any]) -> None:
    mdp = MDP.from_outcomes(listed)
    size = mdp.n_states
    transition = [[Fraction(0)] * size for _ in listed]
    expected = [Fraction(0) for _ in listed]
    for number, (_, _, outcomes) in enumerate(listed):
        for p, n, r in outcomes:
            transition[number][n] += p
            expected[number] += p * r
    state, action = [s for s, _, _ in listed], [a for _, a, _ in listed]
    again = MDP.from_pairs(state, action, transition, expected)
    assert again.transition.toarray().tolist() == mdp.transition.toarray().tolist()
    assert again.reward.tolist() == mdp.reward.tolist()
    assert again.pair_state.tolist() == mdp.pair_state.tolist()
    assert again.pair_action.tolist() == mdp.pair_action.tolist()
    exact = {pair: sum(p * r for (_, r), p in law.items()) for pair, law in laws(mdp).items()}
    assert {pair: sum(p * r for (_, r), p in law.items()) for pair, law in laws(again).items()} == (
        exact
    )


@st.composite
def arrays(draw: st.DrawFn) -> tuple[Any, Any]:
    """Float transitions (A, S, S), their rows in 1/64 and so exact, and rewards (A, S, S)."""
    actions, states = draw(st.integers(1, 3)), draw(st.integers(1, 4))
    cuts = st.lists(st.integers(0, 64), min_size=states - 1, max_size=states - 1)
    transition = np.array(
        [
            [np.diff([0, *sorted(draw(cuts)), 64]) / 64 for _ in range(states)]
            for _ in range(actions)
        ]
    )
    numbers = st.integers(-8, 8)
    size = actions * states * states
    reward = np.array(draw(st.lists(numbers, min_size=size, max_size=size)), dtype=float)
    return transition, reward.reshape(actions, states, states) / 4


@given(arrays())
def test_dense_sparse_and_exact_arrays_agree(given: tuple[Any, Any]) -> None:
    transition, reward = given
    dense = MDP.from_arrays(transition, reward, "1/2", layout="ass")
    forms = [
        MDP.from_arrays(
            [sp.csr_array(matrix) for matrix in transition], reward, HALF, layout="ass"
        ),
        MDP.from_arrays([sp.coo_array(matrix) for matrix in transition], reward, 0.5, layout="ass"),
        MDP.from_arrays(
            [sp.csc_matrix(matrix) for matrix in transition], reward, 0.5, layout="ass"
        ),
        MDP.from_arrays(transition.tolist(), reward.tolist(), 0.5, layout="ass"),
        MDP.from_arrays(
            transition.astype(np.float32), reward.astype(np.float32), 0.5, layout="ass"
        ),
        MDP.from_arrays(
            [[[Fraction(p) for p in row] for row in matrix] for matrix in transition],
            [[[str(Fraction(r)) for r in row] for row in matrix] for matrix in reward],
            0.5,
            layout="ass",
        ),
    ]
    for other in forms:
        assert laws(other) == laws(dense)
        assert other.transition.toarray().tolist() == dense.transition.toarray().tolist()
        assert other.reward.tolist() == dense.reward.tolist()
        assert other.n_transitions == np.count_nonzero(transition)
        assert other.discount_exact == HALF


def test_arrays_mean_what_the_contract_says() -> None:
    mdp = MDP.from_arrays(P, R_PAIR, discount=0.9)
    assert (mdp.n_states, mdp.n_actions, mdp.n_pairs) == (3, 2, 6)
    for state in range(3):
        for action in range(2):
            pair = mdp.pair(state, action)
            assert mdp.transition.toarray()[pair].tolist() == P[action, state].tolist()
            assert mdp.reward[pair] == R_PAIR[state, action]
    by_state = MDP.from_arrays(P, [5.0, 6.0, 0.0], 0.9)
    assert by_state.reward.reshape(3, 2).tolist() == [[5, 5], [6, 6], [0, 0]]
    by_move = np.arange(18.0).reshape(2, 3, 3)
    found = MDP.from_arrays(P, by_move, 0.9).reward.reshape(3, 2).T
    assert found == pytest.approx((P * by_move).sum(axis=2))
    assert mdp.terminal.tolist() == [False, False, True]
    assert mdp.backup(np.array([1.0, 2.0, 4.0])) == pytest.approx(
        (R_PAIR + 0.9 * (P @ [1.0, 2.0, 4.0]).T).reshape(-1)
    )


def test_a_square_reward_array_is_of_states_and_actions() -> None:
    """Where S = A, the shape (S, A) alone says which index is which."""
    transition = np.stack([np.eye(2), np.eye(2)[::-1]])
    mdp = MDP.from_arrays(transition, [[1.0, 2.0], [3.0, 4.0]], 0.5)
    assert mdp.reward.tolist() == [1, 2, 3, 4]


def test_pairs_may_be_missing_and_unsorted() -> None:
    transition = np.array([[0, 1.0], [1, 0], [0.5, 0.5]])
    for form in (transition, sp.csr_array(transition), sp.coo_matrix(transition)):
        mdp = MDP.from_pairs([1, 0, 0], [2, 1, 0], form, [10.0, 20.0, 30.0], "1/2")
        assert mdp.pair_state.tolist() == [0, 0, 1]
        assert mdp.pair_action.tolist() == [0, 1, 2]
        assert mdp.reward.tolist() == [30, 20, 10]
        assert mdp.transition.toarray().tolist() == [[0.5, 0.5], [1, 0], [0, 1]]
        assert mdp.forced.tolist() == [False, True]
        assert list(mdp.pairs_of(0)) == [0, 1]


def test_rewards_of_moves_may_be_sparse() -> None:
    rows, gains = np.array([[0.5, 0.5], [0, 1]]), np.array([[0, 4.0], [9, 1]])
    dense = MDP.from_pairs([0, 1], [0, 0], rows, gains)
    for form in (sp.csr_array, sp.coo_array, sp.csc_matrix, sp.lil_matrix, sp.dok_array):
        for transition in (rows, form(rows)):
            mdp = MDP.from_pairs([0, 1], [0, 0], transition, form(gains))
            assert laws(mdp) == laws(dense)
    assert dense.table.row(0) == [(HALF, 0, 0), (HALF, 1, 4)]


def test_what_is_given_is_not_changed() -> None:
    transition, reward = P.copy(), R_PAIR.copy()
    sparse = [sp.csr_array(matrix) for matrix in P]
    mdp = MDP.from_arrays(transition, reward, 0.9)
    MDP.from_arrays(sparse, reward, 0.9)
    state, action = np.array([0, 1]), np.array([0, 0])
    rows, gains = np.eye(2), np.zeros(2)
    MDP.from_pairs(state, action, rows, gains)
    for array in (transition, reward, state, action, rows, gains, sparse[0].data):
        assert array.flags.writeable
        array[...] = 0
    assert mdp.transition.toarray()[0].tolist() == [0.5, 0.5, 0]
    assert mdp.reward[0] == 1


@pytest.mark.parametrize("value", [Fraction(1, 3), "1/3", 1, True and 1, "0.25", "1e-3"])
def test_exact_numbers_stay_exact(value: Any) -> None:
    other = 1 - Fraction(value)
    mdp = MDP.from_arrays([[[value, other], [0, 1]]], [value, 0])
    law = {0: Fraction(value), 1: other}
    assert {n: p for p, n, _ in mdp.table.row(0)} == {n: p for n, p in law.items() if p}
    assert mdp.table.row(0)[0][2] == Fraction(value)


def test_numbers_that_outgrow_64_bits() -> None:
    tiny = Fraction(1, 3**60)
    mdp = MDP.from_outcomes([(0, 0, [(tiny, 0, 10**30), (1 - tiny, 1, 0)]), (1, 0, [(1, 1, 0)])])
    assert mdp.table.weight.dtype == object
    assert mdp.table.row(0)[0] == (tiny, 0, 10**30)
    assert mdp.reward[0] == float(tiny * 10**30)
    assert mdp.transition.data[0] == float(tiny)


@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=6))
def test_any_float_reward_is_exact(values: list[float]) -> None:
    size = len(values)
    mdp = MDP.from_outcomes([(s, 0, [(1, s, values[s])]) for s in range(size)], HALF)
    top, bottom = mdp.table.integer_gains()
    assert [Fraction(int(a), int(b)) for a, b in zip(top, bottom, strict=True)] == [
        Fraction(value) for value in values
    ]
    assert mdp.reward.tolist() == values


@settings(max_examples=50)
@given(st.lists(st.integers(1, 2**53), min_size=2, max_size=5))
def test_float_probabilities_are_exact_too(weights: list[int]) -> None:
    chances = [weight / sum(weights) for weight in weights]
    chances = [chance for chance in chances if chance > 0]
    size = len(chances)
    listed = [(0, 0, [(p, s, 0) for s, p in enumerate(chances)])]
    mdp = MDP.from_outcomes(listed + [(s, 0, [(1, s, 0)]) for s in range(1, size)])
    top, bottom = mdp.table.integer_weights()
    exact = [Fraction(int(a), int(bottom[0])) for a in top[:size]]
    assert sum(exact) == 1
    assert [float(p) for p in exact] == mdp.table.probabilities()[:size].tolist()


def test_a_sparse_array_of_pair_rewards_works() -> None:
    """Sparse rewards of shape (S, A) are those of the dense array."""
    rewards = np.array([[0.0, 1.5], [2.0, 0.0], [0.0, -1.0]])
    P = [np.eye(3), np.eye(3)[[1, 2, 0]]]
    for form in (sp.csr_array, sp.csc_matrix, sp.coo_array, sp.lil_matrix):
        mdp = MDP.from_arrays(P, form(rewards), 0.5)
        assert mdp.reward.tolist() == rewards.reshape(-1).tolist()
        assert MDP.from_arrays(P, form(rewards.astype(int)), 0.5).table.gain.dtype == np.int64


# ---- what is no model ----------------------------------------------------------------------------


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
    "reward inf": (P, np.where(R_PAIR == 3, np.inf, R_PAIR), 0.9, "a reward is inf"),
    "no action": (P, np.where(R_PAIR == 0, -np.inf, R_PAIR), 0.9, "a state without action"),
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
KINDS = {
    "row": DistributionError,
    "nan": DistributionError,
    "exact": DistributionError,
    "negative": NegativeError,
    "reward shape": ShapeError,
    "reward scalar": ShapeError,
    "transitions flat": ShapeError,
    "sparse sizes": ShapeError,
}


@pytest.mark.parametrize("name", BAD_ARRAYS)
def test_arrays_that_are_no_model(name: str) -> None:
    transition, reward, discount, message = BAD_ARRAYS[name]
    with pytest.raises(ModelError) as caught:
        MDP.from_arrays(transition, reward, discount)
    assert message in caught.value.what
    kind = type(caught.value)
    assert kind is KINDS.get(name.partition(" ")[0], KINDS.get(name, kind))


def test_a_row_that_no_policy_uses_is_checked_too() -> None:
    with pytest.raises(ModelError) as caught:
        MDP.from_arrays(spoiled(1, 1, 0, 0.4), R_PAIR, 0.9, actions=["stay", "go"])
    assert caught.value.where == "state (state 1), action go"
    assert "missing outcome" in caught.value.fix


EYE = np.eye(2)
BAD_PAIRS: dict[str, tuple[Any, Any, Any, Any, str]] = {
    "duplicate": ([0, 0, 1], [1, 1, 0], [[1, 0], [1, 0], [0, 1]], [0, 0, 0], "appears twice"),
    "state out of range": ([0, 2], [0, 0], EYE, [0, 0], "there is no state 2"),
    "state negative": ([0, -1], [0, 0], EYE, [0, 0], "there is no state -1"),
    "action negative": ([0, 1], [0, -1], EYE, [0, 0], "there is no action -1"),
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
    "next negative": ([(0, 0, [(1, -1, 0)])], "there is no next state -1"),
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
    with pytest.raises(ModelError, match="no option colour="):
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


def damaged(place: int) -> sp.csr_array:
    matrix = sp.csr_array(np.eye(2))
    matrix.indices[1] = place
    return matrix


SPARSE = sp.csr_array(np.eye(2))
REFUSED: dict[str, tuple[Any, Any, str, str]] = {
    "three dimensions": (sp.coo_array(np.stack([np.eye(2)] * 2)), [0, 0], "P", "(2, 2, 2)"),
    "index of P": ([damaged(5)], [0, 0], "P", "column 5"),
    "negative index of P": ([damaged(-1)], [0, 0], "P", "column -1"),
    "index of R": ([SPARSE, SPARSE], [SPARSE, damaged(7)], "R", "column 7"),
    "shapes of R": ([SPARSE, SPARSE], [SPARSE, sp.eye_array(3)], "R", "matrices of rewards"),
    "size of R": ([SPARSE, SPARSE], [sp.eye_array(3)] * 2, "R", "rewards have shape (2, 3, 3)"),
    "kinds of R": ([SPARSE, SPARSE], [SPARSE, np.eye(2)], "R", "R mixes sparse and dense"),
    "words in R": ([SPARSE], ["a", "b"], "R", "not a finite rational"),
    "complex R": ([SPARSE], sp.csr_array(np.eye(2) * 1j), "R", "complex"),
    "shape of sparse R": (
        [SPARSE],
        sp.csr_array(np.ones((3, 1))),
        "R",
        "rewards have shape (3, 1)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_errors_name_the_array_that_is_wrong(name: str) -> None:
    """No error of SciPy, and none about R that speaks of P."""
    P, R, where, what = REFUSED[name]
    with pytest.raises(ModelError) as caught:
        MDP.from_arrays(P, R, 0.5)
    assert caught.value.where == where
    assert what in caught.value.what
    assert caught.value.fix


# ---- names, the start, and changes --------------------------------------------------------------


def test_names_and_start() -> None:
    mdp = MDP.from_arrays(
        P, R_PAIR, 0.9, start={1: "1/3", 0: "2/3", 2: 0}, actions=["stay", "go"],
        states=["a", "b", "c"], name="three",
    )  # fmt: skip
    assert mdp.start == ((0, Fraction(2, 3)), (1, Fraction(1, 3)))
    assert mdp.start_distribution == pytest.approx([2 / 3, 1 / 3, 0])
    assert (mdp.actions, mdp.name, mdp.space.label(1)) == (("stay", "go"), "three", "state b")
    assert mdp.where(3) == "state (state b), action go"
    assert mdp.pair(1, "go") == mdp.pair(1, 1) == 3
    with pytest.raises(ModelError, match="did you mean stay"):
        mdp.action("sty")


def test_with_validates_again() -> None:
    mdp = MDP.from_arrays(P, R_PAIR, 0.9)
    assert mdp.with_(discount="1/3").discount_exact == Fraction(1, 3)
    assert (mdp.discount, mdp.discount_exact) == (0.9, Fraction(0.9))
    assert mdp.with_(start=2).start == ((2, Fraction(1)),)
    assert mdp.with_(start={0: HALF, 2: HALF}).start_distribution.tolist() == [0.5, 0, 0.5]
    assert mdp.with_(name="x", actions=("l", "r")).actions == ("l", "r")
    for bad in (
        {"discount": 1.5},
        {"discount": "x"},
        {"start": 3},
        {"start": -1},
        {"start": {0: HALF}},
        {"start": {0: 2, 1: -1}},
        {"start": {0: 10**400}},
        {"discount": 10**400},
        {"start": "first"},
        {"start": True},
        {"start": {}},
        {"actions": ("a", "a")},
        {"actions": ("a",)},
        {"space": StateSpace.plain(2)},
        {"space": StateSpace.plain(4)},
        {"pair_state": mdp.pair_state[::-1]},
        {"pair_state": mdp.pair_state[:-1]},
        {"components": np.zeros((6, 1))},
        {"component_names": ("a", "b")},
        {"components": np.zeros((5, 1))},
    ):
        with pytest.raises(ModelError):
            mdp.with_(**bad)


def test_a_new_table_has_new_components() -> None:
    mdp = MDP.from_arrays(P, R_PAIR, 0.9)
    other = MDP.from_arrays(P, R_PAIR + 1, 0.9)
    changed = mdp.with_(table=other.table)
    assert changed.reward.tolist() == other.reward.tolist()
    assert changed.components[:, 0].tolist() == other.reward.tolist()


def test_a_model_is_frozen_and_survives_a_pickle() -> None:
    mdp = MDP.from_outcomes(
        [(0, 0, [("1/3", 0, 1), ("2/3", 1, 2)]), (1, 0, [(1, 1, 0)])], "9/10", name="small"
    )
    for model in (mdp, pickle.loads(pickle.dumps(mdp))):
        assert laws(model) == laws(mdp)
        assert (model.name, model.discount_exact, model.space) == (
            "small",
            Fraction(9, 10),
            mdp.space,
        )
        for array in (
            model.reward, model.components, model.pair_state, model.pair_action,
            model.pair_offsets, model.table.offsets, model.table.next, model.table.weight,
            model.table.gain, model.transition.data, model.transition.indices,
            model.start_distribution,
        ):  # fmt: skip
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0
        with pytest.raises(AttributeError):
            model.name = "other"


def test_repr_says_the_sizes() -> None:
    assert repr(MDP.from_arrays(P, R_PAIR, "9/10", name="three")) == (
        "MDP(three: 3 states, 2 actions, 6 pairs, 9 transitions, discount 9/10)"
    )


TAKES_MODEL = (
    "solve certify evaluate check assert_policy_optimal return_distribution simulate train tradeoff"
    " rationalize curve thresholds tornado one_way two_way gradient robust"
)


@pytest.mark.parametrize("name", TAKES_MODEL.split())
def test_an_option_that_there_is_not_is_refused(name: str) -> None:
    """Python's own TypeError said neither that the model has the discount nor how to change it."""
    function = getattr(exact_mdp, name)
    care = Scenario.load("yuan2025")
    given = (care, "random") if "policy" in signature(function).parameters else (care,)
    with pytest.raises(ModelError, match="no option gamma=") as caught:
        function(*given, gamma=0.9)
    assert caught.value.where
    assert "say mdp.with_(discount=" in caught.value.fix
    with pytest.raises(ModelError, match="no option discuont=") as caught:
        MDP.load("m.npz", discuont=0.9)  # type: ignore[call-arg]
    assert caught.value.fix == "did you mean discount?"
