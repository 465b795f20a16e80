"""The JSON schemas of the three answers, and a check of the part of JSON Schema that they use.

The subset: objects with required and no additional properties, strings with a least and a
greatest length, whole numbers from an enumeration. Source of the terms: JSON Schema 2020-12.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

LONGEST = 1200  # characters of a described behaviour or an utterance

Schema = Mapping[str, Any]


def _record(properties: Mapping[str, Schema]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": dict(properties),
        "required": list(properties),
        "additionalProperties": False,
    }


def behaviour_schema() -> dict[str, Any]:
    """Return the schema of a behaviour: something seen, and words, which may be none."""
    return _record(
        {
            "nonverbal": {"type": "string", "minLength": 1, "maxLength": LONGEST},
            "verbal": {"type": "string", "minLength": 0, "maxLength": LONGEST},
        }
    )


def perception_schema(statuses: Sequence[str]) -> dict[str, Any]:
    """Return the schema of a perceived status vector: 0 or 1 for each status."""
    return _record({status: {"type": "integer", "enum": [0, 1]} for status in statuses})


def execution_schema() -> dict[str, Any]:
    """Return the schema of what the robot says."""
    return _record({"speech": {"type": "string", "minLength": 1, "maxLength": LONGEST}})


def violations(value: object, schema: Schema, where: str = "answer") -> list[str]:
    """Return what keeps a decoded JSON value from fitting a schema; empty where it fits.

    Examples
    --------
    >>> violations({"speech": ""}, execution_schema())
    ['answer.speech has 0 characters, fewer than 1']
    """
    match schema["type"]:
        case "object":
            return _object(value, schema, where)
        case "string":
            return _string(value, schema, where)
        case "integer":
            return _integer(value, schema, where)
    raise ValueError(f"schema type {schema['type']!r} is outside the supported part")


def _object(value: object, schema: Schema, where: str) -> list[str]:
    if not isinstance(value, dict):
        return [f"{where} is not an object"]
    found = [f"{where} lacks {name}" for name in schema["required"] if name not in value]
    for name, part in value.items():
        inner = schema["properties"].get(name)
        if inner is None:
            found.append(f"{where} has a part that was not asked for")
        else:
            found += violations(part, inner, f"{where}.{name}")
    return found


def _string(value: object, schema: Schema, where: str) -> list[str]:
    if not isinstance(value, str):
        return [f"{where} is not a string"]
    if any("\ud800" <= letter <= "\udfff" for letter in value):
        return [f"{where} holds half of a surrogate pair, which is no text"]
    length, least, most = len(value), schema["minLength"], schema["maxLength"]
    if length < least:
        return [f"{where} has {length} characters, fewer than {least}"]
    if length > most:
        return [f"{where} has {length} characters, more than {most}"]
    return []


def _integer(value: object, schema: Schema, where: str) -> list[str]:
    whole = isinstance(value, int) or (isinstance(value, float) and value.is_integer())
    if isinstance(value, bool) or not whole:
        return [f"{where} is not a whole number"]
    if value not in schema["enum"]:
        listed = ", ".join(map(str, schema["enum"]))
        return [f"{where} is {str(value)[:40]}, not one of {listed}"]
    return []
