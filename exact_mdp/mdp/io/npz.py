"""Models saved as NumPy archives, without loss, and read by any program that reads `.npz`.

The arrays of an archive, nothing in it being a pickle:

    header        (B,) uint8     UTF-8 text of a JSON object, see below
    pair_state    (L,) int64     state of each state-action pair, sorted by state, then action
    pair_action   (L,) int64     its action
    offsets       (L+1,) int64   outcomes of pair l are offsets[l] … offsets[l+1]-1
    next          (N,) int32 or int64   next state of each outcome
    weight        (N,) integers or float64   probability of outcome i of pair l is
    denominator   (L,) integers              weight[i] / denominator[l]; `mdp.forms.rows` says what
                                             a row of floats means, which the denominator 1 is of
    gain          (N,) or (L,) integers or float64   reward of an outcome, or of a pair, is
    gain_denominator (L,) integers                   gain[i] / gain_denominator[l]
    event         (N,) uint8     optional: bit b is set where event number b happens
    components    (N, C) or (L, C) integers or float64     optional: reward of an outcome, or of a
    component_denominator (L,) integers          pair, by component, over the pair's denominator
    labels        (K, S) uint8   optional: 1 where the label's states are, of the header's names
    goal          (S,) uint8     optional: 1 in the states that a run has to reach
    target        (S,) uint8     optional: 1 where `until` ended runs, if that is no goal, as the
                                 discount is below 1
    observations  (L,) int64     optional: how often each pair was observed; weights are counts then

Integers are int64 where they fit. Where they do not, the array is uint8 of shape (…, k): each row
is one integer of k ≥ 8 bytes, little-endian, two's complement. The header has the keys `format`
("exact-mdp model"), `version` (1), `name`, `discount`, `start` ([[state, number], …]), `actions`,
`columns` ([{"name", "size", "bits", "words"}, …]: a state's number is that of its column values in
row-major order), `objects` (of a column and of the actions: what these were made of; or left out),
`extra` (names of the states after those), `component_names`, `events`,
`parameters` ([{"name", "value", "low", "high"}, …], low and high may be null), `time_limit` (a
number of steps or null), `episodes` (a number or null), `sense` ("max" or "min"), `labels` (their
names), `unreached` ("inf" or "-inf", what a run that misses the goal is worth),
`float_probabilities` and `float_rewards` (whether some were given as floats), `averaged` (whether
components, or without them the reward, are only means over the outcomes of a pair; left out if not)
and `arrays` (the names of the others). Numbers are written as in `model.json`.

`np.load(path)["pair_state"]` and so on read the arrays, `json.loads` reads the bytes of the header.
"""

from __future__ import annotations

import io
import json
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.forms.names import text_of
from exact_mdp.mdp.io.arrays import read_arrays
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.structured import (
    is_of,
    json_of,
    natural,
    number,
    optional,
    ready,
    refuse,
    shaped,
    unreached,
)
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable

FORMAT, VERSION = "exact-mdp model", 1


def thing(given: Any) -> Hashable:
    """Read the object that a state or an action is."""
    if isinstance(given, list):
        return tuple(map(thing, given))
    if not isinstance(given, int | float | str):
        refuse(given, "a number, a word, a truth value, or a list of these")
    return given


def column(given: Any) -> Column:
    """Read a column of the states."""
    parts = shaped(given, COLUMN)
    size, bits, words = parts["size"], parts["bits"], parts["words"]
    if not size or len(words) not in (0, size) or bits > 62 or (bits and size != 1 << bits):
        refuse(given, "a column with one word for each value, or bits for 2^bits of them")
    return Column(**parts | {"objects": _made(parts["objects"], words)})


