"""TOML, JSON and CSV from outside: read within limits, and against the shape that they must have.

An integer of over 4,000 digits, tables nested more than 100 deep and what the syntax does not allow
are refused here: Python converts no integer of over 4,300 digits to text, and ends a recursion
after about a thousand calls.
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

from exact_mdp.mdp.errors import ModelError, locate_errors, once_each, shorten_text
from exact_mdp.mdp.table import MOST_DIGITS, exact

DEEPEST = 100  # tables and lists within each other; the deepest file that is read has five
TOO_LARGE = 10**MOST_DIGITS
SAFE = 2**53  # from here on not all programs read integers as they are
NUMBER = re.compile(r"-?(0x[0-9a-f]+|[0-9]+)(/(0x[0-9a-f]+|[0-9]+))?")
WORDS = {dict: "an object", list: "a list", str: "a text", bool: "true or false"}


def toml_of(text: str, where: str, *, number: Callable[[str], Any] = exact) -> dict[str, Any]:
    r"""Return the content of a TOML text from the file `where`; decimal numbers are rationals."""
    content: dict[str, Any] = _parse_text(
        partial(tomllib.loads, parse_float=number), text, "TOML", where
    )
    return content


def json_of(text: str | bytes, where: str, **hooks: Any) -> Any:
    """Return the content of a JSON text, each key once; `hooks` are those of `json.loads`."""
    read = partial(json.loads, object_pairs_hook=once_each, **hooks)
    return _parse_text(read, text, "JSON", where)


def _parse_text(read: Callable[[Any], Any], text: str | bytes, kind: str, where: str) -> Any:
    try:
        with locate_errors(where, instead=True):
            content = read(text)
        _check_limits(content, DEEPEST)
    except ModelError:
        raise
    except RecursionError as error:
        what = f"tables or lists are nested more than {DEEPEST} deep"
        raise ModelError(what, where=where, fix="use fewer levels") from error
    except ValueError as error:
        said = "string conversion" in str(error)
        what = (
            f"an integer of over {MOST_DIGITS:,} digits" if said else shorten_text(str(error), 200)
        )
        fix = "correct that place"
        if (where, kind) == ("-", "JSON"):
            fix = "standard input (-) takes JSON, such as a model.json: name other files instead"
        raise ModelError(f"broken {kind}: {what}", where=where, fix=fix) from error
    return content


def _check_limits(content: Any, levels: int) -> None:
    """Raise RecursionError beyond so many levels, ValueError for a number of too many digits."""
    if isinstance(content, dict | list):
        if not levels:
            raise RecursionError
        for each in content.values() if isinstance(content, dict) else content:
            _check_limits(each, levels - 1)
    elif isinstance(content, int) and abs(content) >= TOO_LARGE:
        raise ValueError("string conversion")


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


def require_shape(given: Any, kind: Any) -> Any:
    """Return JSON as `kind` describes it; raises ModelError at the place that differs.

    A kind is a type; a function of the value; [kind], a list of these; (kind, …), a list of that
    length; {str: kind}, an object with any keys; or {key: kind, …}, one with these keys, of which
    one that is missing is read as null, and others are passed over. Lists become tuples.
    """
    if isinstance(kind, type):
        return given if type(given) is kind else refuse_value(given, WORDS[kind])
    if callable(kind):
        return kind(given)
    if isinstance(kind, dict):
        if type(given) is not dict:
            refuse_value(given, WORDS[dict])
        kinds = dict.fromkeys(given, kind[str]) if str in kind else kind
        return {key: _require_shape_at(key, given.get(key), each) for key, each in kinds.items()}
    if type(given) is not list or (isinstance(kind, tuple) and len(given) != len(kind)):
        refuse_value(given, f"a list of {len(kind)}" if isinstance(kind, tuple) else WORDS[list])
    listed = kind if isinstance(kind, tuple) else kind * len(given)
    return tuple(map(_require_shape_at, range(len(given)), given, listed))


def _require_shape_at(place: str | int, given: Any, kind: Any) -> Any:
    try:
        return require_shape(given, kind)
    except ModelError as error:
        where = f"{place}, {error.where}" if error.where else str(place)
        raise ModelError(error.what, where=where, fix=error.fix) from error


def has_format(given: Any, name: str, version: int) -> bool:
    """Return whether an object is of a format and a version, which 2.0 or true do not say."""
    head = [given.get("format"), given.get("version")] if isinstance(given, dict) else []
    return head == [name, version] and type(head[1]) is int


def or_null(kind: Any) -> Callable[[Any], Any]:
    """Return the kind of what may be null, too."""
    return lambda given: None if given is None else require_shape(given, kind)


def refuse_value(given: object, wanted: str) -> NoReturn:
    """Raise ModelError for a value that is not what is wanted."""
    raise ModelError(f"{shorten_text(repr(given), 80)} is not {wanted}", fix="correct it")


def parse_rational(given: Any) -> Fraction:
    """Read a rational number as `encode_rationals` writes it."""
    if type(given) is int:
        return Fraction(given)
    if isinstance(given, str) and NUMBER.fullmatch(given):
        top, _, below = given.partition("/")
        try:
            return Fraction(int(top, 0), int(below or "1", 0))
        except (ValueError, ZeroDivisionError):  # 007, 1/0, or digits beyond Python's limit
            pass
    refuse_value(given, 'an integer, or a text such as "1/3" or "0x1f"')


def parse_natural(given: Any) -> int:
    """Read a number of a state, an action or the like."""
    if type(given) is int and 0 <= given < 2**62:
        return given
    refuse_value(given, "a whole number from 0 up, below 2^62")


def parse_unreached(given: Any) -> float:
    """Read what a run is worth that never reaches the goal."""
    known = {"inf": inf, "-inf": -inf}
    return known[given] if given in [*known] else refuse_value(given, '"inf" or "-inf"')


def encode_rationals(value: Any) -> Any:
    """Return a value for JSON: rationals as integers or texts, tuples as lists."""
    if isinstance(value, dict):
        return {key: encode_rationals(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return list(map(encode_rationals, value))
    if not isinstance(value, Fraction):
        return value
    top, below = value.numerator, value.denominator
    if below == 1:
        return encode_integer(top)
    return f"{top}/{below}" if max(abs(top), below) < SAFE else f"{hex(top)}/{hex(below)}"


def encode_integer(value: int) -> int | str:
    """Return an integer for JSON: as a text where not all programs would read it as it is."""
    return value if -SAFE < value < SAFE else hex(value)
