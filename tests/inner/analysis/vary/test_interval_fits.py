"""The fitted distributions have these quantiles by another library, wherever they exist."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from exact_mdp.analysis.vary.interval_fits import (
    _find_root,
    fit_beta,
    fit_gamma,
    fit_lognormal,
    fit_normal,
    fit_uniform,
)

LAWS = {
    fit_normal: lambda mean, sd: stats.norm(mean, sd),
    fit_lognormal: lambda log, sd: stats.lognorm(sd, scale=math.exp(log)),
    fit_uniform: lambda low, high: stats.uniform(low, high - low),
    fit_gamma: lambda shape, scale: stats.gamma(shape, scale=scale),
    fit_beta: stats.beta,
}
POSITIVE = [(0.5, 0.72), (100, 4000), (3900, 4100), (1e-5, 3)]
SHARES = [
    (0.5, 0.72),
    (0.01, 0.02),
    (0.001, 0.9),
    (0.94, 0.96),
    (0.1, 0.99),
    (1e-5, 1 - 1e-5),
    (1e-9, 1e-8),
    (3e-12, 4e-11),
]
CASES = [
    *((fit_normal, ends) for ends in ((-1, 3), (5, 5.5))),
    *((fit_uniform, ends) for ends in ((-1, 3), (0.1, 0.7))),
    *((fit_lognormal, ends) for ends in POSITIVE),
    *((fit_gamma, ends) for ends in POSITIVE),
    *((fit_beta, ends) for ends in SHARES),
]


@pytest.mark.parametrize(("fit", "ends"), CASES)
def test_the_quantiles_are_those_asked_for(fit, ends) -> None:
    law = LAWS[fit](*fit(*ends))
    assert law.ppf([0.025, 0.975]) == pytest.approx(ends, rel=1e-9, abs=0)


@pytest.mark.parametrize("seed", range(30))
def test_a_distribution_is_found_from_its_own_interval(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = 10 ** rng.uniform(-0.5, 3, size=2)
    for fit in (fit_beta, fit_gamma):
        if fit is fit_beta:
            a, b = min(a, 200.0), min(b, 200.0)
        ends = LAWS[fit](a, b).ppf([0.025, 0.975])
        if 0 < ends[0] < ends[1] < (1 if fit is fit_beta else math.inf):
            assert fit(*ends) == pytest.approx((a, b), rel=1e-6)


def test_a_negative_gamma_is_mirrored() -> None:
    shape, scale = fit_gamma(100, 4000)
    assert fit_gamma(-4000, -100) == (shape, -scale)


@pytest.mark.parametrize(
    ("fit", "ends"),
    [(fit_lognormal, (0, 1)), (fit_gamma, (-1, 1)), (fit_gamma, (0, 1)), (fit_beta, (0, 0.5)),
     (fit_gamma, (-1, 0)), (fit_beta, (0.5, 1)), (fit_beta, (0, 1)), (fit_beta, (1e-20, 1)),
     (fit_beta, (0.5, 1.5)),
     (fit_beta, (0.5, 0.5)), (fit_beta, (0.5, 0.5 + 1e-9)), (fit_gamma, (1, 1 + 1e-9))],
)  # fmt: skip
def test_there_is_none_elsewhere(fit, ends) -> None:
    assert not all(map(math.isfinite, fit(*ends)))


@pytest.mark.parametrize(("size", "found"), [(0.99e12, True), (1.01e12, False)])
def test_shapes_and_sizes_are_at_most_a_million_million(size: float, found: bool) -> None:
    for fit, law in (
        (fit_gamma, stats.gamma(size)),
        (fit_beta, stats.beta(0.3 * size, 0.7 * size)),
    ):
        low, high = law.ppf([0.025, 0.975])
        assert all(map(math.isfinite, fit(low, high))) == found


def test_a_root_is_found_to_14_digits_and_nowhere_but_where_the_sign_changes() -> None:
    cases: list[tuple[Callable[[float], float], float]] = [
        (lambda x: x, 0.0), (lambda x: x - 10, 10.0), (lambda x: math.exp(x) - 5, math.log(5)),
        (lambda x: 3 - x, 3.0),
    ]  # fmt: skip
    for function, root in cases:
        assert abs(_find_root(function, 0.0, 10.0) - root) <= 1e-14 * max(1, root)
    without: list[Callable[[float], float]] = [
        lambda x: x + 0.01, lambda x: -1 - x, lambda x: math.nan, lambda x: math.inf,
        lambda x: math.nan if x > 1 else x,
    ]  # fmt: skip
    assert all(math.isnan(_find_root(function, 0.0, 10.0)) for function in without)
