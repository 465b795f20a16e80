"""Any endpoint that speaks chat completions (the OpenAI protocol), by its address.

The key is read from the environment, goes into one request header, and nowhere else: not into a
recording, a message or a `repr`. Addresses are https, or http on this machine. Nothing else is
taken from the environment: no proxy, no .netrc, no certificates. One deadline bounds an attempt,
from the look-up of the name to the last byte, and an answer has at most 4 MB. Too many requests,
server errors, dropped connections and time-outs are tried again after 1, 2, 4 … seconds, or as long
as the endpoint asks for; an answer in another form than asked is asked for again, with its fault
named; every other status stops the run.
"""

from __future__ import annotations

import json
import math
import os
import queue
import re
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, cast
from urllib.parse import urlsplit

from exact_mdp import ModelError
from exact_mdp.mdp.errors import require_extra
from exact_mdp.paper_repro.agents.texts import Request

MOST_BYTES = 4_000_000  # of an answer, whose texts are a thousandth of that
LONGEST_TEXT = 1200  # characters of a text in an answer
SHAPES = ("json_schema", "json_object", "none")


class BackendError(ModelError):
    """A backend that could not answer: unreachable, refusing, or never in the asked form."""


class Transient(Exception):
    """A failure that may pass; `wait` is how long the endpoint asks to wait."""

    def __init__(self, what: str, wait: float = 0.0) -> None:
        super().__init__(what)
        self.wait = wait


class Malformed(Exception):
    """An answer that is not in the asked form; the text says how."""


