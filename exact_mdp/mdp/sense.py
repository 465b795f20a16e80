"""Rewards that are maximised, or costs that are minimised: one reduction, and the way back.

    min over policies of c(π)  =  -max over policies of -c(π)

Solvers and proofs know rewards that are maximised. A model of costs is answered by its negation
(`MDP.maximised`, `solvers.solution.answer_maximised`), and everything that depends on the direction
is decided here (Puterman, Markov Decision Processes, 1994, section 2.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from math import inf
from typing import Any

import numpy as np

from exact_mdp.mdp.table import Floats


class Sense(StrEnum):
    """Whether the numbers of a model are rewards to maximise or costs to minimise."""

    MAX = "max"
    MIN = "min"

    @property
    def costs(self) -> bool:
        """Whether the least value is the best."""
        return self is Sense.MIN

    @property
    def sign(self) -> int:
        """1 for rewards, -1 for costs: the factor that makes them rewards."""
        if self.costs:
            return -1
        return 1

    @property
    def opposite(self) -> Sense:
        """The sense of the negated numbers."""
        if self.costs:
            return Sense.MAX
        return Sense.MIN

    @property
    def amount(self) -> str:
        """The word for one number: "reward" or "cost"."""
        if self.costs:
            return "cost"
        return "reward"

    @property
    def best(self) -> str:
        """The word for the best value: "greatest" or "least"."""
        if self.costs:
            return "least"
        return "greatest"

    @property
    def worst(self) -> float:
        """The value that is worse than every finite one: -∞, or +∞ for costs."""
        return -self.sign * inf

    @classmethod
    def of_options(cls, names: Mapping[str, Any]) -> Sense:
        """Return the sense among the options of a constructor; a wrong one is refused later."""
        if names.get("sense") == cls.MIN:
            return cls.MIN
        return cls.MAX

    def orient(self, numbers: Any) -> Any:
        """Return numbers as rewards to maximise, or such rewards in this sense; without a -0.0."""
        return 0 + self.sign * numbers

    def orient_interval(self, low: float, high: float) -> tuple[float, float]:
        """Return the ends of a range of numbers as a range of rewards to maximise, or back."""
        if self.costs:
            return -high, -low
        return low, high

    def best_of(self, numbers: Iterable[Any]) -> Any:
        """Return the best one of some numbers."""
        if self.costs:
            return min(numbers)
        return max(numbers)

    def loss(self, best: Any, own: Any) -> Any:
        """Return how much worse `own` is than `best`."""
        if self.costs:
            return own - best
        return best - own

    def losses(self, best: Floats, own: Floats) -> Floats:
        """Return the losses of values that may be infinite; equal infinite values lose nothing."""
        with np.errstate(invalid="ignore"):
            return np.where(best == own, 0.0, self.loss(best, own))
