"""The JSON header of a saved model: names, discount, start, meaning of the states, parameters.

See `mdp.io.npz` for its keys. Rationals are written "p/q", so that nothing is rounded.

Models saved as NumPy archives, without loss, and read by any program that reads `.npz`.

The arrays of an archive, nothing in it being a pickle:

    header        (B,) uint8     UTF-8 text of a JSON object, see below
    pair_state    (L,) int64     state of each state-action pair, sorted by state, then action
    pair_action   (L,) int64     its action
    offsets       (L+1,) int64   outcomes of pair l are offsets[l] … offsets[l+1]-1
    next          (N,) int32 or int64   next state of each outcome
    weight        (N,) integers or float64   probability of outcome i of pair l is
    denominator   (L,) integers              weight[i] / denominator[l]
    gain          (N,) or (L,) integers or float64   reward of an outcome, or of a pair, is
    gain_denominator (L,) integers                   gain[i] / gain_denominator[l]
    event         (N,) uint8     optional: bit b is set where event number b happens
    components    (L, C) float64 expected reward of each pair by component
    weight_doubt  (N,) float64   optional: how far each probability, and each reward, may lie from
    gain_doubt    (N,) or (L,) float64     what it was rounded from, where the arrays do not tell

and any other array of floats that a table of outcomes may have, under its name.

Integers are int64 where they fit. Where they do not, the array is uint8 of shape (…, k): each row
is one integer of k ≥ 8 bytes, little-endian, two's complement. The header has the keys `format`
("exact-mdp model"), `version` (1), `name`, `discount` ("p/q"), `start` ([[state, "p/q"], …]),
`actions`, `columns` ([{"name", "size", "bits", "words"}, …]: a state's number is that of its column
values in row-major order), `extra` (names of the states after those), `component_names`, `events`
`parameters` ([{"name", "value", "low", "high"}, …], low and high may be null) and `time_limit` (a
number of steps or null; older files lack it).

`np.load(path)["pair_state"]` and so on read the arrays, `json.loads` reads the bytes of the header.
"""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Mapping
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, shown_text
from exact_mdp.mdp.io.arrays import read_arrays
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable, exact

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


FIELDS: Mapping[str, tuple[str, ...]] = {
    "offsets": ("int64",),
    "next": ("int32", "int64"),
    "weight": ("int64", "float64", "uint8"),
    "denominator": ("int64", "uint8"),
    "gain": ("int64", "float64", "uint8"),
    "gain_denominator": ("int64", "uint8"),
    "event": ("uint8",),
}
"""Types that an array of the table may have; uint8 among several means rows of bytes."""

OPTIONAL = tuple(field.name for field in fields(OutcomeTable) if field.default is None)
"""Arrays that a table may lack. Those that are not above are floats."""

TABLE = {field.name: FIELDS.get(field.name, ("float64",)) for field in fields(OutcomeTable)}
KINDS: Mapping[str, tuple[str, ...]] = {
    "header": ("uint8",),
    "pair_state": ("int64",),
    "pair_action": ("int64",),
    **TABLE,
    "components": ("float64",),
}
WIDTH = 8


def save(mdp: MDP, path: str | Path) -> None:
    """Write a model to `path`, whole or not at all.

    Raises
    ------
    ModelError
        Where the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> mdp = MDP.from_outcomes([(0, 0, [("1/3", 0, "1/7"), ("2/3", 1, 0)]), (1, 0, [(1, 1, 0)])])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(mdp, f"{folder}/small.npz")
    ...     load(f"{folder}/small.npz").table.row(0)
    [(Fraction(1, 3), 0, Fraction(1, 7)), (Fraction(2, 3), 1, Fraction(0, 1))]
    """
    table = mdp.table
    text = json.dumps(as_header(mdp)).encode("ascii")
    arrays: dict[str, Numbers] = {
        "header": np.frombuffer(text, dtype=np.uint8),
        "pair_state": mdp.pair_state,
        "pair_action": mdp.pair_action,
        "components": mdp.components,
    }
    for name in TABLE:
        array = getattr(table, name)
        if array is not None:
            arrays[name] = _as_bytes(array)
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    write_atomically(path, stream.getvalue())


def load(path: str | Path) -> MDP:
    """Read a model that `save` wrote.

    Raises
    ------
    ModelError
        Where the file cannot be read, is damaged, claims more data than it holds, or does not
        hold a valid model.
    """
    where = str(path)
    try:
        arrays = read_arrays(path, names=_check_names, check=_check_array)
        parts = parts_of(_header(arrays["header"]), pairs=len(arrays["pair_state"]))
        table = OutcomeTable(
            **{name: _as_integers(arrays[name]) for name in TABLE if name in arrays}
        )
        state, action = arrays["pair_state"], arrays["pair_action"]
        return MDP(table, state, action, components=arrays["components"], **parts)
    except ModelError as error:
        if error.where.startswith(shown_text(where)):
            raise
        place = f"{where}, {error.where}" if error.where else where
        raise ModelError(error.what, where=place, fix=error.fix) from error


def _header(data: Numbers) -> object:
    try:
        return json.loads(data.tobytes().decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ModelError(
            f"broken JSON: {str(error)[:200]}", where="header", fix="save the model again"
        ) from error


def _check_names(names: Collection[str]) -> None:
    """Raise ModelError unless an archive holds the arrays of a model, by their names."""
    needed = {name for name in KINDS if name not in OPTIONAL}
    if not needed <= set(names) <= KINDS.keys():
        raise ModelError(
            f"the archive holds {', '.join(names)[:200] or 'nothing'}",
            fix="give a model that exact-mdp wrote; a Q-table is a policy, not a model",
        )


def _check_array(name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    """Raise ModelError unless an array has a type and a shape that the format allows."""
    kinds, kind = KINDS[name], str(dtype.newbyteorder("="))
    bytewise = kind == "uint8" and len(kinds) > 1
    dimensions = 2 if bytewise or name == "components" else 1
    if (
        kind not in kinds
        or len(shape) != dimensions
        or min(shape) < 1
        or (bytewise and shape[1] < WIDTH)
    ):
        raise ModelError(
            f"an array of type {dtype} and shape {shape}",
            where=name,
            fix=f"give {' or '.join(kinds)}, as the format says",
        )


def _as_bytes(array: Numbers) -> Numbers:
    """Return Python integers as rows of bytes; other arrays as they are."""
    if array.dtype != object:
        return array
    values = [int(value) for value in array]
    width = max([WIDTH, *(value.bit_length() // 8 + 1 for value in values)])
    data = b"".join(value.to_bytes(width, "little", signed=True) for value in values)
    return np.frombuffer(data, dtype=np.uint8).reshape(len(values), width)


def _as_integers(array: Numbers) -> Numbers:
    """Return rows of bytes as Python integers; other arrays as they are."""
    if array.dtype != np.uint8 or array.ndim == 1:
        return array
    values = [int.from_bytes(row.tobytes(), "little", signed=True) for row in array]
    wide = np.empty(len(values), dtype=object)
    wide[:] = values
    return wide
