"""What is asked of a language model and what comes back: messages and a schema in, an object out.

A backend is anything with `describe` and `answer`. It returns an object that fits the request's
schema, or raises BackendError; there is no third outcome. `Tap` is a backend that keeps what passes
through it to another one.

Answers and files have their form as JSON Schema. The part of JSON Schema 2020-12 that is used:
objects with properties, those that are required and whether there may be others; strings with a
least and a greatest length, a pattern or a list; whole numbers with limits or a list; arrays with
items and a least length.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from exact_mdp.mdp.errors import ModelError

PURPOSES = ("behaviour", "perception", "execution")


def plain(text: object) -> str:
    """Return text on one line, without control characters.

    Examples
    --------
    >>> plain("one\\nTimestep 7\\x1b[31m")
    'one Timestep 7 [31m'
    """
    return " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())


class BackendError(ModelError):
    """A backend that could not answer: unreachable, refusing, or never in the asked form."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """One question to a backend.

    Attributes
    ----------
    purpose : one of `PURPOSES`
    messages : tuple of (role, content)
        What a language model reads.
    schema : JSON schema of the answer
    facts : the same content as data, for a backend that reads no prose
    seed : int
        Chooses among the possible answers.

    Examples
    --------
    >>> request = Request(
    ...     purpose="perception", messages=(("user", "hello"),), schema={}, facts={}, seed=1
    ... )
    >>> len(request.digest)
    64
    """

    purpose: str
    messages: tuple[tuple[str, str], ...]
    schema: Mapping[str, Any]
    facts: Mapping[str, Any]
    seed: int

    @property
    def digest(self) -> str:
        """SHA-256 of everything asked, by which a recording knows its own requests."""
        text = json.dumps(vars(self), sort_keys=True, ensure_ascii=False)
        return hashlib.sha256(text.encode("utf-8")).hexdigest()


@dataclass(frozen=True, kw_only=True)
class Reply:
    """A validated answer, and what it took.

    Attributes
    ----------
    data : object that fits the request's schema
    attempts : how often the backend was asked, 1 where the first answer was good
    prompt_tokens, completion_tokens : as the backend counts them, over all attempts; no prompt
        tokens where it left one of them uncounted
    seconds : wall time, 0 where it is not measured
    """

    data: Mapping[str, Any]
    attempts: int = 1
    prompt_tokens: int = 0
    completion_tokens: int = 0
    seconds: float = 0.0


class Backend(Protocol):
    """Answers requests. `describe` says what it is, without any secret."""

    def describe(self) -> dict[str, Any]:
        """Return name and settings, as they go into a recording's header."""
        ...

    def answer(self, request: Request) -> Reply:
        """Return an answer that fits the request's schema; raises BackendError."""
        ...


class Tap:
    """Passes requests on to another backend; keeps them in `requests` and adds up the answers.

    Attributes
    ----------
    requests : list of Request
    used : {"requests", "attempts", "prompt_tokens", "completion_tokens"}
    uncounted : answers whose tokens the backend did not count
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self.requests: list[Request] = []
        self.uncounted = 0
        self.used = dict.fromkeys(("requests", "attempts", "prompt_tokens", "completion_tokens"), 0)

    def describe(self) -> dict[str, Any]:
        """Return the description of the backend behind."""
        return self._backend.describe()

    def answer(self, request: Request) -> Reply:
        """Keep the request and return the answer of the backend behind."""
        self.requests.append(request)
        reply = self._backend.answer(request)
        self.used["requests"] += 1
        self.uncounted += reply.prompt_tokens == 0
        for name in ("attempts", "prompt_tokens", "completion_tokens"):
            self.used[name] += getattr(reply, name)
        return reply


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
        yield f"{where} holds half of a surrogate pair, which is not text"
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
