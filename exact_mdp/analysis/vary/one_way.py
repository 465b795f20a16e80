"""One or two parameters at a time: value curves, the tornado diagram, the map of the optimum.

Each is a study of a design of points (`.study`): both ends of every range, or a grid. A policy held
fixed, by default the optimum at today's values, loses regret(θ) = V*(θ) - V_π(θ). A bar of the
tornado spans the values at both ends of a parameter's range (Briggs et al., Medical Decision Making
32, 2012). Values between the points are not known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.analysis.vary.ranges import (
    Range,
    Stated,
    list_usual_parameters,
    range_of,
    ranges_of,
    read_ranges,
    unit_of,
)
from exact_mdp.analysis.vary.study import Study, study
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.policies.arrays import find_distinct_rows
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, list_claim_facts
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import require_count
from exact_mdp.solvers.arguments import is_average
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.claims import Bounded, compute_regret

VALUES = {
    "re-optimised": "value:.6g",
    "policy held fixed": "fixed_value:.6g",
    "its regret": "regret:.3g",
}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Tornado(Pictured):
    """The study of today's values, then of the low and the high end of each parameter's range."""

    model: str
    spans: Mapping[Parameter, Range]
    table: Study

    def __repr__(self) -> str:
        widest = ""
        if self.spans:
            widest = f", the widest of {self.frame()['parameter'][0]}"
        today = f"{self.table.measure} today {self.today['optimal']}"
        return f"Tornado({len(self.spans)} bars{widest}; {today})"

    @property
    def compares(self) -> bool:
        """Whether the policy held fixed is compared with another one."""
        return len(self.table.fixed.T) > 1

    @property
    def differences(self) -> Floats:
        """(D,) at each point of the study: the policy's value less the other one's."""
        one, other = self.table.fixed.T
        return np.asarray(one - other)

    @property
    def today(self) -> dict[str, Bounded]:
        """The optimum at today's values, the value of the policy held "fixed", and its "regret".

        Beside another policy also their "difference".
        """
        optimal, fixed = self.table.bound_point_values(0)
        lost = compute_regret(optimal, fixed, self.table.sense)
        found = {"optimal": optimal, "fixed": fixed, "regret": lost}
        if self.compares:
            apart = float(self.differences[0])
            error = float(self.table.error[0, 1:].sum() + UNIT * abs(apart)) * SLACK
            found["difference"] = Bounded(value=apart, error=error)
        return found

    def report(self, by: str | None = None) -> Report:
        """Return values and regrets at both ends of every range, in descending order of `by`.

        `by` is as for `frame`.
        """
        bars, today = self.frame(by).drop(columns="claim"), self.today
        lost = today["regret"]

        def make_table(policy: str, what: str, rows: Any = None) -> Table:
            columns = {"parameter": "parameter", "from": "low:.6g", "to": "high:.6g"}
            columns |= {"at low": f"{what}_low:.6g", "at high": f"{what}_high:.6g"}
            start = "start value"
            if self.table.criterion_facts:
                start = self.table.measure
            title = f"{start} at both ends, policy {policy}"
            return Table(title=title, rows=rows, columns=columns | {"regret": "regret:.3g"})

        # The policy held fixed has a table of its own unless it is today's optimum.
        held: Any = ()
        if lost.value > lost.error:
            held = self.frame("fixed_swing")
        tables = {
            "bars": make_table("re-optimised; regret of the policy held fixed", "value"),
            "held": make_table("held fixed", "fixed_value", held),
        }
        apart = {}
        if self.compares:
            title = "held fixed, less the value of the other"
            tables = {"apart": make_table(title, "difference", bars)} | tables
            apart = {"difference": Shown(today["difference"].value, today["difference"])}
        return Report(
            title="tornado",
            facts={
                **self.table.criterion_facts,
                **list_claim_facts("start_value", today["optimal"]),
                "policy_value": Shown(today["fixed"].value, today["fixed"]),
                **apart,
                "regret": Shown(lost.value, lost),
                "bars": bars.to_dict("records"),
            },
            tables=tables,
        )

    def frame(self, by: str | None = None) -> DataFrame:
        """Return one row for each parameter; values and regrets in units of reward.

        Rows are in descending order of `by`: the "swing" of the optimum, the "fixed_swing" of the
        policy held fixed or, by default if there is another policy, the "difference_swing".
        """
        spans, study = self.spans, self.table
        table = data_frame(
            {
                "parameter": [parameter.name for parameter in spans],
                "unit": [*map(unit_of, spans)],
                "low": [float(span.low) for span in spans.values()],
                "today": [float(parameter.value) for parameter in spans],
                "high": [float(span.high) for span in spans.values()],
            }
        )
        for end, rows in (("low", slice(1, None, 2)), ("high", slice(2, None, 2))):
            table[f"value_{end}"] = study.optimal[rows]
            table[f"fixed_value_{end}"] = study.fixed[rows, 0]
            table[f"regret_{end}"] = study.regret[rows, 0]
        swings = {"swing": "value", "fixed_swing": "fixed_value"}
        if self.compares:
            apart = self.differences
            table["difference_low"], table["difference_high"] = apart[1::2], apart[2::2]
            swings["difference_swing"] = "difference"
        for swing, what in swings.items():
            table[swing] = (table[f"{what}_high"] - table[f"{what}_low"]).abs()
        table["regret"] = table[["regret_low", "regret_high"]].max(axis=1)
        table["claim"] = str(study.claim)
        if by is None:
            by = "difference_swing" if self.compares else "swing"
        return table.sort_values(by, ascending=False, kind="stable", ignore_index=True)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Curve(Pictured):
    """The study of one parameter's values, in ascending order."""

    model: str
    parameter: Parameter
    table: Study

    def __repr__(self) -> str:
        ends = " to ".join(f"{self.table.optimal[k]:.6g}" for k in (0, -1))
        count = len(self.table.points)
        return f"Curve({count} points of {self.parameter.name}; {self.table.measure} {ends})"

    def report(self) -> Report:
        """Return the values along the range."""
        points = self.frame().drop(columns="claim").to_dict("records")
        columns = {self.parameter.name: "at:.6g"} | VALUES
        table = Table(title=f"{self.table.measure} at the start", columns=columns)
        claim = Shown(self.table.claim)
        facts = self.table.criterion_facts | {"parameter": self.parameter.name, "claim": claim}
        facts["points"] = points
        return Report(title="one-way", facts=facts, tables={"points": table})

    def frame(self) -> DataFrame:
        """Return one row for each value of the parameter."""
        return self.table.frame(["at"])


