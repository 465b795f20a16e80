"""Every value of a parameter at which an optimal action changes, and how far away it is.

Within a piece of the parameter's range a policy stays optimal up to a root of one of its gap
polynomials (`analysis.sensitivity.gaps`); `analysis.sensitivity.sweep` walks from root to root and
solves the model exactly on both sides of each. The stability radius is the distance from today's
value to the nearest threshold on either side, the policy being re-optimised (threshold analysis in
the sense of the ISPOR-SMDM good practices: Briggs et al., Medical Decision Making 32, 2012).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.sensitivity.gaps import Rows
from analysis.sensitivity.ranges import Range, around, checked
from analysis.sensitivity.sweep import Stretch, Sweep
from analysis.sensitivity.units import unit_of
from mdp.chain import reachable
from mdp.model import MDP
from mdp.parameters import Parameter
from mdp.parametric import Parametric, parameter_of, parametric
from mdp.row_change import Piece, row_change
from mdp.scenario import Scenario

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class Switch:
    """A state whose optimal actions change at a threshold.

    Attributes
    ----------
    state : int
    label : str
    columns : mapping
        The state's named columns, such as subtask, trial and status.
    before, after : tuple of str
        All optimal actions below and above the threshold.
    reached : bool
        Whether an optimal policy comes to the state from the start, below or above.
    """

    state: int
    label: str
    columns: Mapping[str, Any]
    before: tuple[str, ...]
    after: tuple[str, ...]
    reached: bool


@dataclass(frozen=True, kw_only=True)
class Threshold:
    """A value at which optimal actions change, between two rationals at most 1e-12 apart.

    The optimum has been proved at both. `touch` is True where another action becomes as good at
    one point and no better on either side.
    """

    low: Fraction
    high: Fraction
    switches: tuple[Switch, ...]
    touch: bool = False

    @property
    def value(self) -> float:
        """The middle of the bracket."""
        return float((self.low + self.high) / 2)

    @property
    def reached(self) -> bool:
        """Whether a state that optimal policies come to is among those that change."""
        return any(switch.reached for switch in self.switches)


@dataclass(frozen=True, kw_only=True, eq=False)
class Thresholds:
    """All thresholds of one parameter within a range, in rising order.

    Attributes
    ----------
    parameter : Parameter
    range : Range
    found : tuple of Threshold
    """

    parameter: Parameter
    range: Range
    found: tuple[Threshold, ...]

    def stable(self, *, reached: bool = False) -> tuple[Fraction, Fraction]:
        """Return the interval around today's value in which no optimal action changes.

        Certified: its ends are the near ends of brackets, or the ends of the range.

        Parameters
        ----------
        reached : bool
            Count only states that an optimal policy comes to from the start.
        """
        low, high, today = self.range.low, self.range.high, self.parameter.value
        for each in self.found:
            if each.touch or (reached and not each.reached):
                continue
            if each.high < today:
                low = max(low, each.high)
            elif each.low > today:
                high = min(high, each.low)
            else:
                return today, today
        return low, high

    @property
    def radius(self) -> Fraction:
        """The policy's stability radius: how far the parameter may move either way.

        Where no threshold is nearer, the distance to an end of the range that is not an end of
        what the parameter may be.
        """
        low, high = self.stable()
        today, parameter = self.parameter.value, self.parameter
        sides = []
        if low != parameter.low:
            sides.append(today - low)
        if high != parameter.high:
            sides.append(high - today)
        return min(sides, default=max(today - low, high - today))


def thresholds(
    source: Scenario | MDP | Parametric,
    name: str,
    bounds: Range | tuple[object, object] | None = None,
) -> Thresholds:
    """Return every threshold of a parameter, the others held.

    Parameters
    ----------
    source : Scenario, MDP or Parametric
    name : str
    bounds : (low, high), optional
        Within today's value ± 20 % unless given.

    Raises
    ------
    ModelError
        For an unknown name, an empty range, or a model with cycles that is too large.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    >>> found = thresholds(MDP.from_outcomes(rows, "1/2"), "discount", ("1/10", "99/100"))
    >>> [threshold.value for threshold in found.found]  # 10/11: Puterman (1994), section 3.1
    [0.90909090909...]
    """
    model = parametric(source)
    parameter = parameter_of(model, name)
    span = around(parameter) if bounds is None else checked(model, {name: bounds})[name]
    found: list[Threshold] = []
    stretches: list[Stretch] = []
    mdp = model.at({})
    for low, high in _parts(model, name, span):
        middle = (low + high) / 2
        base = model.at({name: middle})
        change = row_change(model, name, Piece(low=low, high=high), origin=middle, base=base)
        sweep = Sweep(Rows(base, change), lambda value: model.at({name: value}), low, high)
        stretches += list(sweep)
    for left, right in pairwise(stretches):
        switches = _switches(mdp, left, right)
        if switches:
            low, high = left.after[0], max(left.after[1], right.before[1])
            found.append(Threshold(low=low, high=high, switches=switches))
    for each in stretches:
        found += [_touch(mdp, each, *touch) for touch in each.touches]
    found.sort(key=lambda threshold: threshold.low)
    return Thresholds(parameter=parameter, range=span, found=tuple(found))


def threshold_frame(found: Mapping[str, Thresholds]) -> DataFrame:
    """Return one row for each state that changes at a threshold."""
    from pandas import DataFrame

    rows = [
        {
            "parameter": name,
            "unit": unit_of(each.parameter),
            "today": float(each.parameter.value),
            "threshold": threshold.value,
            **{f"{column}": value for column, value in switch.columns.items()},
            "state": switch.label,
            "before": " or ".join(switch.before),
            "after": " or ".join(switch.after),
            "reached": switch.reached,
            "touch": threshold.touch,
            "claim": "certified",
        }
        for name, each in found.items()
        for threshold in each.found
        for switch in threshold.switches
    ]
    columns = ["parameter", "unit", "today", "threshold", "state", "before", "after", "reached"]
    return DataFrame(rows) if rows else DataFrame(columns=columns)


def stability_frame(found: Mapping[str, Thresholds]) -> DataFrame:
    """Return, for each parameter, the range in which the optimal policy stays as it is."""
    from pandas import DataFrame

    rows = []
    for name, each in found.items():
        low, high = each.stable()
        near, far = each.stable(reached=True)
        rows.append(
            {
                "parameter": name,
                "unit": unit_of(each.parameter),
                "today": float(each.parameter.value),
                "stable from": float(low),
                "stable to": float(high),
                "stable from (states reached)": float(near),
                "stable to (states reached)": float(far),
                "searched from": float(each.range.low),
                "searched to": float(each.range.high),
                "thresholds": len(each.found),
                "policy": "re-optimised",
                "claim": "certified",
            }
        )
    return DataFrame(rows)


def _parts(model: Parametric, name: str, span: Range) -> list[tuple[Fraction, Fraction]]:
    """Return the range cut at its breakpoints; nothing where it is a single point."""
    inside = [cut for cut in model.breakpoints(name) if span.low < cut < span.high]
    ends = sorted({span.low, *inside, span.high})
    return list(pairwise(ends))


def _switches(mdp: MDP, left: Stretch, right: Stretch) -> tuple[Switch, ...]:
    moved = np.flatnonzero(left.optimal != right.optimal)
    if not len(moved):
        return ()
    seen = reachable(mdp, pairs=left.optimal) | reachable(mdp, pairs=right.optimal)
    return tuple(
        _switch(mdp, state, left.optimal, right.optimal, bool(seen[state]))
        for state in np.unique(mdp.pair_state[moved]).tolist()
    )


def _switch(mdp: MDP, state: int, before: np.ndarray, after: np.ndarray, reached: bool) -> Switch:
    def actions(optimal: np.ndarray) -> tuple[str, ...]:
        taken = [pair for pair in mdp.pairs_of(state) if optimal[pair]]
        return tuple(mdp.actions[mdp.pair_action[pair]] for pair in taken)

    return Switch(
        state=state,
        label=mdp.space.label(state),
        columns=dict(mdp.space.as_dict(state)),
        before=actions(before),
        after=actions(after),
        reached=reached,
    )


def _touch(mdp: MDP, stretch: Stretch, low: Fraction, high: Fraction, pair: int) -> Threshold:
    more = stretch.optimal.copy()
    more[pair] = True
    state = int(mdp.pair_state[pair])
    seen = bool(reachable(mdp, pairs=stretch.optimal)[state])
    return Threshold(
        low=low,
        high=high,
        switches=(_switch(mdp, state, stretch.optimal, more, seen),),
        touch=True,
    )
