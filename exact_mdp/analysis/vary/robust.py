"""How much a policy can lose where each row's probabilities may be off, and what hedging costs.

Uncertainty is (s, a)-rectangular: each row has a set of laws around the tables' one, and nature
picks from each on its own, against the agent or with it. An error in a table is something else:
many rows share one number; for that see `analysis.vary.corners`. The sets are those
of Iyengar (Mathematics of Operations Research 30, 2005).

Four values at the start, the policy re-optimised against the sets (robust) or held as it is
(nominal), under the tables' laws or nature's worst, give

    price of robustness = nominal value of the nominal policy - nominal value of the robust one,
    worst-case gain     = worst case of the robust policy - worst case of the nominal one

(Bertsimas and Sim, Operations Research 52, 2004, for the price).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.vary.base_case import finite_worth
from exact_mdp.mdp.errors import ModelError, known, listed, named_options
from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, claimed
from exact_mdp.mdp.result import Pictured, Result
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.robust.divergence import Likelihood, RelativeEntropy
from exact_mdp.solvers.robust.robust import Nature, RobustSolution, solve_robust
from exact_mdp.solvers.robust.sets import Ambiguity, Intervals, L1Ball, radius_of
from exact_mdp.solvers.solution import Bounded, difference
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.policy_chain import PolicyChain

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Robust(Result):
    """Values at the start under nominal, worst and best laws, and the policies behind them.

    Attributes
    ----------
    mdp : MDP
    policy : (L,)
        Probability of each pair under the nominal policy: the optimum of the tables as they are,
        or one that was given.
    value, worst, best : Bounded
        The nominal policy's value with the tables as they are, and at nature's worst and best.
    robust : RobustSolution
        The best policy against nature's worst, and its worst case.
    optimistic : RobustSolution
        The best policy with nature's best.
    robust_value, robust_best : Bounded
        The robust policy's value with the tables as they are, and at nature's best.
    """

    mdp: MDP
    policy: Floats
    value: Bounded
    worst: Bounded
    best: Bounded
    robust: RobustSolution
    optimistic: RobustSolution
    robust_value: Bounded
    robust_best: Bounded

    def __repr__(self) -> str:
        return (
            f"Robust(value {self.value}; worst case {self.worst}, of the robust policy "
            f"{self.robust.start})"
        )

    @property
    def price(self) -> Bounded:
        """What the robust policy gives up where the tables are right."""
        return self._less(self.value, self.robust_value)

    @property
    def gain(self) -> Bounded:
        """What the robust policy earns more in its worst case than the nominal one in its own."""
        return self._less(self.robust.start, self.worst)

    def _less(self, one: Bounded, other: Bounded) -> Bounded:
        """Return how much better one value is than another: of costs, how much less."""
        costs = self.mdp.sense == "min"
        return difference(other, one) if costs else difference(one, other)

    @property
    def changed(self) -> Numbers:
        """(K,) states in which the policies differ, of those that either of them reaches."""
        mdp, taken = self.mdp, _weights(self.robust)
        apart = np.abs(taken - self.policy) > 1e-12
        differs = np.logical_or.reduceat(apart, mdp.pair_offsets[:-1])
        seen = reachable(mdp, pairs=taken > 0) | reachable(mdp, pairs=self.policy > 0)
        return np.flatnonzero(differs & seen & ~mdp.terminal)

    def report(self) -> Report:
        """Return the values under the tables, and under nature's worst and best."""
        mdp = self.mdp
        changes = [
            {
                "state": mdp.space.label(state),
                "before": " or ".join(
                    mdp.actions[mdp.pair_action[pair]]
                    for pair in mdp.pairs_of(state)
                    if self.policy[pair] > 0
                ),
                "after": mdp.actions[mdp.pair_action[np.asarray(self.robust.pairs)[state]]],
            }
            for state in self.changed.tolist()
        ]
        best = {"value": self.optimistic.start.value, "error_bound": self.optimistic.start.error}
        worst = {"value": self.robust.start.value, "error_bound": self.robust.start.error}
        values = [
            {"policy": "held", "right": self.value, "worst": self.worst, "best": self.best},
            {
                "policy": "robust",
                "right": self.robust_value,
                "worst": self.robust.start,
                "best": self.robust_best,
            },
        ]
        columns = {"tables right": "right", "worst case": "worst", "best case": "best"}
        return Report(
            title="robust",
            facts={
                **claimed("start_value", self.value),
                "nature": "dynamic, independent in each state and action",
                "worst_case": Shown(worst | {"nominal_policy": self.worst}),
                "best_case": Shown(best | {"nominal_policy": self.best}),
                "price_of_robustness": self.price,
                "worst_case_gain": self.gain,
                "robust_policy_value": Shown(self.robust_value),
                "policy_changes": changes,
                "seconds": Shown(self.robust.seconds),
            },
            tables={
                "values": Table(
                    title="value at the start",
                    rows=values,
                    columns={"policy": "policy", **columns},
                ),
                "policy_changes": Table(
                    title="states in which the robust policy takes another action",
                    columns={"state": "state", "held": "before", "robust": "after"},
                ),
            },
        )

    def frame(self) -> DataFrame:
        """Return values at the start (reward), one row for each policy and law."""
        import pandas

        rows = [
            ("nominal", "nominal", self.value),
            ("nominal", "worst", self.worst),
            ("nominal", "best", self.best),
            ("robust", "nominal", self.robust_value),
            ("robust", "worst", self.robust.start),
            ("robust", "best", self.robust_best),
            ("optimistic", "best", self.optimistic.start),
        ]
        headings = ["policy", "laws", "value (reward)", "error bound (reward)"]
        table = [(policy, laws, number.value, number.error) for policy, laws, number in rows]
        return pandas.DataFrame(table, columns=headings)


