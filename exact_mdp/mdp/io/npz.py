"""Models saved as NumPy archives, without loss, and read by any program that reads `.npz`.

The arrays of an archive, none of them pickled:

    header        (B,) uint8     UTF-8 text of a JSON object, see below
    pair_state    (L,) int64     state of each state-action pair, sorted by state, then action
    pair_action   (L,) int64     its action
    offsets       (L+1,) int64   outcomes of pair l are offsets[l] … offsets[l+1]-1
    next          (N,) int32 or int64   next state of each outcome
    weight        (N,) integers or float64   probability of outcome i of pair l is
    denominator   (L,) integers              weight[i] / denominator[l]; the denominator of a row
                                             of floats is 1 (see `mdp.forms.rows` for its meaning)
    gain          (N,) or (L,) integers or float64   reward of an outcome, or of a pair, is
    gain_denominator (L,) integers                   gain[i] / gain_denominator[l]
    event         (N,) uint8     optional: bit b is set if event number b happens
    components    (N, C) or (L, C) integers or float64     optional: reward of an outcome, or of a
    component_denominator (L,) integers          pair, by component, over the pair's denominator
    labels        (K, S) uint8   optional: 1 for the states of each label named in the header
    goal          (S,) uint8     optional: 1 for the states that a run has to reach
    target        (S,) uint8     optional: 1 for the states in which `until` ended runs, if they are
                                 not a goal, since the discount is below 1
    observations  (L,) int64     optional: how often each pair was observed; weights are counts then

Integers are int64 if they fit. Otherwise the array is uint8 of shape (…, k): each row is one
integer of k ≥ 8 bytes, little-endian, two's complement. The header has the keys `format`
("exact-mdp model"), `version` (1), `name`, `discount`, `start` ([[state, number], …]), `actions`,
`columns` ([{"name", "size", "bits", "words"}, …]: states are numbered by their column values in
row-major order), `objects` (the objects from which a column, or the actions, were made; or left
out), `extra` (names of the states after those), `component_names`, `events`,
`parameters` ([{"name", "value", "low", "high"}, …], low and high may be null), `time_limit` (a
number of steps or null), `episodes` (a number or null), `sense` ("max" or "min"), `labels` (their
names), `unreached` ("inf" or "-inf", the value of a run that misses the goal),
`float_probabilities` and `float_rewards` (whether some were given as floats), `averaged` (whether
components, or without them the reward, are only means over the outcomes of a pair; left out if not)
and `arrays` (the names of the others). Numbers are written as in `model.json`.

`np.load(path)["pair_state"]` and so on read the arrays, `json.loads` reads the bytes of the header.
Here all files of arrays are read: pickled objects, which run code, are refused, and so is too much.
"""

from __future__ import annotations

import io
import json
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.forms.names import text_of
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.parts import (
    FLOATS,
    MODEL,
    PARTS,
    SETS,
    build_model,
    encode_parts,
    encode_rationals,
    list_sets,
    parse_natural,
    parse_rational,
    states_format,
)
from exact_mdp.mdp.io.structured import json_of, or_null, read_arrays, refuse_value, require_shape
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable, Rows

VERSION = 1


def parse_object(given: Any) -> Hashable:
    """Return the object of a state or an action."""
    if isinstance(given, list):
        return tuple(map(parse_object, given))
    if not isinstance(given, int | float | str):
        refuse_value(given, "a number, a word, a truth value, or a list of these")
    return given


def parse_column(given: Any) -> Column:
    """Return a column of the states."""
    parts = require_shape(given, COLUMN)
    size, bits, words = parts["size"], parts["bits"], parts["words"]
    if not size or len(words) not in (0, size) or bits > 62 or (bits and size != 1 << bits):
        refuse_value(given, "a column with one word for each value, or bits for 2^bits of them")
    return Column(**parts | {"objects": _match_objects(parts["objects"], words)})


