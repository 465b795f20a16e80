"""What it costs to act on a perceived status: the best with memory, without, and none of both.

From above to below: whoever knows the status; whoever remembers what was seen and done
(`solvers.pomdp.pomdp`, between two bounds); the best fixed reading of what is seen
(`analysis.perception.policies`, with a bound on all others); what is seen taken for true. Which
errors cost most is told by `analysis.perception.errors`, the value where the confusion is known
from counts only by `analysis.perception.uncertain`, and how it depends on the accuracy by
`analysis.perception.accuracy` and `analysis.perception.needed`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.gate.column_policies import BestPolicy, is_proven
from exact_mdp.analysis.perception.errors import ErrorCosts, error_costs
from exact_mdp.analysis.perception.policies import (
    NODES,
    best_perceived_policy,
    chosen_policy,
    place_by_place,
    status_names,
)
from exact_mdp.analysis.perception.uncertain import UncertainValue, value_under_counts
from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers import solve
from exact_mdp.solvers.pomdp.pomdp import BeliefSolution, solve_beliefs
from exact_mdp.solvers.pomdp.values import acting, at_start, rounding, values
from exact_mdp.solvers.solution import Bounded

__all__ = [
    "ErrorCosts",
    "PriceOfPerception",
    "UncertainValue",
    "chosen_policy",
    "error_costs",
    "price_of_perception",
    "status_names",
    "value_under_counts",
]


@dataclass(frozen=True, kw_only=True, eq=False)
class PriceOfPerception:
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


def price_of_perception(
    mdp: MDP,
    confusion: ArrayLike,
    *,
    policy: object = "optimal",
    tol: float = 0.02,
    seconds: float = 5.0,
    max_trials: int = 100_000,
    node_limit: int = NODES,
) -> PriceOfPerception:
    """Return what is left of the optimum under a perception, in four ways of dealing with it.

    Parameters
    ----------
    mdp : MDP with a column `status`
    confusion : (Z, Z) probabilities of the perceived status (column) given the true one (row)
    policy : what is taken for true perceptions; the optimum unless given
    tol, seconds, max_trials : when each of the two searches over beliefs ends; where time
        ends it, bounds differ a little from one run to the next
    node_limit : relaxations solved for the best memoryless policy at most

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
    limits: dict[str, Any] = {
        "tol": tol, "seconds": seconds, "max_trials": max_trials
    }  # fmt: skip
    process = Process.of(mdp, confusion)
    optimum = solve(mdp)
    chosen = chosen_policy(mdp, policy, optimum.policy)
    value, _ = values(process, acting(process, process.table(chosen)))
    reading = best_perceived_policy(mdp, process, node_limit=node_limit)
    placed = best_perceived_policy(
        mdp,
        process,
        mdp.space.names,
        start=place_by_place(process, [chosen, reading.policy, "random"]),
        node_limit=max(1, node_limit // 10),
    )
    filtering = solve_beliefs(
        process,
        **limits,
        begin=[chosen, reading.policy, placed.policy],
    )
    blind = process.with_confusion(np.full_like(process.confusion, 1 / process.statuses))
    unseeing = solve_beliefs(blind, **limits)
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
