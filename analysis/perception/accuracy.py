"""How the value depends on the accuracy of perception: curves, and what is best along them.

With accuracy x a status is read rightly with probability x where it is present and where it is
absent, the statuses independently. Curves of a policy's value over a grid come from
`solvers.pomdp.values`, and the best memoryless policy along it (how it hedges as perception
worsens) from `analysis.perception.policies`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.gate.column_policies import BestPolicy
from exact_mdp.analysis.gate.relaxation import Flags
from exact_mdp.analysis.perception.cost import PriceOfPerception, price_of_perception
from exact_mdp.analysis.perception.policies import NODES, best_perceived_policy, status_names
from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.pomdp.values import acting, at_start, rounding, values, visits
from exact_mdp.solvers.values.policy_chain import policy_of

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")

ALL = "all"


def confusion_at(model: MDP, accuracy: float, status: str = ALL) -> Floats:
    """Return the confusion (Z, Z) at one accuracy of a status, the others perfect, or of all."""
    if not 0 <= accuracy <= 1:
        raise ModelError(f"accuracy is {accuracy}", where="accuracy", fix="choose from 0 to 1")
    found = np.ones((1, 1))
    names = status_names(model)
    if status not in (*names, ALL):
        raise ModelError(
            f"unknown status {status!r}", where="accuracy", fix=suggest(status, [*names, ALL])
        )
    for name in names:
        x = accuracy if status in (name, ALL) else 1.0
        found = np.kron(found, np.array([[x, 1 - x], [1 - x, x]]))
    return found


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AccuracyCurves(Pictured):
    """Values of a policy on perceptions along accuracies, status by status and for all.

    Attributes
    ----------
    levels : (M,)
    values : {status, or "all": (M,)}
        The value where this status is perceived with the accuracy and the others perfectly.
    error : float
        No value is off by more than this.
    """

    picture = "exact_mdp.analysis.plots.perception:plot_accuracy_curves"

    levels: Floats
    values: dict[str, Floats]
    error: float

    def frame(self) -> DataFrame:
        """Return one row for each accuracy, one column for each status and for all."""
        return pandas.DataFrame({"accuracy": self.levels} | self.values)


def accuracy_curves(
    model: MDP,
    policy: PolicyLike = "optimal",
    *,
    levels: Iterable[float] | None = None,
    statuses: Sequence[str] | None = None,
) -> AccuracyCurves:
    """Return the value of a policy that takes what it perceives for true, along accuracies.

    Parameters
    ----------
    model : MDP
        With a column `status`.
    policy : PolicyLike
    levels : iterable of float, optional
        Accuracies; 51 from 0.5 to 1 unless given.
    statuses : sequence of str, optional
        The curves; one for each status and "all" unless given.

    Returns
    -------
    AccuracyCurves

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> found = accuracy_curves(Scenario.load("yuan2025").compile(), levels=[0.9, 1])
    >>> found.values["all"].round(4).tolist()
    [140.7766, 146.2359]
    """
    grid = np.linspace(0.5, 1.0, 51) if levels is None else np.array(list(levels), dtype=float)
    process = Process.of(model, confusion_at(model, 1.0))
    table = process.table(policy_of(model, policy))
    found = {}
    for name in (*status_names(model), ALL) if statuses is None else statuses:
        matrices = np.stack([confusion_at(model, x, name) for x in grid.tolist()])
        found[name] = at_start(process, values(process, acting(process, table, matrices))[0])
    return AccuracyCurves(levels=grid, values=found, error=rounding(process))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Hedging(Pictured):
    """The best memoryless policy on perceptions as perception worsens.

    Attributes
    ----------
    mdp : MDP
    levels : (M,)
        Accuracies of all statuses.
    best : tuple of M BestPolicy
    taken_as_true : (M,)
        The value of the policy given, taking what it perceives for true.
    """

    picture = "exact_mdp.analysis.plots.perception:plot_hedging"

    mdp: MDP
    levels: Floats
    best: tuple[BestPolicy, ...]
    taken_as_true: Floats

    @classmethod
    def of(
        cls, model: MDP, levels: Sequence[float], prices: Sequence[PriceOfPerception]
    ) -> Hedging:
        """Return what prices along accuracies say of the best memoryless policy."""
        return cls(
            mdp=model,
            levels=np.array(levels, dtype=float),
            best=tuple(price.memoryless for price in prices),
            taken_as_true=np.array([price.taken_as_true.value for price in prices]),
        )

    @property
    def actions(self) -> Integers:
        """(M, K) the action number for each perceived status."""
        return np.stack([best.policy.table.argmax(axis=1) for best in self.best])

    @property
    def seen(self) -> Flags:
        """(M, K) whether the best policy ever perceives a status where it has a choice."""
        first = Process.of(self.mdp, confusion_at(self.mdp, 1.0))
        choice = first.offered.sum(axis=1) > 1
        found = []
        for x, best in zip(self.levels.tolist(), self.best, strict=True):
            process = first.with_confusion(confusion_at(self.mdp, x))
            met = visits(process, acting(process, process.table(best.policy)))[choice, :, 0]
            found.append(met.sum(axis=0) @ process.confusion > 0)
        return np.stack(found)

    @property
    def values(self) -> Floats:
        """(M,) the values of the best memoryless policies."""
        return np.array([best.value.value for best in self.best])

    @property
    def upper_bounds(self) -> Floats:
        """(M,) no deterministic memoryless policy is worth more."""
        return np.array([best.upper_bound for best in self.best])

    def frame(self) -> DataFrame:
        """Return one row for each accuracy."""
        return pandas.DataFrame(
            {
                "accuracy": self.levels,
                "best memoryless (reward)": self.values,
                "upper bound (reward)": self.upper_bounds,
                "taken for true (reward)": self.taken_as_true,
            }
        )


def hedging(
    model: MDP,
    policy: PolicyLike = "optimal",
    *,
    levels: Sequence[float] = (1.0, 0.98, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.65, 0.6),
    node_limit: int = NODES,
) -> Hedging:
    """Return the best memoryless policy at each accuracy of all statuses.

    Parameters
    ----------
    model : MDP
        With a column `status`.
    policy : PolicyLike
        What is compared, taking what it perceives for true.
    levels : sequence of float
        Accuracies.
    node_limit : int
        Relaxations solved for each at most.

    Returns
    -------
    Hedging

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
        matrix = confusion_at(model, float(x))
        found.append(best_perceived_policy(model, matrix, start=before, node_limit=node_limit))
    curves = accuracy_curves(model, policy, levels=levels, statuses=[ALL])
    return Hedging(
        mdp=model, levels=curves.levels, best=tuple(found), taken_as_true=curves.values[ALL]
    )


def prices(
    model: MDP, levels: Sequence[float], policy: PolicyLike = "optimal", **limits: Any
) -> tuple[PriceOfPerception, ...]:
    """Return `price_of_perception` at each accuracy of all statuses, with its limits."""
    return tuple(
        price_of_perception(model, confusion_at(model, float(x)), policy=policy, **limits)
        for x in levels
    )
