"""One or two parameters at a time: value curves, the tornado diagram, the map of the optimum.

Each is the study of a design of points (`.study`): both ends of every range, or a grid. Holding a
policy, by default the optimum at today's values, costs regret(θ) = V*(θ) - V_π(θ). A bar of the
tornado spans the values at both ends of a parameter's range (Briggs et al., Medical Decision Making
32, 2012); nothing is known between the points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.analysis.vary.base_case import BaseCase, finite_worth
from exact_mdp.analysis.vary.ranges import Range, checked, range_of, ranges_of, unit_of
from exact_mdp.analysis.vary.study import Study, study_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.policies.arrays import distinct
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, claimed
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Integers
from exact_mdp.mdp.validate import counted
from exact_mdp.solvers.solution import Bounded, regret

VALUES = {
    "re-optimised": "value:.6g",
    "policy held fixed": "fixed_value:.6g",
    "its regret": "regret:.3g",
}


@dataclass(frozen=True, kw_only=True)
class Point:
    """The start values of the optimum and of a policy held fixed, at a value of a parameter."""

    optimal: Bounded
    fixed: Bounded
    sense: str = "max"
    at: Fraction = Fraction(0)

    @property
    def regret(self) -> Bounded:
        """What holding the policy costs; not below 0, whatever rounding says."""
        return regret(self.optimal, self.fixed, self.sense)


@dataclass(frozen=True, kw_only=True)
class Bar:
    """The bar of one parameter: the values at both ends of its range, and their distances."""

    parameter: Parameter
    low: Point
    high: Point

    @property
    def swing(self) -> float:
        """Of the optimum."""
        return abs(self.high.optimal.value - self.low.optimal.value)

    @property
    def fixed_swing(self) -> float:
        """Of the policy held fixed."""
        return abs(self.high.fixed.value - self.low.fixed.value)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Tornado(Pictured):
    """Bars of all parameters, the widest first, and the values at today's parameters."""

    model: str
    today: Point
    bars: tuple[Bar, ...]

    def __repr__(self) -> str:
        widest = f", the widest of {self.bars[0].parameter.name}" if self.bars else ""
        return f"Tornado({len(self.bars)} bars{widest}; value today {self.today.optimal})"

    def report(self) -> Report:
        """Return values and regrets at both ends of every range."""
        bars, today = self.frame().drop(columns="claim"), self.today

        def table(policy: str, what: str, rows: Any = ()) -> Table:
            columns = {"parameter": "parameter", "from": "low:.6g", "to": "high:.6g"}
            columns |= {"at low": f"{what}_low:.6g", "at high": f"{what}_high:.6g"}
            title = f"start value at both ends, policy {policy}"
            return Table(title=title, rows=rows, columns=columns | {"regret": "regret:.3g"})

        held = bars.sort_values("fixed_swing", ascending=False, kind="stable")
        return Report(
            title="tornado",
            facts={
                **claimed("start_value", today.optimal),
                "policy_value": Shown(today.fixed.value, today.fixed),
                "regret": Shown(today.regret.value, today.regret),
                "bars": bars.to_dict("records"),
            },
            tables={
                "bars": table("re-optimised; regret of the policy held fixed", "value"),
                "held": table("held fixed", "fixed_value", held if today.regret.value > 0 else ()),
            },
        )

    def frame(self) -> DataFrame:
        """Return one row for each bar; values and regrets in units of reward."""
        return data_frame(
            {
                "parameter": bar.parameter.name,
                "unit": unit_of(bar.parameter),
                "low": float(bar.low.at),
                "today": float(bar.parameter.value),
                "high": float(bar.high.at),
                "value_low": bar.low.optimal.value,
                "fixed_value_low": bar.low.fixed.value,
                "regret_low": bar.low.regret.value,
                "value_high": bar.high.optimal.value,
                "fixed_value_high": bar.high.fixed.value,
                "regret_high": bar.high.regret.value,
                "swing": bar.swing,
                "fixed_swing": bar.fixed_swing,
                "regret": max(bar.low.regret.value, bar.high.regret.value),
                "claim": "bounded",
            }
            for bar in self.bars
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Curve(Pictured):
    """The study of one parameter's values, in rising order."""

    model: str
    parameter: Parameter
    table: Study

    def __repr__(self) -> str:
        ends = " to ".join(f"{self.table.optimal[k]:.6g}" for k in (0, -1))
        count = len(self.table.points)
        return f"Curve({count} points of {self.parameter.name}; value {ends})"

    def report(self) -> Report:
        """Return the values along the range."""
        points = self.frame().drop(columns=["parameter", "unit", "claim"]).to_dict("records")
        table = Table(title="value at the start", columns={self.parameter.name: "at:.6g"} | VALUES)
        facts = {"parameter": self.parameter.name, "points": points}
        return Report(title="one-way", facts=facts, tables={"points": table})

    def frame(self) -> DataFrame:
        """Return one row for each value of the parameter."""
        values = self.table.values()
        values.insert(0, "parameter", self.parameter.name)
        values.insert(1, "unit", unit_of(self.parameter))
        values.insert(2, "at", self.table.points[:, 0].astype(float))
        return values


@named_options
def one_way(
    model: Scenario | MDP | Parametric,
    name: str,
    ranges: Mapping[str, object] | Range | tuple[object, object] | None = None,
    *,
    policy: PolicyLike = "optimal",
    relative: object | None = None,
    points: int = 21,
) -> Curve:
    """Return value curves along one parameter, the policy re-optimised and held fixed.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    name : str
        The parameter.
    ranges : (low, high) or {name: (low, high)}, optional
        Today's value ± 20 % unless given, within what the model admits.
    policy, relative : optional
        As for `tornado`.
    points : int
        Evenly spaced, the ends included.

    Returns
    -------
    Curve

    Raises
    ------
    ModelError
        For unknown names, empty ranges, fewer than 2 points, and where a value is infinite.

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 3)]), (0, 1, [(1, 2, 0)]), (2, 0, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    >>> curve = one_way(MDP.from_outcomes(rows, 1), "discount", ("1/2", 1), points=3)
    >>> curve.table.optimal.tolist(), curve.table.regret[:, 0].tolist()
    ([3.0, 3.0, 4.0], [1.0, 0.0, 0.0])
    """
    family = parametric(model)
    values = grid(range_of(family, name, ranges, relative), points)
    table = study_of(family, {name: values}, [policy])[1]
    return Curve(model=family.name, parameter=parameter_of(family, name), table=table)


@named_options
def tornado(
    model: Scenario | MDP | Parametric,
    *,
    policy: PolicyLike = "optimal",
    names: Iterable[str] | None = None,
    ranges: Mapping[str, object] | None = None,
    relative: object | None = None,
) -> Tornado:
    """Return the tornado of the start value over the ranges of parameters.

    The model is solved once at today's values, and once at each end of a range.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        The policy held fixed, whose regret is given as well; "optimal" is today's optimum.
    names : iterable of str, optional
        The parameters; those of `ranges` where these are given, otherwise all.
    ranges : {name: (low, high)}, optional
        `load_ranges` reads a file of them.
    relative : number or "whole", optional
        Half the width of the other ranges, as a share of today's value (1/5 unless given), or all
        that a parameter may be. Such a range ends where the model does, and where the parameter
        does: say of a utility `Parameter(name="u", value="0.85", low=0, high=1)`.

    Returns
    -------
    Tornado

    Raises
    ------
    ModelError
        For unknown names and empty ranges, and where a value is infinite.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> (bar,) = tornado(moving(mdp, {"stay": [(0, 0)]}), names=["stay"]).bars
    >>> [round(end.optimal.value, 9) for end in (bar.low, bar.high)]
    [1.666666667, 2.5]
    """
    family = parametric(model)
    spans = ranges_of(family, names, ranges, relative)
    ends = [(name, at) for name, span in spans.items() for at in (span.low, span.high)]
    parameters = {name: parameter_of(family, name) for name in spans}
    columns = {
        name: [at if name == moved else parameter.value for moved, at in ends]
        for name, parameter in parameters.items()
    }
    base = BaseCase(mdp=family.at({}))
    fixed_policy, sense = base.held(policy), base.mdp.sense
    points: list[Point] = []
    if ends:
        table = study_of(family, columns, [fixed_policy])[1]
        values = np.column_stack([table.optimal, table.fixed, table.error]).tolist()
        for (_, at), (best, own, off, own_off) in zip(ends, values, strict=True):
            optimal, fixed = Bounded(value=best, error=off), Bounded(value=own, error=own_off)
            points.append(Point(at=at, optimal=optimal, fixed=fixed, sense=sense))
    pairs = zip(parameters.values(), points[::2], points[1::2], strict=True)
    bars = [Bar(parameter=parameter, low=low, high=high) for parameter, low, high in pairs]
    bars.sort(key=lambda bar: -bar.swing)
    worth = finite_worth(base.mdp, fixed_policy, "today's parameters")
    now = Point(optimal=base.solution.start, fixed=worth, sense=sense)
    return Tornado(model=family.name, today=now, bars=tuple(bars))


def grid(span: Range, points: int) -> list[Fraction]:
    """Return evenly spaced values, the ends included; raises ModelError for fewer than 2."""
    points = counted(points, "points", 2)
    step = (span.high - span.low) / (points - 1)
    return [span.low + k * step for k in range(points)]


# ---- two parameters ------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TwoWay(Pictured):
    """The study of a grid of two parameters, row by row, x changing first."""

    mdp: MDP
    x: Parameter
    y: Parameter
    table: Study
    choices: Integers  # (Y, X, S) optimal actions, the lowest where floats cannot tell two apart
    policy: Integers  # (Y, X) its number, on the states that it reaches by today's transitions

    def __repr__(self) -> str:
        points, policies = self.policy.size, int(self.policy.max()) + 1
        return f"TwoWay({self.x.name}, {self.y.name}; points {points}, best policies {policies})"

    def report(self) -> Report:
        """Return the values over the grid, and the number of the best policy."""
        names = {self.x.name: "x:.6g", self.y.name: "y:.6g", "policy": "policy"}
        return Report(
            title="two-way",
            facts={
                "parameters": [self.x.name, self.y.name],
                "policies": int(self.policy.max()) + 1,
                "points": self.frame().drop(columns="claim").to_dict("records"),
            },
            tables={"points": Table(title="value at the start", columns=names | VALUES)},
        )

    def frame(self) -> DataFrame:
        """Return one row for each point of the grid."""
        values, points = self.table.values(), self.table.points.T.astype(float)
        values.insert(0, "x", points[0])
        values.insert(1, "y", points[1])
        values.insert(2, "policy", self.policy.reshape(-1))
        return values

    def chosen(self, number: int) -> dict[str, str]:
        """Return what the policy of a number does in each state that it reaches, with a choice."""
        mdp, choices = self.mdp, self.choices[self.policy == number][0]
        taken = mdp.pair_action == choices[mdp.pair_state]
        seen = np.flatnonzero(reachable(mdp, pairs=taken) & ~mdp.forced & ~mdp.over)
        return {mdp.space.label(state): mdp.actions[choices[state]] for state in seen.tolist()}


@named_options
def two_way(
    model: Scenario | MDP | Parametric,
    x: str,
    y: str,
    *,
    policy: PolicyLike = "optimal",
    ranges: Mapping[str, object] | None = None,
    relative: object | None = None,
    points: int = 11,
) -> TwoWay:
    """Return the map of the optimal policy over two parameters.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    x, y : str
        Different parameters.
    policy, ranges, relative : optional
        As for `tornado`.
    points : int
        Along each side, evenly spaced, the ends included.

    Returns
    -------
    TwoWay

    Raises
    ------
    ModelError
        As for `one_way`, and for twice the same parameter.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> rows = [(0, 0, [("1/2", 1, 4), ("1/2", 2, 0)]), (0, 1, [(1, 1, 1)])]
    >>> mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)]), (2, 0, [(1, 0, 0)])], "1/2")
    >>> ranges = {"p": ("1/10", "9/10"), "discount": (0, "1/2")}
    >>> grid = two_way(moving(mdp, {"p": [(0, 1)]}), "p", "discount", points=2, ranges=ranges)
    >>> grid.choices[:, :, 0].tolist()
    [[1, 0], [1, 0]]
    """
    family = parametric(model)
    across_by, along_by = parameter_of(family, x), parameter_of(family, y)
    if x == y:
        fix = "name two different parameters"
        raise ModelError(f"both parameters are {x}", where="two-way", fix=fix)
    if odd := sorted(set(checked(family, ranges)) - {x, y}):
        raise ModelError(
            f"{odd[0]} has a range, and is neither of the two parameters",
            where="two-way",
            fix=f"give ranges of {x} and {y} alone",
        )
    spans = ranges_of(family, [x, y], ranges, relative)
    across, along = (grid(spans[name], points) for name in (x, y))
    columns = {x: across * points, y: [at for at in along for _ in across]}
    solver, table = study_of(family, columns, [policy])
    mdp, taken = solver.base.mdp, [solver.weights(row) > 0 for row in table.rows]
    actions = np.array([mdp.pair_action[each] for each in taken])
    seen = np.array([reachable(mdp, pairs=each) & ~mdp.forced for each in taken])
    numbers = distinct(np.where(seen, actions, -1)[table.which])[1]
    return TwoWay(
        mdp=mdp,
        x=across_by,
        y=along_by,
        table=table,
        choices=actions[table.which].reshape(points, points, -1),
        policy=numbers.reshape(points, points),
    )
