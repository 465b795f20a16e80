"""TOML, JSON and CSV from outside: read within limits, and against the shape that they must have.

A number of over 4,000 digits, tables nested more than 100 deep and what the syntax does not allow
are refused here, by name, so that nothing behind the door meets them: Python converts no integer of
over 4,300 digits to text, and ends a recursion after about a thousand calls.
"""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from functools import partial
from math import inf
from typing import Any, NoReturn

from exact_mdp.mdp.errors import ModelError, located, once_each, short
from exact_mdp.mdp.table import MOST_DIGITS, exact

DEEPEST = 100  # tables and lists within each other; the deepest file that is read has five
TOO_LARGE = 10**MOST_DIGITS
SAFE = 2**53  # from here on not all programs read integers as they are
NUMBER = re.compile(r"-?(0x[0-9a-f]+|[0-9]+)(/(0x[0-9a-f]+|[0-9]+))?")
WORDS = {dict: "an object", list: "a list", str: "a text", bool: "true or false"}


def toml_of(text: str, where: str, *, number: Callable[[str], Any] = exact) -> dict[str, Any]:
    r"""Return the content of a TOML text; `where` is the file, `number` reads decimal numbers."""
    content: dict[str, Any] = _parsed(
        partial(tomllib.loads, parse_float=number), text, "TOML", where
    )
    return content


def json_of(text: str | bytes, where: str, **hooks: Any) -> Any:
    """Return the content of a JSON text, each key once; `hooks` are those of `json.loads`."""
    read = partial(json.loads, object_pairs_hook=once_each, **hooks)
    return _parsed(read, text, "JSON", where)


def _parsed(read: Callable[[Any], Any], text: str | bytes, kind: str, where: str) -> Any:
    """Return what a text says; what is too deep or too long is refused without a recursion."""
    try:
        with located(where, instead=True):
            content = read(text)
    except ModelError:
        raise
    except RecursionError as error:
        raise _too_deep(where) from error
    except ValueError as error:
        said = f"an integer of over {MOST_DIGITS:,} digits"
        what = said if "string conversion" in str(error) else short(str(error), 200)
        raise ModelError(f"broken {kind}: {what}", where=where, fix="correct that place") from error
    left: list[tuple[tuple[str, ...], Any]] = [((where,), content)]
    while left:
        path, value = left.pop()
        if len(path) > DEEPEST:
            raise _too_deep(f"{where}, {'.'.join(path[1:])}")
        if isinstance(value, dict):
            left += [((*path, str(key)), below) for key, below in value.items()]
        elif isinstance(value, list):
            left += [((*path, str(place)), below) for place, below in enumerate(value)]
        elif isinstance(value, int) and abs(value) >= TOO_LARGE:
            raise ModelError(
                f"an integer of over {MOST_DIGITS:,} digits",
                where=", ".join(filter(None, [where, ".".join(path[1:])])),
                fix="round it",
            )
    return content


def _too_deep(where: str) -> ModelError:
    return ModelError(
        f"tables or lists are nested more than {DEEPEST} deep", where=where, fix="use fewer levels"
    )


def csv_of(
    lines: Iterable[str], where: str = "", *, fix: str = "correct the line"
) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a CSV text that are not blank, each with its line; the header is the first.

    Raises ModelError, with a `fix`, where a row has not as many values as the header.
    """
    reader, line, width = csv.reader(lines, strict=True), 0, 0
    begin = f"{where}, " if where else ""
    try:
        for row in reader:
            if row:
                width = width or len(row)
                if len(row) != width:
                    what = f"{len(row)} values under {width} headings"
                    raise ModelError(what, where=f"{begin}line {line + 1}", fix=fix)
                yield line + 1, row
            line = reader.line_num
    except csv.Error as error:
        place = f"{begin}line {reader.line_num}"
        raise ModelError(f"broken CSV: {error}", where=place, fix="correct that line") from error


# ---- the shape that JSON must have ---------------------------------------------------------------


def shaped(given: Any, kind: Any) -> Any:
    """Return JSON as `kind` describes it; raises ModelError at the place that differs.

    A kind is a type; a function of the value; [kind], a list of these; (kind, …), a list of that
    length; {str: kind}, an object with any keys; or {key: kind, …}, one with these keys, of which
    one that is missing is read as null, and others are passed over. Lists become tuples.
    """
    if isinstance(kind, type):
        return given if type(given) is kind else refuse(given, WORDS[kind])
    if callable(kind):
        return kind(given)
    outer: Any = dict if isinstance(kind, dict) else list
    places: Any
    values: Any
    if type(given) is not outer:
        refuse(given, WORDS[outer])
    if isinstance(kind, tuple) and len(given) != len(kind):
        refuse(given, f"a list of {len(kind)}")
    if outer is list:
        places, values = range(len(given)), given
        kinds = kind if isinstance(kind, tuple) else kind * len(given)
    else:
        places = given if str in kind else kind
        values = [given.get(place) for place in places]
        kinds = [kind[str if str in kind else place] for place in places]
    read = []
    for place, value, each in zip(places, values, kinds, strict=True):
        try:
            read.append(shaped(value, each))
        except ModelError as error:
            where = f"{place}, {error.where}" if error.where else str(place)
            raise ModelError(error.what, where=where, fix=error.fix) from error
    return tuple(read) if outer is list else dict(zip(places, read, strict=True))


def optional(kind: Any) -> Callable[[Any], Any]:
    """Return the kind of what may be null, too."""
    return lambda given: None if given is None else shaped(given, kind)


def refuse(given: object, wanted: str) -> NoReturn:
    """Raise ModelError for a value that is not what is wanted."""
    raise ModelError(f"{short(repr(given), 80)} is not {wanted}", fix="correct it")


def number(given: Any) -> Fraction:
    """Read a rational number as `ready` writes it."""
    if type(given) is int:
        return Fraction(given)
    if isinstance(given, str) and NUMBER.fullmatch(given):
        top, _, below = given.partition("/")
        try:
            return Fraction(int(top, 0), int(below or "1", 0))
        except (ValueError, ZeroDivisionError):  # 007, 1/0, or digits beyond Python's limit
            pass
    refuse(given, 'an integer, or a text such as "1/3" or "0x1f"')


def natural(given: Any) -> int:
    """Read a number of a state, an action or the like."""
    if type(given) is int and 0 <= given < 2**62:
        return given
    refuse(given, "a whole number from 0 up, below 2^62")


def unreached(given: Any) -> float:
    """Read what a run is worth that never reaches the goal."""
    known = {"inf": inf, "-inf": -inf}
    return known[given] if given in [*known] else refuse(given, '"inf" or "-inf"')


def ready(value: Any) -> Any:
    """Return a value for JSON: rationals as integers or texts, tuples as lists."""
    if isinstance(value, dict):
        return {key: ready(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return list(map(ready, value))
    if not isinstance(value, Fraction):
        return value
    top, below = value.numerator, value.denominator
    if below == 1:
        return integer(top)
    return f"{top}/{below}" if max(abs(top), below) < SAFE else f"{hex(top)}/{hex(below)}"


def integer(value: int) -> int | str:
    """Return an integer for JSON: as a text where not all programs would read it as it is."""
    return value if -SAFE < value < SAFE else hex(value)
