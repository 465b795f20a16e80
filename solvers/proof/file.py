"""Certificates as files: JSON, to be read by any program.

Both kinds have the keys

    format        "exact-mdp certificate"
    version       1
    kind          "exact" or "bounded"
    model         SHA-256 of the model, see `mdp.exact`
    states        S
    policy        [S action numbers]

An exact certificate has besides them

    pairs         L
    unique        true or false
    start_value   [numerator, denominator]
    denominators  [integer, …]
    group         [S indices into denominators]
    numerators    [S integers]: V(s) = numerators[s] / denominators[group[s]]
    gaps          [S integers, or null where all actions are optimal]
    gap_scales    [S integers]: the gap is gaps[s] / (gap_scales[s] · denominators[group[s]])
    optimal       a string of L digits, 1 for optimal pairs
    rank          [S integers], or null
    weight        [S integers], or null

where every integer of unbounded size is a string in hexadecimal, such as "-1f4" for -500: Python
refuses to read or write more than 4,300 decimal digits, and hexadecimal takes linear time. A
bounded certificate has

    lower, upper, weight   [S floats], each a string in C99's hexadecimal form, such as "0x1.8p+1"

What is read is checked for its form; whether its claims hold is for `violations` to say.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import LARGEST, read_text, write_atomically
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.proof.claims import BoundedClaims, ExactClaims
from exact_mdp.solvers.proof.rationals import fraction

FORMAT, VERSION = "exact-mdp certificate", 1
HEXADECIMAL = re.compile(r"-?[0-9a-f]+").fullmatch
FLOAT = re.compile(r"-?0x[01]\.[0-9a-f]{1,13}p[+-][0-9]{1,4}").fullmatch
DIGEST = re.compile(r"[0-9a-f]{64}").fullmatch

VECTORS = ("lower", "upper", "weight")

T = TypeVar("T")


def save(found: ExactClaims | BoundedClaims, path: str | Path) -> None:
    """Write a certificate, whole or not at all."""
    head = {
        "format": FORMAT,
        "version": VERSION,
        "kind": "exact" if isinstance(found, ExactClaims) else "bounded",
        "model": found.model,
        "states": len(found.policy),
        "policy": found.policy.tolist(),
    }
    body = _exact(found) if isinstance(found, ExactClaims) else _bounded(found)
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in (head | body).items()]
    write_atomically(path, "{" + ",\n ".join(lines) + "}\n")


def _exact(found: ExactClaims) -> dict[str, object]:
    start = found.start_value
    return {
        "pairs": len(found.optimal_pairs),
        "unique": found.unique,
        "start_value": [f"{start.numerator:x}", f"{start.denominator:x}"],
        "denominators": [f"{value:x}" for value in found.denominator],
        "group": found.group.tolist(),
        "numerators": [f"{value:x}" for value in found.numerator],
        "gaps": [None if value is None else f"{value:x}" for value in found.gap],
        "gap_scales": [f"{value:x}" for value in found.gap_scale],
        "optimal": "".join(np.where(found.optimal_pairs, "1", "0")),
        "rank": None if found.rank is None else found.rank.tolist(),
        "weight": None if found.weight is None else [f"{value:x}" for value in found.weight],
    }


def _bounded(found: BoundedClaims) -> dict[str, object]:
    return {name: [x.hex() for x in getattr(found, name).tolist()] for name in VECTORS}


def exact_fields(path: str | Path) -> dict[str, Any]:
    """Read the fields of an exact certificate; raises ModelError where the file is not one."""
    file = _File(path, "exact")
    states, pairs = file.get("states", _count), file.get("pairs", _count)
    denominator = file.get("denominators", _list_of(_positive))
    group = file.get("group", _array_of(states))
    if group.max(initial=0) >= len(denominator):
        raise file.error("group")
    marks = file.get("optimal", _text)
    if len(marks) != pairs or not set(marks) <= {"0", "1"}:
        raise file.error("optimal")
    return {
        "model": file.get("model", _digest),
        "numerator": file.get("numerators", _list_of(_integer, states)),
        "group": group,
        "denominator": denominator,
        "policy": file.get("policy", _array_of(states)),
        "optimal_pairs": np.frombuffer(marks.encode(), dtype=np.uint8) == ord("1"),
        "gap": file.get("gaps", _list_of(_or_none(_positive), states)),
        "gap_scale": file.get("gap_scales", _list_of(_positive, states)),
        "unique": file.get("unique", _truth),
        "start_value": file.get("start_value", _fraction),
        "rank": file.get("rank", _or_none(_array_of(states))),
        "weight": file.get("weight", _or_none(_list_of(_integer, states))),
    }


def bounded_fields(path: str | Path) -> dict[str, Any]:
    """Read the fields of a bounded certificate; raises ModelError where the file is not one."""
    file = _File(path, "bounded")
    states = file.get("states", _count)
    lower, upper, weight = (file.get(name, _floats_of(states)) for name in VECTORS)
    return {
        "model": file.get("model", _digest),
        "lower": lower,
        "upper": upper,
        "policy": file.get("policy", _array_of(states)),
        "weight": weight,
    }


class _File:
    """The keys of a certificate file."""

    def __init__(self, path: str | Path, kind: str) -> None:
        self.path = str(path)
        try:
            data = json.loads(read_text(path, most=LARGEST))
        except (ValueError, RecursionError) as error:
            if isinstance(error, ModelError):
                raise
            raise ModelError(
                "the file is not JSON", where=self.path, fix="write it with Certificate.save"
            ) from error
        self.data = data if isinstance(data, dict) else {}
        wanted = {"format": FORMAT, "version": VERSION, "kind": kind}
        for key, value in wanted.items():
            if self.data.get(key) != value:
                raise ModelError(
                    f"{key} is {str(self.data.get(key))[:40]!r}, not {value!r}",
                    where=self.path,
                    fix=f"give a file with an {kind} certificate of this version",
                )

    def get(self, key: str, read: Callable[[Any], T]) -> T:
        """Return one key's value; raises ModelError where it is missing or of another form."""
        try:
            return read(self.data[key])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise self.error(key) from error

    def error(self, key: str) -> ModelError:
        """Return the error to raise where a key's value cannot be what was saved."""
        return ModelError(
            f"{key} is missing or damaged",
            where=self.path,
            fix="save the certificate again; solvers/proof/file.py describes the form",
        )