@named_options
def one_way(
    model: Scenario | MDP | Parametric,
    name: str,
    ranges: Stated | Range | tuple[object, object] | None = None,
    *,
    policy: PolicyLike = "optimal",
    relative: object | None = None,
    points: int = 21,
    criterion: str = "total",
) -> Curve:
    """Return value curves along one parameter, for the optimum and for a policy held fixed.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    name : str
        The parameter.
    ranges : (low, high) or {name: (low, high)}, optional
        The range; by default today's value ± 20 %, within the parameter's limits.
    policy, relative : optional
        As for `tornado`.
    points : int
        Number of evenly spaced points, the ends included.
    criterion : "total" or "average"
        As for `study`.

    Returns
    -------
    Curve

    Raises
    ------
    ModelError
        For unknown names, empty ranges, fewer than 2 points, or infinite values.

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 3)]), (0, 1, [(1, 2, 0)]), (2, 0, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    >>> curve = one_way(MDP.from_outcomes(rows, 1), "discount", ("1/2", 1), points=3)
    >>> curve.table.optimal.tolist(), curve.table.regret[:, 0].tolist()
    ([3.0, 3.0, 4.0], [1.0, 0.0, 0.0])
    """
    family = parametric(model)
    values = make_grid(range_of(family, name, ranges, relative), points)
    table = study(family, {name: values}, [policy], criterion=criterion)
    return Curve(model=family.name, parameter=parameter_of(family, name), table=table)


@named_options
def tornado(
    model: Scenario | MDP | Parametric,
    *,
    policy: PolicyLike = "optimal",
    against: PolicyLike | None = None,
    names: Iterable[str] | None = None,
    ranges: Stated | None = None,
    relative: object | None = None,
    criterion: str = "total",
) -> Tornado:
    """Return the tornado of the start value over the ranges of parameters.

    The model is solved at today's values, and at each end of a range.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        The policy held fixed, whose regret is given as well; "optimal" is today's optimum.
    against : PolicyLike, optional
        Another policy held fixed. The bars then show the difference, the value of `policy`
        less the value of this one: for net benefits, the incremental net benefit.
    names : iterable of str, optional
        The parameters; by default the keys of `ranges`, or all parameters without ranges.
    ranges : {name: (low, high)} or the name of a .toml file of them, optional
    relative : number or "whole", optional
        Half the width of the other ranges, as a share of today's value (1/5 by default), or "whole"
        for the parameter's limits. Such a range ends at the limits of the model and of the
        parameter: declare a utility as `Parameter(name="u", value="0.85", low=0, high=1)`.
    criterion : "total" or "average"
        As for `study`.

    Returns
    -------
    Tornado

    Raises
    ------
    ModelError
        For unknown names, empty ranges or infinite values.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> bars = tornado(moving(mdp, {"stay": [(0, 0)]}), names=["stay"]).frame()
    >>> bars[["value_low", "value_high"]].round(9).values.tolist()
    [[1.666666667, 2.5]]
    """
    family = parametric(model)
    if is_average(criterion) and names is None and ranges is None:
        names = list_usual_parameters(family)  # an average does not depend on the discount
    spans = ranges_of(family, names, ranges, relative)
    # The design: today's values, then two points for each range, with one parameter moved.
    design = [{parameter.name: parameter.value for parameter in family.parameters}]
    for name, span in spans.items():
        design += [design[0] | {name: span.low}, design[0] | {name: span.high}]
    columns = {}
    for name in design[0]:
        columns[name] = [point[name] for point in design]
    held = [policy] if against is None else [policy, against]
    return Tornado(
        model=family.name,
        spans={parameter_of(family, name): span for name, span in spans.items()},
        table=study(family, columns, held, criterion=criterion),
    )


