"""The verdict on the reported policy under one reading: value, regret, where it errs, and ranking.

That n experiments for each of three policies rank them as the paper found is

    P(S₂ > S₃ > S₁),   S_i the sum of n independent returns of policy i.

At discount 1 returns lie on a lattice, and `paper_repro.readings.ranking` has the distributions of
the sums without an approximation. Otherwise averages are taken as normal with the exact means and
variances: the integral over x of P(S₂ > x) P(S₁ < x) against the density of S₃, which the central
limit theorem allows (where both are known they differ by less than 10⁻⁴ at 1,000 experiments). What
the paper reports: Yuan et al. (2025), Section 4.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.check import check
from exact_mdp.analysis.gate.disagreements import Disagreement
from exact_mdp.mdp import MDP, Policy
from exact_mdp.mdp.table import Floats
from exact_mdp.paper_repro.readings.evidence import EXPERIMENTS, Evidence
from exact_mdp.paper_repro.readings.ranking import ranked, sums
from exact_mdp.paper_repro.readings.search import STARTS, ReadingSearch
from exact_mdp.solvers import evaluate
from exact_mdp.solvers.solution import Bounded, Certified
from exact_mdp.solvers.values.evaluate import Evaluation
from exact_mdp.solvers.values.returns import return_distribution

AS_FOUND = ("non-directive", "directive", "supportive")  # action in 0000, best policy first


@dataclass(frozen=True, kw_only=True)
class RankingChance:
    """Probability that so many experiments rank the three policies as the paper found them.

    Attributes
    ----------
    experiments : int
    normal : float
        With normal averages of the exact means and variances.
    exact : Bounded or None
        From the exact distribution of the sums; None where returns lie on no lattice.
    """

    experiments: int
    normal: float
    exact: Bounded | None

    @property
    def best(self) -> float:
        """The exact probability where there is one."""
        return self.normal if self.exact is None else min(self.exact.value, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingVerdict:
    """What the reported policies are worth under one reading.

    Attributes
    ----------
    reading, completion : int
    label : str
        What the reading changes from the default.
    mdp : MDP
    audit : Audit
        Of the final policy, a2 in 0000.
    evaluations : mapping
        Of the three policies, by their action in 0000.
    ranking : tuple of RankingChance
        For 1,000 and for 10,000 experiments.
    regret_range : (float, float)
        Least and largest regret of the final policy over all completions.
    """

    reading: int
    completion: int
    label: str
    mdp: MDP
    audit: Audit
    evaluations: Mapping[str, Evaluation]
    ranking: tuple[RankingChance, ...]
    regret_range: tuple[float, float]

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

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """States in which the final policy is not optimal, the costliest first."""
        return self.audit.disagreements

    def by_status(self) -> list[StatusCost]:
        """Return what each status costs, subtasks and trials added up, the costliest first."""
        space, found = self.mdp.space, dict[int, list[Disagreement]]()
        states = np.array([each.state for each in self.disagreements], dtype=np.int64)
        for status, each in zip(space.values("status", states), self.disagreements, strict=True):
            found.setdefault(int(status), []).append(each)
        rows = [
            StatusCost(
                status=space.column("status").label(status),
                learned=each[0].learned,
                optimal=_most_visited(each),
                visits=sum(one.expected_visits for one in each),
                cost=sum(one.cost for one in each),
            )
            for status, each in found.items()
        ]
        return sorted(rows, key=lambda row: (-row.cost, row.status))


@dataclass(frozen=True, kw_only=True)
class StatusCost:
    """A status in which a policy is not optimal everywhere, and what that costs an episode.

    Attributes
    ----------
    status, learned : str
    optimal : tuple of str
        Optimal actions where it is visited most.
    visits, cost : float
        Expected visits in an episode, and what they cost; costs add up to the regret.
    """

    status: str
    learned: str
    optimal: tuple[str, ...]
    visits: float
    cost: float


def _most_visited(states: Sequence[Disagreement]) -> tuple[str, ...]:
    return max(states, key=lambda each: each.expected_visits).optimal


def verdict(
    search: ReadingSearch, reading: int, completion: int, *, exact_ranking: bool = True
) -> ReadingVerdict:
    """Return the verdict under one reading with one completion.

    Raises
    ------
    ModelError
        For a reading that there is not.
    """
    label = search.space.label(reading)
    mdp = search.reading(reading).compile()
    named = {start: Policy.of(mdp, search.policy(completion, start)) for start in AS_FOUND}
    found = {start: evaluate(mdp, policy) for start, policy in named.items()}
    mean = np.array([found[start].mean for start in AS_FOUND])
    variance = np.array([found[start].start_variance for start in AS_FOUND])
    laws = None
    if exact_ranking and mdp.discount_exact == 1:
        laws = [return_distribution(mdp, found[start].chain) for start in AS_FOUND]
    regrets = search.optimum[reading] - search.mean[reading, :, STARTS.index(AS_FOUND[0])]
    return ReadingVerdict(
        reading=reading,
        completion=completion,
        label=label,
        mdp=mdp,
        audit=check(mdp, named[AS_FOUND[0]]),
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


def verdicts(found: Evidence, count: int = 5) -> list[ReadingVerdict]:
    """Return the verdict under the default and the `count` best supported readings."""
    chosen = dict.fromkeys([0, *(int(number) for number in found.ranking[:count])])
    return [verdict(found.search, number, int(found.completion[number])) for number in chosen]


# ---- the chance of the ranking -----------------------------------------------------------------


def normal_ranking(mean: Floats, variance: Floats, experiments: int) -> float:
    """Return P(A₀ > A₁ > A₂) for independent normal averages.

    Examples
    --------
    >>> round(normal_ranking(np.zeros(3), np.ones(3), 10), 12)  # one order of six
    0.166666666667
    """
    from scipy.special import log_ndtr

    spread = np.sqrt(variance / experiments)
    nodes = np.linspace(-10.0, 10.0, 4001)  # the trapezoidal rule is exact to rounding here
    middle = mean[1] + spread[1] * nodes
    logs = log_ndtr((mean[0] - middle) / spread[0]) + log_ndtr((middle - mean[2]) / spread[2])
    density = np.exp(-0.5 * nodes**2 + logs) / sqrt(2 * np.pi)
    return float(min(density.sum() * (nodes[1] - nodes[0]), 1.0))
