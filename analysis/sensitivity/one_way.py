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

from exact_mdp.analysis.sensitivity.base import BaseCase, unit_of
from exact_mdp.analysis.sensitivity.ranges import Range, admitted, around, checked
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers import evaluate, solve
from exact_mdp.solvers.solution import Bounded

if TYPE_CHECKING:
    from pandas import DataFrame

REGRET_ZERO = 0.0


@dataclass(frozen=True, kw_only=True)
class Point:
    """What the optimum and a fixed policy are worth at one value of a parameter.

    `at` is None for today's values of all of them.
    """

    at: Fraction | None
    optimal: Bounded
    fixed: Bounded

    @property
    def regret(self) -> Bounded:
        """What holding the policy costs; not below 0, whatever rounding says."""
        value = max(REGRET_ZERO, self.optimal.value - self.fixed.value)
        return Bounded(value=value, error=(self.optimal.error + self.fixed.error) * (1 + 1e-9))


@dataclass(frozen=True, kw_only=True)
class Bar:
    """The bar of one parameter: the ends of its range and what is worth what there."""

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Tornado:
    """Bars of all parameters, the widest first, and today's values."""

    today: Point
    bars: tuple[Bar, ...]

    def frame(self) -> DataFrame:
        """Return one row for each bar; values and regrets in units of reward."""
        from pandas import DataFrame

        return DataFrame(
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Values along one parameter's range."""

    parameter: Parameter
    points: tuple[Point, ...]

    def frame(self) -> DataFrame:
        """Return one row for each value of the parameter."""
        from pandas import DataFrame

        return DataFrame(
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
    source: Scenario | MDP | Parametric,
    name: str,
    bounds: Range | tuple[object, object] | None = None,
    *,
    policy: object = "optimal",
    points: int = 21,
) -> Curve:
    """Return value curves along one parameter, the policy re-optimised and held fixed.

    Parameters
    ----------
    bounds : (low, high), optional
        Within today's value ± 20 % unless given, and within what the model admits
        (`analysis.sensitivity.ranges.admitted`).
    policy : "optimal" at today's values, or anything that `solvers.evaluate` takes
    points : int
        Evenly spaced, the ends included.

    Raises
    ------
    ModelError
        For unknown names, empty ranges, fewer than 2 points.

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 3)]), (0, 1, [(1, 2, 0)]), (2, 0, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    >>> curve = one_way(MDP.from_outcomes(rows, 1), "discount", ("1/2", 1), points=3)
    >>> [(float(p.at), p.optimal.value, p.fixed.value) for p in curve.points]
    [(0.5, 3.0, 2.0), (0.75, 3.0, 3.0), (1.0, 4.0, 4.0)]
    """
    if points < 2:
        raise ModelError(f"{points} points", where="one-way", fix="ask for at least 2")
    model = parametric(source)
    parameter = parameter_of(model, name)
    if bounds is None:
        span = admitted(model, parameter, around(parameter))
    else:
        span = checked(model, {name: bounds})[name]
    weights = BaseCase(mdp=model.at({})).held(policy)
    step = (span.high - span.low) / (points - 1)
    values = [span.low + k * step for k in range(points)]
    return Curve(parameter=parameter, points=tuple(_point(model, name, v, weights) for v in values))


def tornado(
    source: Scenario | MDP | Parametric,
    *,
    policy: object = "optimal",
    names: Iterable[str] | None = None,
    ranges: Mapping[str, object] | None = None,
    relative: Fraction | None = None,
) -> Tornado:
    """Return the tornado of the start value over the ranges of parameters.

    Parameters
    ----------
    policy : "optimal" at today's values, or anything that `solvers.evaluate` takes
        The policy held fixed, whose regret is told as well.
    names : iterable of str, optional
        The parameters; those of `ranges` where these are given, otherwise all.
    ranges : {name: (low, high)}, optional
        See `analysis.sensitivity.ranges.load_ranges` for a file of them.
    relative : Fraction, optional
        Half the width of the other ranges, as a share of today's value; 1/5 unless given.
        Such a range ends where the model does (`analysis.sensitivity.ranges.admitted`).

    Raises
    ------
    ModelError
        For unknown names and empty ranges.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> (bar,) = tornado(moving(mdp, {"stay": [(0, 0)]}), names=["stay"]).bars
    >>> [round(end.optimal.value, 9) for end in (bar.low, bar.high)]
    [1.666666667, 2.5]
    """
    model = parametric(source)
    stated = checked(model, ranges or {})
    chosen = list(stated) if names is None and stated else names
    if chosen is None:
        chosen = [parameter.name for parameter in model.parameters]
    mdp = model.at({})
    weights = BaseCase(mdp=mdp).held(policy)
    share = {} if relative is None else {"relative": relative}
    bars = []
    for name in chosen:
        parameter = parameter_of(model, name)
        span = stated.get(name) or admitted(model, parameter, around(parameter, **share))
        low = _point(model, name, span.low, weights)
        high = low if span.high == span.low else _point(model, name, span.high, weights)
        bars.append(Bar(parameter=parameter, low=low, high=high))
    bars.sort(key=lambda bar: -bar.swing)
    today = _values(mdp, None, weights)
    return Tornado(today=today, bars=tuple(bars))


def _point(model: Parametric, name: str, value: Fraction, weights: Floats) -> Point:
    return _values(model.at({name: value}), value, weights)


def _values(mdp: MDP, at: Fraction | None, weights: Floats) -> Point:
    return Point(at=at, optimal=solve(mdp).start, fixed=evaluate(mdp, weights).numbers["mean"])
