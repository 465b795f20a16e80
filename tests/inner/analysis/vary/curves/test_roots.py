"""Roots and signs of polynomials."""

from fractions import Fraction
from itertools import combinations_with_replacement, pairwise

import flint
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp.analysis.vary.curves.roots import (
    Root,
    compute_coefficient_signs,
    compute_sign,
    count_sign_variations,
    is_nonnegative,
    is_positive,
    isolate_roots,
    odd_part,
    remove_double_roots,
    roots_on,
)
from exact_mdp.mdp.exact import to_flint

F = Fraction


def product(numbers: list[Fraction]) -> flint.fmpq_poly:
    poly = flint.fmpq_poly([1])
    for number in numbers:
        poly *= flint.fmpq_poly([to_flint(-number), 1])
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
    poly = flint.fmpq_poly([to_flint(c) for c in coefficients])
    assert (is_nonnegative(poly, F(0), F(1)), is_positive(poly, F(0), F(1))) == signs


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
    for root, number in zip(
        isolate_roots(remove_double_roots(poly), low, F(1)), inside, strict=True
    ):
        near = root.narrow_to_width(F(1, 10**9))
        assert near.low <= number <= near.high <= near.low + F(1, 10**9)
    assert count_sign_variations(remove_double_roots(poly), low, F(1)) >= len(inside)
    within = {number for number in numbers if low <= number <= 1}
    assert roots_on(poly, low, F(1)) == len(within)
    assert compute_sign(poly, F(3)) == lead
    odd = {number for number in inside if numbers.count(number) * (1 + square) % 2}
    assert roots_on(odd_part(poly), low, F(1)) >= len(odd)
    assert all((compute_sign(odd_part(poly), number) == 0) == (number in odd) for number in inside)
    cuts = [low, *inside, F(1)]
    least = min(poly(to_flint((a + b) / 2)) for a, b in pairwise(cuts))
    assert is_nonnegative(poly, low, F(1)) == (least >= 0)
    assert is_positive(poly, low, F(1)) == (least > 0 and not within)


def test_roots_closer_than_a_bracket_are_told_apart() -> None:
    """A root 1e-20 from an exact one is not mistaken for it."""
    near, below = F(1, 10**20), F(0)
    every = [F(1, 2) - near, F(1, 2), 1 - near]
    for root, true in zip(isolate_roots(product(every), F(0), F(1)), every, strict=True):
        brackets = root.isolate_beyond(below, F(1, 10**12))
        assert below < brackets.low <= true <= brackets.high <= 1
        below = brackets.high


@pytest.mark.parametrize("lead", [1, -1])
@pytest.mark.parametrize("width", [F(1, 3), F(1, 4), F(1, 10), F(1, 10**6)])
def test_a_root_is_halved_until_it_is_narrow_and_no_further(lead: int, width: Fraction) -> None:
    """Whether the ends are roots themselves, or one of them, or neither."""
    low, high = F(-1, 2), F(3, 2)
    for number in (F(1, 7), F(-2, 9), F(7, 5), F(22, 17)):
        for others in ([], [low], [high], [low, high], [F(-3)], [F(2)]):
            whole = Root(poly=product([number, *others]) * lead, low=low, high=high)
            near = whole.narrow_to_width(width)
            assert near.poly == whole.poly
            assert low <= near.low < number < near.high <= high
            assert width / 2 < near.high - near.low <= width
            assert near.narrow_to_width(near.high - near.low) is near
            assert near.narrow_to_width(width * 5) is near


def test_a_root_that_is_met_is_an_exact_one() -> None:
    whole = Root(poly=product([F(5, 8)]), low=F(0), high=F(1))
    assert whole.narrow_to_width(F(1, 2)).low == F(1, 2)
    exact = whole.narrow_to_width(F(1, 8))
    assert exact.low == exact.high == F(5, 8)
    assert exact.narrow_to_width(F(0)) is exact


