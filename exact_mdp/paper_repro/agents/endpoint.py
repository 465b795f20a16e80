"""The openai backend: any endpoint that speaks chat completions, by its base URL.

The key is read from the environment when the backend is made, goes into one request header, and
nowhere else: not into a recording, a message, a `repr` or a pickle. What an endpoint writes beside
an error is not shown where a key was sent, since it may hold the key in any disguise. Too many
requests (429), server errors, dropped connections and time-outs are tried again after 1, 2, 4 …
seconds, or as long as the endpoint asks for; every other status stops the run with a message.
"""

from __future__ import annotations

import base64
import json
import math
import os
import re
import ssl
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote
from urllib.request import getproxies_environment, proxy_bypass

import numpy as np

from exact_mdp.mdp.errors import ModelError, extra
from exact_mdp.paper_repro.agents.chat import Malformed, Style, ask, decoded
from exact_mdp.paper_repro.agents.protocol import BackendError, Reply, Request, plain

if TYPE_CHECKING:
    from exact_mdp.paper_repro.agents.transport import Address, Answer, Route


AGAIN = (408, 409, 429, 500, 502, 503, 504)
LONGEST_WAIT = 60.0
LONGEST_TIMEOUT = 86_400.0
SECRET = 16  # characters from which on a key is taken for a secret, not for a word such as "none"
RUN = 8  # characters of a key that an answer may not hold in a row


class Key:
    """A key that is never shown and never written to a file."""

    __slots__ = ("text",)

    def __init__(self, text: str) -> None:
        self.text = text

    def __bool__(self) -> bool:
        return bool(self.text)

    def __repr__(self) -> str:
        return "Key(…)"

    def __reduce__(self) -> tuple[object, ...]:
        raise TypeError("a key is not pickled")

    def told_by(self, texts: Mapping[str, Any]) -> bool:
        """Return whether texts hold a part of the key, as it is, reversed, in base64 or in hex.

        Examples
        --------
        >>> key = Key("sk-test-0123456789abcdef")
        >>> key.told_by({"speech": "It is fedcba9876543210."}), key.told_by({"speech": "Good day."})
        (True, False)
        """
        if len(self.text) < SECRET:
            return False
        raw = self.text.encode("ascii")
        forms = [self.text, raw.hex()]
        for skipped in range(3):  # where the key begins within a group of three bytes
            forms += [base64.b64encode(raw[skipped:]).decode(), _urlsafe(raw[skipped:])]
        forms += [form[::-1] for form in forms]
        runs = {form[i : i + RUN].lower() for form in forms for i in range(len(form) - RUN + 1)}
        whole = "\n".join(f"{name}\n{text}" for name, text in texts.items()).lower()
        return any(run in whole for run in runs)


def _urlsafe(raw: bytes) -> str:
    return base64.urlsafe_b64encode(raw).decode()


@dataclass(frozen=True, kw_only=True, repr=False)
class Endpoint:
    """A model behind an endpoint.

    Attributes
    ----------
    model : the model's name there
    base_url : such as http://127.0.0.1:8080/v1
    key_variable : the environment variable that holds the key
    style : how it is asked
    timeout : seconds for a whole answer, from the look-up of the name to the last byte
    trust_environment : whether proxies and certificates are taken from the environment; this
        machine is never asked through a proxy
    sleep : waits between attempts
    """

    model: str
    base_url: str
    key_variable: str = "OPENAI_API_KEY"
    style: Style = field(default_factory=Style)
    timeout: float = 60.0
    trust_environment: bool = False
    sleep: Callable[[float], None] = time.sleep

    def __post_init__(self) -> None:
        from exact_mdp.paper_repro.agents import transport

        if not 0 < self.timeout <= LONGEST_TIMEOUT:
            raise ModelError(
                f"the time limit is {self.timeout:g} s",
                where="--timeout",
                fix=f"give seconds above 0, up to {LONGEST_TIMEOUT:g}",
            )
        key = _key(self.key_variable)
        address = transport.Address.of(self.base_url)
        if address is None:
            if re.search(r"[@?#]", self.base_url):
                raise ModelError(
                    "the base URL holds credentials, a query or a fragment, which would be "
                    "recorded",
                    where="--base-url",
                    fix=f"put the key into the environment as {self.key_variable}",
                )
            raise ModelError(
                "the base URL is not an http or https address",
                where="--base-url",
                fix="write https://…",
            )
        if address.scheme == "http" and not address.loopback and key:
            raise ModelError(
                "a key would travel unencrypted",
                where="--base-url",
                fix=f"use https, or unset {self.key_variable}",
            )
        route = _route(address, bool(key), self.trust_environment)
        for name, value in (("_key", key), ("_address", address), ("_route", route)):
            object.__setattr__(self, name, value)

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
        reply = ask(request, self.style, self._post, self.base_url)
        if self._secret().told_by(reply.data):
            raise BackendError(
                "the answer holds a part of the key that was sent; nothing of it is kept",
                where=self.base_url,
                fix="take another endpoint, and another key: this one was given away",
            )
        return reply

    def _secret(self) -> Key:
        key: Key = self.__dict__["_key"]
        return key

    def _post(self, body: dict[str, Any]) -> tuple[dict[str, Any], int]:
        """Send a body until there is an answer; return it with the number of attempts."""
        from exact_mdp.paper_repro.agents import transport

        jitter = np.random.default_rng(body.get("seed", 0))
        for attempt in range(1, self.style.tries + 1):
            try:
                return self._once({"model": self.model, **body}), attempt
            except transport.Transient as failure:
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
        from exact_mdp.paper_repro.agents import transport

        address: Address = self.__dict__["_address"]
        key = self._secret()
        try:
            answer = transport.post(
                address,
                "/chat/completions",
                json.dumps(body, allow_nan=False).encode("ascii"),
                {"Authorization": f"Bearer {key.text}"} if key else {},
                route=self.__dict__["_route"],
                seconds=self.timeout,
                wanted=lambda status: status == 200 or (status not in AGAIN and not key),
            )
        except transport.Unsafe as risk:
            raise BackendError(
                str(risk),
                where=self.base_url,
                fix="check --base-url; a certificate of your own is named by SSL_CERT_FILE "
                "together with --trust-environment",
            ) from None
        status = answer.status
        if status in AGAIN:
            raise transport.Transient(f"HTTP status {status}", _seconds(answer.retry_after))
        if status != 200:
            raise BackendError(
                f"HTTP status {_phrase(status)}{_said(answer, bool(key))}",
                where=self.base_url,
                fix=_remedy(status, self.key_variable),
            )
        if answer.encoded:
            raise BackendError(
                "the answer is compressed or otherwise encoded, which was not asked for",
                where=self.base_url,
                fix="make the endpoint, or what stands before it, answer with the plain text",
            )
        try:
            found = decoded(answer.data)
        except Malformed as fault:
            raise transport.Transient(f"an answer that {fault}") from None
        return found if isinstance(found, dict) else {}


