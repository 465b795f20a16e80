"""Models from arrays, rows and outcomes: shapes, exactness, agreement of all forms."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from laws import laws

from exact_mdp.mdp import MDP

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
    dense = MDP.from_arrays(transition, reward, "1/2")
    forms = [
        MDP.from_arrays([sp.csr_array(matrix) for matrix in transition], reward, HALF),
        MDP.from_arrays([sp.coo_array(matrix) for matrix in transition], reward, 0.5),
        MDP.from_arrays([sp.csc_matrix(matrix) for matrix in transition], reward, 0.5),
        MDP.from_arrays(transition.tolist(), reward.tolist(), 0.5),
        MDP.from_arrays(transition.astype(np.float32), reward.astype(np.float32), 0.5),
        MDP.from_arrays(
            [[[Fraction(p) for p in row] for row in matrix] for matrix in transition],
            [[[str(Fraction(r)) for r in row] for row in matrix] for matrix in reward],
            0.5,
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


def test_sparse_duplicates_add_up() -> None:
    rows = sp.coo_array(([0.5, 0.25, 0.25, 1.0], ([0, 0, 0, 1], [1, 0, 1, 1])), shape=(2, 2))
    mdp = MDP.from_pairs([0, 1], [0, 0], rows, [0, 0])
    assert mdp.transition.toarray().tolist() == [[0.25, 0.75], [0, 1]]


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


def test_a_float_is_the_dyadic_rational_that_it_is() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(0.1, 0, 0.1), (0.9, 1, 0)]), (1, 0, [(1, 1, 0)])], 0.9)
    assert mdp.table.row(0) == [
        (Fraction(0.1), 0, Fraction(0.1)),
        (Fraction(0.9), 1, Fraction(0)),
    ]
    assert mdp.discount_exact == Fraction(0.9)
    assert mdp.discount == 0.9


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
    assert [Fraction(int(a), int(bottom[0])) for a in top[:size]] == [Fraction(p) for p in chances]
