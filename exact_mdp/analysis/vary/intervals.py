"""Confidence intervals of shares, quantiles and means, and tolerances of acceptability curves.

Shares have Wilson's interval (Wilson, Journal of the American Statistical Association 22, 1927),
and quantiles an interval between order statistics, which assumes no distribution.

A mean of losses often rests on few draws: most draws lose nothing, some lose much. The normal
interval then ends too low. Here Hall's cubic removes the skewness γ of the t statistic (Journal of
the Royal Statistical Society B 54, 1992),

    T = (m - μ) / s,    g(T) = T + γ T² / 3 + γ² T³ / 27 + γ / (6 n),

after which g(T) √n is normal to a higher order. The effective number of draws that carry the mean
is (Σ x)² / Σ x². If it is below 50, do not rely on an interval made from the sample alone: draws
that did not occur may carry more than the ones that did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, log

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats, exact
from exact_mdp.solvers.claims import NORMAL, Estimated

SURE = 0.975  # the probability with which each end is beyond a quantile: 95 % for both


@dataclass(frozen=True, kw_only=True)
class Ranged(Estimated):
    """An estimate with a 95 % interval of its own, from `low` to `high`."""

    low: float
    high: float

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval."""
        return self.low, self.high

    def __abs__(self) -> Ranged:
        low, high = max(0.0, self.low, -self.high), max(self.high, -self.low)
        return replace(self, value=abs(self.value), low=low, high=high)


@dataclass(frozen=True, kw_only=True)
class MeanLoss(Ranged):
    """A mean of numbers that are not negative, and the effective number of draws that carry it."""

    carried: float

    @property
    def few(self) -> bool:
        """Whether so few draws carry the mean that the interval may be too short."""
        return self.carried < 50


def confidence_of(given: object) -> Fraction:
    """Return a confidence between 0 and 1; a float stands for the decimal that it prints as."""
    if isinstance(given, float):
        given = str(given)
    confidence = exact(given, "confidence")
    if not 0 < confidence < 1 or float(confidence) in (0.0, 1.0):
        raise ModelError(
            f"a confidence of {given}",
            where="confidence",
            fix="give more than 0 and less than 1, not so near that its float is 0 or 1",
        )
    return confidence


def mean_of(values: Floats) -> Estimated:
    """Return the mean of independent values with its standard error."""
    spread = float("inf")
    if len(values) > 1:
        spread = float(values.std(ddof=1))
    return Estimated(value=float(values.mean()), standard_error=spread / len(values) ** 0.5)


def mean_loss(values: Floats) -> MeanLoss:
    """Return the mean of independent losses, none below 0, with Hall's interval."""
    # Scaled to a largest value of 1, so that powers stay within the floats.
    plain, count = mean_of(values), len(values)
    size, scaled = float(values.max()), values
    if size > 0:
        scaled = values / size
    sd, square, carried = float(scaled.std()), float(scaled @ scaled), 0.0
    if square > 0:
        carried = float(scaled.sum()) ** 2 / square
    low, high = plain.interval
    if sd > 0:
        skewness = float((((scaled - scaled.mean()) / sd) ** 3).mean())
        # The ends of the normal interval for g(T), turned into ends for T by the inverse of g. A
        # smaller skewness would not move an end by a millionth of itself.
        ends = np.array([NORMAL, -NORMAL]) / count**0.5
        if abs(skewness) > 1e-6:
            inner = 1 + skewness * (ends - skewness / (6 * count))
            ends = 3 / skewness * (np.cbrt(inner) - 1)
        low, high = (plain.value - plain.standard_error * count**0.5 * ends).tolist()
    return MeanLoss(
        value=plain.value,
        standard_error=plain.standard_error,
        low=min(max(low, 0.0), plain.value),
        high=max(high, plain.value),
        carried=carried,
    )


def mean_interval(values: Floats) -> tuple[float, float] | None:
    """Return the bootstrap 95 % interval (BCa) of a mean; None for fewer than ten values."""
    from scipy.stats import bootstrap

    if len(values) < 10:
        return None
    if np.ptp(values) == 0:
        return float(values[0]), float(values[0])
    size = float(np.abs(values).max())  # scaled, as cubes of values may overflow
    ends = bootstrap((values / size,), np.mean, n_resamples=2000, rng=0).confidence_interval
    return float(ends.low) * size, float(ends.high) * size


