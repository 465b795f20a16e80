"""What the reported policies are worth under one reading: value, regret, its causes, and ranking.

The final policy is audited by exact values. That n experiments for each of the three policies rank
them as the paper found (Yuan et al. 2025, Section 4.1) is worked out without a simulation.

The return of an episode is a multiple x of one unit with probability p(x); the sum over n
experiments has the n-fold convolution of p, found by one Fourier transform, F(p)^n. Of three
independent averages A, B, C

    P(A > B > C) = Σ_b P(B = b) P(A > b) P(C < b).

At a discount below 1 returns lie on no lattice. There averages are taken as normal with the exact
means and variances, and the sum becomes an integral, which the central limit theorem allows (where
both are known they differ by less than 10⁻⁴ at 1,000 experiments).

Rounding. A transform of length N errs by at most e = 6 u log₂N of the norm of its input (Higham,
Accuracy and Stability of Numerical Algorithms, 2002, Theorem 24.2), raising to the power n
multiplies that by n at most since |F(p)| ≤ 1, and the inverse adds as much again. In the Euclidean
norm the error of the convolution is then at most (n + 2) e, and in total at most √N times that;
`Sums.error` carries ten times as much.

Of many experiments only the sums near their mean are kept: Hoeffding (1963, Theorem 2) bounds the
probability of the others, which the cyclic transform adds to those kept; it is in the error too.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor, log, log2, sqrt

import numpy as np
from scipy import special

from exact_mdp.analysis.gate.check import Audit, check
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats
from exact_mdp.paper_repro.readings.evidence import EXPERIMENTS, Evidence
from exact_mdp.paper_repro.readings.search import ReadingSearch
from exact_mdp.paper_repro.readings.wording import changes
from exact_mdp.paper_repro.reported import FINAL, STARTS
from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.solution import Bounded, Certified
from exact_mdp.solvers.values.evaluate import Evaluation, evaluate
from exact_mdp.solvers.values.returns import ReturnDistribution, return_distribution

OUTSIDE = 1e-18  # probability that may be left out


@dataclass(frozen=True, kw_only=True)
class RankingChance:
    """Probability that this many experiments rank the three policies as the paper found them."""

    experiments: int
    normal: float  # with normal averages of the exact means and variances
    exact: Bounded | None  # from the exact law of the sums; None where returns lie on no lattice

    @property
    def best(self) -> float:
        """The exact probability where there is one."""
        return self.normal if self.exact is None else min(self.exact.value, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyUnderReading:
    """What the reported policies are worth under one reading with one completion."""

    completion: int
    label: str  # what the reading changes from the default
    mdp: MDP
    audit: Audit  # of the final policy, a2 in 0000
    evaluations: Mapping[str, Evaluation]  # of the three policies, by their action in 0000
    ranking: tuple[RankingChance, ...]  # for 1,000 and for 10,000 experiments
    regret_range: tuple[float, float]  # of the final policy, over all completions

    @property
    def value(self) -> Certified | Bounded:
        """Exact value of the final policy at the start."""
        return self.audit.regret.learned

    @property
    def optimal(self) -> Certified | Bounded:
        """Exact optimal value at the start."""
        return self.audit.regret.optimal

    @property
    def regret(self) -> Certified | Bounded:
        """Exact regret of the final policy."""
        return self.audit.regret.at_start


def cost_by_status(audit: Audit, space: StateSpace) -> dict[str, float]:
    """Return what each status costs an episode, the costliest first; costs add up to the regret."""
    found: defaultdict[str, float] = defaultdict(float)
    for each in audit.disagreements:
        found[space.as_dict(each.state)["status"]] += each.cost
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def under_reading(search: ReadingSearch, reading: int, completion: int) -> PolicyUnderReading:
    """Return what the reported policies are worth under one reading with one completion."""
    mdp = search.reading(reading).compile()
    named = {start: Policy.of(mdp, search.policy(completion, start)) for start in STARTS}
    found = {start: evaluate(mdp, policy) for start, policy in named.items()}
    mean = np.array([each.mean for each in found.values()])
    variance = np.array([each.start_variance for each in found.values()])
    laws = None
    if mdp.discount_exact == 1:
        laws = [return_distribution(mdp, each.chain) for each in found.values()]
    regrets = search.regret[reading]
    return PolicyUnderReading(
        completion=completion,
        label=changes(search.space, reading),
        mdp=mdp,
        audit=check(mdp, named[FINAL]),
        evaluations=found,
        ranking=tuple(
            RankingChance(
                experiments=n,
                normal=normal_ranking(mean, variance, n),
                exact=None if laws is None else ranked(*(sums(law, n) for law in laws)),
            )
            for n in EXPERIMENTS
        ),
        regret_range=(float(regrets.min()), float(regrets.max())),
    )


def under_best_readings(found: Evidence, count: int = 5) -> list[PolicyUnderReading]:
    """Return the same under the default and the `count` best supported readings."""
    numbers = dict.fromkeys([0, *found.ranking[:count].tolist()])
    return [under_reading(found.search, n, int(found.completion[n])) for n in numbers]


# ---- the chance of the ranking -----------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Sums:
    """The law of the sum of n independent returns."""

    lowest: int  # the least sum that is kept, in units
    unit: Fraction
    probability: Floats  # (N,) of the sums lowest, lowest + 1, … in units
    error: float  # the probabilities are off by this much in total, at most


def sums(distribution: ReturnDistribution, runs: int) -> Sums:
    """Return the law of the sum of this many independent returns.

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
    from scipy import fft

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
    length = fft.next_fast_len(size, real=True)
    # Sums that differ by the length fall together, all but one of them outside.
    whole = np.roll(fft.irfft(fft.rfft(single, length) ** runs, length), -(first % length))[:size]
    rounding = 6 * UNIT * log2(length) * (runs + 2) * sqrt(length) * 10
    given = runs * float(distribution.error.sum())
    return Sums(
        lowest=low * runs + first,
        unit=distribution.unit,
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


def normal_ranking(mean: Floats, variance: Floats, experiments: int) -> float:
    """Return P(A > B > C) for independent normal averages.

    >>> round(normal_ranking(np.zeros(3), np.ones(3), 10), 12)  # one order of six
    0.166666666667
    """
    spread = np.sqrt(variance / experiments)
    nodes = np.linspace(-10.0, 10.0, 4001)  # the trapezoidal rule is exact to rounding here
    middle = mean[1] + spread[1] * nodes
    above = special.log_ndtr((mean[0] - middle) / spread[0])
    below = special.log_ndtr((middle - mean[2]) / spread[2])
    density = np.exp(-0.5 * nodes**2 + (above + below)) / sqrt(2 * np.pi)
    return float(min(density.sum() * (nodes[1] - nodes[0]), 1.0))
