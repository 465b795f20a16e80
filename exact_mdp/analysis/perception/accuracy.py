"""How the value depends on the accuracy of perception.

With accuracy x a status is read rightly with probability x where it is present and where it is
absent, the statuses independently. Curves of a policy's value over a grid come from
`analysis.perception.values`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.perception.values import Passes
from exact_mdp.mdp.care.perception import status_names
from exact_mdp.mdp.errors import ModelError, listed, located, suggest
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, exact

if TYPE_CHECKING:
    from pandas import DataFrame


ALL = "all"


def confusion_at(model: MDP, accuracy: float, status: str = ALL) -> Floats:
    """Return the confusion (Z, Z) at one accuracy of a status, the others perfect, or of all."""
    if not 0 <= accuracy <= 1:
        raise ModelError(f"accuracy is {accuracy}", where="accuracy", fix="choose from 0 to 1")
    matrix = np.ones((1, 1))
    names = status_names(model)
    if status not in (*names, ALL):
        raise ModelError(
            f"unknown status {status!r}", where="accuracy", fix=suggest(status, [*names, ALL])
        )
    for name in names:
        x = accuracy if status in (name, ALL) else 1.0
        matrix = np.kron(matrix, np.array([[x, 1 - x], [1 - x, x]]))
    return matrix


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AccuracyCurves(Pictured):
    """Values of a policy on perceptions along accuracies, status by status and for all.

    Attributes
    ----------
    levels : (M,)
    values : {status, or "all": (M,)}
        The value where this status is perceived with the accuracy and the others perfectly.
    error : float
        No value is off by more than this.
    """

    levels: Floats
    values: dict[str, Floats]
    error: float

    def frame(self) -> DataFrame:
        """Return one row for each accuracy, one column for each status and for all."""
        import pandas

        return pandas.DataFrame({"accuracy": self.levels} | self.values)


def accuracy_curves(
    model: MDP,
    policy: PolicyLike = "optimal",
    *,
    levels: Iterable[float] | None = None,
    statuses: Sequence[str] | None = None,
) -> AccuracyCurves:
    """Return the value of a policy that takes what it perceives for true, along accuracies.

    Parameters
    ----------
    model : MDP
        With a column `status`.
    policy : PolicyLike
    levels : iterable of float, optional
        Accuracies; 51 from 0.5 to 1 unless given.
    statuses : sequence of str, optional
        The curves; one for each status and "all" unless given.

    Returns
    -------
    AccuracyCurves

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> found = accuracy_curves(Scenario.load("yuan2025").compile(), levels=[0.9, 1])
    >>> found.values["all"].round(4).tolist()
    [140.7766, 146.2359]
    """
    grid = np.linspace(0.5, 1.0, 51)
    if levels is not None:
        with located("levels"):
            grid = np.array([float(exact(level)) for level in listed(levels, "levels")])
    passes = Passes(model)
    table, curves = passes.table(policy), {}
    names = (*status_names(model), ALL)
    for name in names if statuses is None else listed(statuses, "statuses"):
        matrices = np.stack([confusion_at(model, x, name) for x in grid.tolist()])
        curves[name] = passes.worth(table, matrices)
    return AccuracyCurves(levels=grid, values=curves, error=passes.rounding)
