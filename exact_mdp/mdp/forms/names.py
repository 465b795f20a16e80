"""Which state or action is meant: by the object that it is, by its name, or by its number.

The one rule, for states and actions, in constructors, policies, tables, files and commands:

    an object     is the state or action that was made of it (`MDP.from_function`), as 1 and 0 are
                  what was made of True and False; else the one whose name is the object's text,
                  as after a model is saved
    text          is a name, or else the printed form: state 7, or row 0, column 3
    a number      is a name where names are whole numbers; where none is, it counts from 0 in the
                  model's order. So are the digits of a text that is no name, and those of a state
                  in a file, where all is text
    an array      goes by the model's order

Numbers that are given together, as the keys of a dictionary, are read together. Where they fit both
readings, as names and in the model's order, and what they say differs, they are refused: of states
named 3, 1, 2, 0 a dictionary by 0 … 3 may be either. The printed form says which is meant.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from exact_mdp.mdp.errors import ModelError, no_such, suggest

NUMBER = re.compile(r"-?(0|[1-9]\d{0,17})(\.\d{1,18}|/[1-9]\d{0,17})?")
TRUTH = {"False": Fraction(0), "True": Fraction(1)}
SHOWN = 1000  # of names, where the nearest to a wrong one is looked for


ObjectKey = tuple[bool, Hashable]


class ByNumber(dict[Any, Any]):
    """What is said of things by their numbers in the model's order, which are no names."""


class Told(tuple[tuple[int, Any], ...]):
    """Pairs of a thing's number in the model's order and what is said of it, as a model tells."""

    __slots__ = ()


class Reading(NamedTuple):
    """What things may be; and the error to raise where this fits as well as the reading before."""

    numbers: list[int]
    error: ModelError | None = None


def text_of(thing: object) -> str:
    """Return the text of an object, in a tuple of NumPy's numbers that of plain ones.

    Examples
    --------
    >>> text_of((np.int64(3), "in")), text_of(np.float64(2))
    ("(3, 'in')", '2.0')
    """
    return str(_plain(thing) if type(thing) is tuple else thing)


def _plain(thing: Any) -> Any:
    if type(thing) is tuple:
        return tuple(map(_plain, thing))
    return thing.item() if isinstance(thing, np.generic) else thing


def object_key(thing: Any) -> ObjectKey:
    """Return the key of an object among others: that of True is not that of 1."""
    return (isinstance(thing, bool | np.bool_), thing)


def labels_of(index: Any, parts: Sequence[str]) -> list[Any]:
    """Return the labels of an index of pandas, its levels in the order of the parts that they name.

    Levels without names are in that order; so are all where the parts have no names.
    """
    named = {*index.names} - {None}
    if index.nlevels < 2 or not named or not parts:
        return list(index)
    if {*index.names} != {*parts} or index.nlevels != len(parts):
        raise ModelError(
            f"the levels of the index are {', '.join(map(str, index.names))}",
            where="index",
            fix=f"name them {', '.join(parts)}, in any order, or leave out all names",
        )
    return list(index.reorder_levels(list(parts)))


def parts_of(objects: Sequence[object]) -> tuple[str, ...]:
    """Return what the fields of tuples are called that are all named, and of one kind."""
    kinds = {getattr(thing, "_fields", ()) for thing in objects if isinstance(thing, tuple)}
    return kinds.pop() if len(kinds) == 1 else ()


def value_of(thing: object) -> Fraction | None:
    """Return the value of a number, None of anything else."""
    if isinstance(thing, bool) or not isinstance(thing, int | float | Fraction | np.number):
        return None
    plain: Any = thing.item() if isinstance(thing, np.number) else thing
    finite = isinstance(plain, int | Fraction) or (isinstance(plain, float) and isfinite(plain))
    return Fraction(plain) if finite else None


def amount_of(thing: object) -> Fraction | None:
    """Return the value of a number, also that of True, which is 1; None of anything else."""
    return Fraction(int(thing)) if isinstance(thing, bool | np.bool_) else value_of(thing)


