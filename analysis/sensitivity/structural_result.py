"""What comes out under each reading of a scenario's text, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from solvers.solution import Bounded

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """What comes out under one reading.

    Attributes
    ----------
    label : str
        What it changes.
    settings : mapping
        The same, as `Scenario.with_` takes it.
    states : int
    optimal : Bounded
        Start value with the policy re-optimised.
    sd : float
        Standard deviation of the optimal policy's return.
    actions : (V,)
        An optimal action in each status at subtask 0, trial 0.
    optimal_actions : (V, A) bool
        All of them, up to rounding.
    optimum_changes : bool
        No optimal policy of the model as it is is optimal here.
    changed : tuple of str
        Statuses in which no action is optimal both here and as it is, at subtask 0, trial 0.
    policies : {name: Bounded}
        Start values of policies held fixed.
    top : str
        The parameter of the tables whose elasticity is the largest in absolute value; empty where
        not asked for.
    elasticity : float
    stability : float
        Share of ± 20 % by which all parameters may move at once, at least, before the optimal
        policy can change; NaN where not asked for.
    """

    label: str
    settings: Mapping[str, object]
    states: int
    optimal: Bounded
    sd: float
    actions: tuple[str, ...]
    optimal_actions: NDArray[np.bool_]
    optimum_changes: bool
    changed: tuple[str, ...]
    policies: Mapping[str, Bounded]
    top: str
    elasticity: float
    stability: float

    def regret(self, name: str) -> Bounded:
        """Return what holding a policy costs; 0 where the errors leave open whether it does."""
        lost = self.optimal.value - self.policies[name].value
        error = self.optimal.error + self.policies[name].error
        return Bounded(value=lost if lost > error else 0.0, error=error)


@dataclass(frozen=True, kw_only=True, eq=False)
class Structural:
    """Outputs under every reading; the first one is the present one.

    Attributes
    ----------
    readings : tuple of Reading
    statuses : tuple of str
        Labels of the statuses, such as 0100.
    """

    readings: tuple[Reading, ...]
    statuses: tuple[str, ...]

    @property
    def present(self) -> Reading:
        """The reading that the scenario has."""
        return self.readings[0]

    def frame(self) -> DataFrame:
        """Return one row for each reading; values, sd and regrets in units of reward."""
        from pandas import DataFrame

        rows = []
        for each in self.readings:
            row: dict[str, Any] = {
                "reading": each.label,
                "states": each.states,
                "start value (reward)": each.optimal.value,
                "sd (reward)": each.sd,
                "optimum changes": each.optimum_changes,
                "changes at subtask 0, trial 0": " ".join(each.changed),
            }
            for name, value in each.policies.items():
                row[f"value of {name} (reward)"] = value.value
                row[f"regret of {name} (reward)"] = each.regret(name).value
            if each.top:
                row["top parameter"] = each.top
                row["its elasticity (% per %)"] = each.elasticity
            if not np.isnan(each.stability):
                row["stability radius (share of ± 20 %)"] = each.stability
            rows.append(row | dict(zip(self.statuses, each.actions, strict=True)))
        table = DataFrame(rows)
        table["claim"] = "bounded"
        table.attrs["present"] = {k: str(v) for k, v in self.present.settings.items()}
        table.attrs["units"] = "rewards of the scenario; probabilities and shares without unit"
        table.attrs["policy"] = "re-optimised under each reading; named policies held fixed"
        return table
