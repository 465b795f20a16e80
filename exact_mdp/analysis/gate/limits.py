"""A policy under limits on expected totals: what it has to keep, and what it loses by that.

With r* the optimum under limits c_k ≥ b_k and λ_k their prices (`solvers.objectives.limits`),
no policy earns more of r + λ c than V, r* = μ V - λ b, and every policy π loses

    r* - r(π) = Σ_l x_π(l) gap(l) + λ (c(π) - b),

x_π being its expected visits and gap what a pair falls short of V where r + λ c is earned
(Lagrangian duality: Altman, Constrained Markov Decision Processes, 1999, chapter 3). So an audit of
the priced model names the states in which the regret arises; the last term is the value of the room
that π leaves under its limits. A policy that breaks them may earn more than r*, and fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import nan
from typing import Any

import numpy as np

from exact_mdp.analysis.gate.disagreements import Loss, total_loss
from exact_mdp.analysis.gate.exact_policy import exact_policy
from exact_mdp.analysis.gate.verdicts import Verdict, number
from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import Shown, Table, cell
from exact_mdp.mdp.table import LARGEST, common, exact, integers, shown
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.limits import ConstrainedSolution, Limit, solve_under
from exact_mdp.solvers.objectives.totals import Point
from exact_mdp.solvers.solution import Certified
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, eq=False)
class UnderLimits:
    """The optimum under limits, proven, and the exact totals of a policy beside it.

    Attributes
    ----------
    best : ConstrainedSolution
    earned : Fraction
        The return of the policy.
    totals : {name: Fraction}
        Its totals of what is limited.
    """

    best: ConstrainedSolution
    earned: Fraction
    totals: Mapping[str, Fraction]

    @classmethod
    def of(cls, mdp: MDP, policy: Policy, subject_to: Mapping[str, Any]) -> UnderLimits:
        """Return a policy under limits; see `solve` for these."""
        best = solve_under(mdp, subject_to)
        if faults := best.violations():
            raise RuntimeError(f"the proof of an optimum under limits does not hold: {faults[0]}")
        of = best.of
        earned, *totals = totals_under(of, policy)
        return cls(
            best=best,
            earned=of.sign * earned,
            totals={n: of.sign * t for n, t in zip(of.names[1:], totals, strict=True)},
        )

    def keeps(self, limit: Limit) -> bool:
        """Return whether the policy keeps a limit."""
        return limit.sign * (self.totals[limit.name] - limit.bound) >= 0

    def verdicts(self) -> Iterator[Verdict]:
        """Yield the verdict on each limit, and on whether any policy keeps them all."""
        for limit in self.best.limits:
            total = number(Certified(value=self.totals[limit.name]))
            name = f"within the limit {limit}"
            yield Verdict("the policy", name, self.keeps(limit), f"its total is {total}")
        if not self.best.feasible:
            near = ", ".join(limit.text(10) for limit in self.best.moved)
            text = f"none does (proven); the closest that can be kept: {near}"
            yield Verdict("there", "a policy that keeps all limits", False, text)

    @staticmethod
    def facts(under: UnderLimits | None) -> dict[str, Any]:
        """Return what a report says of limits; null without them."""
        names = ("feasible", "limits", "kept", "totals", "prices", "closest", "room")
        if under is None:
            return dict.fromkeys(names)
        best = under.best
        room = f"{cell(under.room)}: the value of the room left under the limits"
        values = (
            best.feasible,
            [str(limit) for limit in best.limits],
            Shown([under.keeps(limit) for limit in best.limits]),
            Shown(dict(under.totals)),
            Shown(best.prices if best.feasible else None),
            Shown(best.closest),
            Shown(under.room, room) if best.feasible else None,
        )
        return dict(zip(names, values, strict=True))

    def table(self) -> Table:
        """Return each limit with the policy's total, and its price or the closest to be kept."""
        best = self.best
        rows = [
            {
                "limit": str(limit),
                "total": float(self.totals[limit.name]),
                "kept": "yes" if self.keeps(limit) else "NO",
                "price": float(price),
                "closest": moved.text(10),
            }
            for limit, price, moved in zip(best.limits, best.price, best.moved, strict=True)
        ]
        last = {"price": "price:.6g"} if best.feasible else {"closest": "closest"}
        note = "closest: all moved by the same step, the least with which a policy keeps them"
        if best.feasible:
            note = "price: what the optimum gains for one point by which the limit is moved"
        columns = {"limit": "limit", "yours": "total:.10g", "kept": "kept", **last}
        return Table(title="limits", rows=rows, columns=columns, note=note)

    @cached_property
    def priced(self) -> MDP:
        """The model that earns r + λ c; the model itself where no policy keeps the limits."""
        of, best = self.best.of, self.best
        if not best.feasible:
            return of.mdp
        whole, below = common(best.weights)
        scale = of.rows.scale[of.mdp.pair_state].astype(object)
        table = replace(
            of.mdp.table,
            gain=integers((of.sign * of.weighted(whole).astype(object)).tolist()),
            gain_denominator=integers((scale * below).tolist()),
        )
        return of.mdp.with_(table=table, goal=None)

    @property
    def room(self) -> Fraction:
        """What the room that the policy leaves under the limits is worth: λ (c(π) - b)."""
        each = zip(self.best.limits, self.best.price, strict=True)
        return sum(
            (p * limit.sign * (self.totals[limit.name] - limit.bound) for limit, p in each),
            Fraction(0),
        )

    def loss(self, mdp: MDP, policy: Policy, exact: bool | None) -> Loss:
        """Return the regret against the optimum under limits, and where it arises.

        Where no policy keeps the limits, there is no optimum: it is NaN, and so is the regret.
        """
        priced, disagreements = total_loss(self.priced, policy, True)
        best, none = self.best.start or Certified(value=nan), np.full_like(priced.by_state, nan)
        lost = replace(
            priced,
            optimal=best,
            learned=Certified(value=self.earned),
            at_start=Certified(value=self.best.of.sign * (best.value - self.earned)),
        )
        if not self.best.feasible:
            lost = replace(lost, by_state=none, optimal_value=none)
        return lost, disagreements


def totals_under(of: Objectives, policy: Policy) -> Point:
    """Return the exact totals of a policy, mixed ones too, from the start; more is better."""
    chain = replace(PolicyChain.of(of.mdp, policy), mdp=of.ending)  # read by all that is counted
    scale, totals = of.rows.scale.tolist(), []
    for amount in of.amounts:
        earned = [
            sum((w * int(amount[l]) for l, w in chain.exact_weights(s).items()), Fraction(0)) / unit
            for s, unit in enumerate(scale)
        ]
        totals.append(exact_policy(chain, earned).start_value)
    return tuple(totals)


def limit_of(name: str, limit: object) -> Fraction:
    """Return a limit of the regret, checked."""
    with located(name, instead=True):
        limit_value = exact(limit)
    if not 0 <= limit_value <= LARGEST:
        beyond, fix = (
            (", beyond the floats", "choose less") if limit_value > 0 else ("", "choose 0 or more")
        )
        raise ModelError(f"{name} is {shown(limit_value)}{beyond}", where=name, fix=fix)
    return limit_value
