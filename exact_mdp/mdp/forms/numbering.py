"""Numbers and names for states and actions that are given as objects.

Things are numbered in the order in which they first occur. If they are the whole numbers 0 … n-1,
perhaps beside one text such as "end", which comes last, each is its own number, also as a NumPy
integer, float or fraction; False and True count as 0 and 1, as in Python. Text stays text, also
"0". A state without actions is an end: it stays put with reward 0; or it earns a given reward once,
and leads to an additional state.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.forms.names import find_free_name, integer_of, name_things, text_of
from exact_mdp.mdp.space import Column, StateSpace


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
        counted, others = list[Any](), list[Any]()
        for thing in whole:
            (counted if isinstance(thing, int | np.bool_) else others).append(thing)
        from_0 = {*counted} == {*range(len(counted))}
        if others and not (from_0 and len(others) == 1 and isinstance(others[0], str)):
            return things
        if from_0:
            whole = [*sorted(counted), *others]
            self.number = {thing: number for number, thing in enumerate(whole)}
        return whole


def _is_whole(thing: Any) -> bool:
    return not isinstance(thing, str) and integer_of(thing) is not None


def _count_from_zero(things: Sequence[Any]) -> bool:
    """Return whether things are the whole numbers 0 … n-1, which need no names."""
    return all(map(_is_whole, things)) and [*things] == [*range(len(things))]


@dataclass(frozen=True, eq=False)
class OutcomeColumns:
    """Pairs in numbers, in the order given, and all their outcomes."""

    state: list[int] = field(default_factory=list)  # (L,)
    action: list[int] = field(default_factory=list)  # (L,)
    length: list[int] = field(default_factory=list)  # (L,) the number of outcomes
    chance: list[Any] = field(default_factory=list)  # (N,)
    following: list[int] = field(default_factory=list)  # (N,)
    gain: list[Any] = field(default_factory=list)  # (N,)

    def add_pair(self, state: int, action: int, outcomes: Iterable[tuple[Any, int, Any]]) -> None:
        """Add a pair with its outcomes: probability, next state, reward."""
        listed = [*outcomes]
        columns = self.chance, self.following, self.gain
        # By columns, as to append each number alone takes twice as long.
        for column, own in zip(columns, zip(*listed, strict=True), strict=bool(listed)):
            column.extend(own)
        self.state.append(state)
        self.action.append(action)
        self.length.append(len(listed))


def name_columns(
    columns: OutcomeColumns,
    states: Numbering,
    actions: Numbering,
    ends: Iterable[Hashable] | None = None,
    paid: Mapping[Hashable, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return the names of states and actions; change their numbers in `columns`, and add the ends.

    Numbers change if things are whole numbers. `ends` are the states without actions: by default
    those without a pair. Those in `paid` {end: reward} earn the reward once and lead to an
    additional state.
    """
    found = list(states.number), list(actions.number)
    if ends is None:
        acting = {*columns.state}
        ends = [thing for thing, number in states.number.items() if number not in acting]
    things, doing = states.list_in_order(), actions.list_in_order() or ["stay"]
    parts = (states, columns.state), (states, columns.following), (actions, columns.action)
    for (numbering, numbers), before in zip(parts, (found[0], *found), strict=True):
        place = [numbering.number[thing] for thing in before]
        numbers[:] = [place[old] for old in numbers]
    # Ends stay put, or earn their reward and lead to the additional state, which has number S.
    number, last = states.number, len(things)
    for end in ends:
        outcome = (1, number[end], 0)
        if end in paid:
            outcome = (1, last, paid[end])
        columns.add_pair(number[end], 0, [outcome])
    if paid:
        columns.add_pair(last, 0, [(1, last, 0)])
    # Its name must differ from the names of all other states.
    extra: tuple[str, ...] = ()
    if paid:
        extra = (find_free_name("end", [*map(text_of, things)]),)
    column = Column(name="state", size=len(things))
    if not _count_from_zero(things):
        column = replace(column, words=name_things(things, "state"), objects=tuple(things))
    space = StateSpace(columns=(column,), extra=extra)
    return {"space": space, **action_names(doing)}


def action_names(things: Sequence[Any]) -> dict[str, Any]:
    """Return the parts of `MDP` for actions given as things: `actions` and `action_objects`."""
    objects: tuple[Any, ...] = ()
    if not _count_from_zero(things):
        objects = tuple(things)
    return {"actions": name_things(things, "action"), "action_objects": objects}
