"""The cost of acting on a perceived status: the best with memory, without it, and neither.

From above to below: whoever knows the status; whoever remembers what was seen and done
(`solvers.pomdp.pomdp`, between two bounds); the best fixed reading of what is seen
(`analysis.perception.policies`, with a bound on all others); what is seen taken for true. Which
errors cost most is in `analysis.perception.errors`, and how the value depends on the accuracy in
`analysis.perception.accuracy`.

Where the confusion of statuses is known from counts only, its rows are drawn from their posterior
(`mdp.care.perception`), and the policy is evaluated under each draw: mean and quantiles are
estimates, of what the labels leave open.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.gate.column_policies import BestPolicy, is_proven
from exact_mdp.analysis.perception.policies import NODES, best_perceived_policy, place_by_place
from exact_mdp.mdp.care.perception import LEVEL, Counted
from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.randomness import RNG, seed_of
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers import solve
from exact_mdp.solvers.pomdp.pomdp import BeliefSolution, solve_beliefs
from exact_mdp.solvers.pomdp.values import acting, at_start, rounding, values
from exact_mdp.solvers.solution import Bounded, Estimated
from exact_mdp.solvers.values.policy_chain import policy_of

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")

BATCH = 256  # matrices evaluated at once


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PriceOfPerception(Result):
    """What perceiving with errors leaves of the optimum, by how it is dealt with.

    Attributes
    ----------
    perfect : Bounded
        The optimum of whoever knows the status.
    filtering : BeliefSolution
        The best that remembers, from both sides.
    memoryless : BestPolicy
        The best deterministic policy that reads the perceived status alone, and what bounds others.
    with_place : BestPolicy
        The same where the place, such as subtask and trial, is read as well.
    taken_as_true : Bounded
        The policy given (the optimum for the true status), acting as if it saw the truth.
    unseeing : BeliefSolution
        The best that remembers and sees nothing: what perception adds is the difference.
    """

    perfect: Bounded
    filtering: BeliefSolution
    memoryless: BestPolicy
    with_place: BestPolicy
    taken_as_true: Bounded
    unseeing: BeliefSolution

    @property
    def value(self) -> Bounded:
        """The value of the best that remembers."""
        return self.filtering.value

    def frame(self) -> DataFrame:
        """Return one row for each way to deal with errors, between bounds on the best of its kind.

        The bounds of a policy that is known hold for its own value.
        """
        placed, fixed = self.with_place, self.memoryless
        rows = [
            ("the status is known", *self.perfect.interval),
            ("memory of what was seen and done", *self.filtering.interval),
            ("memory of what was done, seeing nothing", *self.unseeing.interval),
            (f"best by {', '.join(placed.columns)} seen", placed.value.value, placed.upper_bound),
            (f"best by {', '.join(fixed.columns)} seen", fixed.value.value, fixed.upper_bound),
            ("seen taken for true", *self.taken_as_true.interval),
        ]
        return pandas.DataFrame(rows, columns=["way", "low (reward)", "high (reward)"])


def price_of_perception(
    model: MDP,
    confusion: ArrayLike,
    *,
    policy: PolicyLike = "optimal",
    tol: float = 0.02,
    seconds: float = 5.0,
    max_trials: int = 100_000,
    node_limit: int = NODES,
) -> PriceOfPerception:
    """Return what is left of the optimum under a perception, in four ways of dealing with it.

    Parameters
    ----------
    model : MDP
        With a column `status`.
    confusion : (Z, Z)
        Probabilities of the perceived status (column) given the true one (row).
    policy : PolicyLike
        What is taken for true perceptions; the optimum unless given.
    tol, seconds, max_trials : float, float, int
        When each of the two searches over beliefs ends; where time ends it, bounds differ a little
        from one run to the next.
    node_limit : int
        Relaxations solved for the best memoryless policy at most.

    Returns
    -------
    PriceOfPerception

    Raises
    ------
    ModelError
        Where the model has no statuses, or a limit is not positive.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.mdp.care.perception import independent
    >>> mdp = Scenario.load("yuan2025").with_(tasks=[1]).compile()
    >>> found = price_of_perception(mdp, independent([0.9] * 4, [0.9] * 4), tol=0.05)
    >>> f"{found.taken_as_true.value:.2f} {found.memoryless.value.value:.2f}"
    '60.32 60.54'
    >>> found.memoryless.value.value <= found.filtering.upper <= found.perfect.interval[1] + 1e-9
    True
    """
    process, optimum = Process.of(model, confusion), solve(model)
    optimal = isinstance(policy, str) and policy == "optimal"
    chosen = policy_of(model, optimum if optimal else policy)
    value, _ = values(process, acting(process, process.table(chosen)))
    reading = best_perceived_policy(model, process, node_limit=node_limit)
    placed = best_perceived_policy(
        model,
        process,
        model.space.names,
        start=place_by_place(process, [chosen, reading.policy, "random"]),
        node_limit=max(1, node_limit // 10),
    )
    blind = process.with_confusion(np.full_like(process.confusion, 1 / process.statuses))
    filtering, unseeing = (
        solve_beliefs(seen, tol=tol, seconds=seconds, max_trials=max_trials, begin=begin)
        for seen, begin in ((process, [chosen, reading.policy, placed.policy]), (blind, None))
    )
    return PriceOfPerception(
        perfect=optimum.start,
        filtering=filtering,
        memoryless=_capped(reading, filtering.upper),
        with_place=_capped(placed, filtering.upper),
        taken_as_true=Bounded(value=float(at_start(process, value)[0]), error=rounding(process)),
        unseeing=unseeing,
    )


def _capped(best: BestPolicy, upper: float) -> BestPolicy:
    """Return a best policy with what no controller can exceed among its upper bounds."""
    cap = max(min(best.mixed_upper_bound, upper), best.value.interval[0])
    bound = min(best.upper_bound, cap)
    proven = is_proven(best.value, bound)
    return replace(best, mixed_upper_bound=cap, upper_bound=bound, proven=proven)


# ---- a confusion known from counts ---------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class UncertainValue(Result):
    """A policy's value where the confusion is known from counts only.

    Attributes
    ----------
    at_mean : Bounded
        Under the posterior mean of the confusion.
    value : Estimated
        The mean over matrices drawn from the posterior.
    interval : (low, high)
        The credible interval, between quantiles of the draws.
    level : float
    draws : (N,)
        The values.
    """

    at_mean: Bounded
    value: Estimated
    interval: tuple[float, float]
    level: float
    draws: Floats

    @property
    def error(self) -> float:
        """The standard error of the mean."""
        return self.value.standard_error

    def frame(self) -> DataFrame:
        """Return one row for each draw."""
        return pandas.DataFrame({"value (reward)": self.draws})


def value_under_counts(
    model: MDP,
    policy: PolicyLike,
    counts: Counted,
    *,
    rng: RNG,
    n: int = 2000,
    level: float = LEVEL,
) -> UncertainValue:
    """Return the value of a policy under a confusion of which only counts are known.

    The policy reads the perceived status; n matrices are drawn from the posterior of the counts,
    which have a prior.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> seen = Counted(counts=50 * np.eye(16, dtype=int), prior=1 / 16)
    >>> found = value_under_counts(mdp, "optimal", seen, rng=0, n=200)
    >>> found.interval[0] < found.at_mean.value < found.interval[1]
    True
    """
    if n < 1 or not 0 < level < 1:
        raise ModelError(
            f"{n} draws, level {level}",
            where="value_under_counts",
            fix="give 1 or more, and such as 0.95",
        )
    drawn = rng if isinstance(rng, np.random.Generator) else np.random.default_rng(seed_of(rng))
    process = Process.of(model, counts.mean)
    table = process.table(policy_of(model, policy))

    def worth(matrices: Floats | None) -> Floats:
        return at_start(process, values(process, acting(process, table, matrices))[0])

    sizes = [min(BATCH, n - first) for first in range(0, n, BATCH)]
    draws = np.concatenate([worth(counts.samples(drawn, size)) for size in sizes])
    draws.setflags(write=False)
    tail = (1 - level) / 2
    low, high = np.quantile(draws, [tail, 1 - tail]).tolist()
    error = float(draws.std(ddof=1) / np.sqrt(n)) if n > 1 else inf
    return UncertainValue(
        at_mean=Bounded(value=float(worth(None)[0]), error=rounding(process)),
        value=Estimated(value=float(draws.mean()), standard_error=error),
        interval=(low, high),
        level=level,
        draws=draws,
    )
