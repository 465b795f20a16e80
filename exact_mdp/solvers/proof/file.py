"""Certificates as files: JSON, to be read by any program.

All kinds have the keys

    format        "exact-mdp certificate"
    version       1
    kind          "exact", "bounded" or "average"; "front" or "limits"
    model         SHA-256 of the model, see `mdp.exact`

and, but for the last four kinds (`solvers.objectives.file`),

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
    endless       only where some policy never ends (`solvers.proof.endless`):
                  {"sign": [S of -1, 0, 1: 1 where the value is infinite], "rank": [S integers],
                  "order": [S integers], "potential": [S rationals], "drift": null, or two lists
                  of S rationals}; a rational is [numerator, denominator]

An infinite start_value is "inf" or "-inf". Every integer of unbounded size is a string in
hexadecimal, such as "-1f4" for -500: Python refuses to read or write more than 4,300 decimal
digits, and hexadecimal takes linear time. A bounded certificate has

    lower, upper, weight   [S floats], each a string in C99's hexadecimal form, such as "0x1.8p+1"

and one of an average reward per step

    start_value   [numerator, denominator]
    g, h, w       {"top": [S integers], "below": integer}: gain, bias, and the bias of -h

What is read is checked for its form; whether its claims hold is for `violations` to say.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import LARGEST, read_text, write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.average.checker import AverageClaims, Rationals
from exact_mdp.solvers.proof.checker import BoundedClaims, ExactClaims
from exact_mdp.solvers.proof.endless import EndlessClaims
from exact_mdp.solvers.proof.rationals import fraction

FORMAT, VERSION = "exact-mdp certificate", 1
VECTORS = ("lower", "upper", "weight")
AVERAGES = ("g", "h", "w")

Read = Callable[[Any], Any]


def model_of(given: MDP | None, own: MDP | None, where: str = "violations") -> MDP:
    """Return the model given, or else the certificate's own; raises ModelError without either."""
    mdp = own if given is None else given
    if mdp is None:
        raise ModelError(
            "a certificate read from a file does not contain the model",
            where=where,
            fix="give the model: certificate.violations(mdp)",
        )
    return mdp


def save(found: ExactClaims | BoundedClaims | AverageClaims, path: str | Path) -> None:
    """Write a certificate, whole or not at all."""
    kind, body = _body(found)
    own = {"states": len(found.policy), "policy": found.policy.tolist()}
    write(path, kind, found.model, own | body)


def write(path: str | Path, kind: str, model: str, body: dict[str, object]) -> None:
    """Write the keys of a certificate of some kind, whole or not at all."""
    head = {"format": FORMAT, "version": VERSION, "kind": kind, "model": model}
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in (head | body).items()]
    write_atomically(path, "{" + ",\n ".join(lines) + "}\n")


def _body(found: ExactClaims | BoundedClaims | AverageClaims) -> tuple[str, dict[str, object]]:
    if isinstance(found, ExactClaims):
        return "exact", _exact(found)
    if isinstance(found, BoundedClaims):
        return "bounded", {
            name: [x.hex() for x in getattr(found, name).tolist()] for name in VECTORS
        }
    start, vectors = found.start_value, {name: getattr(found, name) for name in AVERAGES}
    return "average", {
        "start_value": hexed([start.numerator, start.denominator]),
        **{name: {"top": hexed(x.top), "below": f"{x.below:x}"} for name, x in vectors.items()},
    }


def _exact(found: ExactClaims) -> dict[str, object]:
    return {
        "pairs": len(found.optimal_pairs),
        "unique": found.unique,
        "start_value": hexed_ratio(found.start_value),
        "denominators": hexed(found.denominator),
        "group": found.group.tolist(),
        "numerators": hexed(found.numerator),
        "gaps": hexed(found.gap),
        "gap_scales": hexed(found.gap_scale),
        "optimal": "".join(np.where(found.optimal_pairs, "1", "0")),
        "rank": None if found.rank is None else found.rank.tolist(),
        **({} if found.endless is None else {"endless": _endless(found.endless)}),
    }


def _endless(found: EndlessClaims) -> dict[str, object]:
    listed = {name: getattr(found, name).tolist() for name in ("sign", "rank", "order")}
    drift = None if found.drift is None else [list(map(hexed_ratio, each)) for each in found.drift]
    return listed | {"potential": list(map(hexed_ratio, found.potential)), "drift": drift}


def hexed_ratio(number: Fraction | float) -> object:
    """Return a rational, or an infinity, as a file holds it."""
    if isinstance(number, float):
        return str(number)  # "inf" or "-inf"
    return hexed([number.numerator, number.denominator])


def hexed(numbers: Sequence[int | None]) -> list[str | None]:
    """Return integers in hexadecimal."""
    return [None if number is None else f"{number:x}" for number in numbers]


def exact_fields(path: str | Path) -> dict[str, Any]:
    """Read the fields of an exact certificate; raises ModelError where the file is not one."""
    file = ProofFile(path, "exact")
    states, pairs = file.get("states", count), file.get("pairs", count)
    found = {
        "model": file.get("model", digest),
        "numerator": file.get("numerators", list_of(integer, states)),
        "group": file.get("group", array_of(states)),
        "denominator": file.get("denominators", list_of(positive)),
        "policy": file.get("policy", array_of(states)),
        "gap": file.get("gaps", list_of(or_none(positive), states)),
        "gap_scale": file.get("gap_scales", list_of(positive, states)),
        "unique": file.get("unique", typed(bool)),
        "start_value": file.get("start_value", _value),
        "rank": file.get("rank", or_none(array_of(states))),
    }
    if "endless" in file.data:
        found["endless"] = file.get("endless", partial(_endless_of, states))
    marks = file.get("optimal", typed(str))
    if found["group"].max(initial=0) >= len(found["denominator"]):
        raise file.error("group")
    if len(marks) != pairs or not set(marks) <= {"0", "1"}:
        raise file.error("optimal")
    marked = np.frombuffer(marks.encode(), dtype=np.uint8) == ord("1")
    return found | {"optimal_pairs": marked}