def _key(variable: str) -> Key:
    """Return the key in an environment variable; none where the usual one is not set."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", variable):
        raise ModelError(
            "this is not the name of a variable; it is not shown, since it may be a key",
            where="--key-variable",
            fix="put the key into the environment, and give the name of the variable",
        )
    if variable != Endpoint.key_variable and variable not in os.environ:
        raise ModelError(
            "the environment has no variable of the given name; it is not shown, since it may be "
            "a key",
            where="--key-variable",
            fix="set the variable; leave it empty for an endpoint without a key",
        )
    key = os.environ.get(variable, "").strip()
    if not key.isascii() or not key.isprintable():
        raise ModelError(
            "the key holds characters that a key cannot have", where=variable, fix="set it again"
        )
    return Key(key)


def _route(address: Address, key: bool, trust: bool) -> Route:
    """Return how an address is reached: directly, unless the environment is to be trusted."""
    from exact_mdp.paper_repro.agents import transport

    proxy, user = None, None
    proxies = getproxies_environment() if trust and not address.loopback else {}
    named = next((name for name in (address.scheme, "all") if proxies.get(name)), None)
    if named and not proxy_bypass(f"{address.host}:{address.port}"):
        text = proxies[named] if "://" in proxies[named] else f"http://{proxies[named]}"
        proxy, user = _proxy(text, f"{named.upper()}_PROXY")
    near = key and address.scheme == "http"
    context = _context(trust) if address.scheme == "https" else None
    route: Route = transport.Route(context=context, proxy=proxy, proxy_user=user, near=near)
    return route


def _proxy(text: str, variable: str) -> tuple[Address, tuple[str, str] | None]:
    """Return a proxy's address, and the name and password for it."""
    from exact_mdp.paper_repro.agents import transport

    scheme, _, rest = text.partition("://")
    words, at, place = rest.rpartition("@")
    address = transport.Address.of(f"{scheme}://{place}")
    if address is None or address.scheme != "http" or address.path:
        raise ModelError(
            "the proxy is not an address such as http://host:port",
            where=f"{variable}, by --trust-environment",
            fix="correct it, or leave out --trust-environment",
        )
    name, _, password = words.partition(":")
    return address, (unquote(name), unquote(password)) if at else None


def _context(trust: bool) -> ssl.SSLContext:
    """Return what certificates are checked by: certifi's list, or the environment's where trusted.

    Made without `ssl.create_default_context`, which would write the secrets of each connection to
    the file that SSLKEYLOGFILE names.
    """
    with extra("agents"):
        import certifi
    file = os.environ.get("SSL_CERT_FILE") if trust else None
    folder = os.environ.get("SSL_CERT_DIR") if trust else None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(file or (None if folder else certifi.where()), folder or None)
    except OSError as error:
        raise ModelError(
            f"the certificates cannot be read: {error.strerror or 'not in PEM form'}",
            where="SSL_CERT_FILE, by --trust-environment" if file else "certifi",
            fix="correct the variable" if file else "install the package certifi again",
        ) from error
    return context


def _phrase(status: int) -> str:
    """Return a status with the standard's words for it; an endpoint's own words are not taken.

    Examples
    --------
    >>> _phrase(401), _phrase(799)
    ('401 (Unauthorized)', '799')
    """
    try:
        return f"{status} ({HTTPStatus(status).phrase})"
    except ValueError:
        return str(status)


def _said(answer: Answer, key: bool) -> str:
    """Return the endpoint's own message, shortened; nothing of it where a key was sent."""
    if key:
        return "; what it says is not shown, since a key was sent with the question"
    if answer.encoded:
        return ""
    try:
        text = str(decoded(answer.data)["error"]["message"])
    except (Malformed, KeyError, TypeError):
        text = answer.data[:300].decode("utf-8", errors="replace")
    shown = plain(text)[:200]
    return f": {shown}" if shown else ""


def _seconds(text: str | None) -> float | None:
    """Return the seconds of a Retry-After header, where it states some."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) and value >= 0 else None


def _remedy(status: int, variable: str) -> str:
    if status in (401, 403):
        return f"set {variable} to a key that the endpoint takes"
    if 300 <= status < 400:
        return "redirects are not followed: give the address that it leads to as --base-url"
    if status == 404:
        return "check --base-url (it mostly ends in /v1) and --model"
    return "check --model and --response-format"
