"""Every value of a parameter at which an optimal action changes, and where none does.

These are the ends of the pieces of the value's exact curve (`.curve`).

The stability radius is the distance from today's value to the nearest threshold on either side, the
policy being re-optimised (threshold analysis in the sense of the ISPOR-SMDM good practices: Briggs
et al., Medical Decision Making 32, 2012).
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
from exact_mdp.solvers.solution import Claim


@dataclass(frozen=True, kw_only=True)
class Switch:
    """A state whose optimal actions change at a threshold: all those below it and above it."""

    state: int
    label: str
    columns: Mapping[str, Any]
    before: tuple[str, ...]
    after: tuple[str, ...]
    reached: bool  # whether an optimal policy comes to it from the start, below or above


@dataclass(frozen=True, kw_only=True)
class Threshold:
    """A value at which optimal actions change, between two rationals at most 1e-12 apart.

    The optimum has been proved at both. An action that is as good at one point, and no better on
    either side, makes none.
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
        """Whether a state that optimal policies come to is among those that change."""
        return any(switch.reached for switch in self.switches)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Thresholds(Pictured):
    """All thresholds of one parameter within the range of a curve, in rising order."""

    curve: ValueFunction
    found: tuple[Threshold, ...]

    def __repr__(self) -> str:
        name, span = self.curve.parameter.name, self.curve.range
        found = f"{len(self.found)} threshold{'s' * (len(self.found) != 1)}, {self.claim}"
        low, high = format_rational(span.low), format_rational(span.high)
        return f"Thresholds({name} from {low} to {high}: {found})"

    @property
    def claim(self) -> Claim:
        """Certified, or checked where the degree of the rows is checked and not proven."""
        return self.curve.claim

    def switches(self) -> Iterator[dict[str, Any]]:
        """Yield each state that changes at a threshold, as JSON has it."""
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
        """Return every threshold and what changes there."""
        return report_of({self.curve.parameter.name: self})

    def stable(self, *, reached: bool = False) -> tuple[Fraction, Fraction]:
        """Return the interval around today's value in which no optimal action changes.

        Its ends are the near ends of brackets, or those of the range; `reached` counts only states
        that an optimal policy comes to from the start.
        """
        low, high = self.curve.range.low, self.curve.range.high
        today = self.curve.parameter.value
        for each in (one for one in self.found if one.reached or not reached):
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
        (low, high), parameter = self.stable(), self.curve.parameter
        today = parameter.value
        sides = [today - low] * (low != parameter.low) + [high - today] * (high != parameter.high)
        return min(sides, default=max(today - low, high - today))


def report_of(every: Mapping[str, Thresholds]) -> Report:
    """Return what was found of several parameters."""
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
    claims = [each.claim for each in every.values()]
    switches = [switch for each in every.values() for switch in each.switches()]
    return Report(
        title="thresholds",
        facts={
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
    """Return a row for states that change alike, all of one status (or last column), or at once."""
    groups: dict[Any, list[Mapping[str, Any]]] = {}
    for each in switches:
        *others, last = each["columns"].items()
        shared = last if others else each["threshold"]
        change = (each["parameter"], each["before"], each["after"], shared)
        groups.setdefault(change, []).append(each)
    rows = []
    for (*_, shared), members in groups.items():
        states = [*dict.fromkeys(each["state"] for each in members)]
        names = [each.removeprefix("state ") for each in states]
        names = [" ".join(shared)] if isinstance(shared, tuple) else names
        text = ", ".join(names[:3]) + ", …" * (len(names) > 3)
        text = f"{len(states):,} states: {text}" if len(states) > 1 else states[0]
        first, last = (members[end]["threshold"] for end in (0, -1))
        rows.append({**members[0], "state": text, "to": last if last > first else None})
    return rows


@named_options
def thresholds(
    model: Scenario | MDP | Parametric,
    name: str,
    ranges: Stated | Range | tuple[object, object] | None = None,
    *,
    relative: object | None = None,
) -> Thresholds:
    """Return every threshold of a parameter, the others held and the policy re-optimised.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    name : str
        The parameter.
    ranges : (low, high) or {name: (low, high)}, optional
        Today's value ± 20 % unless given, within what the model admits.
    relative : number, optional
        Another share than 20 %.

    Returns
    -------
    Thresholds
        Those inside the range; its own ends are not looked at.

    Raises
    ------
    ModelError
        For an unknown name, an empty range, a model with cycles that is too large, rows that are
        no polynomials of the degree that a family states, and at discount 1 where some policy never
        ends.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    >>> switches = thresholds(MDP.from_outcomes(rows, "1/2"), "discount", ("1/10", "99/100"))
    >>> [threshold.value for threshold in switches.found]  # 10/11: Puterman (1994), section 3.1
    [0.90909090909...]
    """
    family = parametric(model)
    whole = curve(family, name, range_of(family, name, ranges, relative))
    turns = (
        (left.high, _find_switches(whole.mdp, left.optimal, right.optimal))
        for left, right in pairwise(whole.pieces)
    )
    found = (Threshold(low=low, high=high, switches=each) for (low, high), each in turns if each)
    return Thresholds(curve=whole, found=tuple(found))


def _find_switches(mdp: MDP, before: Flags, after: Flags) -> tuple[Switch, ...]:
    """Return the states whose optimal pairs (L,) change."""
    states = np.unique(mdp.pair_state[before != after]).tolist()
    seen = find_reachable_states(mdp, pairs=before) | find_reachable_states(mdp, pairs=after)
    below, above = actions_of(mdp, before), actions_of(mdp, after)
    return tuple(
        Switch(
            state=state,
            label=mdp.space.label(state),
            columns=dict(mdp.space.as_dict(state)),
            before=below[state],
            after=above[state],
            reached=bool(seen[state]),
        )
        for state in states
    )
