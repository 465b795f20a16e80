"""Derivatives of the start value by the parameters, as they are told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.sensitivity.units import unit_of
from mdp.parameters import Parameter
from solvers.solution import Bounded, Certified

if TYPE_CHECKING:
    from pandas import DataFrame

Number = Certified | Bounded


@dataclass(frozen=True, kw_only=True)
class Derivative:
    """How the start value moves with one parameter.

    Attributes
    ----------
    parameter : Parameter
    left, right : Certified or Bounded, or None beyond the parameter's range
        One-sided derivatives: as the parameter comes from below, and as it goes up.
    elasticity : float or None
        None where there is no single derivative, or the value is 0.
    """

    parameter: Parameter
    left: Number | None
    right: Number | None
    elasticity: float | None

    @property
    def value(self) -> Number | None:
        """The derivative; None where the two sides differ."""
        if self.left is None or self.right is None:
            return self.right if self.left is None else self.left
        return self.left if self.left == self.right else None


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
                "claim": str(self.start_value.claim),
            }
            for name, each in self.derivatives.items()
        ]
        rows.sort(key=lambda row: -np.nan_to_num(abs(row["elasticity (% per %)"])))
        return DataFrame(rows)


def _float(number: Number | None) -> float:
    return np.nan if number is None else float(number.value)
