"""What a probabilistic analysis asks of a model: optima and policies' values at many draws.

A care scenario goes through the batched loops (`analysis.sensitivity.care_draws`); any other
parametric model is built, solved and evaluated draw by draw (`analysis.sensitivity.model_draws`).
Both answer with the same arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from analysis.sensitivity.base_case import BaseCase
from analysis.sensitivity.care_draws import CareSolver
from analysis.sensitivity.model_draws import ModelSolver
from mdp.parametric import Parametric
from mdp.scenario_family import ScenarioFamily
from mdp.table import Floats, Integers
from solvers.care_layout import MOST_ACTIONS, MOST_STATUSES
from solvers.pieces import Arrays


class DrawSolver(Protocol):
    """What a probabilistic analysis asks of a model.

    Attributes
    ----------
    base : BaseCase
        The model at today's values, whose pairs policies are told of.
    block, pool : int
        Draws in one piece of work, and draws of largest regret in which policies are compared to
        choose candidates.
    compiled : bool
    labels, actions : tuples of X and A words
        Where choices are told of, and between what.
    """

    base: BaseCase
    block: int
    pool: int
    compiled: bool
    labels: tuple[str, ...]
    actions: tuple[str, ...]

    def solved(self, names: Sequence[str], draws: Floats) -> Arrays:
        """Return the optima of (D, Q) draws.

        start, error (D,); best (X, A), draws in which an action is optimal up to rounding; lost
        (D, A), what each first action costs, NaN where it is not offered, (D, 0) where there is
        more than one first state; rows (U, G), the policies found, and which (D,) of them is a
        draw's; cut (D,), whether a chance was cut off at 1, of compiled solvers alone.
        """

    def values(self, names: Sequence[str], draws: Floats, policies: Sequence[Floats]) -> Arrays:
        """Return value (D, N) and error (D, N) of N policies, each (L,) probabilities of pairs."""

    def weights(self, row: Integers) -> Floats:
        """Return (L,) probabilities of pairs from a row of `solved`."""

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """Return the action at each label, where the policy says one and the same there."""


def solver_of(model: Parametric) -> DrawSolver:
    """Return the fastest way to solve a model at many draws."""
    if isinstance(model, ScenarioFamily):
        scenario = model.scenario
        if len(scenario.statuses) <= MOST_STATUSES and len(scenario.actions) <= MOST_ACTIONS:
            return CareSolver(model)
    return ModelSolver(model)
