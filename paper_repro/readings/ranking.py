"""How likely experiments are to rank policies as their exact means do, without a simulation.

The return of an episode is a multiple x of one unit with probability p(x); the sum over n
experiments has the n-fold convolution of p, found by one Fourier transform, F(p)^n. Of three
independent averages A, B, C

    P(A > B > C) = Σ_b P(B = b) P(A > b) P(C < b).

Rounding. A transform of length N errs by at most e = 6 u log₂N of the norm of its input (Higham,
Accuracy and Stability of Numerical Algorithms, 2002, Theorem 24.2), raising to the power n
multiplies that by n at most since |F(p)| ≤ 1, and the inverse adds as much again. In the Euclidean
norm the error of the convolution is then at most (n + 2) e, and in total at most √N times that;
`Sums.error` carries ten times as much.

Of many experiments only the sums near their mean are kept: Hoeffding (1963, Theorem 2) bounds the
probability of the others, which the cyclic transform adds to those kept; it is in the error too.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor, log, log2, sqrt

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.solution import Bounded
from exact_mdp.solvers.values.returns import ReturnDistribution

OUTSIDE = 1e-18  # probability that may be left out


@dataclass(frozen=True, kw_only=True, eq=False)
class Sums:
    """The law of the sum of n independent returns.

    Attributes
    ----------
    lowest : int
        Least sum that is kept, in units.
    unit : Fraction
    runs : int
    probability : (N,)
        Of the sums lowest, lowest + 1, … in units.
    error : float
        The probabilities are off by this much in total, at most.
    """

    lowest: int
    unit: Fraction
    runs: int
    probability: Floats
    error: float

    def at_least(self, average: float) -> Bounded:
        """Return the probability of an average of at least so much."""
        bound = Fraction(average) * self.runs / self.unit - self.lowest
        first = min(max(-(-bound.numerator // bound.denominator), 0), len(self.probability))
        return Bounded(value=float(self.probability[first:].sum()), error=self.error)


def sums(distribution: ReturnDistribution, runs: int) -> Sums:
    """Return the law of the sum of so many independent returns.

    Examples
    --------
    >>> import numpy as np
    >>> coin = ReturnDistribution(
    ...     multiples=np.array([0, 1]),
    ...     unit=Fraction(1),
    ...     probabilities=np.array([0.5, 0.5]),
    ...     relative_error=0.0,
    ...     remaining=0.0,
    ... )
    >>> sums(coin, 2).probability.round(12).tolist()
    [0.25, 0.5, 0.25]
    """
    from scipy.fft import irfft, next_fast_len, rfft

    low, high = int(distribution.multiples[0]), int(distribution.multiples[-1])
    single = np.zeros(high - low + 1)
    single[distribution.multiples.astype(np.int64) - low] = distribution.probabilities
    size = (high - low) * runs + 1
    # Hoeffding's inequality: all but OUTSIDE of the probability is this near to the mean.
    near = ceil((high - low) * sqrt(runs * log(2 / OUTSIDE) / 2)) + 2
    first = floor(runs * float(np.arange(len(single)) @ single)) - near
    windowed = 2 * near + 1 < size
    first, size = (first, 2 * near + 1) if windowed else (0, size)
    if size > 2**26:
        raise ModelError(f"{size:,} possible sums", where="ranking", fix="use fewer experiments")
    length = next_fast_len(size, real=True)
    # Sums that differ by the length fall together, all but one of them outside.
    whole = np.roll(irfft(rfft(single, length) ** runs, length), -(first % length))[:size]
    rounding = 6 * UNIT * log2(length) * (runs + 2) * sqrt(length) * 10
    given = runs * float(distribution.error.sum())
    return Sums(
        lowest=low * runs + first,
        unit=distribution.unit,
        runs=runs,
        probability=np.maximum(whole, 0.0),
        error=rounding + given + (2 * OUTSIDE if windowed else 0.0),
    )


def ranked(first: Sums, second: Sums, third: Sums) -> Bounded:
    """Return the probability that the first sum is above the second, and that above the third."""
    if len({each.unit for each in (first, second, third)}) > 1:
        raise ModelError("returns of different units", where="ranking", fix="use one model")
    low = min(each.lowest for each in (first, second, third))
    high = max(each.lowest + len(each.probability) for each in (first, second, third))

    def spread(each: Sums) -> Floats:
        whole = np.zeros(high - low)
        start = each.lowest - low
        whole[start : start + len(each.probability)] = each.probability
        return whole

    above, middle, below = spread(first), spread(second), spread(third)
    exceeds = np.append(np.cumsum(above[::-1])[::-1][1:], 0.0)
    falls = np.insert(np.cumsum(below)[:-1], 0, 0.0)
    error = first.error + second.error + third.error
    return Bounded(value=float(np.sum(middle * exceeds * falls)), error=error)
