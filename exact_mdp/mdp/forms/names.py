"""How to refer to a state or an action: by object, name or number.

The same rule holds for states and actions in constructors, policies, tables, files and commands:

    an object    is the state or action made from it (`MDP.from_function`) or from an equal object;
                 else the one whose name is the object's text, as after a model is saved
    text         is a name; else the printed form, such as "state 7" or "row 0, column 3"; else
                 digits, if no name is a whole number
    a number     counts from 0 in the model's order. If names are whole numbers, it is the state or
                 action of that name, and refused if it could also count another one
    an array     follows the model's order. An array of a policy is refused if names are whole
                 numbers with a gap and it has a row for each of these numbers

For example, if the states are named 3, 1, 2, 0, the text "3" is the first state, and the number 3
is refused.

Things of which a model is made are numbered in the order in which they first occur. If they are the
whole numbers 0 … n-1, perhaps beside one text such as "end", which comes last, each is its own
number, also as a NumPy integer, float or fraction; False and True count as 0 and 1, as in Python.
Text stays text, also "0".
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Container, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, no_such, suggest_name

# Names that look like whole numbers. Up to 18 digits, they fit in 64 bits.
WHOLE = re.compile(r"-?\d{1,18}(\.0)?|True|False")


class ByNumber(tuple[tuple[int, Any], ...]):
    """Pairs (state number, probability), as in the `start` of a model."""

    __slots__ = ()


def text_of(thing: object) -> str:
    """Return the text of an object; NumPy numbers in a tuple are written as Python numbers."""
    if type(thing) is tuple:
        thing = _to_python_objects(thing)
    return str(thing)


def _to_python_objects(thing: Any) -> Any:
    """Return a NumPy number, also inside tuples, as a Python number; other objects as they are."""
    if type(thing) is tuple:
        return tuple(map(_to_python_objects, thing))
    if isinstance(thing, np.generic):
        return thing.item()
    return thing


def name_things(things: Sequence[Any], what: str) -> tuple[str, ...]:
    """Return a name for each thing: its text, or its `repr` if two things have the same text."""
    for form in (text_of, repr):
        names = tuple(map(form, things))
        if len(set(names)) == len(names):
            return names
    twice = Counter(names).most_common(1)[0][0]
    raise ModelError(
        f"two {what}s are both called {twice}", where=f"{what}s", fix="give them different names"
    )


def find_free_name(name: str, taken: Container[str]) -> str:
    """Return a name, with as many "'" as make it differ from the names that are taken."""
    while name in taken:
        name += "'"
    return name


def is_number(thing: object) -> bool:
    """Return whether a thing is a finite number; True and False are not."""
    number = isinstance(thing, int | float | Fraction | np.number) and not isinstance(thing, bool)
    return number and (not isinstance(thing, float | np.floating) or isfinite(thing))


def integer_of(thing: Any) -> int | None:
    """Return a whole number, or a text of at most 18 digits, as an int; else None."""
    if is_number(thing):
        if thing == int(thing):
            return int(thing)
        return None
    if isinstance(thing, str):
        text = thing.strip()
        if text.isascii() and text.isdigit() and len(text) <= 18:
            return int(text)
    return None


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


def count_from_zero(things: Sequence[Any]) -> bool:
    """Return whether things are the whole numbers 0 … n-1, which need no names."""
    return all(map(_is_whole, things)) and [*things] == [*range(len(things))]


def action_names(things: Sequence[Any]) -> dict[str, Any]:
    """Return the parts of `MDP` for actions given as things: `actions` and `action_objects`."""
    objects: tuple[Any, ...] = ()
    if not count_from_zero(things):
        objects = tuple(things)
    return {"actions": name_things(things, "action"), "action_objects": objects}


@dataclass(frozen=True, kw_only=True)
class Names:
    """The ways to refer to `size` things: `words`, `objects`, and the function `otherwise`.

    `what` is "state", "action" or the name of a column; `label` prints a number.
    """

    what: str
    size: int
    words: Mapping[str, int]
    label: Callable[[int], str]
    objects: Mapping[Hashable, int] = field(default_factory=dict)
    otherwise: Callable[[Any], int | None] | None = None

    def find_number(self, thing: object) -> int:
        """Return the number of a thing; raise ModelError if it is unknown or ambiguous."""
        try:
            made = self.objects.get(thing)
        except TypeError:  # it cannot be a key
            raise self._unknown_error(thing) from None
        # The candidates: by object (made), by name (named), by position (place).
        text, whole = text_of(thing), integer_of(thing)
        place = None
        if whole is not None and 0 <= whole < self.size:
            place = whole
        short = text
        if isinstance(thing, str):
            short = text.strip()
        elif is_number(thing):
            short = str(whole)
        named = self.words.get(text, self.words.get(short))
        if is_number(thing):
            # An object comes first. A number that is a name may also be meant as a position.
            fits = {made} - {None}
            if not fits and named is not None:
                fits = {named, place}
        else:
            fits = {made, named} - {None}
            if not fits and self.otherwise:
                fits = {self.otherwise(thing)}
        # Positions count only if whole numbers are not names.
        if not fits - {None} and not self.numbered:
            fits = {place}
        known = [number for number in fits if number is not None]
        if not known:
            raise self._unknown_error(thing)
        if len(known) > 1:
            first, second = sorted(known, key=lambda n: (n == place, n))
            one, two = self.label(first), self.label(second)
            raise ModelError(
                f"{_to_python_objects(thing)!r} may be {one}, by its name, "
                f"or {two}, number {second} in the model's order, and the two differ",
                fix=f'write "{one}" or "{two}"',
            )
        return known[0]

    def find_numbers(self, things: Any) -> list[int]:
        """Return the numbers of several things, or of a single one."""
        if isinstance(things, str) or not isinstance(things, Iterable):
            things = [things]
        return [self.find_number(thing) for thing in things]

    @cached_property
    def numbered(self) -> bool:
        """Whether some names or objects are whole numbers, so numbers are not positions."""
        return any(WHOLE.fullmatch(text_of(thing)) for thing in (*self.words, *self.objects))

    def has_name(self, thing: object) -> bool:
        """Return whether a thing is one of the objects, or has the text of a name."""
        try:
            return thing in self.objects or text_of(thing) in self.words
        except TypeError:
            return False

    def can_find(self, thing: object) -> bool:
        """Return whether `find_number` finds the thing."""
        try:
            return self.find_number(thing) >= 0
        except ModelError:
            return False

    def _unknown_error(self, thing: object) -> ModelError:
        """Return the error for a thing that is not found, with advice."""
        if isinstance(thing, str):
            digits = thing.strip().isdigit()
        else:
            digits = integer_of(thing) is not None
        # A number was a position outside the range.
        if digits and not self.numbered:
            return no_such(self.what, thing, self.size)
        # Among many labels, the search for a similar one stops after a thousand: it takes long.
        known = [*self.words] or [self.label(number) for number in range(min(self.size, 1000))]
        if isinstance(thing, str):
            said = f"unknown {self.what} {thing!r}"
        elif self.what[0] in "aeio":
            said = f"{thing!r} is not an {self.what}"
        else:
            said = f"{thing!r} is not a {self.what}"
        return ModelError(said, fix=suggest_name(str(thing), known))
