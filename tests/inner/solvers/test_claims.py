"""The numbers that leave the toolkit: intervals, differences and regrets."""

from fractions import Fraction as F
from itertools import product
from math import inf, nan, nextafter
from operator import ge, gt, le, lt
from typing import Any

import numpy as np
import pytest

from exact_mdp import Bounded, Certified, Estimated, ModelError
from exact_mdp.mdp.sense import Sense
from exact_mdp.solvers.claims import (
    compute_regret,
    compute_regrets,
    in_decimals,
    in_float,
    is_at_most,
)


def test_an_interval_holds_the_number() -> None:
    third = Certified(value=F(1, 3))
    low, high = third.interval
    assert F(low) <= F(1, 3) <= F(high)
    assert high - low <= 1e-15
    low, high = Bounded(value=1.0, error=0.25).interval
    assert (low, high) == (pytest.approx(0.75), pytest.approx(1.25))
    assert low <= 0.75
    assert high >= 1.25
    low, high = Estimated(value=10.0, standard_error=2.0).interval
    assert ((low + high) / 2, high - 10) == (10.0, pytest.approx(1.959964 * 2))
    low, high = Estimated(value=10.0, standard_error=2.0, cut_off=1.0).interval
    assert high - 10 == pytest.approx(1.959964 * 2 + 1)


def test_numbers_round_as_floats_do() -> None:
    half = [Bounded(value=2.5, error=0.1), Estimated(value=2.5, standard_error=1.0)]
    for number in (Certified(value=F(5, 2)), *half):
        assert (round(number), round(number, 1)) == (2, 2.5)
    third = Certified(value=F(10, 3))
    assert (round(third, 3), f"{third:.3f}") == (3.333, "3.333")
    with pytest.raises(OverflowError):
        round(Certified(value=inf))


def test_differences_are_exact_where_both_are_and_else_bounded() -> None:
    one, other = Certified(value=F(5, 3)), Certified(value=F(2, 3))
    assert one - other == Certified(value=F(1))
    apart = one - Bounded(value=0.5, error=1e-3)
    assert isinstance(apart, Bounded)
    assert abs(F(apart.value) - (F(5, 3) - F(1, 2))) + F(1, 1000) <= F(apart.error) + F(1, 10**15)
    assert apart.error == pytest.approx(1e-3, rel=1e-9)
    assert -one == Certified(value=F(-5, 3))
    assert -Bounded(value=1.5, error=0.1) == Bounded(value=-1.5, error=0.1)


def test_a_regret_is_never_below_0_and_of_costs_the_other_way() -> None:
    low, high = Certified(value=F(2)), Certified(value=F(5))
    assert compute_regret(high, low).value == 3
    assert compute_regret(low, high, Sense.MIN).value == 3
    one, more = Bounded(value=2.0, error=0.5), Bounded(value=2.25, error=0.5)
    lost = compute_regret(one, more)
    assert lost.value == 0
    assert lost.error == pytest.approx(0.75)
    assert compute_regret(one, more, Sense.MIN).value == 0.25
    best, own = np.array([[5.0, 5.0, -1.0]]), np.array([[4.0, 5.1, -2.0]])
    assert compute_regrets(best, own, np.array([[0.2, 0.2, 2.0]])).tolist() == [[1.0, 0.0, 0.0]]
    costs = compute_regrets(own, best, np.array([[0.2, 0.2, 2.0]]), Sense.MIN)
    assert costs.tolist() == [[1.0, 0.0, 0.0]]


def test_numbers_beyond_floats_are_infinite() -> None:
    assert in_float(F(10) ** 400) == inf
    assert in_float(-(F(10) ** 400)) == -inf
    assert in_float(F(1, 3)) == 1 / 3
    decimals = in_decimals([F(1, 3), -inf, None])
    assert decimals[:2] == [1 / 3, -inf]
    assert np.isnan(decimals[2])
    assert nextafter(decimals[0], 1) > F(1, 3)


def test_a_limit_is_kept_broken_or_left_open() -> None:
    for within, limit, wanted in (
        ((0.0, 1.0), 1, True),
        ((0.0, 1.0), F(1, 2), None),
        ((0.5, 1.0), F(1, 2), None),
        ((0.6, 1.0), F(1, 2), False),
        ((F(1, 2), F(1, 2)), F(1, 2), True),
    ):
        assert is_at_most(within, (limit, limit)) == wanted
    assert Certified(value=F(1, 3)).bounds == (F(1, 3), F(1, 3))
    low, high = Bounded(value=1.0, error=0.25).bounds
    assert low < 0.75 < 1.25 < high


EIGHTHS = [F(n, 8) for n in range(9)]


def spread(low: F, high: F) -> Bounded:
    """Return a bounded number whose ends are just beyond two given ones."""
    return Bounded(value=float(low + high) / 2, error=float(high - low) / 2)


