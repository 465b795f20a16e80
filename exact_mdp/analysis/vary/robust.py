"""Robustness: the loss of a policy if probabilities are off, and the price of hedging against it.

Uncertainty is (s, a)-rectangular: nature picks a distribution from a set around each row,
independently of other rows (Iyengar, Mathematics of Operations Research 30, 2005).

    price of robustness = nominal value of the nominal policy - nominal value of the robust one,
    worst-case gain     = worst case of the robust policy - worst case of the nominal one

(Bertsimas and Sim, Operations Research 52, 2004, for the price).

An error in a parameter is different: it affects all rows that share the parameter. The worst choice
of parameters is hard to find (Wiesemann, Kuhn and Rustem, Mathematics of Operations Research 38,
2013). Here a local search over the corners of their ranges gives an estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import isinf
from typing import Any

import numpy as np

from exact_mdp.analysis.optimum import actions_of
from exact_mdp.analysis.vary.ranges import Stated, spans_of
from exact_mdp.analysis.vary.study import StudyDraws, read_points, solver_of
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError, named_options, require_known_name
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, format_cell, list_claim_facts, to_json_values
from exact_mdp.mdp.result import DataFrame, Result, data_frame, frame_to_table
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.arguments import (
    Criterion,
    OfCriterion,
    is_average,
    mdp_of,
    require_average_applies,
)
from exact_mdp.solvers.claims import Bounded, Claim
from exact_mdp.solvers.robust.likelihood import Likelihood
from exact_mdp.solvers.robust.robust import (
    Nature,
    RobustSolution,
    require_room_for_rows,
    solve_robust,
)
from exact_mdp.solvers.robust.sets import Ambiguity, Intervals, L1Ball
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobustComparison(OfCriterion, Result):
    """Values at the start under nominal, worst and best distributions, and their policies."""

    mdp: MDP
    policy: Floats  # (L,) probability of each pair under the nominal policy
    value: Bounded  # the nominal policy in the nominal model
    worst: Bounded  # the nominal policy in its worst case
    best: Bounded  # and in its best case
    robust: RobustSolution  # the best policy for the worst case
    optimistic: RobustSolution  # and for the best case
    robust_value: Bounded  # the robust policy in the nominal model
    robust_best: Bounded  # and in its best case
    criterion: str = "total"  # or "average": all values are rewards per step

    def __repr__(self) -> str:
        return (
            f"Robust({self.measure} {self.value}; worst case {self.worst}, under the robust policy "
            f"{self.robust.start})"
        )

    @property
    def price(self) -> Bounded | None:
        """The price of robustness: the loss of the robust policy in the nominal model.

        None if both values are infinite, and of one sign.
        """
        return self._compute_improvement(self.value, self.robust_value)

    @property
    def gain(self) -> Bounded | None:
        """The worst-case gain: how much better the robust policy is, each in its worst case.

        None if both values are infinite, and of one sign.
        """
        return self._compute_improvement(self.robust.start, self.worst)

    def _compute_improvement(self, one: Bounded, other: Bounded) -> Bounded | None:
        """Return how much better one value is than another; costs are better if they are less."""
        if isinf(one.value) and one.value == other.value:
            return None
        if isinf(one.value) or isinf(other.value):
            return Bounded(value=self.mdp.sense.loss(one.value, other.value), error=0.0)
        better: Bounded = self.mdp.sense.loss(one, other)
        return better

    @property
    def changed(self) -> Numbers:
        """(K,) states in which the policies differ, among the states that either one reaches."""
        mdp, taken = self.mdp, self.robust.policy.weights(self.mdp)
        differs = np.logical_or.reduceat(taken != self.policy, mdp.pair_offsets[:-1])
        seen = find_reachable_states(mdp, pairs=taken > 0)
        seen = seen | find_reachable_states(mdp, pairs=self.policy > 0)
        return np.flatnonzero(differs & seen & ~mdp.terminal)

    def report(self) -> Report:
        """Return the values in the nominal model, and in the worst and the best case."""
        label, moved = self.mdp.space.label, np.isin(self.mdp.pair_state, self.changed)
        both = self.policy, self.robust.policy.weights(self.mdp)
        before, after = (actions_of(self.mdp, moved & (weights > 0)) for weights in both)
        changes = []
        for s in self.changed.tolist():
            changes.append(
                {"state": label(s), "before": " or ".join(before[s]), "after": after[s][0]}
            )
        own, worst, best = self.robust_value, self.robust.start, self.optimistic.start
        values = [
            {"policy": "held", "right": self.value, "worst": self.worst, "best": self.best},
            {"policy": "robust", "right": own, "worst": worst, "best": self.robust_best},
        ]
        columns = {"tables right": "right", "worst case": "worst", "best case": "best"}
        return Report(
            title="robust",
            facts={
                **self.criterion_facts,
                **list_claim_facts("start_value", self.value),
                "nature": "dynamic, independent in each state and action",
                "worst_case": Shown(to_json_values(worst) | {"nominal_policy": self.worst}),
                "best_case": Shown(to_json_values(best) | {"nominal_policy": self.best}),
                "price_of_robustness": self.price,
                "worst_case_gain": self.gain,
                "robust_policy_value": Shown(own),
                "policy_changes": changes,
                "seconds": Shown(self.robust.seconds),
            },
            tables={
                "values": Table(
                    title=f"{self.measure} at the start",
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
        """Return values at the start (reward), one row for each policy and case."""
        rows = [
            ("nominal", "nominal", self.value),
            ("nominal", "worst", self.worst),
            ("nominal", "best", self.best),
            ("robust", "nominal", self.robust_value),
            ("robust", "worst", self.robust.start),
            ("robust", "best", self.robust_best),
            ("optimistic", "best", self.optimistic.start),
        ]
        headings = ["policy", "distributions", "value (reward)", "error bound (reward)"]
        table = [(policy, which, number.value, number.error) for policy, which, number in rows]
        return data_frame(table, columns=headings)


SETS: Mapping[str, tuple[Callable[[MDP, object], Ambiguity], str]] = {
    "interval": (Intervals.relative, "1/5"),
    "l1": (lambda mdp, radius: L1Ball(radius=radius), "1/10"),
    "kl": (lambda mdp, radius: Likelihood(radius=radius), "1/100"),
}
"""Sets by name, each with its default radius."""


@named_options
def robust(
    model: MDP,
    ambiguity: Ambiguity | str = "interval",
    *,
    radius: object | None = None,
    policy: PolicyLike = "optimal",
    criterion: Criterion = "total",
) -> RobustComparison:
    """Return the worst and the best case of a policy, and the policy with the best worst case.

    Parameters
    ----------
    model : MDP
    ambiguity : Ambiguity, or "interval", "l1" or "kl"
        Sets of distributions q around each row p: q within p (1 ± x), within an L1 distance of x,
        or with KL(p‖q) ≤ x. Other intervals are `Intervals(lower=…, upper=…)`.
    radius : number, optional
        x of a named set; by default 1/5, 1/10 and 1/100.
    policy : PolicyLike
        The nominal policy.
    criterion : "total" or "average"
        As for `solve_robust`.

    Returns
    -------
    RobustComparison

    Raises
    ------
    ModelError
        As `solve_robust` raises it.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> cases = robust(Scenario.load("yuan2025").compile(), "l1", radius="1/10")
    >>> print(f"{cases.value.value:.3f} {cases.worst.value:.3f} {cases.robust.start.value:.3f}")
    146.236 139.106 139.106
    """
    model = mdp_of(model)
    require_room_for_rows(model)
    if isinstance(ambiguity, str):
        make, default = SETS[require_known_name(ambiguity, SETS, "set", "robust")]
        if radius is None:
            radius = default
        ambiguity = make(model, radius)
    elif radius is not None:
        raise ModelError(
            "a radius, and a set that has its own",
            where="radius",
            fix='name the set, as in robust(model, "l1", radius=0.1), or leave out the radius',
        )
    # The given policy in the nominal model, and in its worst and best case.
    sets = ambiguity
    if is_average(criterion):
        require_average_applies(model)
    chain = PolicyChain.of(model, policy, criterion=criterion)
    asked: dict[str, Any] = {"criterion": criterion}

    def evaluate_case(weights: Floats, nature: Nature) -> Bounded:
        return solve_robust(model, sets, nature=nature, policy=weights, **asked).start

    # The policy with the best worst case, and its value in the nominal model and its best case.
    best = solve_robust(model, sets, **asked)
    own = best.policy.weights(model)
    return RobustComparison(
        mdp=model,
        policy=chain.weights,
        value=evaluate(model, chain, **asked).start,
        worst=evaluate_case(chain.weights, "worst"),
        best=evaluate_case(chain.weights, "best"),
        robust=best,
        optimistic=solve_robust(model, sets, nature="best", **asked),
        robust_value=evaluate(model, own, **asked).start,
        robust_best=evaluate_case(own, "best"),
        criterion=criterion,
    )


# ---- one choice of the parameters for all states -------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class WorstPoint(Result):
    """The worst corner found."""

    point: Mapping[str, Fraction]  # the value of each parameter
    value: Bounded  # the value of the policy there; its worst case is at most as good
    optimum: Bounded  # the optimal value there; no policy has a better worst case
    corners: int  # number of corners evaluated
    criterion_facts: Mapping[str, Shown]  # none for a total reward

    claim = Claim.ESTIMATED  # a worse point may exist

    def report(self) -> Report:
        """Return the value at the worst corner, and the corner."""
        value = to_json_values(self.value) | {"claim": self.claim}
        point = {name: float(at) for name, at in self.point.items()}
        said = f"at best {format_cell(self.value)}, not proven to be the worst point (estimated)"
        return Report(
            title="worst corner",
            facts={
                **self.criterion_facts,
                "claim": Shown(self.claim),
                "nature": "one choice of the parameters for all states",
                "worst_case": Shown(value | {"point": point, "optimum": self.optimum}, said),
            },
            tables={
                "point": frame_to_table(self.frame(), f"the worst of {self.corners:,} corners")
            },
        )

    def frame(self) -> DataFrame:
        """Return the value of each parameter."""
        at = [float(each) for each in self.point.values()]
        return data_frame({"parameter": list(self.point), "at": at})


def worst_point(
    model: Scenario | MDP | Parametric,
    policy: PolicyLike = "optimal",
    ranges: Stated | None = None,
    *,
    relative: object | None = None,
    criterion: str = "total",
) -> WorstPoint:
    """Return the worst corner of the parameters' ranges that a search finds for a policy.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        Held fixed; "optimal" is the optimum at today's values.
    ranges : {name: (low, high)}, optional
        By default today's values ± 20 %, for all parameters but the discount.
    relative : number, optional
        A share other than 20 %.
    criterion : "total" or "average"
        As for `study`.

    Returns
    -------
    WorstPoint

    Raises
    ------
    ModelError
        For values that the model cannot have together, or a start that mixes +∞ and -∞.

    Examples
    --------
    >>> worst = worst_point(Scenario.load("yuan2025"), ranges={"base.anger": ("1/25", "3/50")})
    >>> str(worst.point["base.anger"]), worst.value.value < 146.2
    ('3/50', True)
    """
    family = parametric(model)
    spans = spans_of(family, None, ranges, relative)
    names = [parameter.name for parameter in spans]
    if isinstance(family, ScenarioFamily) and not family.asks:
        highest = {parameter.name: span.high for parameter, span in spans.items()}
        family.warn_of_cutoffs(highest, where=" at the upper ends of the ranges")
    solver = solver_of(family, names, criterion, finite=False)
    fixed, sign = solver.hold_policy(policy), solver.mdp.sense.sign
    ends = np.array([[float(span.low), float(span.high)] for span in spans.values()])
    every = np.arange(len(names))

    def evaluate_points(points: Floats) -> Floats:
        """Return the values of the policy at some points, negated for costs."""
        return np.asarray(sign * solver.evaluate_policies(points, [fixed])["value"][:, 0])

    def move_each_alone(point: Floats, end: np.ndarray) -> Floats:
        """Return one point for each parameter, with this parameter at its given end."""
        points = np.tile(point, (len(names), 1))
        points[every, every] = ends[every, end]
        return points

    # Begin at the corner of each parameter's worse end, the others at today's values.
    today = np.array([float(parameter.value) for parameter in spans])
    alone = [evaluate_points(move_each_alone(today, np.full(len(names), end))) for end in (0, 1)]
    corner = (alone[1] < alone[0]).astype(int)
    least, corners = evaluate_points(ends[every, corner][None])[0], 1
    # Move the one parameter whose other end is worst, until no move makes the value worse.
    while True:
        moved = evaluate_points(move_each_alone(ends[every, corner], 1 - corner))
        corners += len(moved)
        if moved.min() >= least:
            break
        corner[moved.argmin()] ^= 1
        least = moved.min()
    point = {}
    for (parameter, span), end in zip(spans.items(), corner.tolist(), strict=True):
        if end:
            point[parameter.name] = span.high
        else:
            point[parameter.name] = span.low
    points = read_points(family, {name: [at] for name, at in point.items()})
    table = StudyDraws(solver, points, 1, {}, {}).run_study([fixed])
    optimum, value = table.bound_point_values(0)
    return WorstPoint(
        point=point,
        value=value,
        optimum=optimum,
        corners=corners,
        criterion_facts=table.criterion_facts,
    )