OBJECTS = optional([thing])
COLUMN = {"name": str, "size": natural, "bits": natural, "words": [str], "objects": OBJECTS}
PARAMETER = {"name": str, "value": number, "low": optional(number), "high": optional(number)}
PARAMETER["unit"] = optional(str)
HEADER = {
    "name": str,
    "discount": number,
    "start": [(natural, number)],
    "actions": [str],
    "objects": OBJECTS,
    "columns": [column],
    "extra": [str],
    "component_names": [str],
    "events": [str],
    "parameters": [lambda given: Parameter(**shaped(given, PARAMETER))],
    "time_limit": optional(natural),
    "episodes": optional(natural),
    "sense": str,
    "labels": [str],
    "unreached": unreached,
    "float_probabilities": bool,
    "float_rewards": bool,
    "averaged": optional(bool),
    "arrays": [str],
}
SAME = (
    *("name", "actions", "component_names", "events", "time_limit", "episodes", "sense"),
    *("float_probabilities", "float_rewards"),
)

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
WIDTH = 8


def save(model: MDP, path: str | Path) -> None:
    """Write a model to `path`, whole or not at all."""
    write_atomically(path, packed(model))


def packed(model: MDP) -> bytes:
    """Return the bytes of a model's archive."""
    labels = [*model.labels.values()]
    parts = {
        "pair_state": model.pair_state,
        "pair_action": model.pair_action,
        **{name: getattr(model.table, name) for name in TABLE},
        "labels": np.array(labels, dtype=np.uint8) if labels else None,
        "goal": None if model.goal is None else model.goal.astype(np.uint8),
        "target": None
        if model.target is None or model.goal is not None
        else model.target.astype(np.uint8),
        "observations": model.observations,
    }
    arrays = {name: _as_bytes(array) for name, array in parts.items() if array is not None}
    header = {name: getattr(model, name) for name in SAME} | {
        "format": FORMAT,
        "version": VERSION,
        "discount": model.discount_exact,
        "start": [(int(state), weight) for state, weight in model.start],
        **_objects(model.action_objects, model.actions),
        "columns": [
            {"name": c.name, "size": int(c.size), "bits": int(c.bits), "words": c.words}
            | _objects(c.objects, c.words)
            for c in model.space.columns
        ],
        "extra": model.space.extra,
        "parameters": [{name: getattr(p, name) for name in PARAMETER} for p in model.parameters],
        "labels": [*model.labels],
        "unreached": str(model.unreached),
        **({"averaged": True} if model.table.averaged else {}),
        "arrays": sorted(arrays),
    }
    text = np.frombuffer(json.dumps(ready(header)).encode("ascii"), dtype=np.uint8)
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, header=text, **arrays)
    return stream.getvalue()


def load(path: str | Path) -> MDP:
    """Read a model that `save` wrote; raises ModelError for a damaged file, or no valid model."""
    with located(str(path)):
        return unpacked(path)


def unpacked(source: str | Path | bytes) -> MDP:
    """Return the model of an archive, or of its bytes."""
    arrays = read_arrays(source)
    _check_arrays(arrays)
    state, flags = arrays["pair_state"], [each > 0 for each in arrays.get("labels", ())]
    with located("header"):
        given = json_of(arrays["header"].tobytes(), "header")
        head = shaped(given, HEADER)
        if not is_of(given, FORMAT, VERSION):
            refuse(given.get("version"), f"version {VERSION} of format {FORMAT!r}")
        # One changed byte in an archive's list can hide those of its arrays that a model may lack.
        if [*head["arrays"]] != sorted(arrays.keys() - {"header"}):
            refuse(head["arrays"], "the list of the arrays")
        if len(head["labels"]) != len(flags):
            refuse(head["labels"], f"the names of {len(flags)} labels")
        space = StateSpace(columns=head["columns"], extra=head["extra"])
        if space.size > len(state):
            what = f"the columns make {space.size:.3g} states of {len(state)} state-action pairs"
            raise ModelError(what, where="columns", fix="save the model again")
        objects = _made(head["objects"], head["actions"])
    parts, there = len(head["component_names"]), [name for name in TABLE if name in arrays]
    columns: dict[str, Any] = {name: _as_integers(name, arrays[name], parts) for name in there}
    return MDP(
        OutcomeTable(**columns, averaged=bool(head["averaged"])),
        state,
        arrays["pair_action"],
        space=space,
        action_objects=objects,
        discount_exact=head["discount"],
        start=head["start"],
        parameters=head["parameters"],
        labels=dict(zip(head["labels"], flags, strict=True)),
        goal=arrays["goal"] > 0 if "goal" in arrays else None,
        target=arrays["target"] > 0 if "target" in arrays else None,
        unreached=head["unreached"],
        observations=arrays.get("observations"),
        **{name: head[name] for name in SAME},
    )