def make_grid(span: Range, points: int) -> list[Fraction]:
    """Return evenly spaced values, the ends included; raise ModelError for fewer than 2."""
    points = require_count(points, "points", 2)
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
    choices: Integers  # (Y, X, S) optimal actions, the lowest number on a tie
    policy: Integers  # (Y, X) number of the policy, by the states that it reaches today

    def __repr__(self) -> str:
        points, policies = self.policy.size, int(self.policy.max()) + 1
        return f"TwoWay({self.x.name}, {self.y.name}; points {points}, best policies {policies})"

    def report(self) -> Report:
        """Return the values over the grid, and the number of the best policy."""
        names = {self.x.name: "x:.6g", self.y.name: "y:.6g", "policy": "policy"}
        return Report(
            title="two-way",
            facts={
                **self.table.criterion_facts,
                "parameters": [self.x.name, self.y.name],
                "policies": int(self.policy.max()) + 1,
                "claim": Shown(self.table.claim),
                "points": self.frame().drop(columns="claim").to_dict("records"),
            },
            tables={
                "points": Table(title=f"{self.table.measure} at the start", columns=names | VALUES)
            },
        )

    def frame(self) -> DataFrame:
        """Return one row for each point of the grid."""
        return self.table.frame(["x", "y"]).assign(policy=self.policy.reshape(-1))

    def list_actions(self, number: int) -> dict[str, str]:
        """Return the actions of a numbered policy, in states with a choice that it reaches."""
        mdp, choices = self.mdp, self.choices[self.policy == number][0]
        taken = mdp.pair_action == choices[mdp.pair_state]
        seen = np.flatnonzero(find_reachable_states(mdp, pairs=taken) & mdp.ends.must_choose)
        return {mdp.space.label(state): mdp.actions[choices[state]] for state in seen.tolist()}


@named_options
def two_way(
    model: Scenario | MDP | Parametric,
    x: str,
    y: str,
    *,
    policy: PolicyLike = "optimal",
    ranges: Stated | None = None,
    relative: object | None = None,
    points: int = 11,
    criterion: str = "total",
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
        Number of evenly spaced points along each side, the ends included.
    criterion : "total" or "average"
        As for `study`.

    Returns
    -------
    TwoWay

    Raises
    ------
    ModelError
        As for `one_way`, and if both parameters are the same.

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
    others = sorted(set(read_ranges(family, ranges)) - {x, y})
    if others:
        raise ModelError(
            f"{others[0]} has a range, and is neither of the two parameters",
            where="two-way",
            fix=f"give ranges of {x} and {y} alone",
        )
    # The grid: x changes first.
    spans = ranges_of(family, [x, y], ranges, relative)
    across, along = (make_grid(spans[name], points) for name in (x, y))
    rows = []
    for at in along:
        rows += [at] * points
    columns = {x: across * points, y: rows}
    mdp, table = family.at({}), study(family, columns, [policy], criterion=criterion)

    # Policies are numbered by their actions in the states with a choice that they reach.
    taken = [mdp.pair_action == row[mdp.pair_state] for row in table.rows]
    seen = np.array([find_reachable_states(mdp, pairs=each) & ~mdp.forced for each in taken])
    numbers = find_distinct_rows(np.where(seen, table.rows, -1)[table.which])[1]
    return TwoWay(
        mdp=mdp,
        x=across_by,
        y=along_by,
        table=table,
        choices=table.rows[table.which].reshape(points, points, -1),
        policy=numbers.reshape(points, points),
    )