# ---- forms: each returns what was read, or raises ValueError or TypeError ------------------------


def _integer(text: str) -> int:
    if not HEXADECIMAL(text):
        raise ValueError
    return int(text, 16)


def _positive(text: str) -> int:
    value = _integer(text)
    if value <= 0:
        raise ValueError
    return value


def _fraction(pair: list[str]) -> Fraction:
    top, bottom = pair
    return fraction(_integer(top), _positive(bottom))


def _float(text: str) -> float:
    if not FLOAT(text):
        raise ValueError
    return float.fromhex(text)


def _count(value: object) -> int:
    if type(value) is not int or value < 1:
        raise ValueError
    return value


def _truth(value: object) -> bool:
    if type(value) is not bool:
        raise ValueError
    return value


def _text(value: object) -> str:
    if type(value) is not str:
        raise ValueError
    return value


def _digest(value: str) -> str:
    if not DIGEST(value):
        raise ValueError
    return value


def _or_none(read: Callable[[Any], T]) -> Callable[[Any], T | None]:
    return lambda value: None if value is None else read(value)


def _list_of(read: Callable[[Any], T], length: int | None = None) -> Callable[[Any], list[T]]:
    def listed(values: object) -> list[T]:
        if not isinstance(values, list) or not values or length not in (None, len(values)):
            raise ValueError
        return [read(value) for value in values]

    return listed


def _floats_of(length: int) -> Callable[[Any], Floats]:
    read = _list_of(_float, length)
    return lambda values: np.array(read(values), dtype=np.float64)


def _array_of(length: int) -> Callable[[Any], Integers]:
    """Return a reader of so many integers from 0 up."""

    def array(values: object) -> Integers:
        if not isinstance(values, list) or len(values) != length or set(map(type, values)) != {int}:
            raise ValueError
        if min(values) < 0:
            raise ValueError
        return np.array(values, dtype=np.int64)

    return array