def test_a_root_apart_from_a_point_has_no_root_at_its_ends() -> None:
    third = Root(poly=product([F(0), F(1, 3), F(1)]), low=F(0), high=F(1))
    exact = third.isolate_beyond(F(0), F(1, 100))
    assert (exact.low, exact.high) == (F(1, 3), F(1, 3))
    square = flint.fmpq_poly([-2, 0, 1])
    for poly, low, high in (
        (square, F(1), F(2)),
        (square * product([F(1)]), F(1), F(2)),
        (square * product([F(2)]), F(1), F(2)),
        (square * product([F(1), F(2)]), F(1), F(2)),
    ):
        for point in (F(1), F(141421356237, 10**11)):
            near = Root(poly=poly, low=low, high=high).isolate_beyond(point, F(3))
            assert point < near.low < near.high
            assert near.low**2 < 2 < near.high**2
            assert near.high - near.low <= 1
            assert compute_sign(poly, near.low) * compute_sign(poly, near.high) == -1
    loose = Root(poly=square, low=F(1), high=F(2)).isolate_beyond(F(0), F(3))
    assert (loose.low, loose.high) == (1, 2)
    long = F(123456789012347, 10**15)  # no fraction of a denominator that is looked for
    wide = Root(poly=product([long]), low=F(0), high=F(1)).isolate_beyond(F(0), F(1, 10**3))
    assert 0 < wide.low < long < wide.high


@pytest.mark.parametrize("digits", [1, 6, 12])
def test_a_root_apart_is_a_fraction_where_its_denominator_is_small(digits: int) -> None:
    number = F(10 ** (digits - 1) + 1, 10**digits - 1) if digits > 1 else F(2, 7)
    near = Root(poly=product([number]), low=F(0), high=F(1)).isolate_beyond(
        F(0), F(1, 10 ** (2 * digits))
    )
    assert (near.low, near.high) == (number, number)


def test_fractions_of_one_digit_are_met_in_wide_intervals() -> None:
    """No other fraction of one digit is as near to the middle; some of two digits are."""
    for number in {F(p, q) for q in range(2, 11) for p in range(1, q)}:
        near = Root(poly=product([number]), low=F(-1, 7), high=F(8, 7)).isolate_beyond(
            F(-1), F(1, 150)
        )
        assert (near.low, near.high) == (number, number)


def test_another_polynomial_may_have_the_root_too() -> None:
    square = flint.fmpq_poly([-2, 0, 1])
    root = Root(poly=square * product([F(3)]), low=F(1), high=F(2))
    assert root.is_of(square * product([F(7)]))
    assert root.is_of(square**2)
    assert not root.is_of(product([F(3)]))
    assert not root.is_of(flint.fmpq_poly([-3, 0, 1]))  # another one in the same interval
    point = Root(poly=product([F(1, 2)]), low=F(1, 2), high=F(1, 2))
    assert point.is_of(product([F(1, 2), F(4)]))
    assert not point.is_of(product([F(1, 3), F(4)]))


