"""The numbers that leave the toolkit: intervals, differences and regrets."""

from fractions import Fraction as F
from math import inf, nextafter

import numpy as np
import pytest

from exact_mdp import Bounded, Certified, Estimated
from exact_mdp.mdp.sense import Sense
from exact_mdp.solvers.claims import (
    compute_regret,
    compute_regrets,
    in_decimals,
    in_float,
    interval_of,
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
        assert is_at_most(within, F(limit)) == wanted
    assert interval_of(Certified(value=F(1, 3))) == (F(1, 3), F(1, 3))
    low, high = interval_of(Bounded(value=1.0, error=0.25))
    assert low < 0.75 < 1.25 < high
