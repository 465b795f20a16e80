"""What the values of an analysis are: totals, or average rewards per step."""

from __future__ import annotations

from exact_mdp.mdp.report import Shown
from exact_mdp.solvers.arguments import is_average


class OfCriterion:
    """Base class of results whose values are total or average rewards."""

    criterion: str

    @property
    def measure(self) -> str:
        """What the values are, in words."""
        if is_average(self.criterion):
            return "average reward"
        return "value"

    @property
    def criterion_facts(self) -> dict[str, Shown]:
        """The facts of a report that say so; none for a total."""
        if is_average(self.criterion):
            return {"criterion": Shown(self.criterion, "average reward per step")}
        return {}
