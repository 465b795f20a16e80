"""Encode records as JSON, and decode them by the types of their fields: the file format of proofs.

    int                  a text in hexadecimal, such as "-0x1f4"
    Fraction             a text of two such numbers, "0x1/0x3"; infinite floats "inf" and "-inf"
    str, bool            as they are
    array of integers    a list of numbers
    tuple or list        a list
    a record             an object with the keys of its fields
    an optional value    null, or the other type

A file has the keys `format` ("exact-mdp certificate") and `version` (2) beside the keys of its
record, whose `kind` names the claim. Integers are hexadecimal because this is fast, and because
Python refuses to read or write over 4,300 decimal digits; no reader takes more than 100,000
hexadecimal digits, so that none runs out of time or memory. Reading checks only the form of a file;
`violations` checks its claims.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import LARGEST, read_bytes
from exact_mdp.mdp.io.parts import encode_hexadecimal
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.exact.checker import Unreadable, check_keys, ensure, once
from exact_mdp.solvers.exact.levels import make_fraction

T = TypeVar("T")

FORMAT, VERSION = "exact-mdp certificate", 2
INTEGER = re.compile(r"-?0x(0|[1-9a-f][0-9a-f]{0,99999})")  # a stated limit, as in `checker`


def encode_record(value: Any, integer: Callable[[int], object] = hex) -> Any:
    """Encode a record, or the value of a field, as a JSON value with integers as texts."""
    inner = partial(encode_record, integer=integer)
    if is_dataclass(value):
        names = _list_field_types(cast(Any, type(value)))
        return {name: inner(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Sense):
        return value.value
    if isinstance(value, bool | str | NoneType):
        return value
    if isinstance(value, int):
        return integer(value)
    if isinstance(value, Fraction):
        return encode_hexadecimal(value)
    if isinstance(value, float):
        return str(value)
    if not isinstance(value, list | tuple):
        raise TypeError(f"{value!r} is of type {type(value).__name__}, which no file holds")
    if {*map(type, value)} <= {int}:  # most are long lists of integers
        return [*map(integer, value)]
    return [inner(each) for each in value]


def decode_record(kind: Any, value: Any) -> Any:
    """Decode a JSON value as a given type; raise ValueError if it does not fit."""
    of, record = get_args(kind), is_dataclass(kind)
    # The first member of a union that fits.
    if get_origin(kind) in (Union, UnionType):
        for each in of:
            with suppress(ValueError, TypeError, AttributeError):
                return decode_record(each, value)
        raise ValueError
    if record:
        types = _list_field_types(kind)
        _require_fit(isinstance(value, dict) and value.keys() == types.keys())
        return kind(**{name: decode_record(each, value[name]) for name, each in types.items()})
    if kind is Sense:
        return Sense(value)
    if kind in (str, bool, NoneType):
        _require_fit(type(value) is kind)
        return value
    if kind is int:
        _require_fit(isinstance(value, str) and INTEGER.fullmatch(value))
        return int(value, 16)
    if kind is Fraction:
        _require_fit(isinstance(value, str))
        top, below = (decode_record(int, part) for part in value.split("/"))
        _require_fit(below > 0)
        return make_fraction(top, below)
    if kind is float:
        _require_fit(value in ("inf", "-inf"))
        return float(value)
    if kind == Integers:
        _require_fit(isinstance(value, list) and {*map(type, value)} <= {int})
        return np.array(value, dtype=np.int64)
    _require_fit(isinstance(value, list))
    items = [decode_record(of[0], each) for each in value]
    if get_origin(kind) is tuple:
        return tuple(items)
    return items


def _require_fit(right: object) -> None:
    if not right:
        raise ValueError


@cache
def _list_field_types(kind: Any) -> dict[str, Any]:
    """Return the types of the fields that files contain, which are the fields without a default."""
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in fields(kind) if f.default is f.default_factory}


def rebuild_proof(proof: Any) -> Any:
    """Return the proof as it would be read from its file; raise Unreadable for other types."""
    try:
        if proof.kind in type(proof).kinds:
            return decode_record(type(proof), encode_record(proof))
    except (ValueError, TypeError, AttributeError, OverflowError):
        pass
    raise Unreadable(f"no file holds such a proof of {' or '.join(type(proof).kinds)}")


def build_file_content(proof: Any, integer: Callable[[int], object] = hex) -> dict[str, Any]:
    """Return the content of a proof's file."""
    return {"format": FORMAT, "version": VERSION, **encode_record(proof, integer)}


def load_proof(kinds: Mapping[str, type[T]], path: str | Path) -> T:
    """Read a certificate of one of the given kinds; raise ModelError for any other file."""
    text, fault = read_bytes(path, most=LARGEST), "not a certificate, which is JSON text"
    try:
        data = json.loads(text, object_pairs_hook=once)
        fault = "the file is damaged"
        if not isinstance(data, dict):
            data = {}
        head: dict[str, list[Any]] = {"format": [FORMAT], "version": [VERSION], "kind": [*kinds]}
        for key, known in head.items():
            own, each = data.get(key), " or ".join(map(repr, known))
            right = own in known and type(own) is type(known[0])  # 2.0 equals 2, too
            ensure(right, f"{key} is {str(own)[:40]!r}, not {each}")
        record = kinds[data["kind"]]
        types, read = _list_field_types(cast(Any, record)), dict[str, Any]()
        check_keys(data, {"format", "version", *types}, "the certificate")
        for part, kind in types.items():
            fault = f"{part} is damaged"
            read[part] = decode_record(kind, data[part])
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        if isinstance(error, Unreadable):
            fault = str(error)
        raise ModelError(
            fault,
            where=str(path),
            fix="name a file that certificate.save wrote, or `exact-mdp solve MODEL --certify "
            "--certificate F.json`, of this version",
        ) from error
    return record(**read)