@dataclass(frozen=True, kw_only=True)
class Endpoint:
    """A model behind an endpoint."""

    model: str  # its name there
    base_url: str  # such as http://127.0.0.1:8080/v1
    key_variable: str = "OPENAI_API_KEY"  # the environment variable that holds the key
    temperature: float = 0.7
    max_tokens: int = 400
    shape: str = "json_schema"  # how the form is requested; it is checked in any case
    tries: int = 4  # attempts for each request before the run stops
    timeout: float = 60.0  # seconds for a whole attempt
    sleep: Callable[[float], None] = field(default=time.sleep, repr=False)

    def __post_init__(self) -> None:
        if not 0 < self.timeout < math.inf:
            raise ModelError(
                f"the time limit is {self.timeout:g} s", where="--timeout", fix="give seconds > 0"
            )
        _checked_address(self.base_url)
        with require_extra("agents"):
            import_module("httpx")
        self._read_key()

    def describe(self) -> dict[str, Any]:
        """Return the endpoint and its settings, without the key."""
        return {
            "backend": "openai",
            "model": self.model,
            "base_url": self.base_url,
            "temperature": self.temperature,
            "max_tokens": self.max_tokens,
            "response_format": self.shape,
        }

    def answer(self, request: Request) -> dict[str, Any]:
        """Return an answer in the asked form; raise BackendError if there is none."""
        fault = ""
        for attempt in range(self.tries):
            try:
                return self._request_once(request, fault, attempt)
            except Malformed as error:
                fault = str(error)
                last = f"it was not in the asked form: {fault}"
            except Transient as error:
                last = str(error)
                if attempt + 1 < self.tries:
                    self.sleep(min(max(2.0**attempt, error.wait), 60.0))
        raise BackendError(
            f"no answer in {self.tries} attempts; the last one: {last}",
            where=f"{self.base_url}, {request.purpose}",
            fix="--resume goes on once the endpoint is back; or take another model, or another "
            "--response-format",
        )

    def _request_once(self, request: Request, fault: str, attempt: int) -> dict[str, Any]:
        key = self._read_key()
        status, wait, data = self._send_in_thread(self._build_body(request, fault, attempt), key)
        # A timeout, a conflict, too many requests or a failing server: another attempt may succeed.
        if status in (408, 409, 429, 500, 502, 503, 504):
            raise Transient(f"HTTP status {status}", wait)
        if status != 200:
            raise BackendError(
                f"HTTP status {status}", where=self.base_url, fix=_suggest_remedy(status)
            )
        answer = require_form(_parse_completion(data, self.base_url), request.fields)
        if len(key) > 8 and key in json.dumps(answer, ensure_ascii=False):
            raise BackendError(
                "the answer holds the key that was sent; nothing of it is kept",
                where=self.base_url,
                fix="take another endpoint, and another key: this one was given away",
            )
        return answer

    def _build_body(self, request: Request, fault: str, attempt: int) -> dict[str, Any]:
        """Return the body of a chat completion."""
        messages = [{"role": role, "content": content} for role, content in request.messages]
        if fault:
            messages[-1]["content"] += (
                f"\n\nAn earlier answer could not be used: {fault}. "
                "Answer with the JSON object alone."
            )
        body: dict[str, Any] = {
            "model": self.model,
            "messages": messages,
            "max_tokens": self.max_tokens,
            "temperature": self.temperature,
            "seed": (request.seed + attempt) % 2**31,
        }
        if self.shape == "json_schema":
            named = {
                "name": request.purpose,
                "strict": True,
                "schema": build_schema(request.fields),
            }
            body["response_format"] = {"type": "json_schema", "json_schema": named}
        elif self.shape == "json_object":
            body["response_format"] = {"type": "json_object"}
        return body

    def _send_in_thread(self, body: Mapping[str, Any], key: str) -> tuple[int, float, bytes]:
        """Return the status, the wait that is asked for, and the data, all within one deadline.

        The request is sent in a thread, since nothing else bounds the look-up of a name.
        """
        answers: queue.Queue[tuple[int, float, bytes] | Exception] = queue.Queue()

        def send() -> None:
            try:
                answers.put(self._post_body(body, key))
            except Exception as error:  # handed to the thread that waits
                answers.put(error)

        threading.Thread(target=send, daemon=True).start()
        try:
            answer = answers.get(timeout=self.timeout)
        except queue.Empty:
            raise Transient(f"no answer within {self.timeout:g} s") from None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _post_body(self, body: Mapping[str, Any], key: str) -> tuple[int, float, bytes]:
        import httpx

        context = httpx.create_ssl_context(trust_env=False)
        cast(Any, context).keylog_filename = None  # secrets of a connection go into no file
        headers = {"Accept-Encoding": "identity"}
        if key:
            headers["Authorization"] = f"Bearer {key}"
        url, data = f"{self.base_url.rstrip('/')}/chat/completions", b""
        try:
            with (
                httpx.Client(trust_env=False, verify=context, timeout=self.timeout) as client,
                client.stream("POST", url, json=body, headers=headers) as answer,
            ):
                if answer.status_code == 200:
                    for piece in answer.iter_raw():
                        data += piece
                        if len(data) > MOST_BYTES:
                            raise Transient(f"an answer of over {MOST_BYTES:,} bytes")
                return (
                    answer.status_code,
                    _parse_retry_after(answer.headers.get("retry-after")),
                    data,
                )
        except httpx.HTTPError as error:
            if "CERTIFICATE_VERIFY_FAILED" in str(error):
                raise BackendError(
                    "the certificate of the endpoint is not trusted",
                    where=self.base_url,
                    fix="check --base-url",
                ) from None
            raise Transient(f"{type(error).__name__}, the connection failed") from None

    def _read_key(self) -> str:
        """Return the key; an empty one if the usual variable is not set."""
        name = self.key_variable
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or (
            name != Endpoint.key_variable and name not in os.environ
        ):
            raise ModelError(
                "the environment has no variable of the given name, which is not shown, since it "
                "may be a key",
                where="--key-variable",
                fix="put the key into the environment, and give the name of the variable",
            )
        key = os.environ.get(name, "").strip()
        if not key.isascii() or not key.isprintable():
            raise ModelError(
                "the key holds characters that a key cannot have", where=name, fix="set it again"
            )
        return key