OBJECTS = or_null([parse_object])
COLUMN = {
    "name": str,
    "size": parse_natural,
    "bits": parse_natural,
    "words": [str],
    "objects": OBJECTS,
}
PARAMETER = {
    "name": str,
    "value": parse_rational,
    "low": or_null(parse_rational),
    "high": or_null(parse_rational),
    "unit": or_null(str),
}
HEADER = PARTS | {
    "actions": [str],
    "component_names": [str],
    "events": [str],
    "episodes": or_null(parse_natural),
    "start": [(parse_natural, parse_rational)],
    "objects": OBJECTS,
    "columns": [parse_column],
    "extra": [str],
    "parameters": [lambda given: Parameter(**require_shape(given, PARAMETER))],
    "labels": [str],
    "arrays": [str],
}
SAME = ("actions", "component_names", "events", "episodes")
ORDER = (
    *("name", "actions", "component_names", "events", "time_limit", "episodes", "sense", *FLOATS),
    *("format", "version", "discount", "start", "objects", "columns", "extra", "parameters"),
    *("labels", "unreached", "averaged", "arrays"),
)
"""The order of the keys in a header."""

ARRAYS: dict[str, tuple[str, ...]] = {
    "header": ("uint8",),
    "pair_state": ("int64",),
    "pair_action": ("int64",),
    "offsets": ("int64",),
    "next": ("int32", "int64"),
    "weight": ("int64", "float64", "uint8"),
    "denominator": ("int64", "uint8"),
    "gain": ("int64", "float64", "uint8"),
    "gain_denominator": ("int64", "uint8"),
    "event": ("uint8",),
    "components": ("int64", "float64", "uint8"),
    "component_denominator": ("int64", "uint8"),
    "labels": ("uint8",),
    "goal": ("uint8",),
    "target": ("uint8",),
    "observations": ("int64",),
}
"""Types that an array may have; uint8 among several means rows of bytes, one for each integer."""

TABLE = tuple(ARRAYS)[3:12]
MAY_LACK = tuple(ARRAYS)[9:]


def write_npz(model: MDP, path: str | Path) -> None:
    """Write a model to `path`, completely or not at all."""
    write_atomically(path, pack_model(model))


def pack_model(model: MDP) -> bytes:
    """Return the bytes of a model's archive."""
    # The arrays; those that the model lacks are left out.
    parts: dict[str, Any] = {"pair_state": model.pair_state, "pair_action": model.pair_action}
    parts |= {name: getattr(model.table, name) for name in TABLE}
    if model.labels:
        parts["labels"] = np.array([*model.labels.values()], dtype=np.uint8)
    parts |= {name: states.astype(np.uint8) for name, states in list_sets(model).items()}
    parts["observations"] = model.observations
    arrays = {name: _as_bytes(array) for name, array in parts.items() if array is not None}
    # The header.
    columns = []
    for column in model.space.columns:
        entry = {"name": column.name, "size": int(column.size), "bits": int(column.bits)}
        columns.append(
            entry | {"words": column.words} | _encode_objects(column.objects, column.words)
        )
    parameters = []
    for p in model.parameters:
        parameters.append({name: getattr(p, name) for name in PARAMETER})
    head = encode_parts(model) | {name: getattr(model, name) for name in SAME}
    head |= {
        "format": MODEL,
        "version": VERSION,
        "start": [(int(state), weight) for state, weight in model.start],
        **_encode_objects(model.action_objects, model.actions),
        "columns": columns,
        "extra": model.space.extra,
        "parameters": parameters,
        "labels": [*model.labels],
        "arrays": sorted(arrays),
    }
    header = {key: encode_rationals(head[key]) for key in ORDER if key in head}
    text = np.frombuffer(json.dumps(header).encode("ascii"), dtype=np.uint8)
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, header=text, **arrays)
    return stream.getvalue()


def read_npz(path: str | Path) -> MDP:
    """Return a model written by `write_npz`; raise ModelError for a damaged file."""
    with locate_errors(str(path)):
        return unpack_model(path)