def _weights(solution: RobustSolution) -> Floats:
    """Return (L,) probabilities of pairs of the policy that was found."""
    assert solution.pairs is not None
    taken = np.zeros(solution.mdp.n_pairs)
    taken[solution.pairs] = 1.0
    return taken


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobustCurve(Pictured):
    """How values move with the radius of the sets.

    Attributes
    ----------
    kind : str
        As in `SETS`.
    points : tuple of (radius, Robust)
    """

    kind: str
    points: tuple[tuple[float, Robust], ...]

    def __repr__(self) -> str:
        ends = " to ".join(f"{self.points[k][0]:g}" for k in (0, -1))
        return f"RobustCurve({len(self.points)} radii of {self.kind}, {ends})"

    def frame(self) -> DataFrame:
        """Return values at the start (reward), one row for each radius."""
        import pandas

        return pandas.DataFrame(
            [
                {
                    "set": self.kind,
                    "radius": radius,
                    "nominal policy, nominal (reward)": each.value.value,
                    "nominal policy, worst (reward)": each.worst.value,
                    "robust policy, nominal (reward)": each.robust_value.value,
                    "robust policy, worst (reward)": each.robust.start.value,
                    "price of robustness (reward)": each.price.value,
                    "worst-case gain (reward)": each.gain.value,
                    "states changed": len(each.changed),
                }
                for radius, each in self.points
            ]
        )


SETS: MappingProxyType[str, Callable[[MDP, object], Ambiguity]] = MappingProxyType(
    {
        "interval": Intervals.relative,
        "absolute": Intervals.absolute,
        "l1": lambda mdp, radius: L1Ball(radius=radius),
        "kl": lambda mdp, radius: Likelihood(radius=radius),
        "entropy": lambda mdp, radius: RelativeEntropy(radius=radius),
    }
)
"""Sets by name and radius: p (1 ± x), p ± x, L1 distance, KL(p‖q) and KL(q‖p) in nats."""


def ambiguity_of(mdp: MDP, kind: str, radius: object) -> Ambiguity:
    """Return a set of laws by name (see `SETS`); raises ModelError for others."""
    return SETS[known(kind, SETS, "set", "robust")](mdp, radius)


@named_options
def robust(
    model: MDP,
    ambiguity: Ambiguity | None = None,
    *,
    policy: PolicyLike = "optimal",
) -> Robust:
    """Return the worst and the best case of a policy, and the best policy against the worst.

    Parameters
    ----------
    model : MDP
    ambiguity : Ambiguity, optional
        Sets of laws; p ± 20 % of itself unless given.
    policy : PolicyLike
        The nominal policy.

    Returns
    -------
    Robust

    Raises
    ------
    ModelError
        As `solvers.robust.robust.solve_robust` does.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> cases = robust(Scenario.load("yuan2025").compile())
    >>> print(f"{cases.value.value:.4f} {cases.worst.value:.4f} {cases.robust.start.value:.4f}")
    146.2359 140.7817 140.7817
    """
    model = mdp_of(model)
    sets = Intervals.relative(model, "1/5") if ambiguity is None else ambiguity
    chain = PolicyChain.of(model, policy)

    def fixed(weights: Floats, nature: Nature) -> Bounded:
        return solve_robust(model, sets, nature=nature, policy=weights).start

    best = solve_robust(model, sets)
    own = _weights(best)
    return Robust(
        mdp=model,
        policy=chain.weights,
        value=finite_worth(model, chain, "today's laws"),
        worst=fixed(chain.weights, "worst"),
        best=fixed(chain.weights, "best"),
        robust=best,
        optimistic=solve_robust(model, sets, nature="best"),
        robust_value=finite_worth(model, own, "today's laws"),
        robust_best=fixed(own, "best"),
    )


def robust_curve(
    model: MDP, kind: str, radii: Iterable[object], *, policy: PolicyLike = "optimal"
) -> RobustCurve:
    """Return `robust` at each radius of one kind of set.

    Parameters
    ----------
    model : MDP
    kind : str
        As in `SETS`.
    radii : iterable of numbers
    policy : PolicyLike
        The nominal policy.

    Returns
    -------
    RobustCurve

    Raises
    ------
    ModelError
        For an unknown kind, and where no radius or one that cannot be is given.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> cases = robust_curve(Scenario.load("yuan2025").compile(), "l1", [0, 0.1])
    >>> [round(each.robust.start.value, 3) for _, each in cases.points]
    [146.236, 139.106]
    """
    model = mdp_of(model)
    numbers = [radius_of(radius, "a radius") for radius in listed(radii, "radii")]
    if not numbers:
        raise ModelError(
            "no radius is given", where="robust curve", fix="give some, such as [0, 0.1, 0.2]"
        )
    chain = PolicyChain.of(model, policy)
    points = [(x, robust(model, ambiguity_of(model, kind, x), policy=chain)) for x in numbers]
    return RobustCurve(kind=kind, points=tuple(points))