def _checked_address(url: str) -> None:
    """Raise ModelError for an address that is neither https nor on this machine."""
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname or "", parts.port
    except ValueError:
        host, parts = "", urlsplit("")
    loopback = host == "localhost" or host == "::1" or re.fullmatch(r"127(\.\d+){3}", host)
    if re.search(r"[@?#]", url):
        raise ModelError(
            "the address holds credentials, a query or a fragment, which would be recorded",
            where="--base-url",
            fix="put the key into the environment",
        )
    if not host or parts.scheme not in ("http", "https"):
        raise ModelError("not an http or https address", where="--base-url", fix="write https://…")
    if parts.scheme == "http" and not loopback:
        raise ModelError(
            "messages would travel unencrypted",
            where="--base-url",
            fix="use https; http is for this machine",
        )


def build_schema(fields: Mapping[str, str]) -> dict[str, Any]:
    """Return the JSON schema of an answer.

    >>> build_schema({"anger": "bit"})["properties"]
    {'anger': {'type': 'integer', 'enum': [0, 1]}}
    """
    forms = {
        "text": {"type": "string", "maxLength": LONGEST_TEXT},
        "bit": {"type": "integer", "enum": [0, 1]},
    }
    return {
        "type": "object",
        "properties": {name: forms[form] for name, form in fields.items()},
        "required": list(fields),
        "additionalProperties": False,
    }


def require_form(value: object, fields: Mapping[str, str]) -> dict[str, Any]:
    """Return an answer that has the asked form; raises Malformed.

    >>> require_form({"anger": 1}, {"anger": "bit"})
    {'anger': 1}
    """
    if not isinstance(value, dict) or value.keys() != fields.keys():
        raise Malformed(f"it is not an object with exactly the keys {', '.join(fields)}")
    for name, form in fields.items():
        answer = value[name]
        if form == "bit" and (type(answer) is not int or answer not in (0, 1)):
            raise Malformed(f"{name} is not 0 or 1")
        if form == "text":
            if not isinstance(answer, str) or len(answer) > LONGEST_TEXT:
                raise Malformed(f"{name} is not a text of at most {LONGEST_TEXT} characters")
            if any("\ud800" <= c <= "\udfff" for c in answer):
                raise Malformed(f"{name} holds half a surrogate pair")
    return value


def _parse_completion(data: bytes, where: str) -> object:
    """Return the object in a completion; raises Malformed, or BackendError for a refusal."""
    try:
        choice = decode_json(data)["choices"][0]
        message, why = choice["message"], choice.get("finish_reason")
        refusal, content = message.get("refusal"), message["content"]
    except (KeyError, IndexError, TypeError, AttributeError):
        raise Malformed("it held no choice with a message") from None
    if refusal or why == "content_filter":
        raise BackendError(
            "the model refused to answer",
            where=where,
            fix="--resume to try again, or take another model",
        )
    if why == "length":
        raise Malformed("it was cut off at the greatest length")
    if not isinstance(content, str):
        raise Malformed("its content was not text")
    text = content.strip()
    if text.startswith("```") and text.endswith("```") and "\n" in text:
        text = text[text.index("\n") + 1 : -3]
    return decode_json(text.encode("utf-8", "surrogatepass"))


def decode_json(data: bytes) -> Any:
    """Return the value of JSON text; raise Malformed if it is not JSON or names a key twice.

    >>> decode_json(b'{"anger": 1}')
    {'anger': 1}
    """

    def once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(pairs)) < len(pairs):
            raise Malformed("it names a key twice")
        return dict(pairs)

    try:
        return json.loads(data.decode("utf-8-sig"), object_pairs_hook=once_each)
    except (ValueError, RecursionError):
        raise Malformed("it is not JSON") from None


def _parse_retry_after(text: str | None) -> float:
    """Return the seconds of a Retry-After header; 0 if it states none."""
    try:
        value = float(text or 0)
    except ValueError:
        return 0.0
    if 0 <= value < math.inf:
        return value
    return 0.0


def _suggest_remedy(status: int) -> str:
    if status in (401, 403):
        return "set the key to one that the endpoint takes"
    if 300 <= status < 400:
        return "redirects are not followed: give the address that it leads to as --base-url"
    return "check --base-url (it mostly ends in /v1), --model and --response-format"
