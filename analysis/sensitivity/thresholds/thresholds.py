"""Thresholds of parameters as they are told: what changes at each, and where nothing does.

The stability radius is the distance from today's value to the nearest threshold on either side, the
policy being re-optimised (threshold analysis in the sense of the ISPOR-SMDM good practices: Briggs
et al., Medical Decision Making 32, 2012).

Every value of a parameter at which an optimal action changes.

Within a piece of the parameter's range a policy stays optimal up to a root of one of its gap
polynomials (`analysis.sensitivity.thresholds.gaps`); `analysis.sensitivity.thresholds.sweep` walks
from root to root and solves the model exactly on both sides of each. How far the nearest one is, is
told in `analysis.sensitivity.thresholds.thresholds`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.sensitivity.base import unit_of
from exact_mdp.analysis.sensitivity.ranges import Range, admitted, around, checked
from exact_mdp.analysis.sensitivity.thresholds.gaps import Rows
from exact_mdp.analysis.sensitivity.thresholds.sweep import Stretch, Sweep
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.row_change import Piece, row_change
from exact_mdp.solvers.solution import Claim

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
    checked : int or None
        Points at which the degree of a family's rows was checked, where it is not proven: there may
        be more thresholds. None where a proof says that there are no others.
    """

    parameter: Parameter
    range: Range
    found: tuple[Threshold, ...]
    checked: int | None = None

    @property
    def claim(self) -> Claim:
        """Certified, or estimated where the degree of the rows is checked and not proven."""
        return Claim.CERTIFIED if self.checked is None else Claim.ESTIMATED

    def stable(self, *, reached: bool = False) -> tuple[Fraction, Fraction]:
        """Return the interval around today's value in which no optimal action changes.

        As sure as the thresholds (`claim`): its ends are the near ends of brackets, or the ends of
        the range.

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
            "claim": str(each.claim),
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
                "claim": str(each.claim),
            }
        )
    return DataFrame(rows)


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
        Within today's value ± 20 % unless given, and within what the model admits
        (`analysis.sensitivity.ranges.admitted`).

    Returns
    -------
    Thresholds
        Those inside the range, touches included; its own ends are not looked at. They are certified
        where the degree of the rows is proven; where that of a `mdp.parametric.Family` is only
        checked at some points they say so.

    Raises
    ------
    ModelError
        For an unknown name, an empty range, a model with cycles that is too large, or rows that are
        no polynomials of the degree that a family states.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    >>> found = thresholds(MDP.from_outcomes(rows, "1/2"), "discount", ("1/10", "99/100"))
    >>> [threshold.value for threshold in found.found]  # 10/11: Puterman (1994), section 3.1
    [0.90909090909...]
    """
    model = parametric(source)
    parameter = parameter_of(model, name)
    if bounds is None:
        span = admitted(model, parameter, around(parameter))
    else:
        span = checked(model, {name: bounds})[name]
    found: list[Threshold] = []
    stretches: list[Stretch] = []
    mdp = model.at({})
    checked_at: int | None = None
    for low, high in _parts(model, name, span):
        middle = (low + high) / 2
        base = model.at({name: middle})
        change = row_change(model, name, Piece(low=low, high=high), origin=middle, base=base)
        if change.checked is not None:
            checked_at = change.checked
        sweep = Sweep(Rows(base, change), lambda value: model.at({name: value}), low, high)
        stretches += list(sweep)
    for left, right in pairwise(stretches):
        switches = _switches(mdp, left, right)
        low, high = left.after[0], max(left.after[1], right.before[1])
        if switches:
            found.append(Threshold(low=low, high=high, switches=switches))
        if low == high:  # a breakpoint: rows have a kink there, and so may a gap that is 0 there
            found += _ties(mdp, model.at({name: low}), left, right, low)
    for each in stretches:
        found += [_touch(mdp, each, *touch) for touch in each.touches]
    found.sort(key=lambda threshold: threshold.low)
    return Thresholds(parameter=parameter, range=span, found=tuple(found), checked=checked_at)


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


def _ties(mdp: MDP, there: MDP, left: Stretch, right: Stretch, value: Fraction) -> list[Threshold]:
    """Return the touch at a breakpoint: what is as good there and on neither side of it."""
    tied = proven(there).optimal_pairs & ~left.optimal & ~right.optimal
    tied &= ~mdp.terminal[mdp.pair_state]
    if not tied.any():
        return []
    more = left.optimal | tied
    seen = reachable(mdp, pairs=left.optimal) | reachable(mdp, pairs=right.optimal)
    switches = tuple(
        _switch(mdp, state, left.optimal, more, bool(seen[state]))
        for state in np.unique(mdp.pair_state[tied]).tolist()
    )
    return [Threshold(low=value, high=value, switches=switches, touch=True)]


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
