"""The form of every answer and file of the agents, as JSON Schema, and the check of it.

The part of JSON Schema 2020-12 that is used: objects with properties, those that are required and
whether there may be others; strings with a least and a greatest length, a pattern or a list;
whole numbers with limits or a list; arrays with items and a least length.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Schema = Mapping[str, Any]

LONGEST = 1200  # characters of a described behaviour or an utterance
LISTED = 40  # characters shown of a number that does not fit

TEXT: Schema = {"type": "string"}
OBJECT: Schema = {"type": "object"}


def record(properties: Mapping[str, Schema], *, others: bool | Schema = False) -> dict[str, Any]:
    """Return the schema of an object with these parts, and whether there may be others."""
    return {
        "type": "object",
        "properties": dict(properties),
        "required": list(properties),
        "additionalProperties": others,
    }


def whole(least: int = 0, most: int | None = None) -> dict[str, Any]:
    """Return the schema of a whole number."""
    return {"type": "integer", "minimum": least} | ({} if most is None else {"maximum": most})


def listed(items: Schema, least: int = 0) -> dict[str, Any]:
    """Return the schema of an array."""
    return {"type": "array", "items": items, "minItems": least}


def behaviour_schema() -> dict[str, Any]:
    """Return the schema of a behaviour: something seen, and words, which may be none."""
    return record(
        {
            "nonverbal": {"type": "string", "minLength": 1, "maxLength": LONGEST},
            "verbal": {"type": "string", "minLength": 0, "maxLength": LONGEST},
        }
    )


def perception_schema(statuses: Sequence[str]) -> dict[str, Any]:
    """Return the schema of a perceived status vector: 0 or 1 for each status."""
    return record({status: {"type": "integer", "enum": [0, 1]} for status in statuses})


def execution_schema() -> dict[str, Any]:
    """Return the schema of what the robot says."""
    return record({"speech": {"type": "string", "minLength": 1, "maxLength": LONGEST}})


def violations(value: object, schema: Schema, where: str = "answer") -> list[str]:
    """Return what keeps a decoded JSON value from fitting a schema; empty where it fits.

    Examples
    --------
    >>> violations({"speech": ""}, execution_schema())
    ['answer.speech has 0 characters, fewer than 1']
    """
    check = _CHECKS[schema["type"]] if schema else None
    return [] if check is None else list(check(value, schema, where))


def _object(value: object, schema: Schema, where: str) -> Iterator[str]:
    if not isinstance(value, dict):
        yield f"{where} is not an object"
        return
    properties = schema.get("properties", {})
    yield from (f"{where} lacks {name}" for name in schema.get("required", ()) if name not in value)
    for name, part in value.items():
        if name in properties:
            yield from violations(part, properties[name], f"{where}.{name}")
            continue
        others = schema.get("additionalProperties", True)
        if isinstance(others, Mapping):
            yield from violations(part, others, f"{where}.{name}")
        elif not others:
            yield f"{where} has a part that was not asked for"


def _array(value: object, schema: Schema, where: str) -> Iterator[str]:
    if not isinstance(value, list) or len(value) < schema["minItems"]:
        yield f"{where} is not a list of at least {schema['minItems']}"
        return
    for number, part in enumerate(value):
        yield from violations(part, schema["items"], f"{where}[{number}]")


def _string(value: object, schema: Schema, where: str) -> Iterator[str]:
    if not isinstance(value, str):
        yield f"{where} is not a string"
        return
    least, most = schema.get("minLength", 0), schema.get("maxLength")
    if any("\ud800" <= letter <= "\udfff" for letter in value):
        yield f"{where} holds half of a surrogate pair, which is no text"
    elif len(value) < least:
        yield f"{where} has {len(value)} characters, fewer than {least}"
    elif most is not None and len(value) > most:
        yield f"{where} has {len(value)} characters, more than {most}"
    elif not re.fullmatch(schema.get("pattern", "(?s:.*)"), value):
        yield f"{where} is not of the form {schema['pattern']}"
    elif value not in schema.get("enum", (value,)):
        yield f"{where} is not one of {', '.join(schema['enum'])}"


def _integer(value: object, schema: Schema, where: str) -> Iterator[str]:
    among = schema.get("enum")
    if isinstance(value, float) and among is not None and value.is_integer():
        value = int(value)  # an answer may write 1.0
    if not isinstance(value, int) or isinstance(value, bool):
        yield f"{where} is not a whole number"
    elif among is not None and value not in among:
        yield f"{where} is {str(value)[:LISTED]}, not one of {', '.join(map(str, among))}"
    elif not schema.get("minimum", value) <= value <= schema.get("maximum", value):
        yield f"{where} is {str(value)[:LISTED]}, outside of its limits"


_CHECKS = {"object": _object, "array": _array, "string": _string, "integer": _integer}
