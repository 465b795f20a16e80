"""Exploration and learning rates that change from epoch to epoch.

The authors' decaying exploration is ε(t) = ε_min + (ε_max - ε_min) exp(-λ t), t counting epochs
from 0, with λ such that ε = 0.8 at t = 300:  λ = ln((ε_max - ε_min) / (0.8 - ε_min)) / 300
(Yuan et al. 2025, Equation 2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, log
from typing import Any, TypeAlias

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats, float_of

Schedule: TypeAlias = Any  # `values(epochs)` are (E,) numbers, starting with epoch t = 0


@dataclass(frozen=True)
class Constant:
    """The same number throughout.

    Examples
    --------
    >>> Constant(0.1).values(2).tolist()
    [0.1, 0.1]
    """

    value: float

    def values(self, epochs: int) -> Floats:
        """Return (E,) numbers."""
        return np.full(epochs, float(self.value))


@dataclass(frozen=True, kw_only=True)
class Exponential:
    """minimum + (maximum - minimum) exp(-decay t).

    Examples
    --------
    >>> schedule = Exponential.through(0.8, at=300, minimum=0.03)
    >>> round(schedule.decay, 8), round(float(schedule.values(301)[300]), 12)
    (0.00076969, 0.8)
    """

    minimum: float = 0.0
    maximum: float = 1.0
    decay: float

    @classmethod
    def through(
        cls, value: float, *, at: float, minimum: float = 0.0, maximum: float = 1.0
    ) -> Exponential:
        """Return the schedule that has fallen to `value` at epoch `at`.

        Parameters
        ----------
        value : float
            Between `minimum` and `maximum`.
        at : float
            The epoch, above 0, at which the schedule has that value.
        minimum, maximum : float, optional
            The limit of the schedule, and its value at epoch 0.

        Returns
        -------
        Exponential

        Raises
        ------
        ModelError
            If no decay passes through that value.

        Examples
        --------
        >>> schedule = Exponential.through(0.8, at=300, minimum=0.03)
        >>> round(float(schedule.values(301)[300]), 6)
        0.8
        """
        if not (minimum < value < maximum and at > 0):
            raise ModelError(
                f"no decay from {maximum:g} to {minimum:g} passes through {value:g} at {at:g}",
                where="schedule",
                fix="choose a value between the two, and a positive epoch",
            )
        decay = log((maximum - minimum) / (value - minimum)) / at
        return cls(minimum=minimum, maximum=maximum, decay=decay)

    def values(self, epochs: int) -> Floats:
        """Return (E,) numbers."""
        # math.exp, not NumPy's, whose last bit depends on the processor.
        fall = [exp(-self.decay * epoch) for epoch in range(epochs)]
        return self.minimum + (self.maximum - self.minimum) * np.array(fall)


PAPER_CONSTANT = Constant(0.1)
PAPER_DECAYING = Exponential.through(0.8, at=300, minimum=0.03)


def as_schedule(name: str, given: Any, epochs: int) -> Schedule:
    """Return a schedule; a number is a constant one. Raise ModelError if values leave [0, 1]."""
    known = callable(getattr(given, "values", None)) and not isinstance(given, Mapping)
    if known:
        schedule = given
    else:
        schedule = Constant(float_of(given, "schedule"))
    values = np.asarray(schedule.values(epochs), dtype=np.float64)
    if values.shape != (epochs,) or not ((values >= 0) & (values <= 1)).all():
        raise ModelError(
            f"{name} does not stay between 0 and 1",
            where=f"{schedule!r}",
            fix="choose numbers from 0 to 1, one for each epoch",
        )
    return schedule
