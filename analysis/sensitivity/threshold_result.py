"""Thresholds of parameters as they are told: what changes at each, and where nothing does.

The stability radius is the distance from today's value to the nearest threshold on either side, the
policy being re-optimised (threshold analysis in the sense of the ISPOR-SMDM good practices: Briggs
et al., Medical Decision Making 32, 2012).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from analysis.sensitivity.ranges import Range
from analysis.sensitivity.units import unit_of
from mdp.parameters import Parameter
from solvers.solution import Claim

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
