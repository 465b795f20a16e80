"""Models saved as NumPy archives, without loss, and read by any program that reads `.npz`.

The arrays of an archive, nothing in it being a pickle:

    header        (B,) uint8     UTF-8 text of a JSON object, see below
    pair_state    (L,) int64     state of each state-action pair, sorted by state, then action
    pair_action   (L,) int64     its action
    offsets       (L+1,) int64   outcomes of pair l are offsets[l] … offsets[l+1]-1
    next          (N,) int32 or int64   next state of each outcome
    weight        (N,) integers or float64   probability of outcome i of pair l is
    denominator   (L,) integers              weight[i] / denominator[l]; `mdp.rows` says what a row
                                             of floats means, which the denominator 1 is of
    gain          (N,) or (L,) integers or float64   reward of an outcome, or of a pair, is
    gain_denominator (L,) integers                   gain[i] / gain_denominator[l]
    event         (N,) uint8     optional: bit b is set where event number b happens
    components    (L, C) integers or float64     optional: expected reward of each pair by
    component_denominator (L,) integers          component, components[l, c] over the denominator;
                                           1 in older files, which have all components in floats
    labels        (K, S) uint8   optional: 1 where the label's states are, of the header's names
    goal          (S,) uint8     optional: 1 in the states that a run has to reach
    observations  (L,) int64     optional: how often each pair was observed; weights are counts then

Integers are int64 where they fit. Where they do not, the array is uint8 of shape (…, k): each row
is one integer of k ≥ 8 bytes, little-endian, two's complement. The header has the keys `format`
("exact-mdp model"), `version` (1), `name`, `discount` ("p/q"), `start` ([[state, "p/q"], …]),
`actions`, `columns` ([{"name", "size", "bits", "words"}, …]: a state's number is that of its column
values in row-major order), `objects` (of a column and of the actions: what these were made of),
`extra` (names of the states after those), `component_names`, `events`,
`parameters` ([{"name", "value", "low", "high"}, …], low and high may be null), `time_limit` (a
number of steps or null), `sense` ("max" or "min"), `labels` (their names), `unreached` ("inf" or
"-inf", what a run that misses the goal is worth), `float_probabilities` and `float_rewards`
(whether some were given as floats) and `arrays` (the names of the others); older files lack some of
the last seven and `objects`.

`np.load(path)["pair_state"]` and so on read the arrays, `json.loads` reads the bytes of the header.
"""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Hashable, Mapping, Sequence
from fractions import Fraction
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from exact_mdp.mdp.components import ComponentTable
from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.forms.names import text_of
from exact_mdp.mdp.io.arrays import read_arrays
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable, exact, ones

T = TypeVar("T")

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
            | _objects(c.objects)
            for c in mdp.space.columns
        ],
        **_objects(mdp.action_objects),
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
        "episodes": mdp.episodes,
        "sense": mdp.sense,
        "labels": list(mdp.labels),
        "unreached": str(mdp.unreached),
        "float_probabilities": mdp.float_probabilities,
        "float_rewards": mdp.float_rewards,
    }


def parts_of(content: object, *, pairs: int, labels: Sequence[Any] = ()) -> dict[str, Any]:
    """Return the constructor's arguments that a header states, for a model of L = `pairs` pairs.

    `labels` are the states of each label, in the header's order.
    """
    header = _of_kind(content, "header", dict)
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
        columns=tuple(map(_column, _of_kind(header.get("columns"), "columns", list))),
        extra=_words(header, "extra"),
    )
    if space.size > pairs:
        raise ModelError(
            f"the columns make {space.size:.3g} states, but there are {pairs} state-action pairs",
            where="header, columns",
            fix="every state has at least one pair; save the model again",
        )
    limit = header.get("time_limit")  # files of before there were limits have none
    episodes = header.get("episodes")
    named = _words({"labels": []} | header, "labels")
    if len(named) != len(labels):
        raise ModelError(
            f"{len(named)} names of labels for {len(labels)} labels",
            where="header, labels",
            fix="save the model again",
        )
    unreached = header.get("unreached", "inf")
    if unreached not in ("inf", "-inf"):
        raise _wrong("unreached", '"inf" or "-inf"')
    return {
        "space": space,
        "name": _of_kind(header.get("name"), "name", str),
        "discount_exact": _rational(header.get("discount"), "discount"),
        "start": tuple(map(_weight, _of_kind(header.get("start"), "start", list))),
        "actions": _words(header, "actions"),
        "action_objects": _made(header, _words(header, "actions")),
        "component_names": _words(header, "component_names"),
        "events": _words(header, "events"),
        "parameters": tuple(
            map(_parameter, _of_kind(header.get("parameters"), "parameters", list))
        ),
        "time_limit": None if limit is None else _of_kind(limit, "time_limit", int),
        "episodes": None if episodes is None else _of_kind(episodes, "episodes", int),
        "sense": _of_kind(header.get("sense", "max"), "sense", str),
        "labels": dict(zip(named, labels, strict=True)),
        "unreached": float(unreached),
        **{
            name: _of_kind(header.get(name, False), name, bool)
            for name in ("float_probabilities", "float_rewards")
        },
    }


