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
    components    (L, C) integers or float64     optional: expected reward of each pair by
    component_denominator (L,) integers          component, components[l, c] over the denominator
    observations  (L,) int64     optional: how often each pair was observed; weights are counts then

Integers are int64 where they fit. Where they do not, the array has texts in hexadecimal, such as
-0x1f4. The header has the keys of `model.json` but for pairs, components and names of states, and
`columns` ([{"name", "size", "bits", "words"}, …]: a state's number is that of its column values in
row-major order), `objects` (of a column and of the actions: what these were made of; or left out),
`extra` (names of the states after those), `component_names`, `events`,
`parameters` ([{"name", "value", "low", "high", "unit"}, …], the last three may be null),
`time_limit` (a number of steps or null), `episodes` (a number or null) and `arrays` (the names of
the others).

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
from exact_mdp.mdp.io.model_json import head_of, parts_of, read_head, whole
from exact_mdp.mdp.io.structured import json_of, natural, number, optional, ready, refuse, shaped
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable


def thing(given: Any) -> Hashable:
    """Read the object that a state or an action is; a tuple is a list."""
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
    return Column(**parts | {"objects": _named(parts["objects"], words)})


OBJECTS = optional([thing])
COLUMN = {"name": str, "size": natural, "bits": natural, "words": [str], "objects": OBJECTS}
PARAMETER = {"name": str, "value": number, "low": optional(number), "high": optional(number)}
PARAMETER["unit"] = optional(str)
MORE = {
    "objects": OBJECTS,
    "columns": [column],
    "extra": [str],
    "component_names": [str],
    "events": [str],
    "parameters": [lambda given: Parameter(**shaped(given, PARAMETER))],
    "time_limit": optional(natural),
    "episodes": optional(natural),
    "arrays": [str],
}
SAME = ("component_names", "events", "time_limit", "episodes")
INTEGER, WIDE, NUMBER = ("int64",), ("int64", "S"), ("int64", "S", "float64")
ARRAYS: dict[str, tuple[str, ...]] = {
    "pair_state": INTEGER,
    "pair_action": INTEGER,
    "offsets": INTEGER,
    "next": ("int32", "int64"),
    "weight": NUMBER,
    "denominator": WIDE,
    "gain": NUMBER,
    "gain_denominator": WIDE,
    "event": ("uint8",),
    "components": NUMBER,
    "component_denominator": WIDE,
    "observations": INTEGER,
}
"""Types that an array may have, texts of any length among them; the last four may be missing."""
NEEDED, TABLE = {*tuple(ARRAYS)[:8]}, tuple(ARRAYS)[2:11]


def save(model: MDP, path: str | Path) -> None:
    """Write a model to `path`, whole or not at all."""
    write_atomically(path, packed(model))


def packed(model: MDP) -> bytes:
    """Return the bytes of a model's archive."""
    parts = {name: getattr(model.table if name in TABLE else model, name) for name in ARRAYS}
    arrays = {name: _as_texts(array) for name, array in parts.items() if array is not None}
    more = {name: getattr(model, name) for name in SAME} | {
        **_objects(model.action_objects, model.actions),
        "columns": [
            {"name": c.name, "size": int(c.size), "bits": int(c.bits), "words": c.words}
            | _objects(c.objects, c.words)
            for c in model.space.columns
        ],
        "extra": model.space.extra,
        "parameters": [{name: getattr(p, name) for name in PARAMETER} for p in model.parameters],
        "arrays": sorted(arrays),
    }
    header = json.dumps(head_of(model) | ready(more)).encode("ascii")
    stream = io.BytesIO()
    text = np.frombuffer(header, dtype=np.uint8)
    np.savez(stream, allow_pickle=False, header=text, **arrays)
    return stream.getvalue()


def load(path: str | Path) -> MDP:
    """Read a model that `save` wrote; raises ModelError for a damaged file, or no valid model."""
    with located(str(path)):
        return unpacked(path)


def unpacked(source: str | Path | bytes) -> MDP:
    """Return the model of an archive, or of its bytes."""
    arrays = read_arrays(source)
    if "header" not in arrays:
        raise ModelError(
            f"the archive holds {', '.join(arrays)[:200] or 'nothing'}",
            fix="give a model that exact-mdp wrote; a Q-table is a policy, not a model",
        )
    with located("header"):
        head = read_head(json_of(arrays.pop("header").tobytes(), "header"), MORE)
        # One changed byte in an archive's list can hide those of its arrays that a model may lack.
        if [*head["arrays"]] != sorted(arrays) or not NEEDED <= arrays.keys() <= ARRAYS.keys():
            refuse(head["arrays"], "the list of the arrays, which are those of a model")
        parts = parts_of(head, len(arrays["pair_state"]))
        space = StateSpace(columns=head["columns"], extra=head["extra"])
        if space.size != head["states"]:
            refuse(head["columns"], f"columns of {head['states']} states")
        actions = head["action_names"] or ()
        objects = _named(head["objects"], actions)
    arrays = {name: _as_integers(name, array) for name, array in arrays.items()}
    return MDP(
        OutcomeTable(**{name: arrays[name] for name in TABLE if name in arrays}),
        arrays["pair_state"],
        arrays["pair_action"],
        space=space,
        actions=actions,
        action_objects=objects,
        discount_exact=head["discount"],
        parameters=head["parameters"],
        observations=arrays.get("observations"),
        **parts,
        **{name: head[name] for name in SAME},
    )


def _objects(things: Sequence[Hashable], words: Sequence[str]) -> dict[str, Any]:
    """Return the objects that states or actions are, if JSON gives them back."""
    try:
        text = json.dumps(things, default=lambda number: number.item(), allow_nan=False)
        listed = json_of(text, "objects")
        _named(tuple(map(thing, listed)), words)
    except (AttributeError, TypeError, ValueError):
        return {}
    return {"objects": listed} if listed else {}


def _named(objects: Sequence[Hashable] | None, words: Sequence[str]) -> tuple[Hashable, ...]:
    """Return the objects that a header lists, if any, whose texts are the words."""
    listed = [(text_of(each), repr(each)) for each in objects or ()]
    fits = len(listed) == len(words) and all(map(tuple.__contains__, listed, words))
    if objects is not None and not fits:
        refuse(objects, "an object for each name, of that text")
    return tuple(objects or ())


def _as_texts(array: Numbers) -> Numbers:
    """Return Python integers as texts; other arrays as they are."""
    if array.dtype != object:
        return array
    return np.array([hex(value).encode() for value in array.flat]).reshape(array.shape)


def _as_integers(name: str, array: Numbers) -> Numbers:
    """Return texts as Python integers, other arrays as they are; refuse those of other types."""
    kind = "S" if array.dtype.kind == "S" else str(array.dtype)
    if kind not in ARRAYS[name] or array.ndim != 1 + (name == "components") or not array.size:
        fix = f"give {' or '.join(ARRAYS[name])}, as the format says"
        raise ModelError(f"an array of type {kind} and shape {array.shape}", where=name, fix=fix)
    if kind != "S":
        return array
    wide = np.empty(array.size, dtype=object)
    with located(name):
        wide[:] = [whole(text.decode("latin-1")) for text in array.flat]
    return wide.reshape(array.shape)