def unpack_model(source: str | Path | bytes) -> MDP:
    """Return the model of an archive, or of its bytes."""
    arrays = read_arrays(source)
    _check_arrays(arrays)
    state, flags = arrays["pair_state"], [each > 0 for each in arrays.get("labels", ())]
    with locate_errors("header"):
        given = json_of(arrays["header"].tobytes(), "header")
        head = require_shape(given, HEADER)
        if not states_format(given, MODEL, VERSION):
            refuse_value(given.get("version"), f"version {VERSION} of format {MODEL!r}")
        # A damaged list of members can hide arrays that a model may lack, so the header lists them.
        if [*head["arrays"]] != sorted(arrays.keys() - {"header"}):
            refuse_value(head["arrays"], "the list of the arrays")
        if len(head["labels"]) != len(flags):
            refuse_value(head["labels"], f"the names of {len(flags)} labels")
        space = StateSpace(columns=head["columns"], extra=head["extra"])
        if space.size > len(state):
            what = f"the columns make {space.size:.3g} states of {len(state)} state-action pairs"
            raise ModelError(what, where="columns", fix="save the model again")
        objects = _match_objects(head["objects"], head["actions"])
    # Python integers are stored as rows of bytes.
    parts, there = len(head["component_names"]), [name for name in TABLE if name in arrays]
    columns: dict[str, Any] = {name: _as_integers(name, arrays[name], parts) for name in there}
    rows = {name: columns.pop(name) for name in ("offsets", "next", "weight", "denominator")}
    sets: dict[str, Any] = {name: arrays[name] > 0 for name in SETS if name in arrays}
    return build_model(
        head,
        OutcomeTable(rows=Rows(**rows), **columns),
        pair_state=state,
        pair_action=arrays["pair_action"],
        space=space,
        action_objects=objects,
        start=head["start"],
        parameters=head["parameters"],
        labels=dict(zip(head["labels"], flags, strict=True)),
        observations=arrays.get("observations"),
        **sets,
        **{name: head[name] for name in SAME},
    )


def _encode_objects(things: Sequence[Hashable], words: Sequence[str]) -> dict[str, Any]:
    """Return {"objects": objects} if JSON can represent them (tuples as lists), else {}."""
    try:
        text = json.dumps(things, default=lambda number: number.item(), allow_nan=False)
        listed = json_of(text, "objects")
        _match_objects(tuple(map(parse_object, listed)), words)
    except (AttributeError, TypeError, ValueError):
        return {}
    if not listed:
        return {}
    return {"objects": listed}


def _match_objects(
    objects: Sequence[Hashable] | None, words: Sequence[str]
) -> tuple[Hashable, ...]:
    """Return the objects of a header; raise ModelError unless their texts are the words."""
    listed = [(text_of(each), repr(each)) for each in objects or ()]
    fits = len(listed) == len(words) and all(map(tuple.__contains__, listed, words))
    if objects is not None and not fits:
        refuse_value(objects, "a list with an object for each name, with the name as its text")
    return tuple(objects or ())


def _check_arrays(arrays: dict[str, Numbers]) -> None:
    """Raise ModelError unless these are the arrays of a model, with the right types and shapes."""
    if not ARRAYS.keys() - {*MAY_LACK} <= arrays.keys() <= ARRAYS.keys():
        raise ModelError(
            f"the archive holds {', '.join(arrays)[:200] or 'nothing'}",
            fix="give a model that exact-mdp wrote; a Q-table is a policy, not a model",
        )
    for name, array in arrays.items():
        kinds, kind, shape = ARRAYS[name], str(array.dtype), array.shape
        # Arrays of bytes have an integer of 8 or more bytes in each row.
        bytewise = kind == "uint8" and len(kinds) > 1
        dimensions = 1
        if bytewise or name in ("components", "labels"):
            dimensions = 2
        narrow = bytewise and shape[1:] < (8,)
        if kind not in kinds or len(shape) != dimensions or min(shape) < 1 or narrow:
            fix = f"give {' or '.join(kinds)}, as the format says"
            raise ModelError(f"an array of type {kind} and shape {shape}", where=name, fix=fix)


def _as_bytes(array: Numbers) -> Numbers:
    """Return an array of Python integers as rows of bytes; other arrays as they are."""
    if array.dtype != object:
        return array
    values = array.reshape(-1).tolist()
    width = max([8, *(value.bit_length() // 8 + 1 for value in values)])
    data = b"".join(value.to_bytes(width, "little", signed=True) for value in values)
    return np.frombuffer(data, dtype=np.uint8).reshape(len(array), -1)


def _as_integers(name: str, array: Numbers, parts: int) -> Numbers:
    """Return rows of bytes as Python integers, `parts` in each row of components.

    Other arrays are returned as they are.
    """
    if array.dtype != np.uint8 or array.ndim == 1:
        return array
    count = 1
    if name == "components":
        count = parts
    if count < 1 or array.shape[1] % count:
        what = f"rows of {array.shape[1]} bytes for {count} components"
        raise ModelError(what, where=name, fix="save the model again")
    rows = array.reshape(len(array) * count, -1)
    values = [int.from_bytes(row.tobytes(), "little", signed=True) for row in rows]
    wide = np.array(values, dtype=object)
    if name == "components":
        return wide.reshape(-1, count)
    return wide