def _column(entry: object) -> Column:
    column = _of_kind(entry, "columns", dict)
    size, bits = (_of_kind(column.get(key), key, int) for key in ("size", "bits"))
    words = _words(column, "words")
    fits = size > 0 and (not words or len(words) == size)
    if bits > 62 or not fits or (bits and size != 1 << bits):
        raise ModelError(
            f"a column of {size} values, {bits} bits and {len(words)} words",
            where="header, columns",
            fix="give one word for each value, or bits for 2^bits of them",
        )
    name = _of_kind(column.get("name"), "name", str)
    return Column(name=name, size=size, bits=bits, words=words, objects=_made(column, words))


def _objects(things: Sequence[Hashable]) -> dict[str, Any]:
    """Return the objects that states or actions are, where JSON has them; a tuple is a list."""
    listed = [_json(thing) for thing in things]
    return {"objects": listed} if listed and None not in listed else {}


def _json(thing: Any) -> Any:
    """Return a number, a word, a truth value or a tuple of these for JSON, None for another."""
    plain = thing.item() if isinstance(thing, np.generic) else thing
    if type(plain) is tuple:
        parts = [_json(part) for part in plain]
        return None if None in parts else parts
    kept = type(plain) in (int, str, bool) or (type(plain) is float and isfinite(plain))
    return plain if kept and len(str(plain)) < LONGEST else None


def _made(header: Mapping[str, Any], words: Sequence[str]) -> tuple[Hashable, ...]:
    """Return the objects that a header lists, whose texts are the words; none of older files."""
    if "objects" not in header:
        return ()
    made = tuple(map(_tuples, _of_kind(header["objects"], "objects", list)))
    fits = len(made) == len(words) and all(
        word in (text_of(thing), repr(thing)) for thing, word in zip(made, words, strict=True)
    )
    if not fits:
        raise _wrong("objects", "an object for each name, of that text")
    return made


def _tuples(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_tuples, value))
    if type(value) not in (int, float, str, bool):
        raise _wrong("objects", "numbers, words, truth values, and lists of these")
    return value


def _parameter(entry: object) -> Parameter:
    given = _of_kind(entry, "parameters", dict)
    name = _of_kind(given.get("name"), "name", str)
    low, high = (
        None if given.get(key) is None else _rational(given[key], name) for key in ("low", "high")
    )
    return Parameter(name=name, value=_rational(given.get("value"), name), low=low, high=high)


def _weight(entry: object) -> tuple[int, Fraction]:
    if not isinstance(entry, list) or len(entry) != 2 or type(entry[0]) is not int:
        raise _wrong("start", "[[state, probability], …]")
    return entry[0], _rational(entry[1], "start")


WANTED = {
    dict: "an object",
    list: "a list",
    str: "a string",
    int: "a whole number",
    bool: "true or false",
}


def _of_kind(value: object, key: str, kind: type[T]) -> T:
    if type(value) is not kind or (isinstance(value, int) and value < 0):
        raise _wrong(key, WANTED[kind])
    return value


def _words(header: Mapping[str, Any], key: str) -> tuple[str, ...]:
    values = _of_kind(header.get(key), key, list)
    if not all(isinstance(value, str) for value in values):
        raise _wrong(key, "a list of strings")
    return tuple(values)


def _rational(value: object, key: str) -> Fraction:
    if not isinstance(value, str):
        raise _wrong(key, 'a string such as "1/3"')
    with located(f"header, {key}", instead=True):
        return exact(value)


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

OPTIONAL = ("event",)
"""Arrays that a table may lack."""

COMPONENTS = ("components", "component_denominator")
"""Where a model has more than its reward; (L, C) integers in bytes have one row for each pair."""

FLAGS = ("labels", "goal")
"""Truth values about states, which a model may lack."""

KINDS: Mapping[str, tuple[str, ...]] = {
    "header": ("uint8",),
    "pair_state": ("int64",),
    "pair_action": ("int64",),
    **FIELDS,
    "components": ("int64", "float64", "uint8"),
    "component_denominator": ("int64", "uint8"),
    "labels": ("uint8",),
    "goal": ("uint8",),
    "observations": ("int64",),
}
WIDTH = 8


