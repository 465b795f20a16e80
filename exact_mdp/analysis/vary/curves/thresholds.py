"""Thresholds: the values of a parameter at which an optimal action changes.

They are the ends of the pieces of the value's exact curve (`.curve`). The stability radius is the
distance from today's value to the nearest threshold on either side, with the policy re-optimised
(threshold analysis in the sense of the ISPOR-SMDM good practices: Briggs et al., Medical Decision
Making 32, 2012).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np

from exact_mdp.analysis.optimum import actions_of
from exact_mdp.analysis.vary.curves.curve import ValueFunction, curve
from exact_mdp.analysis.vary.ranges import Range, Stated, range_of, unit_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import named_options
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.report import Report, Table
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import format_rational
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.claims import Claim


@dataclass(frozen=True, kw_only=True)
class Switch:
    """A state whose optimal actions change at a threshold, with the actions below and above it."""

    state: int
    label: str
    columns: Mapping[str, Any]
    before: tuple[str, ...]
    after: tuple[str, ...]
    reached: bool  # whether an optimal policy reaches it from the start, below or above


@dataclass(frozen=True, kw_only=True)
class Threshold:
    """A value at which optimal actions change, between two rationals at most 1e-12 apart.

    The optimum is proven at both. A tie at a single point, without a change, is not a threshold.
    """

    low: Fraction
    high: Fraction
    switches: tuple[Switch, ...]

    @property
    def value(self) -> float:
        """The middle of the bracket."""
        return float((self.low + self.high) / 2)

    @property
    def reached(self) -> bool:
        """Whether a state that optimal policies reach is among the switches."""
        return any(switch.reached for switch in self.switches)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Thresholds(Pictured):
    """All thresholds of one parameter within the range of a curve, in ascending order."""

    curve: ValueFunction
    found: tuple[Threshold, ...]

    def __repr__(self) -> str:
        name, span = self.curve.parameter.name, self.curve.range
        noun = "thresholds"
        if len(self.found) == 1:
            noun = "threshold"
        low, high = format_rational(span.low), format_rational(span.high)
        return f"Thresholds({name} from {low} to {high}: {len(self.found)} {noun}, {self.claim})"

    @property
    def claim(self) -> Claim:
        """Certified, or checked if the degree of the rows is checked and not proven."""
        return self.curve.claim

    def switches(self) -> Iterator[dict[str, Any]]:
        """Yield a record for each state that changes at a threshold, as in JSON."""
        for threshold in self.found:
            for switch in threshold.switches:
                yield {
                    "parameter": self.curve.parameter.name,
                    "threshold": threshold.value,
                    "low": threshold.low,
                    "high": threshold.high,
                    "state": switch.label,
                    "columns": switch.columns,
                    "before": switch.before,
                    "after": switch.after,
                    "reached": switch.reached,
                }

    def frame(self) -> DataFrame:
        """Return one row for each state that changes at a threshold."""
        columns = ["parameter", "threshold", "state", "before", "after", "reached"]
        table = data_frame(self.switches(), columns=columns).assign(claim=str(self.claim))
        table[["before", "after"]] = table[["before", "after"]].map(" or ".join)
        return table

    def report(self) -> Report:
        """Return every threshold with the actions that change."""
        return report_of({self.curve.parameter.name: self})

    def stable(self, *, reached: bool = False) -> tuple[Fraction, Fraction]:
        """Return the interval around today's value in which no optimal action changes.

        Its ends are the near ends of brackets, or the ends of the range; with `reached`, only
        states that an optimal policy reaches from the start count.
        """
        low, high = self.curve.range.low, self.curve.range.high
        today = self.curve.parameter.value
        for each in self.found:
            if reached and not each.reached:
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
        """The stability radius: how far the parameter may move either way.

        Without a threshold it is the distance to the nearest end of the range; the limits of the
        parameter itself do not count, unless there is nothing else.
        """
        (low, high), parameter = self.stable(), self.curve.parameter
        today = parameter.value
        sides = []
        if low != parameter.low:
            sides.append(today - low)
        if high != parameter.high:
            sides.append(high - today)
        return min(sides, default=max(today - low, high - today))


def report_of(every: Mapping[str, Thresholds]) -> Report:
    """Return one report on the thresholds of several parameters."""
    # Where the policy stays: in all states, and in the states that optimal policies reach.
    stable: dict[str, dict[str, Any]] = {}
    for name, each in every.items():
        parameter, span = each.curve.parameter, each.curve.range
        numbers = [*each.stable(), *each.stable(reached=True), each.radius]
        keys = ("low", "high", "low_on_reached_states", "high_on_reached_states", "radius")
        stable[name] = {
            "today": float(parameter.value),
            "unit": unit_of(parameter),
            **dict(zip(keys, map(float, numbers), strict=True)),
            "searched": [float(span.low), float(span.high)],
        }
    rows = [stable[name] | {"name": name, "found": len(each.found)} for name, each in every.items()]
    # One unproven degree makes the whole report checked instead of certified.
    claims = [each.claim for each in every.values()]
    switches: list[dict[str, Any]] = []
    criterion: dict[str, Any] = {}
    for each in every.values():
        switches += each.switches()
        criterion |= each.curve.criterion_facts
    return Report(
        title="thresholds",
        facts={
            **criterion,
            "claim": Claim.CHECKED if Claim.CHECKED in claims else Claim.CERTIFIED,
            "stable": stable,
            "switches": switches,
        },
        tables={
            "stable": Table(
                title="the optimal policy stays as it is, other parameters held",
                rows=rows,
                columns={
                    "parameter": "name",
                    "today": "today:.6g",
                    "stays from": "low:.6g",
                    "to": "high:.6g",
                    "searched": "searched",
                    "thresholds": "found",
                },
                first=len(every),
            ),
            "switches": Table(
                title="optimal actions that change",
                rows=_group_switches(switches),
                columns={
                    "parameter": "parameter",
                    "state": "state",
                    "threshold": "threshold:.6g",
                    "to": "to:.6g",
                    "below": "before",
                    "above": "after",
                },
            ),
        },
    )


def _group_switches(switches: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for all states with the same change and the same last column.

    In a model with one column, the states must change at the same threshold instead.
    """
    groups: dict[Any, list[Mapping[str, Any]]] = {}
    for each in switches:
        *others, last = each["columns"].items()
        if others:
            shared = last
        else:
            shared = each["threshold"]
        change = (each["parameter"], each["before"], each["after"], shared)
        groups.setdefault(change, []).append(each)
    rows = []
    for (*_, shared), members in groups.items():
        states = [*dict.fromkeys(each["state"] for each in members)]
        # One state by its name; several by the column that they share, or by the first names.
        text = states[0]
        if len(states) > 1:
            names = [each.removeprefix("state ") for each in states]
            if isinstance(shared, tuple):
                names = [" ".join(shared)]
            text = f"{len(states):,} states: {', '.join(names[:3])}"
            if len(names) > 3:
                text += ", …"
        # `to` is shown if the thresholds of the group differ.
        first, last = members[0]["threshold"], members[-1]["threshold"]
        rows.append({**members[0], "state": text, "to": last if last > first else None})
    return rows


