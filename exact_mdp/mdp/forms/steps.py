"""Models whose rows and rewards depend on the time: one model for each step, of the same states.

The states are pairs of a time and a state, as in `within`, which is the case of equal steps: the
rows of step t lead from time t to time t + 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any, Self

from exact_mdp.mdp.build import FromArrays
from exact_mdp.mdp.errors import ModelError, require_list
from exact_mdp.mdp.questions.horizon import TimeLayers
from exact_mdp.mdp.questions.origin import origin_of
from exact_mdp.mdp.space import TIME

SAME = {
    "actions": "actions",
    "discount_exact": "discount",
    "sense": "sense",
    "component_names": "components",
    "events": "events",
    "space": "states",
}
"""The parts that the models of all steps have in common, with a word for each."""


class FromSteps(FromArrays):
    """Models of several steps, each with its own rows and rewards."""

    @classmethod
    def from_steps(cls, models: Iterable[Self]) -> Self:
        """Build an episode of N steps from N models of the same states: rows that depend on time.

        Parameters
        ----------
        models : iterable of N MDP
            The rows, rewards and labels of steps 0 … N-1. States, actions, discount, sense and
            components must be the same. The first has the start.

        Returns
        -------
        MDP
            With the states of `within(N)`: a policy may be an array (N, S) of actions.

        Raises
        ------
        ModelError
            Without models, for a model that differs from the first, and for a model that answers a
            question: ask it of the result.

        Examples
        --------
        >>> from exact_mdp import MDP, certify
        >>> risks = ["1/10", "2/10", "3/10"]
        >>> years = [
        ...     MDP.from_arrays([[[f"{10 - int(risk[0])}/10", risk], [0, 1]]], [1, 0])
        ...     for risk in risks
        ... ]
        >>> certify(MDP.from_steps(years)).start_value  # 1 + 9/10 + 9/10 · 8/10
        Fraction(131, 50)
        """
        listed = require_list(models, "models, one for each step")
        _require_same_states(listed)
        runs = [(same[0], len(same)) for same in (list(group) for _, group in groupby(listed, id))]
        layers = TimeLayers(runs)
        model: Self = layers.build_model(layers.join_tables())
        return model


def _require_same_states(models: Sequence[Any]) -> None:
    """Raise ModelError unless models can be the steps of one episode."""
    if not models:
        fix = "give a list of MDP, one for each step"
        raise ModelError("there is no model", where="models", fix=fix)
    first = models[0]
    for step, model in enumerate(models):
        where = f"models[{step}]"
        if not isinstance(model, FromSteps):
            raise ModelError(
                f"{type(model).__name__} is not an MDP", where=where, fix="give an MDP"
            )
        if origin_of(model) is not None or model.goal is not None or TIME in model.space.names:
            fix = "ask the question of the model that from_steps returns"
            raise ModelError("the model answers a question already", where=where, fix=fix)
        differ = [name for name in SAME if getattr(model, name) != getattr(first, name)]
        if model.labels.keys() != first.labels.keys():
            differ.append("labels")
        if differ:
            what = f"the model differs from the first in its {SAME.get(differ[0], 'labels')}"
            raise ModelError(what, where=where, fix="build all steps alike")
