"""How the value depends on the accuracy of perception: curves, and what is best along them.

With accuracy x a status is read rightly with probability x where it is present and where it is
absent, the statuses independently. Curves of a policy's value over a grid come from
`solvers.pomdp.values`, and the best memoryless policy along it (how it hedges as perception
worsens) from `analysis.perception.policies`. The accuracy that is needed for a share of the value
is found exactly, in `analysis.perception.needed`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.gate.column_policies import BestPolicy
from exact_mdp.analysis.perception.cost import PriceOfPerception, price_of_perception
from exact_mdp.analysis.perception.needed import ALL, AccuracyNeeded, accuracy_needed, confusion_at
from exact_mdp.analysis.perception.policies import (
    NODES,
    best_perceived_policy,
    chosen_policy,
    status_names,
)
from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.pomdp.values import acting, at_start, rounding, values
from exact_mdp.solvers.solution import Claim

if TYPE_CHECKING:
    from pandas import DataFrame

__all__ = [
    "ALL",
    "AccuracyCurves",
    "AccuracyNeeded",
    "Hedging",
    "accuracy_curves",
    "accuracy_needed",
    "confusion_at",
    "hedging",
    "prices",
]


@dataclass(frozen=True, kw_only=True, eq=False)
class AccuracyCurves:
    """Values of a policy on perceptions along accuracies, status by status and for all.

    Attributes
    ----------
    levels : (M,)
    values : {status, or "all": (M,)}
        The value where this status is perceived with the accuracy and the others perfectly.
    error : float
        No value is off by more than this.
    """

    levels: Floats
    values: dict[str, Floats]
    error: float

    @property
    def claim(self) -> Claim:
        """What is claimed of every value."""
        return Claim.BOUNDED

    def frame(self) -> DataFrame:
        """Return one row for each accuracy, one column for each status and for all."""
        from pandas import DataFrame

        return DataFrame({"accuracy": self.levels} | self.values)


def accuracy_curves(
    mdp: MDP,
    policy: object = "optimal",
    *,
    levels: Iterable[float] | None = None,
    statuses: Sequence[str] | None = None,
) -> AccuracyCurves:
    """Return the value of a policy that takes what it perceives for true, along accuracies.

    Parameters
    ----------
    levels : accuracies; 51 from 0.5 to 1 unless given
    statuses : the curves; one for each status and "all" unless given

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> found = accuracy_curves(Scenario.load("yuan2025").compile(), levels=[0.9, 1])
    >>> found.values["all"].round(4).tolist()
    [140.7766, 146.2359]
    """
    grid = np.linspace(0.5, 1.0, 51) if levels is None else np.array(list(levels), dtype=float)
    process = Process.of(mdp, confusion_at(mdp, 1.0))
    table = process.table(chosen_policy(mdp, policy))
    found = {}
    for name in (*status_names(mdp), ALL) if statuses is None else statuses:
        matrices = np.stack([confusion_at(mdp, x, name) for x in grid.tolist()])
        found[name] = at_start(process, values(process, acting(process, table, matrices))[0])
    return AccuracyCurves(levels=grid, values=found, error=rounding(process))


@dataclass(frozen=True, kw_only=True, eq=False)
class Hedging:
    """The best memoryless policy on perceptions as perception worsens.

    Attributes
    ----------
    mdp : MDP
    levels : (M,) accuracies of all statuses
    best : tuple of M BestPolicy
    taken_as_true : (M,)
        What the policy given is worth, taking what it perceives for true.
    """

    mdp: MDP
    levels: Floats
    best: tuple[BestPolicy, ...]
    taken_as_true: Floats

    @classmethod
    def of(cls, mdp: MDP, levels: Sequence[float], prices: Sequence[PriceOfPerception]) -> Hedging:
        """Return what prices along accuracies say of the best memoryless policy."""
        return cls(
            mdp=mdp,
            levels=np.array(levels, dtype=float),
            best=tuple(price.memoryless for price in prices),
            taken_as_true=np.array([price.taken_as_true.value for price in prices]),
        )

    @property
    def actions(self) -> Integers:
        """(M, K) the action number for each perceived status."""
        return np.stack([best.policy.table.argmax(axis=1) for best in self.best])

    @property
    def values(self) -> Floats:
        """(M,) what the best memoryless policies are worth."""
        return np.array([best.value.value for best in self.best])

    @property
    def upper_bounds(self) -> Floats:
        """(M,) no deterministic memoryless policy is worth more."""
        return np.array([best.upper_bound for best in self.best])


def hedging(
    mdp: MDP,
    policy: object = "optimal",
    *,
    levels: Sequence[float] = (1.0, 0.98, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.65, 0.6),
    node_limit: int = NODES,
) -> Hedging:
    """Return the best memoryless policy at each accuracy of all statuses.

    Parameters
    ----------
    policy : what is compared, taking what it perceives for true
    levels : accuracies
    node_limit : relaxations solved for each at most

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> found = hedging(Scenario.load("yuan2025").compile(), levels=[1, 0.9])
    >>> [best.proven for best in found.best], (found.values >= found.taken_as_true).tolist()
    ([True, True], [True, True])
    """
    found: list[BestPolicy] = []
    for x in levels:
        before = found[-1].policy if found else None
        matrix = confusion_at(mdp, float(x))
        found.append(best_perceived_policy(mdp, matrix, start=before, node_limit=node_limit))
    curves = accuracy_curves(mdp, policy, levels=levels, statuses=[ALL])
    return Hedging(
        mdp=mdp,
        levels=np.array(levels, dtype=float),
        best=tuple(found),
        taken_as_true=curves.values[ALL],
    )


def prices(
    mdp: MDP, levels: Sequence[float], policy: object = "optimal", **limits: Any
) -> tuple[PriceOfPerception, ...]:
    """Return what is left of the optimum at each accuracy of all statuses.

    Parameters
    ----------
    levels : accuracies
    **limits : as for `analysis.perception.cost.price_of_perception`
    """
    return tuple(
        price_of_perception(mdp, confusion_at(mdp, float(x)), policy=policy, **limits)
        for x in levels
    )
