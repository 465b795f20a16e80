"""For which weights would a policy be right? The inverse of solving, exactly.

The reward is r = Σ_c w_c c with w = 1 today. A policy π is optimal from the start under w if and
only if

    w · (v(π) - v(ρ)) ≥ 0   for every policy ρ,      v: expected totals of the components,

so that these weights are a polyhedral cone; w = 0 is in it, a change of 1. The least change

    t* = min over these w of max over c of |w_c - 1|

is a linear program whose rows are found as they are needed: for the weights of the last one, the
model is solved exactly, and a policy ρ that beats π is a new row. Likewise for one weight x alone,
the others being 1, where the set is an interval. The proof: values V that no policy exceeds at the
weights found, with μ V = w · v(π); and policies ρ whose rows, by the multipliers of linear
programming (Farkas), leave nothing below t*. (Ng and Russell, Algorithms for inverse reinforcement
learning, ICML 2000, state the cone for policies that are optimal in all states.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from exact_mdp.analysis.gate.exact_policy import mixed_rows
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import Result
from exact_mdp.solvers.exact.find import visited
from exact_mdp.solvers.exact.levels import fraction
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.checker import (
    Cut,
    Flow,
    Interval,
    Point,
    Rank,
    Values,
    allowed,
    totals_of,
)
from exact_mdp.solvers.objectives.file import WeightsProof
from exact_mdp.solvers.objectives.occupancy import visits
from exact_mdp.solvers.objectives.optima import optimum, rank_of
from exact_mdp.solvers.objectives.simplex import maximise
from exact_mdp.solvers.solution import Certified, Claim
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.policy_chain import PolicyChain

if TYPE_CHECKING:
    from pandas import DataFrame

ZERO, ONE = Fraction(0), Fraction(1)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Rationalization(Result):
    """The least change of the weights of a reward under which a policy is optimal from the start.

    Attributes
    ----------
    change : Fraction
        The greatest relative change of a weight: 1 where nothing less than dropping weights does.
    weights : {component: Fraction}
        A multiplier for each component of the reward, 1 today.
    alone : {component: (low, high) or None}
        The multipliers of 0 or more of this component, the others unchanged, under which the policy
        is optimal; None where there are none. `high` may be infinite.
    flow : {pair: Fraction}
        Expected visits of pairs under the policy.
    dual : Values
        What no policy exceeds under the weights.
    cuts : tuple of Cut
        Policies that nothing less than the change makes worse than this one, with multipliers.
    intervals : {component: Interval}
        What proves `alone`.
    objectives : Objectives
    rank : (S,) int64, optional
        Proof that every policy ends, at discount 1.

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    >>> parts = {"gain": [6, 3, 0], "effort": [-1, 0, 0]}
    >>> found = rationalize(MDP.from_outcomes(rows, components=parts), {"0": "1", "1": "0"})
    >>> found.change, found.weights
    (Fraction(1, 2), {'gain': Fraction(1, 2), 'effort': Fraction(3, 2)})
    >>> found.alone["effort"], found.violations()
    ((Fraction(3, 1), inf), [])
    """

    change: Fraction
    weights: dict[str, Fraction]
    flow: Flow
    dual: Values
    cuts: tuple[Cut, ...]
    intervals: dict[str, Interval]
    objectives: Objectives
    rank: Rank

    claim: ClassVar[Claim] = Claim.CERTIFIED

    @property
    def possible(self) -> bool:
        """Whether a change below 1 does it: no weight is dropped or turned round."""
        return self.change < 1

    @property
    def alone(self) -> dict[str, tuple[Fraction, Fraction | float] | None]:
        """The interval of each multiplier alone; see the class."""
        return {name: own.ends for name, own in self.intervals.items()}

    def __repr__(self) -> str:
        done = f"a change of {float(self.change):.6g}" if self.possible else "no change below 1"
        return f"Rationalization({done} makes the policy optimal; certified)"

    def report(self) -> Report:
        """Return the weights, the change, and for each weight what it does alone."""
        rows = [
            {
                "name": name,
                "weight": weight,
                "alone": "none" if ends is None else f"{ends[0]} to {ends[1]}",
            }
            for (name, weight), ends in zip(self.weights.items(), self.alone.values(), strict=True)
        ]
        table = Table(
            title="multipliers of the weights",
            rows=rows,
            columns={"component": "name", "multiplier": "weight:.6g", "alone": "alone"},
            note="alone: the multipliers of this weight for which the policy is optimal, the "
            "others unchanged",
        )
        return Report(
            title="weights that make a policy optimal",
            facts={
                "claim": Shown(self.claim),
                "possible": Shown(
                    self.possible,
                    "the policy is optimal already"
                    if not self.change
                    else "the policy is optimal with these weights"
                    if self.possible
                    else "with no weights short of dropping them all (proven)",
                ),
                "change": Shown(self.change, Certified(value=self.change)),
                "weights": self.weights,
                "alone": Shown({name: ends and list(ends) for name, ends in self.alone.items()}),
            },
            tables={"weights": table},
        )

    def frame(self) -> DataFrame:
        """Return a row for each component: its multiplier, and the interval that does it alone."""
        import pandas

        rows = [
            (name, weight, *(self.alone[name] or (None, None)))
            for name, weight in self.weights.items()
        ]
        return pandas.DataFrame(rows, columns=["component", "multiplier", "alone from", "to"])

    def violations(self) -> list[str]:
        """Return what does not hold of the result, in words: nothing where it is sound."""
        return self._proof.violations(self.objectives.mdp)

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON, for `exact-mdp verify`; see `solvers.objectives.file`."""
        self._proof.save(path)

    @property
    def _proof(self) -> WeightsProof:
        proof: WeightsProof = WeightsProof.about(
            self.objectives,
            rank=self.rank,
            weights=tuple(self.weights.values()),
            change=self.change,
            flow=self.flow,
            dual=self.dual,
            cuts=self.cuts,
            intervals=tuple(self.intervals.values()),
        )
        return proof


