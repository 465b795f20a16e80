"""The expected reward until a set of states T is reached: the reward if T is absorbing.

    V(s) = 0 in T,    V(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V(s')  elsewhere

At discount 1 a run that never reaches T has the value +∞, as PRISM and Storm define R[F T]: T is
the goal of the model (Baier and Katoen, Principles of Model Checking, MIT Press 2008, section 10.6;
https://www.prismmodelchecker.org/manual/PropertySpecification/Reward-basedProperties). Below
discount 1 such a run has a finite value, and T is only the target. If one component of the reward
counts, the model is first reduced to the model that earns this component alone.

The way back: states and pairs keep their numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from exact_mdp.mdp.components import REST, cancel_common_divisor, with_components
from exact_mdp.mdp.errors import ModelError, suggest_name
from exact_mdp.mdp.forms.names import find_free_name
from exact_mdp.mdp.questions.ending import find_labelled_states, is_expression, make_terminal
from exact_mdp.mdp.questions.origin import origin_of
from exact_mdp.mdp.questions.terminal_values import read_terminal_values, require_unpaid
from exact_mdp.mdp.table import multiply


@dataclass(frozen=True)
class Until:
    """What a run earns until it reaches a labelled state."""

    label: str

    def require_applicable(self, model: Any) -> None:
        """Raise ModelError if the label is unknown, or a labelled state has a terminal value."""
        find_labelled_states(model, self.label)
        origin = origin_of(model)
        if origin is None or not origin.paid:
            return
        space, goal = origin.model.space, origin.model.labels.get(self.label, [])
        if is_expression(self.label):
            goal = find_labelled_states(origin.model, self.label)
        for question in origin.questions:
            given = question.options.get("terminal_value")
            require_unpaid(read_terminal_values(given, space), goal, space)

    def apply(self, model: Any) -> Any:
        """Return the model in which runs end in the labelled states."""
        target, goal = find_labelled_states(model, self.label), None
        if model.discount_exact == 1:
            goal = target
        return make_terminal(model, target, goal=goal, target=target)


@dataclass(frozen=True)
class Component:
    """The component of the reward that counts alone; others may stay, as amounts for limits."""

    name: str
    others: bool = False

    def require_applicable(self, model: Any) -> None:
        """Raise ModelError if the model has no such component."""
        if self.name not in model.component_names:
            fix = suggest_name(self.name, model.component_names)
            raise ModelError(
                f"no reward component {self.name!r}", where="reward components", fix=fix
            )

    def apply(self, model: Any) -> Any:
        """Return the model whose reward is the component; its origin has that reward, too."""
        if (self.name,) == model.component_names and not model.table.parted_by_outcome:
            return model
        origin = origin_of(model)
        if origin is not None and self.name in origin.model.component_names:
            # Terminal values are a component of their own, so they do not count.
            unpaid = origin.without_terminal_value()
            return replace(unpaid, model=self.apply(origin.model)).rebuild_model()
        names, number = model.component_names, model.component_names.index(self.name)
        table = model.table.with_component_reward(number)
        if not self.others:
            return replace(model, table=table, component_names=(self.name,))
        # All components as they are, and what the new reward is less than their sum.
        amounts, below = model.table.expected_components_exact()
        gain, bottom = model.table.expected_gain_exact
        less = multiply(amounts[:, number], bottom) - multiply(gain, below)
        rest = cancel_common_divisor(less, multiply(below, bottom), table)
        table = with_components(table, [*((column, below) for column in amounts.T), rest])
        names = (*names, find_free_name(REST, names))
        return replace(model, table=replace(table, averaged=True), component_names=names)
