"""The JSON Schema of scenario files, by which editors complete and check them as they are written.

It follows from the keys, readings and weights that the reader of scenarios knows (`toml.KEYS`,
`tables`). `schema.json` beside this module is what `text` returns; a test compares the two, and
`python -m exact_mdp.mdp.care.schema > mdp/care/schema.json` writes it again.
"""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from exact_mdp.mdp.care.tables import READINGS, SHARED_WEIGHTS
from exact_mdp.mdp.care.toml import KEYS

FILE = files("exact_mdp.mdp.care") / "schema.json"
RATIO = {"type": "string", "pattern": r"^[-+]?[0-9.]+([eE][-+]?[0-9]+)?(/[0-9]+)?$"}
NUMBER = {"anyOf": [{"type": "number"}, RATIO]}
CHANCE = {"anyOf": [{"type": "number", "minimum": 0, "maximum": 1}, RATIO]}
TEXT = {"type": "string"}
WORDS = {
    "type": "array",
    "items": {"type": "string", "pattern": r"^[^.]+$"},
    "minItems": 1,
    "uniqueItems": True,
}
COUNT = {"type": "integer", "minimum": 1}


def _each(form: dict[str, Any]) -> dict[str, Any]:
    """Return a table that has any names, all of one form."""
    return {"type": "object", "additionalProperties": form}


def _all(*names: str) -> dict[str, Any]:
    """Return a table that has these probabilities and no other."""
    chances = {name: TEXT if name == "other" else CHANCE for name in names}
    return {"properties": chances, "required": list(names), "additionalProperties": False}


FORMS: dict[str, dict[str, Any]] = {
    **dict.fromkeys(("name", "title", "source"), TEXT),
    **dict.fromkeys(("statuses", "actions"), WORDS),
    "tasks": {"type": "array", "items": COUNT, "minItems": 1},
    "max_trial": COUNT,
    "discount": CHANCE,
    "readings": {
        "type": "object",
        "properties": {name: {"enum": list(options)} for name, options in READINGS.items()},
        "additionalProperties": False,
    },
    "status_weight": _each(TEXT),
    **dict.fromkeys(("base", "persistence"), _each(CHANCE)),
    "influence": _each(_each(CHANCE)),
    "assistance": _each(_each({"type": "object", **_all("persistence", "onset")})),
    "skip": _each(
        {"type": "object", "anyOf": [_all("persistence"), _all("other", "alone", "with-other")]}
    ),
    "reward": {
        "type": "object",
        "properties": {**dict.fromkeys(SHARED_WEIGHTS, NUMBER), "assist": _each(NUMBER)},
        "additionalProperties": NUMBER,
    },
}


def schema() -> dict[str, Any]:
    """Return the schema of a scenario file."""
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "A care scenario of exact-mdp",
        "type": "object",
        "properties": {key: {"description": said, **FORMS[key]} for key, said in KEYS.items()},
        "required": ["statuses", "actions", "tasks", "max_trial"],
        "additionalProperties": False,
    }


def text() -> str:
    """Return what `schema.json` holds."""
    return json.dumps(schema(), indent=1) + "\n"


if __name__ == "__main__":
    print(text(), end="")
