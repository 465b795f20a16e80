"""Runs that end at a label, and steps that are certain: what the reductions share.

A pair is redirected if it leads surely to one state and earns 0; a state becomes terminal if its
pairs are redirected to itself.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, require_known_name
from exact_mdp.mdp.questions.expressions import find_states, is_expression, list_variables
from exact_mdp.mdp.table import Numbers, OutcomeTable
from exact_mdp.mdp.validate import Flags, Parts

REACHED = "reached"
ONE_COMPONENT = {"component_names": ("reward",)}
# A question changes the rows, so counts of the original rows no longer describe them.
NO_DATA: dict[str, Any] = {"observations": None, "episodes": None}
NO_GOAL: dict[str, Any] = {"goal": None, "target": None}


def describe_sense(model: Parts) -> str:
    """Return in words what the value of a model measures; "" for rewards to maximise."""
    if REACHED in model.space.extra:
        return f"{model.sense.best} probability of reaching"
    if model.sense.costs:
        return "costs to minimise"
    return ""


def ends_at_label(model: Parts) -> bool:
    """Return whether runs end at a label: the model is one of `until` or `reaching`."""
    return model.target is not None or REACHED in model.space.extra


def find_labelled_states(model: Parts, label: str) -> Flags:
    """Return the states (S,) of a label, or of an expression over labels and state variables.

    Raises ModelError if the label is unknown, if the expression cannot be read, and if the model
    already answers a question: its runs have been cut off.
    """
    if ends_at_label(model):
        raise ModelError(
            "this model already answers a question, and its runs end there",
            where=f"label {label!r}",
            fix="ask the model that it was made from, or give one label to the states of both "
            "questions",
        )
    named = isinstance(label, str) and label not in model.labels
    if named and (is_expression(label) or label in list_variables(model.space)):
        return find_states(model, label)
    if not model.labels:
        raise ModelError(
            f"unknown label {label!r}",
            where="labels",
            fix="the model has none: build it with labels={name: (S,) truth values}, or give an "
            "expression such as 'state=3'",
        )
    return model.labels[require_known_name(label, model.labels, "label", "labels")]


def redirect_pairs(table: OutcomeTable, ends: Flags, follows: Numbers) -> OutcomeTable:
    """Return a table in which the pairs in `ends` (L,) lead surely to `follows` (L,), earning 0.

    Both arrays may have one entry more, for a new pair at the end.
    """

    def append_certain_pair(name: str, values: Numbers) -> Numbers:
        return np.concatenate([values, fill_certain(name, values, 1)])

    # Append one certain outcome; every redirected pair then becomes a copy of it.
    ending = table.map_numbers(
        append_certain_pair,
        append_certain_pair,
        offsets=np.append(table.offsets, table.offsets[-1] + 1),
        next_states=np.append(table.next, table.next.dtype.type(0)),
    )
    ended = ending.of_pairs(np.where(ends, table.pairs, np.arange(len(ends))))
    # Each copy leads to a state of its own.
    lengths = np.diff(ended.offsets)
    moved = np.repeat(np.asarray(follows), lengths).astype(ended.next.dtype)
    following = np.where(np.repeat(ends, lengths), moved, ended.next)
    return replace(ended, rows=replace(ended.rows, next=following))


def make_terminal(model: Any, states: Flags, **changes: Any) -> Any:
    """Return the model with the given states (S,) made terminal, and with other changes."""
    table = redirect_pairs(model.table, states[model.pair_state], model.pair_state)
    return replace(model, table=table, **NO_DATA, **changes)


def fill_certain(name: str, values: Numbers, count: int) -> Numbers:
    """Return entries of the array `name` for `count` outcomes that are certain and earn 0."""
    one = name == "weight" or name.endswith("denominator")
    return np.full((count, *values.shape[1:]), int(one), dtype=values.dtype)