def bounded_fields(path: str | Path) -> dict[str, Any]:
    """Read the fields of a bounded certificate; raises ModelError where the file is not one."""
    file = ProofFile(path, "bounded")
    states = file.get("states", count)
    vectors = {name: np.array(file.get(name, list_of(_float, states))) for name in VECTORS}
    names = {"model": file.get("model", digest), "policy": file.get("policy", array_of(states))}
    return names | vectors


def average_fields(path: str | Path) -> dict[str, Any]:
    """Read the fields of a certificate of an average; raises ModelError where it is not one."""
    file = ProofFile(path, "average")
    states = file.get("states", count)
    vectors = {name: file.get(name, over_one(states)) for name in AVERAGES}
    return vectors | {
        "model": file.get("model", digest),
        "policy": file.get("policy", array_of(states)),
        "start_value": file.get("start_value", ratio),
    }


class ProofFile:
    """The keys of a certificate file."""

    def __init__(self, path: str | Path, kind: str) -> None:
        self.path = str(path)
        try:
            data = json.loads(read_text(path, most=LARGEST))
        except (ValueError, RecursionError) as error:
            if isinstance(error, ModelError):
                raise
            raise ModelError(
                "the file is not JSON",
                where=self.path,
                fix="write it again, with save or --certificate",
            ) from error
        self.data = data if isinstance(data, dict) else {}
        for key, value in {"format": FORMAT, "version": VERSION, "kind": kind}.items():
            if self.data.get(key) != value:
                raise ModelError(
                    f"{key} is {str(self.data.get(key))[:40]!r}, not {value!r}",
                    where=self.path,
                    fix=f"give a file with an {kind} certificate of this version",
                )

    def get(self, key: str, read: Read) -> Any:
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
            fix="save the certificate again; help(exact_mdp.solvers.proof.file) describes the form",
        )


# ---- forms: each returns what was read, or raises ValueError or TypeError ------------------------


def wanted(value: Any, right: bool) -> Any:
    """Return a value that is right; raises ValueError for another."""
    if not right:
        raise ValueError
    return value


def typed(kind: type) -> Read:
    """Return a reader of values of one type."""
    return lambda value: wanted(value, type(value) is kind)


def _matching(pattern: str, read: Read) -> Read:
    fits = re.compile(pattern).fullmatch
    return lambda text: read(wanted(text, fits(text) is not None))


integer = _matching(r"-?[0-9a-f]+", partial(int, base=16))
_float = _matching(r"-?0x[01]\.[0-9a-f]{1,13}p[+-][0-9]{1,4}", float.fromhex)
digest = _matching(r"[0-9a-f]{64}", str)


def positive(text: str) -> int:
    """Read an integer above 0."""
    value = integer(text)
    return int(wanted(value, value > 0))


def ratio(pair: list[str]) -> Fraction:
    """Read a rational."""
    top, bottom = pair
    return fraction(integer(top), positive(bottom))


def over_one(length: int) -> Read:
    """Return a reader of this many integers over one denominator."""
    return lambda parts: Rationals(list_of(integer, length)(parts["top"]), positive(parts["below"]))


def _value(content: Any) -> Fraction | float:
    return float(content) if content in ("inf", "-inf") else ratio(content)


def _endless_of(states: int, content: dict[str, Any]) -> EndlessClaims:
    """Return the claims; one that is missing is a KeyError, as a key of the file is."""
    rationals, drift = list_of(ratio, states), content["drift"]
    means, biases = ([], []) if drift is None else map(rationals, drift)
    signs = np.array(list_of(typed(int), states)(content["sign"]), dtype=np.int64)
    return EndlessClaims(
        sign=wanted(signs, bool((np.abs(signs) <= 1).all())),
        rank=array_of(states)(content["rank"]),
        order=array_of(states)(content["order"]),
        potential=rationals(content["potential"]),
        drift=None if drift is None else (means, biases),
    )


def count(value: object) -> int:
    """Read a number of things."""
    number = typed(int)(value)
    return int(wanted(number, number >= 1))


def or_none(read: Read) -> Read:
    """Return a reader that takes null, too."""
    return lambda value: None if value is None else read(value)


def list_of(read: Read, length: int | None = None) -> Read:
    """Return a reader of a list that is not empty, or of one of a length."""

    def listed(values: object) -> list[Any]:
        if not isinstance(values, list) or length not in (None, len(values)):
            raise ValueError
        if length is None and not values:
            raise ValueError
        return [read(value) for value in values]

    return listed


def array_of(length: int) -> Read:
    """Return a reader of this many integers from 0 up."""

    def array(values: object) -> Integers:
        if not isinstance(values, list) or len(values) != length or set(map(type, values)) != {int}:
            raise ValueError
        return np.array(wanted(values, min(values) >= 0), dtype=np.int64)

    return array