def mean_at_least(sample: Floats, doubt: float) -> float:
    """Return a lower bound on the mean of independent nonnegative numbers, wrong with chance δ.

    For n numbers X ≥ 0, with Y = min(X, c) and its sample variance s², the mean is at least
    mean Y - √(2 s² log(2/δ) / n) - 7 c log(2/δ) / (3 (n - 1)) (Thomas, Theocharous and Ghavamzadeh,
    AAAI 2015, theorem 1). The first twentieth of the sample chooses c, and the rest proves the
    bound. Of fewer than 60 numbers, less than three would choose: the bound is then 0.
    """
    first, rest = np.split(sample, [len(sample) // 20])
    if len(sample) < 60:
        return 0.0

    def bound_mean(numbers: Floats, most: float) -> float:
        cut, n = np.minimum(numbers, most), len(rest)
        spread = 2 * float(cut.var(ddof=1)) * log(2 / doubt) / n
        return float(cut.mean() - spread**0.5 - 7 * most * log(2 / doubt) / (3 * (n - 1)))

    # The bound holds for any threshold; a fine grid only makes it tight.
    grid = float(first.max()) * np.geomspace(1e-4, 2.0, 200)
    threshold = float(grid[int(np.argmax([bound_mean(first, c) for c in grid]))])
    return max(bound_mean(rest, threshold), 0.0)


def tolerances_of(regrets: Sequence[Floats], count: int = 51) -> Floats:
    """Return 0, and a geometric grid up to the largest 99 % quantile of policies' regrets (D,)."""
    most = max(float(np.quantile(regret, 0.99)) for regret in regrets)
    if most == 0:
        return np.zeros(1)
    return np.append(0.0, np.geomspace(1e-4 * most, most, count - 1))


def estimate_quantiles(
    values: Floats, probabilities: Sequence[float] = (0.025, 0.05, 0.25, 0.5, 0.75, 0.95, 0.975)
) -> list[dict[str, float]]:
    """Return quantiles of a sample with 95 % intervals between order statistics.

    The k-th smallest of n draws is above a quantile only if fewer than k draws are below it. An end
    is infinite if no draw is beyond the quantile with enough certainty.
    """
    ordered, count, listed = np.sort(values), len(values), []
    within = np.concatenate([[-np.inf], ordered, [np.inf]])
    for p in probabilities:
        chance = special.bdtr(np.arange(count), count, p)  # of at most 0, 1, … draws below
        low = float(within[np.searchsorted(chance, 1 - SURE, side="right")])
        high = float(within[np.searchsorted(chance, SURE) + 1])
        own = float(np.quantile(ordered, p))
        listed.append({"probability": p, "value": own, "low": low, "high": high})
    return listed


def upper_quantile(values: Floats, probability: float) -> float:
    """Return an order statistic that is at least a quantile with probability 0.975.

    The k-th smallest of n draws is below it only if at least k draws are; their number is binomial.
    """
    require_draws(len(values), probability)
    chance = special.bdtr(np.arange(len(values)), len(values), probability)
    return float(np.sort(values)[np.searchsorted(chance, SURE)])


def require_draws(count: int, probability: float) -> None:
    """Raise ModelError if even the greatest draw may be below a quantile: p^n > 0.025."""
    least = ceil(log(1 - SURE) / log(probability))
    if count < least:
        raise ModelError(
            f"{count:,} draws are too few for the {100 * probability:.10g} % quantile of the "
            "posterior",
            where="draws",
            fix=f"give {least:,} or more (--evidence n={least}, Posterior(n={least}))",
        )


def compute_wilson_interval(successes: ArrayLike, count: int) -> tuple[Floats, Floats]:
    """Return the ends of Wilson's 95 % interval of a share."""
    share, square = np.asarray(successes) / count, NORMAL**2
    middle = (share + square / (2 * count)) / (1 + square / count)
    half = np.sqrt(share * (1 - share) / count + square / (4 * count**2)) * NORMAL
    half = half / (1 + square / count)
    low = np.where(share == 0, 0.0, middle - half)
    return low, np.where(share == 1, 1.0, middle + half)


def estimate_share(successes: int, count: int) -> Ranged:
    """Return a share of a sample with Wilson's interval, which is sound even for 0 and 1."""
    share, (low, high) = successes / count, compute_wilson_interval(successes, count)
    error = (share * (1 - share) / count) ** 0.5
    return Ranged(value=share, standard_error=error, low=float(low), high=float(high))
