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

from dataclasses import replace
from typing import Any

from exact_mdp.mdp.components import REST, cancel_common_divisor, with_components
from exact_mdp.mdp.errors import ModelError, suggest_name
from exact_mdp.mdp.forms.names import find_free_name
from exact_mdp.mdp.questions.ending import find_labelled_states, is_expression, make_terminal
from exact_mdp.mdp.questions.origin import origin_of
from exact_mdp.mdp.questions.terminal_values import read_terminal_values, require_unpaid
from exact_mdp.mdp.table import multiply


def ask_until(model: Any, label: str) -> Any:
    """Return the model in which runs end in the labelled states.

    Raises ModelError if the label is unknown, or a labelled state has a terminal value.
    """
    target, goal, origin = find_labelled_states(model, label), None, origin_of(model)
    if origin is not None and origin.paid:
        space, unpaid = origin.model.space, origin.model.labels.get(label, [])
        if is_expression(label):
            unpaid = find_labelled_states(origin.model, label)
        for question in origin.questions:
            given = question.options.get("terminal_value")
            require_unpaid(read_terminal_values(given, space), unpaid, space)
    if model.discount_exact == 1:
        goal = target
    return make_terminal(model, target, goal=goal, target=target)


def ask_component(model: Any, name: str, *, others: bool = False) -> Any:
    """Return the model whose reward is one component; its origin has that reward, too.

    The others may stay, as amounts for limits. Raises ModelError if there is no such component.
    """
    names = model.component_names
    if name not in names:
        fix = suggest_name(name, names)
        raise ModelError(f"no reward component {name!r}", where="reward components", fix=fix)
    if (name,) == names and not model.table.parted_by_outcome:
        return model
    origin = origin_of(model)
    if origin is not None and name in origin.model.component_names:
        # Terminal values are a component of their own, so they do not count.
        unpaid = origin.without_terminal_value()
        asked = ask_component(origin.model, name, others=others)
        return replace(unpaid, model=asked).rebuild_model()
    number = names.index(name)
    table = model.table.with_component_reward(number)
    if not others:
        return replace(model, table=table, component_names=(name,))
    # All components as they are, and what the new reward is less than their sum.
    amounts, below = model.table.expected_components_exact()
    gain, bottom = model.table.expected_gain_exact
    less = multiply(amounts[:, number], bottom) - multiply(gain, below)
    rest = cancel_common_divisor(less, multiply(below, bottom), table)
    table = with_components(table, [*((column, below) for column in amounts.T), rest])
    names = (*names, find_free_name(REST, names))
    return replace(model, table=replace(table, averaged=True), component_names=names)
