"""One parameter at a time: value curves, the tornado diagram, and the regret of a policy.

At every value of the parameter the model is solved (the policy re-optimised) and a given policy is
evaluated as it stands (the policy held fixed); the difference is what holding it costs,

    regret(θ) = V*(θ) - V_π(θ).

Unless another policy is given, the one held fixed is the optimum at today's values. A bar of the
tornado spans the values at both ends of a parameter's range (Briggs et al., Medical Decision
Making 32, 2012); a curve may have its extremes in between.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from exact_mdp.analysis.vary.base_case import BaseCase, finite_optimum, finite_worth
from exact_mdp.analysis.vary.ranges import Range, range_of, ranges_of, unit_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import counted
from exact_mdp.solvers.solution import Bounded

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class Values:
    """The start values of the optimum and of a policy that is held fixed."""

    optimal: Bounded
    fixed: Bounded
    sense: str = "max"

    @property
    def regret(self) -> Bounded:
        """What holding the policy costs; not below 0, whatever rounding says."""
        lost = self.optimal.value - self.fixed.value
        value = max(0.0, lost if self.sense == "max" else -lost)
        return Bounded(value=value, error=(self.optimal.error + self.fixed.error) * (1 + 1e-9))


@dataclass(frozen=True, kw_only=True)
class Point(Values):
    """These values at one value of a parameter, `at`."""

    at: Fraction


@dataclass(frozen=True, kw_only=True)
class Bar:
    """The bar of one parameter: the values at both ends of its range."""

    parameter: Parameter
    low: Point
    high: Point

    @property
    def swing(self) -> float:
        """Distance of the optimal values at both ends."""
        return abs(self.high.optimal.value - self.low.optimal.value)

    @property
    def fixed_swing(self) -> float:
        """Distance of the fixed policy's values at both ends."""
        return abs(self.high.fixed.value - self.low.fixed.value)

    @property
    def regret(self) -> float:
        """The larger regret of the two ends."""
        return max(self.low.regret.value, self.high.regret.value)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Tornado(Pictured):
    """Bars of all parameters, the widest first, and the values at today's parameters.

    Attributes
    ----------
    today : Values
    bars : tuple of Bar
    """

    today: Values
    bars: tuple[Bar, ...]

    def __repr__(self) -> str:
        widest = f", the widest of {self.bars[0].parameter.name}" if self.bars else ""
        return f"Tornado({len(self.bars)} bars{widest}; value today {self.today.optimal})"

    @property
    def value(self) -> Bounded:
        """The optimal start value today."""
        return self.today.optimal

    @property
    def error(self) -> float:
        """Bound on the error of `value`."""
        return self.value.error

    def frame(self) -> DataFrame:
        """Return one row for each bar; values and regrets in units of reward."""
        import pandas

        return pandas.DataFrame(
            [
                {
                    "parameter": bar.parameter.name,
                    "unit": unit_of(bar.parameter),
                    "low": float(bar.low.at),
                    "today": float(bar.parameter.value),
                    "high": float(bar.high.at),
                    "value at low, re-optimised (reward)": bar.low.optimal.value,
                    "value at high, re-optimised (reward)": bar.high.optimal.value,
                    "swing, re-optimised (reward)": bar.swing,
                    "value at low, policy fixed (reward)": bar.low.fixed.value,
                    "value at high, policy fixed (reward)": bar.high.fixed.value,
                    "swing, policy fixed (reward)": bar.fixed_swing,
                    "regret at low (reward)": bar.low.regret.value,
                    "regret at high (reward)": bar.high.regret.value,
                    "claim": "bounded",
                }
                for bar in self.bars
            ]
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Curve(Pictured):
    """Values along one parameter's range."""

    parameter: Parameter
    points: tuple[Point, ...]

    def frame(self) -> DataFrame:
        """Return one row for each value of the parameter."""
        import pandas

        return pandas.DataFrame(
            {
                "parameter": self.parameter.name,
                "unit": unit_of(self.parameter),
                "at": [float(point.at) for point in self.points],
                "value, re-optimised (reward)": [p.optimal.value for p in self.points],
                "value, policy fixed (reward)": [p.fixed.value for p in self.points],
                "regret (reward)": [p.regret.value for p in self.points],
                "error bound (reward)": [p.regret.error for p in self.points],
                "claim": "bounded",
            }
        )


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
    policy : PolicyLike
        The policy held fixed; "optimal" is the optimum at today's values.
    relative : number, optional
        Another share than 20 %.
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
    >>> [(float(p.at), p.optimal.value, p.fixed.value) for p in curve.points]
    [(0.5, 3.0, 2.0), (0.75, 3.0, 3.0), (1.0, 4.0, 4.0)]
    """
    family = parametric(model)
    values = grid(range_of(family, name, ranges, relative), points)
    held = BaseCase(mdp=family.at({})).held(policy)
    found = tuple(_point(family, name, value, held) for value in values)
    return Curve(parameter=parameter_of(family, name), points=found)


def tornado(
    model: Scenario | MDP | Parametric,
    *,
    policy: PolicyLike = "optimal",
    names: Iterable[str] | None = None,
    ranges: Mapping[str, object] | None = None,
    relative: object | None = None,
) -> Tornado:
    """Return the tornado of the start value over the ranges of parameters.

    The model is compiled and solved once at today's values, and once at each end of a range.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        The policy held fixed, whose regret is given as well; "optimal" is today's optimum.
    names : iterable of str, optional
        The parameters; those of `ranges` where these are given, otherwise all.
    ranges : {name: (low, high)}, optional
        See `analysis.vary.ranges.load_ranges` for a file of them.
    relative : number or "whole", optional
        Half the width of the other ranges, as a share of today's value (1/5 unless given), or all
        that a parameter may be. Such a range ends where the model does.

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
    base = BaseCase(mdp=family.at({}))
    held = base.held(policy)
    bars = []
    for name, span in spans.items():
        low = _point(family, name, span.low, held)
        high = low
        if span.high > span.low:
            high = _point(family, name, span.high, held)
        bars.append(Bar(parameter=parameter_of(family, name), low=low, high=high))
    bars.sort(key=lambda bar: -bar.swing)
    fixed = finite_worth(base.mdp, held, "today's parameters")
    today = Values(optimal=base.solution.start, fixed=fixed, sense=base.mdp.sense)
    return Tornado(today=today, bars=tuple(bars))


def _point(family: Parametric, name: str, at: Fraction, held: Floats) -> Point:
    mdp, where = family.at({name: at}), f"{name} = {at}"
    fixed = finite_worth(mdp, held, where)
    return Point(at=at, optimal=finite_optimum(mdp, where).start, fixed=fixed, sense=mdp.sense)


def grid(span: Range, points: int) -> list[Fraction]:
    """Return evenly spaced values, the ends included; raises ModelError for fewer than 2."""
    points = counted(points, "points", 2)
    step = (span.high - span.low) / (points - 1)
    return [span.low + k * step for k in range(points)]
