"""A backend that keeps what passes through it: the requests, and what the answers took."""

from __future__ import annotations

from typing import Any

from paper_repro.agents.protocol import Backend, Reply, Request


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
