"""The openai backend: any endpoint that speaks chat completions, by its base URL.

The key is read from the environment when the backend is made, goes into one request header, and
nowhere else: not into a recording, a message or a `repr`. Too many requests (429), server errors,
dropped connections and time-outs are tried again after 1, 2, 4 … seconds, or as long as the
endpoint asks for; every other status stops the run with a message.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np

from mdp.errors import ModelError
from paper_repro.agents.chat import Style, ask
from paper_repro.agents.protocol import BackendError, Reply, Request

if TYPE_CHECKING:
    import httpx

AGAIN = (408, 409, 429, 500, 502, 503, 504)
LONGEST_WAIT = 60.0
LONGEST_ANSWER = 4_000_000  # bytes
LOOPBACK = ("localhost", "127.0.0.1", "::1")


class Transient(Exception):
    """A failure that may pass: what happened, and how long the endpoint asks to wait."""

    def __init__(self, what: str, wait: float | None = None) -> None:
        super().__init__(what)
        self.wait = wait


@dataclass(frozen=True, kw_only=True, repr=False)
class Endpoint:
    """A model behind an endpoint.

    Attributes
    ----------
    model : the model's name there
    base_url : such as http://127.0.0.1:8080/v1
    style : how it is asked
    timeout : seconds for a whole answer
    sleep : waits between attempts
    """

    model: str
    base_url: str
    key_variable: str = "OPENAI_API_KEY"
    style: Style = field(default_factory=Style)
    timeout: float = 60.0
    sleep: Callable[[float], None] = time.sleep

    def __post_init__(self) -> None:
        try:
            parts = urlsplit(self.base_url)
            sound = parts.port != 0 and self.base_url.isprintable()
        except ValueError:  # a bracket or a port that is none
            sound = False
        if not sound or parts.scheme not in ("http", "https") or not parts.hostname:
            raise ModelError(
                "the base URL is no http or https address",
                where="--base-url",
                fix="write https://…",
            )
        if parts.username or parts.password or parts.query:
            raise ModelError(
                "the base URL holds credentials or a query, which would be recorded",
                where="--base-url",
                fix=f"put the key into the environment as {self.key_variable}",
            )
        if parts.scheme == "http" and parts.hostname not in LOOPBACK and self._key():
            raise ModelError(
                "a key would travel unencrypted",
                where="--base-url",
                fix=f"use https, or unset {self.key_variable}",
            )
        object.__setattr__(self, "_client", self._connect())

    def __repr__(self) -> str:
        return f"Endpoint(model={self.model!r}, base_url={self.base_url!r})"

    def describe(self) -> dict[str, Any]:
        """Return the endpoint and how it is asked; the key is no part of it."""
        return {
            "backend": "openai",
            "model": self.model,
            "base_url": self.base_url,
            "temperature": self.style.temperature,
            "max_tokens": self.style.max_tokens,
            "response_format": self.style.shape,
        }

    def answer(self, request: Request) -> Reply:
        """Return an answer that fits the schema; raises BackendError."""
        return ask(request, self.style, self._post, self.base_url)

    def close(self) -> None:
        """Close the connections."""
        self._http().close()

    def _key(self) -> str:
        return os.environ.get(self.key_variable, "").strip()

    def _http(self) -> httpx.Client:
        client: httpx.Client = self.__dict__["_client"]
        return client

    def _connect(self) -> httpx.Client:
        try:
            import httpx
        except ImportError as error:
            raise ModelError(
                "the package httpx is not installed",
                where="openai backend",
                fix='install it: pip install "exact-mdp[agents-openai]"',
            ) from error
        key = self._key()
        if not key.isascii() or not key.isprintable():
            raise ModelError(
                "the key holds characters that no key has",
                where=self.key_variable,
                fix="set it again",
            )
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        return httpx.Client(headers=headers, timeout=self.timeout)

    def _post(self, body: dict[str, Any]) -> tuple[dict[str, Any], int]:
        """Send a body until there is an answer; return it with the number of attempts."""
        jitter = np.random.default_rng(body.get("seed", 0))
        for attempt in range(1, self.style.tries + 1):
            try:
                return self._once({"model": self.model, **body}), attempt
            except Transient as failure:
                if attempt == self.style.tries:
                    raise BackendError(
                        f"no answer in {attempt} attempts; the last one: {failure}",
                        where=self.base_url,
                        fix="resume once the endpoint is back",
                    ) from None
                wait = 2.0 ** (attempt - 1) * (1 + 0.25 * jitter.random())
                self.sleep(min(max(wait, failure.wait or 0.0), LONGEST_WAIT))
        raise AssertionError("tries is at least 1")

    def _once(self, body: dict[str, Any]) -> dict[str, Any]:
        import httpx

        deadline = time.monotonic() + self.timeout
        try:
            with self._http().stream(
                "POST", f"{self.base_url.rstrip('/')}/chat/completions", json=body
            ) as response:
                data = b""
                for chunk in response.iter_bytes():
                    data += chunk
                    if len(data) > LONGEST_ANSWER:
                        raise Transient(f"an answer of over {LONGEST_ANSWER:,} bytes")
                    if time.monotonic() > deadline:
                        raise Transient(f"no whole answer within {self.timeout:g} s")
                status, headers = response.status_code, response.headers
        except httpx.TimeoutException:
            raise Transient(f"no answer within {self.timeout:g} s") from None
        except httpx.HTTPError as error:
            raise Transient(f"the connection failed ({type(error).__name__})") from None
        if status in AGAIN:
            raise Transient(f"HTTP status {status}", _seconds(headers.get("retry-after")))
        if status != 200:
            raise BackendError(
                f"HTTP status {status}: {self._said(data)}",
                where=self.base_url,
                fix=_remedy(status, self.key_variable),
            )
        try:
            answer = json.loads(data)
        except (ValueError, RecursionError):
            raise Transient("an answer that is not JSON") from None
        return answer if isinstance(answer, dict) else {}

    def _said(self, data: bytes) -> str:
        """Return the endpoint's own message, shortened, with the key taken out of it."""
        try:
            text = str(json.loads(data)["error"]["message"])
        except (ValueError, KeyError, TypeError, RecursionError):
            text = data[:300].decode("utf-8", errors="replace")
        key = self._key()
        text = text.replace(key, "…") if key else text
        words = ["…" if word.lower().startswith("sk-") else word for word in text.split()]
        return " ".join(words)[:200] or "no message"


def _seconds(text: str | None) -> float | None:
    """Return the seconds of a Retry-After header, where it states some."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if 0 <= value < float("inf") else None


def _remedy(status: int, variable: str) -> str:
    if status in (401, 403):
        return f"set {variable} to a key that the endpoint takes"
    if status == 404:
        return "check --base-url (it mostly ends in /v1) and --model"
    return "check --model and --response-format"
