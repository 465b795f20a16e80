"""Records as JSON and back, by the types of their fields: the one form of all proofs in files.

    int                  a text in hexadecimal, such as "-0x1f4", of any length
    Fraction             a text of two, such as "0x1/0x3"; infinite floats "inf" and "-inf"
    str, bool            as they are
    array of integers    a list of numbers
    array of flags       a text with 0 or 1 for each
    tuple or list        a list; a mapping is a list of [key, value]
    a record             an object with the keys of its fields
    what may be None     null, or the other type

A file has the keys `format` ("exact-mdp certificate") and `version` (2) as well as those of its
record, of which `kind` says what it proves. Python refuses to read or write over 4,300 decimal
digits; hexadecimal is quick, too. What is read is checked for its form; whether its claims hold is
for `violations` to say.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import LARGEST, read_bytes, write_atomically
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.exact.checker import Unreadable, once
from exact_mdp.solvers.exact.levels import fraction

T = TypeVar("T")
Flags = NDArray[np.bool_]

FORMAT, VERSION = "exact-mdp certificate", 2
INTEGER = re.compile(r"-?0x(0|[1-9a-f][0-9a-f]*)")


def encode(value: Any, integer: Callable[[int], object] = hex) -> Any:
    """Return a record, or a value of a field, as JSON has it, with integers as texts."""
    inner = partial(encode, integer=integer)
    if is_dataclass(value) or hasattr(value, "_fields"):
        return {name: inner(getattr(value, name)) for name in _types(cast(Any, type(value)))}
    if isinstance(value, np.ndarray):
        if value.dtype == bool:
            return "".join(np.where(value, "1", "0"))
        return value.tolist()
    if isinstance(value, bool | str | NoneType):
        return value
    if isinstance(value, int):
        return integer(value)
    if isinstance(value, Fraction):
        return f"{hex(value.numerator)}/{hex(value.denominator)}"
    if isinstance(value, float):
        return str(value)
    if isinstance(value, Mapping):
        return [[inner(key), inner(each)] for key, each in value.items()]
    if not isinstance(value, list | tuple):
        raise TypeError(f"{value!r} is of type {type(value).__name__}, which no file holds")
    return [inner(each) for each in value]


def decode(kind: Any, value: Any) -> Any:
    """Return what JSON has as a value of a type; raises ValueError where it is none."""
    of = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        return _either(of, value)
    if is_dataclass(kind) or hasattr(kind, "_fields"):
        types = _types(kind)
        _wanted(isinstance(value, dict) and value.keys() == types.keys())
        return kind(**{name: decode(each, value[name]) for name, each in types.items()})
    if kind in (str, bool, NoneType):
        _wanted(type(value) is kind)
        return value
    if kind is int:
        _wanted(isinstance(value, str) and INTEGER.fullmatch(value))
        return int(value, 16)
    if kind is Fraction:
        _wanted(isinstance(value, str))
        top, below = (decode(int, part) for part in value.split("/"))
        _wanted(below > 0)
        return fraction(top, below)
    if kind is float:
        _wanted(value in ("inf", "-inf"))
        return float(value)
    if kind == Integers:
        _wanted(isinstance(value, list) and {*map(type, value)} <= {int})
        return np.array(value, dtype=np.int64)
    if kind == Flags:
        _wanted(isinstance(value, str) and {*value} <= {"0", "1"})
        return np.array([each == "1" for each in value], dtype=bool)
    origin: Any = get_origin(kind)
    _wanted(isinstance(value, list))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        pairs = [(decode(of[0], key), decode(of[1], each)) for key, each in value]
        _wanted(len(dict(pairs)) == len(pairs))
        return dict(pairs)
    if origin is tuple and of[-1] is not Ellipsis:
        return tuple(decode(each, part) for each, part in zip(of, value, strict=True))
    items = [decode(of[0], each) for each in value]
    return tuple(items) if origin is tuple else items


def _either(of: Sequence[Any], value: Any) -> Any:
    """Return a value as the first of some types that it is of."""
    for kind in of:
        try:
            return decode(kind, value)
        except (ValueError, TypeError, AttributeError):
            continue
    raise ValueError


def _wanted(right: object) -> None:
    if not right:
        raise ValueError


@cache
def _types(kind: Any) -> dict[str, Any]:
    """Return the types of the fields that are written: those without a default."""
    hints = get_type_hints(kind)
    names: Iterable[str] = hints
    if is_dataclass(kind):  # those without a default
        names = [f.name for f in fields(kind) if f.default is f.default_factory]
    return {name: hints[name] for name in names}


def checked(proof: Any) -> Any:
    """Return a proof made of what its file would hold; raises Unreadable for other types."""
    try:
        if proof.kind in type(proof).kinds:
            return decode(type(proof), encode(proof))
    except (ValueError, TypeError, AttributeError, OverflowError):
        pass
    raise Unreadable(f"no file holds such a proof of {' or '.join(type(proof).kinds)}")


def content(proof: Any, integer: Callable[[int], object] = hex) -> dict[str, Any]:
    """Return what the file of a proof has."""
    return {"format": FORMAT, "version": VERSION, **encode(proof, integer)}


def save(proof: Any, path: str | Path) -> None:
    """Write a proof as a file, whole or not at all."""
    each = content(proof).items()
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in each]
    write_atomically(path, "{" + ",\n ".join(lines) + "}\n")


def load(kinds: Mapping[str, type[T]], path: str | Path) -> T:
    """Read a certificate of one of some kinds; raises ModelError for another file."""
    where = str(path)
    try:
        data = json.loads(read_bytes(path, most=LARGEST), object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        if isinstance(error, ModelError):
            raise
        twice = isinstance(error, Unreadable)
        what = str(error) if twice else "not a certificate, which is JSON text"
        raise _damaged(what, where) from error
    data = data if isinstance(data, dict) else {}
    kind: Any = data.get("kind")
    head: dict[str, list[Any]] = {"format": [FORMAT], "version": [VERSION], "kind": [*kinds]}
    for key, known in head.items():
        if (own := data.get(key)) not in known or isinstance(own, bool):
            wanted = " or ".join(map(repr, known))
            raise _damaged(f"{key} is {str(own)[:40]!r}, not {wanted}", where)
    data = {key: data[key] for key in data.keys() - {"format", "version"}}
    types = _types(cast(Any, kinds[kind]))
    if data.keys() != types.keys():
        keys = ", ".join(sorted(data.keys() ^ types.keys()))[:80]
        raise _damaged(f"keys that are missing, or too many: {keys}", where)
    read = {}
    for name, each in types.items():
        try:
            read[name] = decode(each, data[name])
        except (ValueError, TypeError, AttributeError, OverflowError) as error:
            raise _damaged(f"{name} is damaged", where) from error
    return kinds[kind](**read)


def _damaged(what: str, where: str) -> ModelError:
    fix = "name a file that certificate.save or --certificate F.json wrote, of this version"
    return ModelError(what, where=where, fix=fix)