def _objects(things: Sequence[Hashable], words: Sequence[str]) -> dict[str, Any]:
    """Return the objects that states or actions are, if JSON gives them back; a tuple is a list."""
    try:
        text = json.dumps(things, default=lambda number: number.item(), allow_nan=False)
        listed = json_of(text, "objects")
        _made(tuple(map(thing, listed)), words)
    except (AttributeError, TypeError, ValueError):
        return {}
    return {"objects": listed} if listed else {}


def _made(objects: Sequence[Hashable] | None, words: Sequence[str]) -> tuple[Hashable, ...]:
    """Return the objects that a header lists, if any, whose texts are the words."""
    listed = [(text_of(each), repr(each)) for each in objects or ()]
    fits = len(listed) == len(words) and all(map(tuple.__contains__, listed, words))
    if objects is not None and not fits:
        refuse(objects, "an object for each name, of that text")
    return tuple(objects or ())


def _check_arrays(arrays: dict[str, Numbers]) -> None:
    """Raise ModelError unless arrays are those of a model, of types and shapes that it allows."""
    if not ARRAYS.keys() - {*MAY_LACK} <= arrays.keys() <= ARRAYS.keys():
        raise ModelError(
            f"the archive holds {', '.join(arrays)[:200] or 'nothing'}",
            fix="give a model that exact-mdp wrote; a Q-table is a policy, not a model",
        )
    for name, array in arrays.items():
        kinds, kind, shape = ARRAYS[name], str(array.dtype), array.shape
        bytewise = kind == "uint8" and len(kinds) > 1
        dimensions = 2 if bytewise or name in ("components", "labels") else 1
        narrow = bytewise and shape[1:] < (WIDTH,)
        if kind not in kinds or len(shape) != dimensions or min(shape) < 1 or narrow:
            fix = f"give {' or '.join(kinds)}, as the format says"
            raise ModelError(f"an array of type {kind} and shape {shape}", where=name, fix=fix)


def _as_bytes(array: Numbers) -> Numbers:
    """Return Python integers as rows of bytes, one for each row; other arrays as they are."""
    if array.dtype != object:
        return array
    values = array.reshape(-1).tolist()
    width = max([WIDTH, *(value.bit_length() // 8 + 1 for value in values)])
    data = b"".join(value.to_bytes(width, "little", signed=True) for value in values)
    return np.frombuffer(data, dtype=np.uint8).reshape(len(array), -1)


def _as_integers(name: str, array: Numbers, parts: int) -> Numbers:
    """Return rows of bytes as Python integers, those of components in parts; others as they are."""
    if array.dtype != np.uint8 or array.ndim == 1:
        return array
    count = parts if name == "components" else 1
    if count < 1 or array.shape[1] % count:
        what = f"rows of {array.shape[1]} bytes for {count} components"
        raise ModelError(what, where=name, fix="save the model again")
    rows = array.reshape(len(array) * count, -1)
    values = [int.from_bytes(row.tobytes(), "little", signed=True) for row in rows]
    wide = np.empty(len(values), dtype=object)
    wide[:] = values
    return wide.reshape(-1, count) if name == "components" else wide
