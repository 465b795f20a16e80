"""The parts of a model in our files, each said once: how it is written in JSON and read back.

The header of a `.npz` file, and so of a `.umb` file, and a `model.json` share these parts. Numbers
are integers, or texts: "1/3", or in hexadecimal "0x1f". Integers of 2^53 and above are texts,
because some programs would round them. A file, also a certificate, states its format and version.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.structured import or_null, refuse_value
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import EXACT_IN_FLOAT, OutcomeTable
from exact_mdp.mdp.validate import Flags

MODEL = "exact-mdp model"  # the format of both kinds of files
SETS = ("goal", "target")
FLOATS = ("float_probabilities", "float_rewards")
NUMBER = re.compile(r"-?(0x[0-9a-f]+|[0-9]+)(/(0x[0-9a-f]+|[0-9]+))?")


# ---- numbers -------------------------------------------------------------------------------------


def parse_rational(given: Any) -> Fraction:
    """Return a rational number from the form that `encode_rationals` writes."""
    if type(given) is int:
        return Fraction(given)
    if isinstance(given, str) and NUMBER.fullmatch(given):
        top, _, below = given.partition("/")
        try:
            return Fraction(int(top, 0), int(below or "1", 0))
        except (ValueError, ZeroDivisionError):  # 007, 1/0, or digits beyond Python's limit
            pass
    refuse_value(given, 'an integer, or a text such as "1/3" or "0x1f"')


def parse_natural(given: Any) -> int:
    """Return the number of a state, an action or the like."""
    if type(given) is int and 0 <= given < 2**62:
        return given
    refuse_value(given, "a whole number from 0 up, below 2^62")


def parse_positive(given: Any) -> int:
    """Return a positive integer."""
    value = parse_rational(given)
    if value <= 0 or value.denominator != 1:
        refuse_value(given, "a positive integer")
    return value.numerator


def encode_rationals(value: Any) -> Any:
    """Return a value in JSON's types: rationals as integers or texts, tuples as lists."""
    if isinstance(value, dict):
        return {key: encode_rationals(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return list(map(encode_rationals, value))
    if not isinstance(value, Fraction):
        return value
    top, below = value.numerator, value.denominator
    if below == 1:
        return encode_integer(top)
    if max(abs(top), below) < EXACT_IN_FLOAT:
        return f"{top}/{below}"
    return encode_hexadecimal(value)


def encode_integer(value: int) -> int | str:
    """Return an integer for JSON; a large one, which some programs would round, as a text."""
    if abs(value) < EXACT_IN_FLOAT:
        return value
    return hex(value)


def encode_hexadecimal(value: Fraction) -> str:
    """Return a rational as a text of two integers, "0x1/0x3"."""
    return f"{hex(value.numerator)}/{hex(value.denominator)}"


# ---- parts of a model ----------------------------------------------------------------------------


def parse_unreached(given: Any) -> float:
    """Return the value of a run that never reaches the goal, "inf" or "-inf", as a float."""
    if isinstance(given, str) and given in ("inf", "-inf"):
        return float(given)
    refuse_value(given, '"inf" or "-inf"')


PARTS: dict[str, Any] = {
    "name": str,
    "discount": parse_rational,
    "sense": str,
    **dict.fromkeys(FLOATS, bool),
    "unreached": parse_unreached,
    "time_limit": or_null(parse_positive),
    "averaged": or_null(bool),
}
"""The required shapes of the parts that all files share."""


def encode_parts(mdp: MDP) -> dict[str, Any]:
    """Return the shared parts of a model; `averaged` is left out unless it is true."""
    parts = {name: getattr(mdp, name) for name in ("name", "sense", *FLOATS, "time_limit")}
    parts |= {"discount": mdp.discount_exact, "unreached": str(mdp.unreached)}
    if mdp.table.averaged:
        parts["averaged"] = True
    return parts


def list_sets(mdp: MDP) -> dict[str, Flags]:
    """Return the states that a question is about: its goal, or else its target; {} without any."""
    sets = {"goal": mdp.goal, "target": mdp.target}
    if mdp.goal is not None:
        del sets["target"]
    return {name: states for name, states in sets.items() if states is not None}


def build_model(head: Mapping[str, Any], table: OutcomeTable, **others: Any) -> MDP:
    """Return the model with the shared parts of a file, and others that it states its own way."""
    shared = {name: head[name] for name in PARTS if name not in ("discount", "averaged")}
    table = replace(table, averaged=bool(head["averaged"]))
    return MDP(table, discount_exact=head["discount"], **shared, **others)


# ---- files ---------------------------------------------------------------------------------------


def states_format(given: Any, name: str, version: int) -> bool:
    """Return whether an object states a format and a version, an integer (not 2.0 or true)."""
    if not isinstance(given, dict):
        return False
    stated = given.get("version")
    return given.get("format") == name and stated == version and type(stated) is int


def write_object(path: str | Path, content: Mapping[str, Any], listed: Iterable[str] = ()) -> None:
    """Write a JSON object, completely or not at all, with a line for each key.

    The keys in `listed` are written last, with a line for each entry.
    """
    lines = [f"{json.dumps(k)}: {json.dumps(content[k])}" for k in content if k not in listed]
    for key in listed:
        entries = ",\n  ".join(map(json.dumps, content[key]))
        lines.append(f"{json.dumps(key)}: [\n  {entries}]")
    write_atomically(path, "{" + ",\n ".join(lines) + "}\n")