def rationalize(model: MDP | Scenario, policy: PolicyLike) -> Rationalization:
    """Return the least change of the weights of the reward that makes a policy optimal.

    Parameters
    ----------
    model : MDP or Scenario
        With components of the reward; a discount below 1, or every policy ends.
    policy : PolicyLike

    Returns
    -------
    Rationalization

    Raises
    ------
    ModelError
        For a policy that does not fit, or a component whose total is infinite.

    Examples
    --------
    >>> scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    >>> rationalize(scenario, "optimal").change
    Fraction(0, 1)
    """
    mdp = mdp_of(model)
    of = Objectives.of(mdp, mdp.component_names)
    own = _flow(of, policy)
    search = _Search(of, totals_of(of, own))
    weights, change, dual, cuts = search.least()
    return Rationalization(
        change=change,
        weights=dict(zip(of.names, weights, strict=True)),
        flow=own,
        dual=dual,
        cuts=cuts,
        intervals={name: search.alone(k) for k, name in enumerate(of.names)},
        objectives=of,
        rank=rank_of(of),
    )


def _flow(of: Objectives, policy: PolicyLike) -> Flow:
    """Return the expected visits of pairs under any policy."""
    chain = replace(PolicyChain.of(of.mdp, policy), mdp=of.ending)
    states = of.reached(chain.pairs) & ~of.ending.terminal
    found = visited(mixed_rows(of.rows, chain), states, of.mdp.start)
    below = found.each_below
    return {
        pair: share * fraction(found.top[s], below[s])
        for s in np.flatnonzero(states).tolist()
        for pair, share in chain.exact_weights(s).items()
    }


class _Search:
    """The policies found so far, as their visits and how far their totals are above the given."""

    def __init__(self, of: Objectives, totals: Point) -> None:
        self.of, self.totals = of, totals
        self.found: list[tuple[Flow, Point]] = []

    def beaten(self, weights: Sequence[Fraction]) -> Values | tuple[Flow, Point]:
        """Return what proves that the policy is optimal for weights, or one that beats it."""
        best = optimum(self.of, weights)
        if best.total == sum((w * v for w, v in zip(weights, self.totals, strict=True)), ZERO):
            return best.values
        state = self.of.mdp.pair_state[best.optimal]
        other = visits(self.of, best.optimal[np.flatnonzero(np.diff(state, prepend=-1))])
        lead = zip(totals_of(self.of, other), self.totals, strict=True)
        self.found.append((other, tuple(a - b for a, b in lead)))
        return self.found[-1]

    def least(self) -> tuple[list[Fraction], Fraction, Values, tuple[Cut, ...]]:
        """Return weights, the change, the proof of optimality and that of the change."""
        size = len(self.totals)
        unit = [[Fraction(i == k) for i in range(size)] for k in range(size)]
        bounds = [[*row, ONE] for row in unit] + [[*(-x for x in row), ONE] for row in unit]
        worth = [ONE] * size + [-ONE] * size
        while True:
            columns = bounds + [[*(-x for x in lead), ZERO] for _, lead in self.found]
            solved = maximise([*worth, *[ZERO] * len(self.found)], columns, [*[ZERO] * size, ONE])
            *weights, change = solved.y
            found = self.beaten(weights)
            if isinstance(found, Values):
                multipliers = solved.x[2 * size :]
                cuts = tuple(
                    Cut(flow=other, multiplier=x)
                    for (other, _), x in zip(self.found, multipliers, strict=True)
                    if x
                )
                return weights, change, found, cuts

    def alone(self, k: int) -> Interval:
        """Return the multipliers of one component under which the policy is optimal."""
        size = len(self.totals)

        def beaten(x: Fraction | float) -> Values | None:
            rest = ONE if x < inf else ZERO
            weights = [rest] * size
            weights[k] = ONE if isinstance(x, float) else x
            found = self.beaten(weights)
            return found if isinstance(found, Values) else None

        beaten(inf)
        while True:
            low, high, cuts = allowed(
                [(other, lead[k], sum(lead) - lead[k]) for other, lead in self.found]
            )
            if low > high:
                return Interval(low=None, high=None, at_low=None, at_high=None, cuts=cuts)
            at_low = beaten(low)
            at_high = at_low and beaten(high)
            if at_low and at_high:
                return Interval(low=low, high=high, at_low=at_low, at_high=at_high, cuts=cuts)
