"""Exactness belongs to each number: any mixture of kinds, in every constructor and reader."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from mixed_numbers import Law, again, floats, kinds, optimal, rows_of

from exact_mdp.mdp import MDP, ModelError
from exact_mdp.mdp.io.npz import load, save
from exact_mdp.solvers import certify

REWARDS = (F(1, 7), F(1, 4), F(3), F(-2, 5), F(0), F(2**60 + 1), F(1, 2**70), F(-7, 8))
EYE = [[1, 0], [0, 1]]


@st.composite
def laws(draw: st.DrawFn) -> tuple[int, list[Law], F]:
    """Draw a number of states, rows that sum to 1 exactly, binary or not, and a discount."""
    states = draw(st.integers(1, 3))
    rows: list[Law] = []
    for state in range(states):
        for action in range(draw(st.integers(1, 2))):
            weights = draw(st.lists(st.sampled_from([1, 2, 3, 5]), min_size=1, max_size=3))
            if draw(st.booleans()):  # of a power of two
                weights = [*weights, 32 - sum(weights)]
            outcomes = [
                (
                    F(w, sum(weights)),
                    draw(st.integers(0, states - 1)),
                    draw(st.sampled_from(REWARDS)),
                )
                for w in weights
            ]
            rows.append((state, action, outcomes))
    return states, rows, draw(st.sampled_from([F(0), F(1, 2), F(9, 10)]))


@settings(max_examples=150)
@given(laws(), st.data())
def test_a_mixture_is_worth_what_fractions_are_worth(
    law: tuple[int, list[Law], F], data: st.DataObject
) -> None:
    """Each number may be given in any kind that holds it: the values are the same fractions."""
    states, rows, discount = law

    def any_kind(value: F) -> Any:
        return data.draw(st.sampled_from(kinds(value)))

    mixed = [
        (s, a, [(any_kind(p), t, any_kind(r)) for p, t, r in outcomes]) for s, a, outcomes in rows
    ]
    mdp = MDP.from_outcomes(mixed, any_kind(discount))
    found = certify(mdp)
    assert list(found.value) == optimal(rows, states, discount)
    assert found.violations() == []


@settings(max_examples=150)
@given(laws(), st.data())
def test_a_float_of_the_same_value_changes_nothing(
    law: tuple[int, list[Law], F], data: st.DataObject
) -> None:
    """Replacing any of the fractions that are binary by floats leaves all fractions as they are."""
    _, rows, discount = law

    def perhaps(value: F) -> Any:
        return data.draw(st.sampled_from([value, *floats(value)]))

    mixed = [(s, a, [(perhaps(p), t, perhaps(r)) for p, t, r in law]) for s, a, law in rows]
    plain = certify(MDP.from_outcomes(rows, discount))
    other = certify(MDP.from_outcomes(mixed, perhaps(discount)))
    assert list(other.value) == list(plain.value)
    assert list(other.gaps) == list(plain.gaps)
    assert other.optimal_pairs.tolist() == plain.optimal_pairs.tolist()
    assert (other.start_value, other.unique) == (plain.start_value, plain.unique)
    assert other.model == plain.model


def test_one_float_among_fractions_leaves_them_exact() -> None:
    """Rewards [1/7, 0.25]: both count as they are, in every constructor."""
    swap = [[0, 1], [1, 0]]
    exact = certify(MDP.from_arrays([swap], [F(1, 7), F(1, 4)], F(9, 10)))
    wanted = list(exact.value)
    assert wanted[0] == (F(1, 7) + F(9, 10) * F(1, 4)) / (1 - F(81, 100))
    mixed = [F(1, 7), 0.25]
    moved = [[0, F(1, 7)], [0.25, 0]]
    for mdp in (
        MDP.from_arrays([swap], mixed, F(9, 10)),
        MDP.from_arrays([swap], [[F(1, 7)], [0.25]], "0.9"),
        MDP.from_arrays([swap], [moved], F(9, 10)),
        MDP.from_arrays([swap], ["1/7", np.float32(0.25)], F(9, 10)),
        MDP.from_arrays([sp.csr_array(swap)], np.array(mixed, dtype=object), F(9, 10)),
        MDP.from_pairs([0, 1], [0, 0], swap, mixed, F(9, 10)),
        MDP.from_pairs([1, 0], [0, 0], [[1.0, 0], [0, 1]], mixed[::-1], F(9, 10)),
        MDP.from_outcomes([(0, 0, [(1.0, 1, F(1, 7))]), (1, 0, [(1, 0, 0.25)])], F(9, 10)),
    ):
        assert list(certify(mdp).value) == wanted


def test_a_float_in_a_list_of_words_is_not_read_as_a_word() -> None:
    """0.1 beside "1/2" is the float 0.1, not 1/10; a large integer beside a float keeps its end."""
    mdp = MDP.from_arrays([EYE], [["1/2"], [0.1]], 0)
    assert list(certify(mdp).value) == [F(1, 2), F(0.1)]
    mdp = MDP.from_arrays([EYE], [2**60 + 1, 0.5], 0)
    assert list(certify(mdp).value) == [2**60 + 1, F(1, 2)]
    mdp = MDP.from_arrays([EYE], [2**63, -1], 0)
    assert list(certify(mdp).value) == [2**63, -1]
    parts = [np.array([2**60 + 1, 1]), np.array([0.5, 0.25])]  # columns of S and A
    assert certify(MDP.from_arrays([EYE, EYE], parts, 0)).value[0] == 2**60 + 1


def test_numbers_wider_than_doubles_keep_their_value() -> None:
    """A long double is taken as it is, alone and in arrays; a float32 is what it is, too."""
    wide = np.longdouble(1) + np.finfo(np.longdouble).eps
    value = F(*wide.as_integer_ratio())
    for reward in ([wide, 0], np.array([wide, 0]), [wide, F(1, 3)]):
        assert certify(MDP.from_arrays([EYE], reward, 0)).value[0] == value
    found = MDP.from_arrays([EYE], np.array([0.1, 0], dtype=np.float32), 0)
    assert certify(found).value[0] == F(float(np.float32(0.1)))
    assert MDP.from_arrays([EYE], [1, 0], wide / 2).discount_exact == value / 2


def test_outcomes_that_come_twice_are_added_exactly() -> None:
    """0.1 + 0.2 to one state is not 0.3: neither among outcomes nor in a sparse matrix."""
    total = F(0.1) + F(0.2)
    rows = [(0, 0, [(0.1, 1, 0), (0.2, 1, 0), (0.7, 0, 0)]), (1, 0, [(1, 1, 0)])]
    entries = ([0.1, 0.2, 0.7, 1.0], ([0, 0, 0, 1], [1, 1, 0, 1]))
    sparse = sp.coo_array(entries, shape=(2, 2))
    for mdp in (
        MDP.from_outcomes(rows),
        MDP.from_pairs([0, 1], [0, 0], sparse, [0, 0]),
        MDP.from_arrays([sparse], [0, 0]),
    ):
        assert sum(p for p, t, _ in mdp.table.row(0) if t == 1) == total
        rounding = sum(float(np.spacing(x)) / 2 for x in (0.1, 0.2, 0.7))
        assert mdp.table.weight_rounding()[:-1].sum() == rounding
    rewards = sp.coo_array(([0.1, 0.2], ([0, 0], [0, 0])), shape=(2, 1))
    assert certify(MDP.from_arrays([EYE], rewards, 0)).value[0] == total
    third = MDP.from_outcomes([(0, 0, [(F(1, 3), 0, 1), (0.25, 0, 1), (F(5, 12), 0, 1)])], 0)
    assert third.table.row(0) == [(F(1), 0, F(1))]


def test_it_stays_known_what_each_number_was_rounded_from(tmp_path: Any) -> None:
    """Half an ulp of a float, of its own width; 0 of an exact number; sums of both; when saved."""
    half = float(np.spacing(0.25)) / 2
    short = float(np.spacing(np.float32(0.25))) / 2
    rows = [
        (0, 0, [(0.25, 0, 0.5), (F(1, 4), 1, 1), (np.float32(0.25), 2, F(1, 3)), ("1/4", 2, 0)]),
        (1, 0, [(0.25, 0, 0), (0.25, 0, 0), (F(1, 2), 0, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    mdp = MDP.from_outcomes(rows, 0.5)
    assert sorted(mdp.table.weight_rounding()[:4]) == [0, 0, half, short]
    assert mdp.table.weight_rounding()[4:].tolist() == [2 * half, 0]
    assert sorted(mdp.table.gain_rounding()) == [0, 0, 0, 0, 0, float(np.spacing(0.5)) / 2]
    save(mdp, tmp_path / "m.npz")
    pairs = np.arange(3)
    for other in (load(tmp_path / "m.npz"), mdp.with_(discount=0.25), again(mdp)):
        assert other.table.weight_rounding().tolist() == mdp.table.weight_rounding().tolist()
        assert other.table.gain_rounding().tolist() == mdp.table.gain_rounding().tolist()
        assert rows_of(other) == rows_of(mdp)
    part = mdp.table.of_pairs(pairs[1:])
    assert part.weight_rounding().tolist() == mdp.table.weight_rounding()[4:].tolist()
    floating = MDP.from_arrays([np.eye(2)], np.ones(2), 0.5).table
    assert (floating.weight.dtype, floating.weight_doubt) == (np.float64, None)
    exact = MDP.from_arrays([EYE], ["1/3", 1], 0.5).table
    assert not exact.weight_rounding().any()
    assert not exact.gain_rounding().any()


@pytest.mark.parametrize(
    "row",
    [
        ["1/3", F(2, 3) - F(1, 10**12)],
        ["0.5", "0.4999999999999999"],
        [F(1, 3), 0.6666667],
        [0.5, 0.4999],
    ],
)
def test_what_is_not_binary_sums_to_1_exactly(row: Sequence[Any]) -> None:
    """Only a row with a float in it, or of binary fractions alone, may miss 1, by 1e-9."""
    with pytest.raises(ModelError, match="not 1"):
        MDP.from_arrays([[row, [0, 1]]], [0, 0], 0.5)


def test_a_number_that_is_not_finite_is_refused_by_its_place() -> None:
    """A NaN among fractions is a NaN of that state and action."""
    for value in (float("nan"), float("inf"), np.float32("inf")):
        with pytest.raises(ModelError) as caught:
            MDP.from_outcomes([(0, 0, [(F(1, 3), 0, value), (F(2, 3), 0, F(1, 3))])])
        assert "inf" in str(caught.value) or "nan" in str(caught.value)
