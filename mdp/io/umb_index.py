"""The index of a UMB file: sizes of the model, and the types of the numbers in its other files.

`index.json` holds one object each on the transition system, the annotations (rewards, labels and
others, by group and key) and the variables of the states. A key that is not known is passed over; a
value of another kind than the format says is a ValueError. A type is a word with a size in bits:

    bool 1    string, int, uint, double 64    rational 128    an interval twice that of its ends

unless a size is given. The package umbi checks the same with schemas that take 0.2 s to load.

Source of the format: https://pmc-tools.github.io/umb/spec
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")

BITS = {"bool": 1, "string": 64, "int": 64, "uint": 64, "double": 64, "rational": 128}
BITS |= {f"{word}-interval": 2 * BITS[word] for word in ("int", "uint", "double", "rational")}
APPLIES = ("states", "choices", "branches")


@dataclass(frozen=True)
class Kind:
    """The type of a number in a file."""

    type: str
    bits: int


TRUTH, WORD32, WORD64 = Kind("bool", 1), Kind("uint", 32), Kind("uint", 64)


@dataclass(frozen=True, kw_only=True)
class System:
    """The sizes of a transition system."""

    time: str
    players: int
    states: int
    initial: int
    choices: int
    actions: int
    branches: int
    observations: int
    probability: Kind | None


@dataclass(frozen=True, kw_only=True)
class Annotation:
    """What an annotation is called, and what it says something about."""

    alias: str
    description: str
    over: tuple[str, ...]
    kind: Kind


@dataclass(frozen=True, kw_only=True)
class Field:
    """Some bits of a state's variables; padding has no type."""

    name: str
    kind: Kind | None
    bits: int
    optional: bool


@dataclass(frozen=True, kw_only=True)
class Index:
    """What the index says.

    Attributes
    ----------
    variables : tuple of Field, optional
        How the variables of a state are packed, where all states have the same.
    """

    name: str
    system: System
    annotations: Mapping[str, Mapping[str, Annotation]]
    variables: tuple[Field, ...] | None


def index_of(data: bytes) -> Index:
    """Return the index in a file; raises ValueError where it is not one."""
    top = _object(json.loads(data.decode("utf-8")), "the index")
    groups = _named(top, "annotations")
    return Index(
        name=_given(_given(top, "model-data", dict, {}), "name", str, ""),
        system=_system(_needed(top, "transition-system", dict)),
        annotations={
            group: {key: _annotation(_object(about, key)) for key, about in named.items()}
            for group, named in groups.items()
        },
        variables=_variables(_named(top, "valuations").get("states")),
    )


def _system(said: Mapping[str, Any]) -> System:
    found = System(
        time=_needed(said, "time", str),
        players=_size(said, "#players"),
        states=_size(said, "#states"),
        initial=_size(said, "#initial-states"),
        choices=_size(said, "#choices"),
        actions=_size(said, "#choice-actions"),
        branches=_size(said, "#branches"),
        observations=_size(said, "#observations"),
        probability=_kind(said, "branch-probability-type"),
    )
    if found.states == 0 or found.initial > found.states:
        raise ValueError(f"{found.initial} initial states of {found.states}")
    kind = found.probability
    if kind is not None and kind.type.partition("-")[0] not in ("double", "rational"):
        raise ValueError(f"probabilities of type {kind.type}")
    return found


def _annotation(said: Mapping[str, Any]) -> Annotation:
    over, kind = _given(said, "applies-to", list, []), _kind(said, "type")
    if kind is None or any(each not in APPLIES for each in over):
        raise ValueError("an annotation has no type, or applies to something unknown")
    return Annotation(
        alias=_given(said, "alias", str, ""),
        description=_given(said, "description", str, ""),
        over=tuple(over),
        kind=kind,
    )


def _variables(said: Mapping[str, Any] | None) -> tuple[Field, ...] | None:
    classes = [] if said is None else _needed(said, "classes", list)
    if len(classes) != 1:
        return None
    listed = _needed(_object(classes[0], "classes"), "variables", list)
    return tuple(_field(_object(each, "variables")) for each in listed)


def _field(said: Mapping[str, Any]) -> Field:
    if "padding" in said:
        return Field(name="", kind=None, bits=_size(said, "padding"), optional=False)
    name, kind = _needed(said, "name", str), _kind(said, "type")
    optional = _given(said, "is-optional", bool, False)
    if kind is None or kind.type.endswith("-interval") or _given(said, "offset", int, 0):
        raise ValueError(f"the variable {name} is an interval, has no type, or an offset")
    # A flag of presence goes with each value that may be missing.
    return Field(name=name, kind=kind, bits=kind.bits + optional, optional=optional)


def _kind(said: Mapping[str, Any], key: str) -> Kind | None:
    found = _given(said, key, dict, None)
    if found is None:
        return None
    word = _needed(found, "type", str)
    if word not in BITS:
        raise ValueError(f"unknown type {word[:40]}")
    bits = _size(found, "size") if "size" in found else BITS[word]
    fixed = word in ("string", "double") and bits != BITS[word]
    ends = (1 + ("rational" in word)) * (1 + word.endswith("-interval"))
    if bits == 0 or bits % ends or fixed:
        raise ValueError(f"{bits} bits for a {word}")
    return Kind(word, bits)


def _size(said: Mapping[str, Any], key: str) -> int:
    found = _needed(said, key, int)
    if not 0 <= found < 2**64:
        raise ValueError(f"{key} is {found}")
    return found


def _named(said: Mapping[str, Any], key: str) -> dict[str, dict[str, Any]]:
    return {name: _object(each, name) for name, each in _given(said, key, dict, {}).items()}


def _object(found: Any, where: str) -> dict[str, Any]:
    if not isinstance(found, dict):
        raise ValueError(f"{where[:40]} is not a JSON object")
    return found


def _needed(said: Mapping[str, Any], key: str, kind: type[T]) -> T:
    found: T | None = _given(said, key, kind, None)
    if found is None:
        raise ValueError(f'the index has no "{key}"')
    return found


def _given(said: Mapping[str, Any], key: str, kind: type[T], default: Any) -> Any:
    found = said.get(key)
    if found is None:
        return default
    if not isinstance(found, kind) or (kind is int and isinstance(found, bool)):
        raise ValueError(f'"{key}" is not of type {kind.__name__}')
    return found
