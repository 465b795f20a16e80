"""Distributions by their 95 % interval, as papers publish relative risks, costs and utilities.

    F(low) = 0.025,    F(high) = 0.975

Both equations are met, so a mean is not asked for. A normal, log-normal or uniform
distribution has a closed solution. A gamma's shape follows from the ratio of the two quantiles,
which falls as the shape grows, and its scale from one of them. For a beta, the mean at which the
lower quantile fits is found at each size α + β, and then the size at which the upper one fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from scipy.optimize import brentq
from scipy.special import betaincinv, gammaincinv, ndtri

TAIL = 0.025
WIDTH = 2 * float(ndtri(1 - TAIL))  # the interval of a standard normal distribution
SIZES = (-3.0, 12.0)  # decimal logarithms of shapes and sizes that are searched
Numbers = tuple[float, ...]
NONE = (math.nan, math.nan)


def fit_normal(low: float, high: float) -> Numbers:
    """Return mean and sd."""
    return (low + high) / 2, (high - low) / WIDTH


def fit_lognormal(low: float, high: float) -> Numbers:
    """Return mean and sd of the logarithm; NaN unless both are positive."""
    if low <= 0:
        return NONE
    return fit_normal(math.log(low), math.log(high))


def fit_uniform(low: float, high: float) -> Numbers:
    """Return the ends."""
    beyond = (high - low) * TAIL / (1 - 2 * TAIL)
    return low - beyond, high + beyond


def fit_gamma(low: float, high: float) -> Numbers:
    """Return shape and scale; NaN unless both are positive or, with a negative scale, negative."""
    if high < 0:
        shape, scale = fit_gamma(-high, -low)
        return shape, -scale
    if low <= 0:
        return NONE

    def ratio(power: float) -> float:
        own = [float(gammaincinv(10**power, share)) for share in (TAIL, 1 - TAIL)]
        return math.log(own[1] / own[0]) - math.log(high / low) if own[0] else math.inf

    shape = 10 ** _find_root(ratio, *SIZES)
    return shape, low / float(gammaincinv(shape, TAIL))


def fit_beta(low: float, high: float) -> Numbers:
    """Return α and β; NaN unless the interval lies between 0 and 1."""
    if not 0 < low < high < 1:
        return NONE
    if low + high > 1:  # near 0 a float has more digits than near 1
        beta, alpha = fit_beta(1 - high, 1 - low)
        return alpha, beta

    def mean_at(power: float) -> float:
        def beyond(log: float) -> float:  # a logarithm has the digits of a small mean, too
            mean = math.exp(log)
            return float(betaincinv(mean * 10**power, (1 - mean) * 10**power, TAIL)) - low

        return math.exp(_find_root(beyond, math.log(low), -1e-12))

    def width(power: float) -> float:
        mean, size = mean_at(power), 10**power
        return float(betaincinv(mean * size, (1 - mean) * size, 1 - TAIL)) - high

    power = _find_root(width, *SIZES)
    mean, size = mean_at(power), 10**power
    return mean * size, (1 - mean) * size


def _find_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return where a function changes its sign; NaN if it does not in this range."""
    if not function(low) * function(high) <= 0:  # the product may be NaN
        return math.nan
    return float(brentq(function, low, high, xtol=1e-14, rtol=1e-14))