def test_signs_are_those_of_the_coefficients_after_the_substitution() -> None:
    """(1 + t)^n p((b + a t) / (1 + t)), multiplied out term by term."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        numbers = [F(int(k)) for k in rng.integers(-9, 10, 4)] + [F(1)]
        low, high = (F(int(k), 5) for k in sorted(rng.choice(np.arange(-9, 10), 2, replace=False)))
        poly = flint.fmpq_poly([to_flint(c) for c in numbers])
        up, one = flint.fmpq_poly([to_flint(high), to_flint(low)]), flint.fmpq_poly([1, 1])
        terms = (to_flint(c) * up**k * one ** (4 - k) for k, c in enumerate(numbers))
        coefficients = sum(terms, flint.fmpq_poly()).coeffs()
        wanted = [c > 0 for c in coefficients if c != 0]
        assert compute_coefficient_signs(poly, low, high) == wanted
        assert count_sign_variations(poly, low, high) == sum(a != b for a, b in pairwise(wanted))


def test_at_one_point_an_interval_is_as_a_point() -> None:
    poly = product([F(1), F(2)])
    for x, least in ((F(0), 1), (F(1), 0), (F(3, 2), -1), (F(2), 0), (F(3), 1)):
        assert compute_sign(poly, x) == least
        assert is_nonnegative(poly, x, x) == (least >= 0)
        assert is_positive(poly, x, x) == (least > 0)
        assert roots_on(poly, x, x) == (least == 0)


def test_a_polynomial_is_looked_at_inside_the_interval_alone() -> None:
    """Double roots hide from the first look; the sign is negative just beyond an end."""
    for low, high in ((F(0), F(1)), (F(2), F(3)), (F(-3), F(-1))):
        at = [low + (high - low) * F(k, 6) for k in range(1, 6)]
        for a, b in pairwise(at):
            double = product([a, a, b, b])
            assert is_nonnegative(double, low, high)
            assert not is_nonnegative(-double, low, high)
            assert is_nonnegative(double * product([low]), low, high)
            assert is_nonnegative(-double * product([high]), low, high)
            assert not is_nonnegative(-double * product([low]), low, high)
            assert not is_nonnegative(double * product([high]), low, high)


def test_double_roots_become_single_ones() -> None:
    a, b, c = F(1, 2), F(-3), F(5, 7)
    poly = product([a, b, b, c, c, c]) * 6
    assert remove_double_roots(poly) / remove_double_roots(poly).leading_coefficient() == product(
        [a, b, c]
    )
    odd = odd_part(poly)
    assert odd / odd.leading_coefficient() == product([a, c])
    assert odd_part(product([b, b])).degree() == 0
    for few in (flint.fmpq_poly([3]), product([a]), flint.fmpq_poly()):
        assert remove_double_roots(few) == few
    assert remove_double_roots(product([b, b])).degree() == 1
    assert [each.low for each in isolate_roots(product([a]), F(0), F(1))] == [F(0)]
    assert roots_on(poly, b, c) == 3
    assert roots_on(poly, a, F(7, 10)) == 1


def test_a_root_of_more_than_twelve_digits_is_not_looked_for() -> None:
    number = F(10**11, 10**12 + 1)
    near = Root(poly=product([number]), low=F(0), high=F(1)).isolate_beyond(F(0), F(1, 10**26))
    assert near.low < number < near.high


def test_a_root_at_an_end_is_not_the_one_inside() -> None:
    number = F(1, 10**13 + 1)
    near = Root(poly=product([F(0), number]), low=F(0), high=F(1)).isolate_beyond(F(-1), F(1, 100))
    assert 0 < near.low < number < near.high


def test_a_root_is_told_to_lie_between_two_points_that_may_be_roots_too() -> None:
    """Points on both sides of a root, the root itself, and other roots of its polynomial."""
    rng = np.random.default_rng(11)
    for lead in (1, -1):
        for _ in range(20):
            numbers = sorted(F(int(k), 24) for k in rng.choice(np.arange(1, 24), 4, replace=False))
            poly = product([F(0), *numbers, F(1)]) * lead
            points = [F(-1, 3), F(0), F(1), F(4, 3), *numbers]
            points += [number + sign * F(1, 97) for number in numbers for sign in (1, -1)]
            for root, number in zip(isolate_roots(poly, F(0), F(1)), numbers, strict=True):
                ends = [*points, root.low, root.high]
                for low, high in combinations_with_replacement(sorted(ends), 2):
                    assert root.lies_between(low, high) == (low <= number <= high)
    square = Root(poly=flint.fmpq_poly([-2, 0, 1]), low=F(1), high=F(2))
    near = F(141421356237, 10**11)
    assert square.lies_between(near, near + F(1, 10**11))
    assert not square.lies_between(near - F(1, 10**11), near)
    assert not square.lies_between(near + F(1, 10**11), F(2))


def test_roots_are_those_of_flint() -> None:
    """All roots of random polynomials over the complex numbers: the real ones, where they are."""
    rng = np.random.default_rng(7)
    for _ in range(30):
        numbers = rng.integers(-9, 10, 6).tolist()
        poly = flint.fmpq_poly([*numbers, 1])
        real = [
            (float(each.real), times)
            for each, times in flint.fmpz_poly([*numbers, 1]).complex_roots()
            if each.imag == 0
        ]
        for low, high in ((F(-10), F(10)), (F(-1), F(1, 3)), (F(1, 7), F(2))):
            inside = sorted(x for x, _ in real if low < x < high)
            found = [*isolate_roots(remove_double_roots(poly), low, high)]
            assert len(found) == len(inside)
            for root, number in zip(found, inside, strict=True):
                near = root.isolate_beyond(low, F(1, 10**12))
                assert float(near.low) == pytest.approx(number, rel=1e-9, abs=1e-9)
            turning = sorted(x for x, times in real if times % 2 and low < x < high)
            odd = [*isolate_roots(odd_part(poly), low, high)]
            assert [float(each.narrow_to_width(F(1, 10**12)).low) for each in odd] == pytest.approx(
                turning, rel=1e-9, abs=1e-9
            )
