"""Intervals of means, shares and quantiles, against their equations and a second library."""

import numpy as np
import pytest
from scipy.stats import binom, binomtest

from exact_mdp.analysis.vary.intervals import (
    NORMAL,
    mean_at_least,
    mean_loss,
    quantiles,
    upper_quantile,
    wilson,
)


@pytest.mark.parametrize("seed", range(4))
def test_halls_interval_solves_his_cubic(seed: int) -> None:
    """g(T) √n is ± 1.96 at the two ends, with g(T) = T + k T²/3 + k² T³/27 + k/(6n)."""
    values = np.random.default_rng(seed).lognormal(0, 1, 40)
    n, found = len(values), mean_loss(values)
    k = (((values - values.mean()) / values.std()) ** 3).mean()
    ends = np.array([found.low, found.high])
    t = (values.mean() - ends) / (found.standard_error * n**0.5)
    g = t + k * t**2 / 3 + k**2 * t**3 / 27 + k / (6 * n)
    assert g * n**0.5 == pytest.approx([NORMAL, -NORMAL])


@pytest.mark.parametrize(("successes", "count"), [(0, 20), (3, 20), (20, 20), (1, 1), (50, 1000)])
def test_wilsons_interval_is_that_of_scipy(successes: int, count: int) -> None:
    wanted = binomtest(successes, count).proportion_ci(method="wilson")
    low, high = wilson(successes, count)
    assert (float(low), float(high)) == pytest.approx((wanted.low, wanted.high), abs=1e-6)


@pytest.mark.parametrize(("count", "probability"), [(60, 0.9), (100, 0.95), (500, 0.99)])
def test_an_upper_quantile_is_the_lowest_order_statistic_that_is_sure(
    count: int, probability: float
) -> None:
    """The k-th smallest is below the quantile where at least k of n draws are."""
    values = np.random.default_rng(count).permutation(count).astype(float)  # 0 is the smallest
    sure = [k for k in range(1, count + 1) if binom.sf(k - 1, count, probability) <= 0.025]
    assert upper_quantile(values, probability) == min(sure) - 1


def test_the_ends_of_a_quantile_are_order_statistics() -> None:
    count, p = 200, 0.3
    (found,) = quantiles(np.arange(count, dtype=float), [p])
    # The quantile is below the k-th smallest only where fewer than k draws are below it.
    low = max(k for k in range(1, count + 1) if binom.sf(k - 1, count, p) >= 0.975)
    high = min(k for k in range(1, count + 1) if binom.cdf(k - 1, count, p) >= 0.975)
    assert found["low"] == low - 1
    assert found["high"] == high - 1


def test_the_bound_on_a_mean_is_that_of_its_theorem() -> None:
    sample = np.concatenate([np.full(50, 2.0), np.full(950, 1.0)])
    found, n, doubt = mean_at_least(sample, 0.05), 950, 0.05
    # All of the rest are 1, so that their variance is 0 and only the last term remains.
    cuts = 2.0 * np.geomspace(1e-4, 2.0, 10_000)
    bounds = np.minimum(1.0, cuts) - 7 * cuts * np.log(2 / doubt) / (3 * (n - 1))
    assert 0 < found <= bounds.max() + 1e-12
    assert mean_at_least(sample * 3, 0.05) == pytest.approx(3 * found)
