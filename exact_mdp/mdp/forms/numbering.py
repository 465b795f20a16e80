"""Numbers and names for states and actions that are given as objects.

Things are numbered in the order in which they first occur. If they are the whole numbers 0 … n-1,
each is its own number, also as a NumPy integer, float or fraction; False and True count as 0 and 1,
as in Python. Text stays text, also "0". A state without actions is an end: it stays put with
reward 0; or it earns a given reward once, and leads to an additional state.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.forms.names import integer_of, name_things, text_of
from exact_mdp.mdp.space import Column, StateSpace

Row = tuple[Hashable, Hashable, Sequence[tuple[Any, Hashable, Any]]]
"""State, action and outcomes: probability, next state, reward."""


class Numbering:
    """Numbers for things, in the order in which they first occur."""

    def __init__(self) -> None:
        self.number: dict[Hashable, int] = {}

    def add_thing(self, thing: Any, what: str, where: str) -> int:
        """Return the number of a thing, a new one if needed; ModelError if it is not hashable."""
        try:
            return self.number.setdefault(thing, len(self.number))
        except TypeError as error:
            raise ModelError(
                f"{what} is {thing!r}, which cannot be a key",
                where=where,
                fix="use numbers, words or tuples, not lists, arrays or dictionaries",
            ) from error

    def list_in_order(self) -> list[Any]:
        """Return the things in the order of their numbers; 0 … n-1 are renumbered as themselves."""
        things: list[Any] = list(self.number)
        whole = []
        for thing in things:
            if _is_whole(thing):
                thing = int(thing)
            whole.append(thing)
        if not all(isinstance(thing, int | np.bool_) for thing in whole):
            return things
        if {*whole} == {*range(len(whole))}:
            whole.sort()
            self.number = {thing: number for number, thing in enumerate(whole)}
        return whole


def _is_whole(thing: Any) -> bool:
    return not isinstance(thing, str) and integer_of(thing) is not None


def _count_from_zero(things: Sequence[Any]) -> bool:
    """Return whether things are the whole numbers 0 … n-1, which need no names."""
    return all(map(_is_whole, things)) and [*things] == [*range(len(things))]


def number_rows(
    rows: Iterable[Row],
    states: Numbering,
    ends: Iterable[Hashable],
    paid: Mapping[Hashable, Any] = MappingProxyType({}),
) -> tuple[list[Any], dict[str, Any]]:
    """Return rows for `MDP.from_outcomes`, with numbers for things, and the names of the things.

    `ends` are the states without actions. Those in `paid` {end: reward} earn the reward once and
    lead to an additional state.
    """
    # Number all states and actions as they occur.
    actions, listed = Numbering(), list(rows)
    for state, action, outcomes in listed:
        actions.add_thing(action, "an action", f"state {state}")
        states.add_thing(state, "a state", "rows")
        for _, following, _ in outcomes:
            states.add_thing(following, "a next state", f"state {state}, action {action}")
    things, doing = states.list_in_order(), actions.list_in_order() or ["stay"]
    number, act = states.number, actions.number
    # Write the rows in numbers.
    chosen: list[Any] = []
    for state, action, outcomes in listed:
        numbered = [(p, number[then], r) for p, then, r in outcomes]
        chosen.append((number[state], act[action], numbered))
    # Ends stay put, or earn their reward and lead to the additional state, which has number S.
    last = len(things)
    for end in ends:
        outcome = (1, number[end], 0)
        if end in paid:
            outcome = (1, last, paid[end])
        chosen.append((number[end], 0, [outcome]))
    if paid:
        chosen.append((last, 0, [(1, last, 0)]))
    # Its name must differ from the names of all other states.
    name = "end"
    while name in map(text_of, things):
        name += "'"
    extra: tuple[str, ...] = ()
    if paid:
        extra = (name,)
    column = Column(name="state", size=len(things))
    if not _count_from_zero(things):
        column = replace(column, words=name_things(things, "state"), objects=tuple(things))
    space = StateSpace(columns=(column,), extra=extra)
    return chosen, {"space": space, **action_names(doing)}


def action_names(things: Sequence[Any]) -> dict[str, Any]:
    """Return the parts of `MDP` for actions given as things: `actions` and `action_objects`."""
    objects: tuple[Any, ...] = ()
    if not _count_from_zero(things):
        objects = tuple(things)
    return {"actions": name_things(things, "action"), "action_objects": objects}
