"""Derivatives of the start value by the parameters, as they are told."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from analysis.sensitivity.units import unit_of
from mdp.parameters import Parameter
from solvers.solution import Bounded, Certified, Claim

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class Checked:
    """An exact number that stands on the degree of a polynomial, which no proof shows.

    Attributes
    ----------
    value : Fraction
    points : int
        At so many values of the parameter the model is what the polynomial says.

    Examples
    --------
    >>> print(Checked(value=Fraction(4), points=6))
    4 (estimated: the degree was checked at 6 points, not proven)
    """

    value: Fraction
    points: int

    @property
    def claim(self) -> Claim:
        return Claim.ESTIMATED

    def __str__(self) -> str:
        text = str(Certified(value=self.value)).partition(" (")[0]
        return f"{text} ({self.claim}: the degree was checked at {self.points} points, not proven)"


def claimed(value: Fraction, checked: int | None) -> Certified | Checked:
    """Return a number as certified, unless its degree was only `checked` at some points.

    Examples
    --------
    >>> claimed(Fraction(1, 2), None).claim, claimed(Fraction(1, 2), 6).claim
    (<Claim.CERTIFIED: 'certified'>, <Claim.ESTIMATED: 'estimated'>)
    """
    return Certified(value=value) if checked is None else Checked(value=value, points=checked)


Number = Certified | Bounded
Slope = Certified | Bounded | Checked


@dataclass(frozen=True, kw_only=True)
class Derivative:
    """How the start value moves with one parameter.

    Attributes
    ----------
    parameter : Parameter
    left, right : Certified, Bounded or Checked, or None beyond the parameter's range
        One-sided derivatives: as the parameter comes from below, and as it goes up. Checked where
        the degree of a `Family` is not proven.
    elasticity : float or None
        None where there is no single derivative, or the value is 0.
    """

    parameter: Parameter
    left: Slope | None
    right: Slope | None
    elasticity: float | None

    @property
    def value(self) -> Slope | None:
        """The derivative; None where the two sides differ."""
        if self.left is None or self.right is None:
            return self.right if self.left is None else self.left
        return self.left if self.left == self.right else None

    @property
    def claim(self) -> Claim:
        """The weaker one of both sides' claims; certified where there is no side."""
        claims = {side.claim for side in (self.left, self.right) if side is not None}
        order = (Claim.ESTIMATED, Claim.BOUNDED)
        return next((claim for claim in order if claim in claims), Claim.CERTIFIED)


@dataclass(frozen=True, kw_only=True, eq=False)
class Gradient:
    """Derivatives of the start value by every parameter.

    Attributes
    ----------
    start_value : Certified or Bounded
    derivatives : {parameter name: Derivative}
    steps : {setting: (backward, forward)}
        Differences of the start value for whole-number settings such as max_trial: what the last
        unit adds, and what one more would.
    reoptimised : bool
        Whether the policy follows the parameter, or is held fixed.
    """

    start_value: Number
    derivatives: dict[str, Derivative]
    steps: dict[str, tuple[Number | None, Number]]
    reoptimised: bool

    def __getitem__(self, name: str) -> Derivative:
        return self.derivatives[name]

    def frame(self) -> DataFrame:
        """Return one row for each parameter, the largest elasticity first."""
        from pandas import DataFrame

        rows = [
            {
                "parameter": name,
                "value": float(each.parameter.value),
                "unit": unit_of(each.parameter),
                "derivative (reward per unit)": _float(each.value),
                "left": _float(each.left),
                "right": _float(each.right),
                "elasticity (% per %)": np.nan if each.elasticity is None else each.elasticity,
                "policy": "re-optimised" if self.reoptimised else "fixed",
                "claim": str(each.claim),
            }
            for name, each in self.derivatives.items()
        ]
        rows.sort(key=lambda row: -np.nan_to_num(abs(row["elasticity (% per %)"])))
        return DataFrame(rows)


def floating(number: Fraction | float) -> float:
    """Return a number as a float; an infinite one where it is beyond the range of floats.

    Examples
    --------
    >>> floating(Fraction(1, 4)), floating(Fraction(-(10**400)))
    (0.25, -inf)
    """
    try:
        return float(number)
    except OverflowError:
        return inf if number > 0 else -inf


def _float(number: Slope | None) -> float:
    return np.nan if number is None else floating(number.value)