@dataclass(frozen=True, kw_only=True)
class Names:
    """The names of `size` things, the objects that some are, and what else names one.

    Examples
    --------
    >>> names = Names(what="state", size=3, words={"2": 0, "7": 1, "0": 2}, label="{}".format)
    >>> names.numbers([7, "2"]), names.number("0")
    ([1, 0], 2)
    >>> [reading.numbers for reading in names.readings([0, 2])]
    [[2, 0], [0, 2]]
    """

    what: str
    size: int
    words: Mapping[str, int]
    label: Callable[[int], str]
    objects: Mapping[ObjectKey, int] = field(default_factory=dict)
    otherwise: Callable[[object], int | None] = lambda thing: None

    def number(self, thing: object) -> int:
        """Return the number of one thing; raises ModelError where it is none, or may be two."""
        return self.numbers([thing])[0]

    def numbers(self, things: object) -> list[int]:
        """Return the numbers of things; raises ModelError where there are two readings."""
        found = self.readings(things)
        if found[-1].error:
            raise found[-1].error
        return found[0].numbers

    def readings(self, things: object) -> list[Reading]:
        """Return the one or two readings of things that are given together, or of one alone."""
        given = [things]
        if isinstance(things, Iterable) and not isinstance(things, str):
            given = list(things)
        certain = [self._certain(thing) for thing in given]
        loose = [place for place, number in enumerate(certain) if number is None]
        named, counted = list(certain), list(certain)
        for place in loose:
            named[place] = self._named(given[place])
            counted[place] = self._counted(value_of(given[place]))
            if named[place] is None and (self.numbered or counted[place] is None):
                raise self._unknown(given[place])
        chosen = [x if y is None else y for x, y in zip(counted, named, strict=True)]
        found = [number for number in chosen if number is not None]
        if chosen == counted or None in counted:
            return [Reading(found)]
        place = next(k for k in loose if chosen[k] != counted[k])
        other = [number for number in counted if number is not None]
        return [
            Reading(found),
            Reading(other, self.either(given[place], found[place], other[place])),
        ]

    @cached_property
    def numbered(self) -> bool:
        """Whether whole numbers are names or objects, so that they count nothing."""
        values = {*self._of_value, *(amount_of(thing) for _, thing in self.objects)} - {None}
        return any(value.denominator == 1 for value in values if value is not None)

    @cached_property
    def _of_value(self) -> dict[Fraction, int]:
        """The names that are numbers, and True and False, which equal numbers."""
        values = {word: Fraction(word) for word in self.words if NUMBER.fullmatch(word)}
        values |= {word: value for word, value in TRUTH.items() if word in self.words}
        pairs = [(values[word], number) for word, number in self.words.items() if word in values]
        return dict(reversed(pairs))

    def _named(self, number: object) -> int | None:
        """Return what a number is the name of."""
        value = value_of(number)
        return self.words.get(text_of(number), None if value is None else self._of_value.get(value))

    def _counted(self, value: Fraction | None) -> int | None:
        """Return the thing that a whole number counts to."""
        whole = value is not None and value.denominator == 1 and 0 <= value < self.size
        return int(value) if whole and value is not None else None

    def knows(self, thing: object) -> bool:
        """Return whether something other than a number is an object, or has the text of a name."""
        try:
            made = self._made(thing)
        except TypeError:
            return False
        return made is not None or text_of(thing) in self.words

    def _made(self, thing: Any) -> int | None:
        """Return what was made of an object, or of what equals it; raises TypeError for no key."""
        made = self.objects.get(object_key(thing))
        return self.objects.get((True, thing)) if made is None else made

    def _certain(self, thing: object) -> int | None:
        """Return what an object or a text is; None for a number, which has to be read."""
        try:
            made = self._made(thing)
        except TypeError:  # no key
            raise self._unknown(thing) from None
        if value_of(thing) is not None:
            return made
        text = text_of(thing)
        word = text.strip() if isinstance(thing, str) and text not in self.words else text
        fits = {made, self.words.get(word)} - {None} or {self.otherwise(thing)} - {None}
        digits = isinstance(thing, str) and word.isascii() and word.isdigit() and len(word) < 19
        if not fits and digits and not self.numbered:
            fits = {self._counted(Fraction(word))} - {None}
        known = sorted(number for number in fits if number is not None)
        if not known:
            raise self._unknown(thing)
        if len(known) > 1:
            raise self.either(thing, known[0], known[1])
        return known[0]

    def _unknown(self, thing: object) -> ModelError:
        digits = isinstance(thing, str) and thing.strip().isdigit()
        value = value_of(thing)
        if (digits or (value and value.denominator == 1)) and not self.numbered:
            return no_such(self.what, thing, self.size)
        known = [*self.words] or [self.label(number) for number in range(min(self.size, SHOWN))]
        said = f"unknown {self.what} {thing!r}"
        if not isinstance(thing, str):
            said = f"{thing!r} is not a{'n' * (self.what[0] in 'aeio')} {self.what}"
        return ModelError(said, fix=suggest(str(thing), known))

    def either(self, thing: object, first: int, second: int) -> ModelError:
        """Return the error to raise where a thing may be two."""
        one, two, shown = self.label(first), self.label(second), repr(_plain(thing))
        return ModelError(
            f"{shown} may be {one}, by its name, or {two}, number {second} in the model's order, "
            "which differ",
            fix=f'write "{one}" or "{two}", or give an array in the model\'s order',
        )
