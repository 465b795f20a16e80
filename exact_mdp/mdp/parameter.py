"""Named parameters: a number of a model, and the range that it may take."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING

from exact_mdp.mdp.errors import ModelError, check_names
from exact_mdp.mdp.table import exact, format_beside_limits, format_rational


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One named number of a model.

    Attributes
    ----------
    name : str
        Such as `base.anger` or `reward.task-complete`.
    value : Fraction
        Given as a number or "p/q", and kept exactly.
    low, high : Fraction or None
        The range of allowed values; None for an end without a limit.
    unit : str, optional
        The unit of the number, for tables and axes.

    Examples
    --------
    >>> Parameter(name="base.anger", value="3/20").value
    Fraction(3, 20)
    >>> Parameter(name="base.anger", value=1.5, low=0, high=1)
    Traceback (most recent call last):
    ...
    exact_mdp.mdp.errors.ModelError: base.anger is 1.5, outside [0, 1]
      where: parameter base.anger
      fix:   choose a value in that range
    """

    name: str
    value: Fraction
    low: Fraction | None = None
    high: Fraction | None = None
    unit: str | None = None

    if TYPE_CHECKING:  # the constructor accepts any number

        def __init__(
            self,
            *,
            name: str,
            value: object,
            low: object = None,
            high: object = None,
            unit: str | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        check_names((self.name,), "parameter", where="parameters")
        if not self.name:
            raise ModelError("a parameter has no name", where="parameters", fix="give it one")
        if self.unit is not None:
            check_names((self.unit,), "unit", where=f"parameter {self.name}")
        # Convert the numbers; the ends of the range may be left open.
        for part in ("value", "low", "high"):
            number = getattr(self, part)
            if part == "value" or number is not None:
                number = exact(number, f"parameter {self.name}, {part}")
                object.__setattr__(self, part, number)
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ModelError(
                f"low is {format_rational(self.low)}, "
                f"and high is less: {format_rational(self.high)}",
                where=f"parameter {self.name}",
                fix="give the lower end as low",
            )
        self.check(self.value)

    @property
    def limits(self) -> tuple[Fraction | float, Fraction | float]:
        """The ends of the range; infinite if they are left open."""
        least: Fraction | float = -inf
        most: Fraction | float = inf
        if self.low is not None:
            least = self.low
        if self.high is not None:
            most = self.high
        return least, most

    def check(self, value: Fraction) -> None:
        """Raise ModelError for a value outside the range."""
        least, most = self.limits
        if not least <= value <= most:
            ends: dict[Fraction | float, str] = {-inf: "-∞", inf: "∞"}
            known = [end for end in (self.low, self.high) if end is not None]
            ends |= {end: format_rational(end) for end in known}
            raise ModelError(
                f"{self.name} is {format_beside_limits(value, *known)}, outside "
                f"[{ends[least]}, {ends[most]}]",
                where=f"parameter {self.name}",
                fix="choose a value in that range",
            )
