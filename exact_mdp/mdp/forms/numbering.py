"""Numbers for states and actions that are given as objects, and the names that these go by.

Things are numbered in the order in which they come; whole numbers 0 … n-1 keep themselves, also as
NumPy's integers, floats and fractions, and so do False and True, which Python counts as 0 and 1.
Text is kept as what it is, "0" too. A state without actions is an end: it stays put and earns
nothing; or it earns a stated number once, and leads to one that is added for it.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.forms.names import integer_of, name_things, text_of
from exact_mdp.mdp.space import Column, StateSpace

Row = tuple[Hashable, Hashable, Sequence[tuple[Any, Hashable, Any]]]
"""State, action and outcomes: probability, next state, reward."""


class Numbering:
    """Numbers for things, in the order in which they come."""

    def __init__(self) -> None:
        self.number: dict[Hashable, int] = {}

    def add_thing(self, thing: Any, what: str, where: str) -> int:
        """Return the number of a thing, a new one where it is new; raise ModelError for others."""
        try:
            return self.number.setdefault(thing, len(self.number))
        except TypeError as error:
            raise ModelError(
                f"{what} is {thing!r}, which cannot be a key",
                where=where,
                fix="use numbers, words or tuples, not lists, arrays or dictionaries",
            ) from error

    def list_in_order(self) -> list[Any]:
        """Return the things by number; whole numbers from 0 on are their own."""
        things: list[Any] = list(self.number)
        whole = [int(thing) if _is_whole(thing) else thing for thing in things]
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
    """Return rows of numbers for `MDP.from_outcomes`, and the names of states and actions.

    The ends that are `paid` earn a number once and lead to another one, which is added for them.
    """
    actions, listed = Numbering(), list(rows)
    for state, action, outcomes in listed:
        actions.add_thing(action, "an action", f"state {state}")
        states.add_thing(state, "a state", "rows")
        for _, following, _ in outcomes:
            states.add_thing(following, "a next state", f"state {state}, action {action}")
    things, doing = states.list_in_order(), actions.list_in_order() or ["stay"]
    number, act = states.number, actions.number
    chosen: list[Any] = [
        (number[state], act[action], [(p, number[then], r) for p, then, r in outcomes])
        for state, action, outcomes in listed
    ]
    last = len(things)
    for end in ends:
        after = (1, last, paid[end]) if end in paid else (1, number[end], 0)
        chosen.append((number[end], 0, [after]))
    extra = "end"
    while extra in map(text_of, things):
        extra += "'"
    if paid:
        chosen.append((last, 0, [(1, last, 0)]))
    plain = _count_from_zero(things)
    column = Column(
        name="state",
        size=len(things),
        words=() if plain else name_things(things, "state"),
        objects=() if plain else tuple(things),
    )
    space = StateSpace(columns=(column,), extra=(extra,) if paid else ())
    return chosen, {"space": space, **action_names(doing)}


def action_names(things: Sequence[Any]) -> dict[str, Any]:
    """Return what `MDP` takes of things that are its actions: their names, and the things."""
    return {
        "actions": name_things(things, "action"),
        "action_objects": () if _count_from_zero(things) else tuple(things),
    }
