"""Reading numbers: every form means the same whether it is read at once or number by number."""

from fractions import Fraction as F
from itertools import pairwise
from math import lcm

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exact_mdp import MDP
from exact_mdp.mdp.forms.numbers import array_of, rationalize_rows
from exact_mdp.mdp.forms.rows import rationalize_row
from exact_mdp.mdp.table import find_nonzero, hold_same_numbers, over_groups

NUMBERS = st.one_of(
    st.fractions(max_denominator=50),
    st.builds(F, st.integers(-5, 5)),
    st.builds(F, st.integers(-(10**30), 10**30), st.sampled_from([2**60, 3**50, 10**25])),
)


@given(st.lists(st.lists(NUMBERS, max_size=4), max_size=5))
def test_a_common_denominator_is_the_least_one_of_its_group(groups: list[list[F]]) -> None:
    values = [number for group in groups for number in group]
    offsets = np.cumsum([0, *map(len, groups)])
    top, below = over_groups(values, offsets)
    assert below.tolist() == [lcm(*(number.denominator for number in group)) for group in groups]
    for group, bottom, (first, last) in zip(
        groups, below.tolist(), pairwise(offsets.tolist()), strict=True
    ):
        assert [F(whole, bottom) for whole in top[first:last].tolist()] == group


ROWS = [
    [0.1, 0.2, 0.7],
    [F(1, 3), 1 / 6, 0.5],
    [1 / 7, 2 / 7, 4 / 7],
    [0.123456789, 0.5, 0.376543211],
    [F(1)],
    [0.45 + 1e-10, 0.45 + 1e-10, 0.1],
    [F(123, 1000), 0.877],
    [0.3, 0.3, 0.4 - 3e-10],
]


@given(st.lists(st.sampled_from(ROWS), min_size=1, max_size=6).map(lambda rows: rows * 4))
def test_rows_of_floats_beside_exact_rows_stand_for_the_same(rows: list[list[F | float]]) -> None:
    values = np.empty(sum(map(len, rows)), dtype=object)
    values[:] = [number for row in rows for number in row]
    offsets = np.cumsum([0, *map(len, rows)])
    top, below = rationalize_rows(values, offsets)
    for row, bottom, (first, last) in zip(
        rows, below.tolist(), pairwise(offsets.tolist()), strict=True
    ):
        found = [F(number) / bottom for number in top[first:last].tolist()]
        if top.dtype == np.float64:
            found = rationalize_row(top[first:last].tolist())
        assert found == rationalize_row(row)


def test_integers_beside_floats_are_floats_if_they_mean_the_same() -> None:
    assert array_of([[0, 0.5], [1, 0.25]], "here").tolist() == [[0.0, 0.5], [1.0, 0.25]]
    assert array_of([[0, 0.5], [1, 0.25]], "here").dtype == np.float64
    # An integer that is not a float, and a number that may be a rounding error beside an exact 1.
    for odd in (2**53 + 1, 1e-12):
        assert array_of([1, odd, 0.5], "here").tolist() == [F(1), odd, 0.5]
    # Exact numbers are not read again, but copied: an array of the user stays the user's.
    given = array_of([F(1, 3), 0.5], "here")
    again = array_of(given, "here")
    given[0] = F(2, 3)
    assert again.tolist() == [F(1, 3), 0.5]


def test_numbers_are_compared_by_value_though_objects_are_told_apart_first() -> None:
    left = np.array([F(1, 3), F(0), 0.5], dtype=object)
    assert find_nonzero(left).tolist() == [True, False, True]
    assert hold_same_numbers(left, np.array([F(1, 3), 0, F(1, 2)], dtype=object))
    assert not hold_same_numbers(left, np.array([F(1, 3), 0, F(1, 3)], dtype=object))


@pytest.mark.parametrize("whole", [int, float])
def test_one_row_that_leads_twice_to_a_state_leaves_the_others_as_they_are(whole: type) -> None:
    rows = [(s, 0, [(0.1, 0, 1.0), (0.2, 1, 1.0), (0.7, 2, 1.0)]) for s in range(3)]
    twice = [(0.3, 0, 1.0), (0.15, 1, 1.0), (0.55, 1, 1.0)]
    model = MDP.from_outcomes([*rows, (3, 0, twice), (4, 0, [(whole(1), 4, 0.0)])], "9/10")
    assert [model.table.row(pair)[0][0] for pair in range(4)] == [F(1, 10)] * 3 + [F(3, 10)]
    assert model.table.row(3)[1][:2] == (F(7, 10), 1)
