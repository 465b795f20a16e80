"""Roots and signs of polynomials."""

from fractions import Fraction
from itertools import pairwise

import flint
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp.analysis.vary.curves.roots import (
    nonnegative,
    odd_part,
    positive,
    roots,
    roots_on,
    sign,
    simple,
    variations,
)
from exact_mdp.mdp.exact import rational

F = Fraction


def product(numbers: list[Fraction]) -> flint.fmpq_poly:
    poly = flint.fmpq_poly([1])
    for number in numbers:
        poly *= flint.fmpq_poly([rational(-number), 1])
    return poly


@pytest.mark.parametrize(
    ("coefficients", "signs"),
    [
        ((1, -4, 4), (True, False)),  # (1 - 2 y)²: a double root, which Bernstein does not decide
        ((1, -4, F(4001, 1000)), (True, True)),
        ((1, -4, F(3999, 1000)), (False, False)),
        ((0, 1, -1), (True, False)),
        ((), (True, False)),
        ((-1,), (False, False)),
    ],
)
def test_signs_on_the_unit_interval(
    coefficients: tuple[Fraction | int, ...], signs: tuple[bool, bool]
) -> None:
    poly = flint.fmpq_poly([rational(c) for c in coefficients])
    assert (nonnegative(poly, F(0), F(1)), positive(poly, F(0), F(1))) == signs


@settings(max_examples=100)
@given(
    st.lists(st.fractions(-2, 2, max_denominator=20), max_size=6),
    st.sampled_from([-1, 1]),
    st.booleans(),
    st.sampled_from([F(-1), F(0)]),
)
def test_roots_are_all_found_once_and_signs_change_there(
    numbers: list[Fraction], lead: int, square: bool, low: Fraction
) -> None:
    poly = product(numbers * (1 + square)) * lead
    inside = sorted({number for number in numbers if low < number < 1})
    for root, number in zip(roots(simple(poly), low, F(1)), inside, strict=True):
        near = root.narrowed(F(1, 10**9))
        assert near.low <= number <= near.high <= near.low + F(1, 10**9)
    assert variations(simple(poly), low, F(1)) >= len(inside)
    within = {number for number in numbers if low <= number <= 1}
    assert roots_on(poly, low, F(1)) == len(within)
    assert sign(poly, F(3)) == lead
    odd = {number for number in inside if numbers.count(number) * (1 + square) % 2}
    assert roots_on(odd_part(poly), low, F(1)) >= len(odd)
    assert all((sign(odd_part(poly), number) == 0) == (number in odd) for number in inside)
    cuts = [low, *inside, F(1)]
    least = min(poly(rational((a + b) / 2)) for a, b in pairwise(cuts))
    assert nonnegative(poly, low, F(1)) == (least >= 0)
    assert positive(poly, low, F(1)) == (least > 0 and not within)


def test_roots_closer_than_a_bracket_are_told_apart() -> None:
    """A root 1e-20 from an exact one is not mistaken for it."""
    near, below = F(1, 10**20), F(0)
    every = [F(1, 2) - near, F(1, 2), 1 - near]
    for root, true in zip(roots(product(every), F(0), F(1)), every, strict=True):
        brackets = root.apart(below, F(1, 10**12))
        assert below < brackets.low <= true <= brackets.high <= 1
        below = brackets.high
