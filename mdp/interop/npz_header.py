"""The JSON header of a saved model: names, discount, start, meaning of the states, parameters.

See `mdp.interop.npz` for its keys. Rationals are written "p/q", so that nothing is rounded.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from mdp.errors import ModelError
from mdp.model import MDP
from mdp.parameters import Parameter
from mdp.space import Column, StateSpace
from mdp.table import exact

FORMAT, VERSION = "exact-mdp model", 1
LONGEST = 4000
"""Digits that the reader of rationals accepts."""


def as_header(mdp: MDP) -> dict[str, Any]:
    """Return the header of a model as what JSON can hold."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": mdp.name,
        "discount": _text(mdp.discount_exact),
        "start": [[int(state), _text(weight)] for state, weight in mdp.start],
        "actions": list(mdp.actions),
        "columns": [
            {"name": c.name, "size": int(c.size), "bits": int(c.bits), "words": list(c.words)}
            for c in mdp.space.columns
        ],
        "extra": list(mdp.space.extra),
        "component_names": list(mdp.component_names),
        "events": list(mdp.events),
        "parameters": [
            {
                "name": p.name,
                "value": _text(p.value),
                "low": None if p.low is None else _text(p.low),
                "high": None if p.high is None else _text(p.high),
            }
            for p in mdp.parameters
        ],
        "time_limit": mdp.time_limit,
    }


def parts_of(content: object, *, pairs: int) -> dict[str, Any]:
    """Return the constructor's arguments that a header states, for a model of L = `pairs` pairs."""
    header = _object(content, "header")
    if header.get("format") != FORMAT:
        raise ModelError(
            f"the format is {header.get('format')!r}",
            where="header",
            fix=f"give an archive of format {FORMAT!r}",
        )
    if header.get("version") != VERSION:
        raise ModelError(
            f"version {header.get('version')!r} of the format",
            where="header",
            fix=f"this release reads version {VERSION}; use the one that wrote the file",
        )
    space = StateSpace(
        columns=tuple(_column(entry) for entry in _list(header, "columns")),
        extra=_words(header, "extra"),
    )
    if space.size > pairs:
        raise ModelError(
            f"the columns make {space.size:.3g} states, there are {pairs} state-action pairs",
            where="header, columns",
            fix="every state has at least one pair; save the model again",
        )
    return {
        "space": space,
        "name": _word(header, "name"),
        "discount_exact": _rational(header.get("discount"), "discount"),
        "start": tuple(_weight(entry) for entry in _list(header, "start")),
        "actions": _words(header, "actions"),
        "component_names": _words(header, "component_names"),
        "events": _words(header, "events"),
        "parameters": tuple(_parameter(entry) for entry in _list(header, "parameters")),
        "time_limit": _time_limit(header),
    }


def _column(entry: object) -> Column:
    column = _object(entry, "columns")
    size, bits = _whole(column, "size"), _whole(column, "bits")
    words = _words(column, "words")
    fits = size > 0 and (not words or len(words) == size)
    if bits > 62 or not fits or (bits and size != 1 << bits):
        raise ModelError(
            f"a column of {size} values, {bits} bits and {len(words)} words",
            where="header, columns",
            fix="give one word for each value, or bits for 2^bits of them",
        )
    return Column(name=_word(column, "name"), size=size, bits=bits, words=words)


def _parameter(entry: object) -> Parameter:
    given = _object(entry, "parameters")
    name = _word(given, "name")
    low, high = (
        None if given.get(key) is None else _rational(given[key], name) for key in ("low", "high")
    )
    return Parameter(name=name, value=_rational(given.get("value"), name), low=low, high=high)


def _weight(entry: object) -> tuple[int, Fraction]:
    if not isinstance(entry, list) or len(entry) != 2 or type(entry[0]) is not int:
        raise _wrong("start", "[[state, probability], …]")
    return entry[0], _rational(entry[1], "start")


def _object(value: object, key: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise _wrong(key, "an object")
    return value


def _list(header: Mapping[str, Any], key: str) -> list[Any]:
    value = header.get(key)
    if not isinstance(value, list):
        raise _wrong(key, "a list")
    return value


def _words(header: Mapping[str, Any], key: str) -> tuple[str, ...]:
    values = _list(header, key)
    if not all(isinstance(value, str) for value in values):
        raise _wrong(key, "a list of texts")
    return tuple(values)


def _word(header: Mapping[str, Any], key: str) -> str:
    value = header.get(key)
    if not isinstance(value, str):
        raise _wrong(key, "a text")
    return value


def _whole(header: Mapping[str, Any], key: str) -> int:
    value = header.get(key)
    if type(value) is not int or value < 0:
        raise _wrong(key, "a whole number")
    return value


def _time_limit(header: Mapping[str, Any]) -> int | None:
    """Return the number of steps; None where there is none, and in files of before there were."""
    return None if header.get("time_limit") is None else _whole(header, "time_limit")


def _rational(value: object, key: str) -> Fraction:
    if not isinstance(value, str):
        raise _wrong(key, 'a text such as "1/3"')
    try:
        return exact(value)
    except ModelError as error:
        raise ModelError(error.what, where=f"header, {key}", fix=error.fix) from error


def _wrong(key: str, wanted: str) -> ModelError:
    return ModelError(f"{key} is not {wanted}", where=f"header, {key}", fix="save the model again")


def _text(number: Fraction) -> str:
    # Two bits a decimal digit are too few for any number of that length: a cheap bound first.
    bits = max(abs(number.numerator).bit_length(), number.denominator.bit_length())
    text = str(number) if bits < 4 * LONGEST else ""
    if not text or len(text) > LONGEST:
        raise ModelError(
            f"a rational of over {LONGEST:,} characters",
            where="header",
            fix="round that parameter, discount or start probability",
        )
    return text
