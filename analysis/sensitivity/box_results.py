"""What is found of a policy, and of the best policy, over a box of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Literal

import numpy as np

from mdp.table import Floats
from solvers.solution import Bounded, Certified

if TYPE_CHECKING:
    from pandas import DataFrame

Side = Literal["worst", "best"]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxExtreme:
    """The least, or the greatest, value of a policy over a box.

    Attributes
    ----------
    side : "worst" or "best"
    low, high : float
        The extreme lies between them.
    point : {name: Fraction}
        Where `reached` is attained.
    reached : Fraction
        The policy's exact value there: the extreme itself where `proven`.
    proven : bool
        Every sign was proven, so that `point` is the exact extreme.
    signs : {name: "rising", "falling", "none" or "open"}
        How the value moves with each parameter, as far as proven: throughout the part of the box
        that is left once the ends proven before it are fixed.
    parts : int
        Boxes that were bounded.
    """

    side: Side
    low: float
    high: float
    point: Mapping[str, Fraction]
    reached: Fraction
    proven: bool
    signs: Mapping[str, str]
    parts: int

    @property
    def value(self) -> Certified | Bounded:
        """The extreme, exact where that is proven, else the middle of its bounds."""
        if self.proven:
            return Certified(value=self.reached)
        middle = (self.low + self.high) / 2
        half = max(self.high - middle, middle - self.low)
        return Bounded(value=middle, error=float(np.nextafter(half, np.inf)))

    @property
    def gap(self) -> float:
        """Distance of the bounds; 0 where the extreme is exact."""
        return 0.0 if self.proven else self.high - self.low

    def frame(self) -> DataFrame:
        """Return where each parameter is at the extreme, and what is proven of its direction."""
        from pandas import DataFrame

        return DataFrame(
            [
                {"parameter": name, "at": float(at), "value moves": self.signs[name]}
                for name, at in self.point.items()
            ]
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxOptimum:
    """What the best policy can be sure of over a box: max_π min_θ V^π(θ).

    Attributes
    ----------
    low, high : float
        It lies between them.
    policy : (L,)
        Probabilities of pairs of the candidate with the best worst case.
    worst : BoxExtreme
        That candidate's worst case.
    candidates : {name: BoxExtreme}
    saddle : bool
        Some point's exact optimum is the candidate's exact worst case: no policy does better.
    """

    low: float
    high: float
    policy: Floats
    worst: BoxExtreme
    candidates: Mapping[str, BoxExtreme]
    saddle: bool

    @property
    def gap(self) -> float:
        """Distance of the bounds."""
        return 0.0 if self.saddle else self.high - self.low

    def frame(self) -> DataFrame:
        """Return each candidate's worst case (reward)."""
        from pandas import DataFrame

        return DataFrame(
            [
                {
                    "policy": name,
                    "worst case from (reward)": found.low,
                    "to (reward)": found.high,
                    "claim": found.value.claim,
                }
                for name, found in self.candidates.items()
            ]
        )