@pytest.mark.parametrize("compare", [lt, le, gt, ge])
def test_certified_numbers_compare_as_their_values_do(compare: Any) -> None:
    for a, b in product(EIGHTHS, EIGHTHS):
        right = compare(a, b)
        for other in (b, float(b), np.float64(b), np.float32(b), Certified(value=b)):
            assert compare(Certified(value=a), other) is right
            assert bool(compare(a, Certified(value=b))) is right
    assert compare(Certified(value=F(1, 3)), 1 / 3) is compare(F(1, 3), F(1 / 3))
    assert compare(Certified(value=inf), 10**400) is compare(inf, 10**400)
    assert compare(Certified(value=F(10) ** 400), np.float32(inf)) is compare(1, inf)
    assert compare(Bounded(value=-inf, error=0.0), 10**400) is compare(0, 1)


@pytest.mark.parametrize("compare", [lt, le, gt, ge])
def test_a_comparison_holds_for_all_numbers_within_the_bounds_or_is_refused(compare: Any) -> None:
    """Against every pair of points, one within each of two intervals."""
    spans = [(a, b) for a, b in product(EIGHTHS[::2], EIGHTHS[::2]) if a < b]
    for (a, b), (c, d) in product(spans, spans):
        middle, right = (c + d) / 2, compare(a, c)
        answers = {compare(x, y) for x, y in product((a, b), (c, d))}
        if b < c or d < a:
            assert answers == {right}
            for other in (spread(c, d), middle, float(middle), Certified(value=middle)):
                assert compare(spread(a, b), other) is right
        else:
            assert len(answers) == 2 or b == c or d == a
            with pytest.raises(ModelError, match="does not decide") as caught:
                compare(spread(a, b), spread(c, d))
            assert "float(number)" in caught.value.fix


def test_an_open_comparison_says_between_which_ends_the_uncertain_number_is() -> None:
    unsure, sure = Bounded(value=0.5, error=0.25), Certified(value=F(1, 2))
    for compare in (lambda: unsure < 0.5, lambda: unsure > 0.5, lambda: sure >= unsure):
        with pytest.raises(
            ModelError, match=r"^0\.5 ± 0\.2 \(bounded\) is known to lie from 0\.2499"
        ):
            compare()
    mean = Estimated(value=2.0, standard_error=0.5)
    assert mean > 1
    assert unsure < mean
    with pytest.raises(ModelError, match=r"how it compares with 1\.5") as caught:
        mean.__gt__(1.5)
    assert "the mean alone" in caught.value.fix
    with pytest.raises(ModelError, match="nan is not a finite"):
        sure.__lt__(nan)
    with pytest.raises(ModelError, match="nan to nan"):
        Certified(value=nan).__le__(1)


def test_numbers_sort_and_do_not_compare_with_texts() -> None:
    low, middle, high = (Bounded(value=x, error=0.1) for x in (0.0, 1.0, 2.0))
    third = Certified(value=F(1, 3))
    assert sorted([high, 3, third, middle, low]) == [low, third, middle, high, 3]
    assert max(low, third) is third
    assert (third < np.array([0.0, 0.5])).tolist() == [False, True]
    for other in ("1/3", None, [1]):
        for compare in (lt, le, gt, ge):
            with pytest.raises(TypeError):
                compare(third, other)


def test_a_certified_number_equals_its_value_and_others_their_fields() -> None:
    half = Certified(value=F(1, 2))
    assert half == 0.5 == half == F(1, 2) == half == np.float32(0.5)
    assert half != F(1, 3)
    assert half != "1/2"
    assert {half: "found"}[F(1, 2)] == {0.5: "found"}[half] == "found"  # type: ignore[index]
    assert Certified(value=F(1, 3)) != 1 / 3
    one = Bounded(value=0.5, error=0.0)
    assert one == Bounded(value=0.5, error=0.0)
    assert one != Bounded(value=0.5, error=0.1)
    assert one != 0.5
    assert one != half
    assert hash(one) == hash(Bounded(value=0.5, error=0.0))
    assert bool(Certified(value=F(0)))


def test_a_format_shows_the_number_alone_and_no_format_its_claim() -> None:
    third, close = Certified(value=F(1, 3)), Bounded(value=-0.5, error=1e-9)
    mean = Estimated(value=2.0, standard_error=0.5)
    assert f"{third:.3f}|{close:>8.2f}|{mean:.1e}" == "0.333|   -0.50|2.0e+00"
    assert f"{third}, {close}" == "1/3 (certified), -0.5 ± 1e-09 (bounded)"
    assert f"{Certified(value=F(10) ** 400):.1f}" == "inf"


def test_a_size_has_the_error_of_its_number() -> None:
    for value in (F(-3, 2), F(0), F(3, 2), -inf):
        assert abs(Certified(value=value)).value == abs(value)
    assert abs(Bounded(value=-1.5, error=2.0)) == Bounded(value=1.5, error=2.0)
    assert abs(Bounded(value=1.5, error=2.0)) == Bounded(value=1.5, error=2.0)
    mean = abs(Estimated(value=-1.5, standard_error=0.5, cut_off=0.25))
    assert mean == Estimated(value=1.5, standard_error=0.5, cut_off=0.25)