@named_options
def thresholds(
    model: Scenario | MDP | Parametric,
    name: str,
    ranges: Stated | Range | tuple[object, object] | None = None,
    *,
    relative: object | None = None,
    criterion: str = "total",
) -> Thresholds:
    """Find every threshold of a parameter, with the others held fixed and the policy re-optimised.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    name : str
        The parameter.
    ranges : (low, high) or {name: (low, high)}, optional
        The range; by default today's value ± 20 %, within the parameter's limits.
    relative : number, optional
        A share other than 20 %.
    criterion : "total" or "average"
        As for `study`.

    Returns
    -------
    Thresholds
        All thresholds strictly inside the range.

    Raises
    ------
    ModelError
        For an unknown name, an empty range, a model with cycles that is too large, rows that are
        not polynomials of the degree that a family states, or at discount 1 if some policy never
        ends, unless each of its steps costs something; for an average, if it may jump where a
        transition vanishes.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    >>> switches = thresholds(MDP.from_outcomes(rows, "1/2"), "discount", ("1/10", "99/100"))
    >>> [threshold.value for threshold in switches.found]  # 10/11: Puterman (1994), section 3.1
    [0.90909090909...]
    """
    family = parametric(model)
    span = range_of(family, name, ranges, relative)
    whole = curve(family, name, span, criterion=criterion)
    found = []
    for left, right in pairwise(whole.pieces):
        switches = _find_switches(whole.mdp, left.optimal, right.optimal)
        if switches:  # two pieces may also meet at a breakpoint of the rows
            low, high = left.high
            found.append(Threshold(low=low, high=high, switches=switches))
    return Thresholds(curve=whole, found=tuple(found))


def _find_switches(mdp: MDP, before: Flags, after: Flags) -> tuple[Switch, ...]:
    """Return the states whose optimal pairs (L,) change."""
    states = np.unique(mdp.pair_state[before != after]).tolist()
    seen = find_reachable_states(mdp, pairs=before) | find_reachable_states(mdp, pairs=after)
    below, above = actions_of(mdp, before), actions_of(mdp, after)
    switches = []
    for state in states:
        switches.append(
            Switch(
                state=state,
                label=mdp.space.label(state),
                columns=dict(mdp.space.as_dict(state)),
                before=below[state],
                after=above[state],
                reached=bool(seen[state]),
            )
        )
    return tuple(switches)
