"""Which state or action is meant: by the object that it is, by its name, or by its number.

The one rule, for states and actions, in constructors, policies, tables, files and commands:

    an object    is the state or action that was made of it (`MDP.from_function`), or of what equals
                 it; else the one whose name is the object's text, as after a model is saved
    text         is a name, or else the printed form: state 7, or row 0, column 3; or else digits,
                 where no name is a whole number
    a number     counts from 0 in the model's order, unless names are whole numbers: then it is the
                 one of that name, and refused where it may be the number of another
    an array     goes by the model's order; of a policy, it is refused if names are whole numbers
                 with a gap, and it has a row for each of these numbers

So of states named 3, 1, 2, 0 the text "3" is the first, and the number 3 is refused.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, no_such, suggest_name

WHOLE = re.compile(r"-?\d{1,18}(\.0)?|True|False")
SHOWN = 1000  # of names, where the nearest to a wrong one is looked for
DIGITS = 18  # of a number at most


class ByNumber(tuple[tuple[int, Any], ...]):
    """Pairs of a state's number in the model's order and its probability, as a model says them."""

    __slots__ = ()


def text_of(thing: object) -> str:
    """Return the text of an object, in a tuple of NumPy's numbers that of plain ones."""
    return str(_to_python_objects(thing) if type(thing) is tuple else thing)


def _to_python_objects(thing: Any) -> Any:
    if type(thing) is tuple:
        return tuple(map(_to_python_objects, thing))
    return thing.item() if isinstance(thing, np.generic) else thing


def name_things(things: Sequence[Any], what: str) -> tuple[str, ...]:
    """Return a name for each thing: its text, or its `repr` where two things have the same text."""
    for form in (text_of, repr):
        names = tuple(map(form, things))
        if len(set(names)) == len(names):
            return names
    twice = Counter(names).most_common(1)[0][0]
    raise ModelError(
        f"two {what}s are both called {twice}", where=f"{what}s", fix="give them different names"
    )


def is_number(thing: object) -> bool:
    """Return whether a thing is a finite number; True and False are none."""
    number = isinstance(thing, int | float | Fraction | np.number) and not isinstance(thing, bool)
    return number and (not isinstance(thing, float | np.floating) or isfinite(thing))


def integer_of(thing: Any) -> int | None:
    """Return the whole number that a number is, or that the digits of a text are."""
    if is_number(thing):
        return int(thing) if thing == int(thing) else None
    text = thing.strip() if isinstance(thing, str) else ""
    return int(text) if text.isascii() and text.isdigit() and len(text) <= DIGITS else None


@dataclass(frozen=True, kw_only=True)
class Names:
    """The names of `size` things, the objects that some are, and what else names one."""

    what: str
    size: int
    words: Mapping[str, int]
    label: Callable[[int], str]
    objects: Mapping[Hashable, int] = field(default_factory=dict)
    otherwise: Callable[[Any], int | None] | None = None

    def find_number(self, thing: object) -> int:
        """Return the number of one thing; raises ModelError where it is none, or may be two."""
        try:
            made = self.objects.get(thing)
        except TypeError:  # no key
            raise self._unknown_error(thing) from None
        text, whole = text_of(thing), integer_of(thing)
        place = whole if whole is not None and 0 <= whole < self.size else None
        short = text.strip() if isinstance(thing, str) else str(whole if is_number(thing) else text)
        named = self.words.get(text, self.words.get(short))
        if is_number(thing):
            fits = {made} - {None} or (set() if named is None else {named, place})
        else:
            fits = {made, named} - {None} or {self.otherwise and self.otherwise(thing)}
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
                f"or {two}, number {second} in the "
                "model's order, which differ",
                fix=f'write "{one}" or "{two}"',
            )
        return known[0]

    def find_numbers(self, things: Any) -> list[int]:
        """Return the numbers of some things, or of one alone."""
        many = isinstance(things, Iterable) and not isinstance(things, str)
        return [self.find_number(thing) for thing in (things if many else [things])]

    @cached_property
    def numbered(self) -> bool:
        """Whether whole numbers are names or objects, so that they count nothing."""
        return any(WHOLE.fullmatch(text_of(thing)) for thing in (*self.words, *self.objects))

    def has_name(self, thing: object) -> bool:
        """Return whether something other than a number is an object, or has the text of a name."""
        try:
            return thing in self.objects or text_of(thing) in self.words
        except TypeError:
            return False

    def can_find(self, thing: object) -> bool:
        """Return whether something is one of these, given in any way."""
        try:
            return self.find_number(thing) >= 0
        except ModelError:
            return False

    def _unknown_error(self, thing: object) -> ModelError:
        digits = (
            thing.strip().isdigit() if isinstance(thing, str) else integer_of(thing) is not None
        )
        if digits and not self.numbered:
            return no_such(self.what, thing, self.size)
        known = [*self.words] or [self.label(number) for number in range(min(self.size, SHOWN))]
        said = f"unknown {self.what} {thing!r}"
        if not isinstance(thing, str):
            said = f"{thing!r} is not a{'n' * (self.what[0] in 'aeio')} {self.what}"
        return ModelError(said, fix=suggest_name(str(thing), known))