def save(model: MDP, path: str | Path) -> None:
    """Write a model to `path`, whole or not at all.

    Examples
    --------
    >>> import tempfile
    >>> mdp = MDP.from_outcomes([(0, 0, [("1/3", 0, "1/7"), ("2/3", 1, 0)]), (1, 0, [(1, 1, 0)])])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(mdp, f"{folder}/small.npz")
    ...     load(f"{folder}/small.npz").table.row(0)
    [(Fraction(1, 3), 0, Fraction(1, 7)), (Fraction(2, 3), 1, Fraction(0, 1))]
    """
    write_atomically(path, packed(model))


def packed(model: MDP) -> bytes:
    """Return the bytes of a model's archive."""
    parts = {name: getattr(model.table, name) for name in FIELDS}
    arrays = {
        "pair_state": model.pair_state,
        "pair_action": model.pair_action,
        **{name: _as_bytes(array) for name, array in parts.items() if array is not None},
    }
    if model.component_table is not None:
        amount, below = model.component_table.amount, model.component_table.denominator
        flat = _as_bytes(amount.reshape(-1))
        arrays["components"] = flat.reshape(*amount.shape[:1], -1)
        arrays["component_denominator"] = _as_bytes(np.ascontiguousarray(below))
    if model.labels:
        arrays["labels"] = np.array(list(model.labels.values()), dtype=np.uint8)
    if model.goal is not None:
        arrays["goal"] = model.goal.astype(np.uint8)
    if model.observations is not None:
        arrays["observations"] = model.observations
    text = json.dumps(as_header(model) | {"arrays": sorted(arrays)}).encode("ascii")
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, header=np.frombuffer(text, dtype=np.uint8), **arrays)
    return stream.getvalue()


def load(path: str | Path) -> MDP:
    """Read a model that `save` wrote; raises ModelError for a damaged file, or no valid model."""
    with located(str(path)):
        return unpacked(path)


def unpacked(source: str | Path | bytes) -> MDP:
    """Return the model of an archive, or of its bytes."""
    arrays = read_arrays(source, names=_check_names, check=_check_array)
    header = json_of(arrays["header"].tobytes(), "header")
    flags = {name: arrays[name] == 1 for name in FLAGS if name in arrays}
    for name in flags:
        if arrays[name].max() > 1:
            raise ModelError("a truth value is neither 0 nor 1", where=name, fix="save it again")
    parts = parts_of(header, pairs=len(arrays["pair_state"]), labels=flags.get("labels", ()))
    parts |= {"goal": flags.get("goal"), "observations": arrays.get("observations")}
    # One changed byte in an archive's list can hide those of its arrays that a model may lack.
    listed = header.get("arrays", sorted(arrays.keys() - {"header"}))
    if listed != sorted(arrays.keys() - {"header"}):
        raise ModelError("the archive lacks an array that its header names", fix="save it again")
    table = OutcomeTable(**{name: _as_integers(arrays[name]) for name in FIELDS if name in arrays})
    state, action = arrays["pair_state"], arrays["pair_action"]
    known = _components(arrays, len(parts["component_names"]))
    return MDP(table, state, action, component_table=known, **parts)


def _components(arrays: Mapping[str, Numbers], parts: int) -> ComponentTable | None:
    """Return the table of components; None where the reward is the only one."""
    if "components" not in arrays:
        return None
    amount = arrays["components"]
    if amount.dtype == np.uint8:
        if parts < 1 or amount.shape[1] % parts or amount.shape[1] < WIDTH * parts:
            raise ModelError(
                f"rows of {amount.shape[1]} bytes for {parts} components",
                where="components",
                fix="save the model again",
            )
        amount = _as_integers(amount.reshape(len(amount) * parts, -1)).reshape(-1, parts)
    below = arrays.get("component_denominator")
    if below is None and amount.dtype == np.float64 and amount.shape[1] == 1 == parts:
        return None  # an older file of a model whose only component is the reward
    return ComponentTable(
        amount=amount, denominator=ones(len(amount)) if below is None else _as_integers(below)
    )


def _check_names(names: Collection[str]) -> None:
    """Raise ModelError unless an archive holds the arrays of a model, by their names."""
    needed = KINDS.keys() - {*OPTIONAL, *COMPONENTS, *FLAGS, "observations"}
    if not needed <= set(names) <= KINDS.keys():
        raise ModelError(
            f"the archive holds {', '.join(names)[:200] or 'nothing'}",
            fix="give a model that exact-mdp wrote; a Q-table is a policy, not a model",
        )


def _check_array(name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    """Raise ModelError unless an array has a type and a shape that the format allows."""
    kinds, kind = KINDS[name], str(dtype.newbyteorder("="))
    bytewise = kind == "uint8" and len(kinds) > 1
    dimensions = 2 if bytewise or name in ("components", "labels") else 1
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
