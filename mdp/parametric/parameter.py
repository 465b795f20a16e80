"""Named parameters: a number of a model, and the range that it may take."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from exact_mdp.mdp.errors import ModelError, check_names
from exact_mdp.mdp.table import beside, shown


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One named number of a model.

    Attributes
    ----------
    name : str
        Such as `base.anger` or `reward.task-complete`.
    value : Fraction
    low, high : Fraction or None
        The range that the number may take; None where it is open.

    Examples
    --------
    >>> Parameter(name="base.anger", value=Fraction(3, 2), low=Fraction(0), high=Fraction(1))
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

    def __post_init__(self) -> None:
        check_names((self.name,), "parameter", where="parameters")
        self.check(self.value)

    def check(self, value: Fraction) -> None:
        """Raise ModelError for a value outside the range."""
        below = self.low is not None and value < self.low
        above = self.high is not None and value > self.high
        if below or above:
            low = "-∞" if self.low is None else shown(self.low)
            high = "∞" if self.high is None else shown(self.high)
            ends = [end for end in (self.low, self.high) if end is not None]
            raise ModelError(
                f"{self.name} is {beside(value, *ends)}, outside [{low}, {high}]",
                where=f"parameter {self.name}",
                fix="choose a value in that range",
            )
