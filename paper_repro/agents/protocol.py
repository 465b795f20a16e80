"""What is asked of a language model and what comes back: messages and a schema in, an object out.

A backend is anything with `describe` and `answer`. It returns an object that fits the request's
schema, or raises BackendError; there is no third outcome. `Tap` is a backend that keeps what passes
through it to another one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
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
