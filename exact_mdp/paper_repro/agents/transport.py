"""One question to an endpoint: a connection of its own, one deadline, a limit on its bytes.

    name, connection, TLS, question, headers, body   before one deadline
    bytes received, headers and framing included     within one limit

Every wait for the other side is as long as what is left until the deadline, so that a server
cannot extend it by sending a byte now and then. The connection is closed after the answer,
whatever happens. Nothing is taken from the environment, no redirect is followed, no cookie is
kept and nothing is decompressed. httpcore reads the messages: HTTP/1.1, RFC 9112.
"""

from __future__ import annotations

import ipaddress
import queue
import re
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import httpcore

LONGEST_HEAD = 65_536  # bytes until the headers end
LONGEST_ANSWER = 4_000_000  # bytes of a whole answer
PIECE = 16_384  # bytes read at a time

FAILED = (
    httpcore.NetworkError,
    httpcore.ProtocolError,
    httpcore.ProxyError,
    httpcore.TimeoutException,
)


class Transient(Exception):
    """A failure that may pass: what happened, and how long the endpoint asks to wait."""

    def __init__(self, what: str, wait: float | None = None) -> None:
        super().__init__(what)
        self.wait = wait


class Unsafe(Exception):
    """A connection that is not made, since a key would be at risk on it."""


@dataclass(frozen=True, kw_only=True)
class Address:
    """The parts of an http or https address, read once and never again from its text."""

    scheme: str
    host: str
    port: int
    path: str

    @classmethod
    def of(cls, url: str) -> Address | None:
        """Return the parts; None for an address with anything else in it, or for none.

        Examples
        --------
        >>> Address.of("http://127.0.0.1:8080/v1/")
        Address(scheme='http', host='127.0.0.1', port=8080, path='/v1')
        >>> Address.of("ftp://example.org") is Address.of("https://user@example.org") is None
        True
        """
        try:
            parts = urlsplit(url)
            host, port = parts.hostname or "", parts.port
        except ValueError:  # a bracket or a port that is none
            return None
        odd = not url.isascii() or not url.isprintable() or "@" in parts.netloc or "\\" in url
        if odd or "?" in url or "#" in url or port == 0 or parts.scheme not in ("http", "https"):
            return None
        if not re.fullmatch(r"[a-z0-9._-]+", host) and not _is_ip(host):
            return None
        if not re.fullmatch(r"[A-Za-z0-9._~!$&'()*+,;=:@%/-]*", parts.path):
            return None
        port = port or (443 if parts.scheme == "https" else 80)
        return cls(scheme=parts.scheme, host=host, port=port, path=parts.path.rstrip("/"))

    @property
    def loopback(self) -> bool:
        """Whether the host is this machine, by its name or number."""
        return self.host == "localhost" or (_is_ip(self.host) and _is_near(self.host))

    @property
    def authority(self) -> str:
        """Host and port as a Host header has them."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        usual = {"http": 80, "https": 443}[self.scheme]
        return host if self.port == usual else f"{host}:{self.port}"


@dataclass(frozen=True, kw_only=True)
class Route:
    """How an address is reached.

    Attributes
    ----------
    context : what a TLS connection is checked by; an https address needs one
    proxy : the address of a proxy that is spoken to over http
    proxy_user : name and password for it
    near : refuse a name that does not lead to this machine
    """

    context: ssl.SSLContext | None = None
    proxy: Address | None = None
    proxy_user: tuple[str, str] | None = None
    near: bool = False


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What came back.

    Attributes
    ----------
    status : of HTTP
    retry_after : the header of that name, or None
    encoded : whether the body is in another form than its own, such as compressed
    data : the body as it was sent; empty where it was not to be read
    """

    status: int
    retry_after: str | None
    encoded: bool
    data: bytes


class Budget:
    """What is left for one answer: seconds until the deadline, bytes until the limit."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._end = seconds, time.monotonic() + seconds
        self._taken, self._most, self._what = 0, LONGEST_HEAD, "headers"

    def late(self) -> Transient:
        """Return the failure of an answer that is not there in time."""
        return Transient(f"no whole answer within {self._seconds:g} s")

    def left(self) -> float:
        """Return the seconds left; raises Transient where there are none."""
        left = self._end - time.monotonic()
        if left <= 0:
            raise self.late()
        return left

    def take(self, count: int) -> None:
        """Count bytes that came in; raises Transient where they are too many."""
        self._taken += count
        if self._taken > self._most:
            raise Transient(f"{self._what} of over {self._most:,} bytes")

    def end_of_head(self) -> None:
        """Allow for the body, now that the headers are read."""
        self._most, self._what = LONGEST_ANSWER, "an answer"


class Stream(httpcore.NetworkStream):
    """A socket whose every wait ends with the budget."""

    def __init__(self, sock: socket.socket, budget: Budget, made: list[socket.socket]) -> None:
        self._sock, self._budget, self._made = sock, budget, made
        made.append(sock)

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        """Return the next bytes, none at the end."""
        self._sock.settimeout(self._budget.left())
        try:
            data = self._sock.recv(min(max_bytes, PIECE))
        except TimeoutError:
            raise self._budget.late() from None
        except OSError as error:
            raise httpcore.ReadError from error
        self._budget.take(len(data))
        return data

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        """Send all bytes."""
        rest = memoryview(buffer)
        while rest:
            self._sock.settimeout(self._budget.left())
            try:
                rest = rest[self._sock.send(rest) :]
            except TimeoutError:
                raise self._budget.late() from None
            except OSError as error:
                raise httpcore.WriteError from error

    def start_tls(
        self,
        ssl_context: ssl.SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,
    ) -> httpcore.NetworkStream:
        """Return the stream encrypted. The socket's time limit holds for the whole handshake."""
        self._sock.settimeout(self._budget.left())
        try:
            sock = ssl_context.wrap_socket(self._sock, server_hostname=server_hostname)
        except TimeoutError:
            raise self._budget.late() from None
        except ssl.SSLCertVerificationError as error:
            raise Unsafe("the certificate of the endpoint is not trusted") from error
        except OSError as error:
            raise httpcore.ConnectError from error
        return Stream(sock, self._budget, self._made)

    def get_extra_info(self, info: str) -> Any:
        """Return nothing: HTTP/1.1 alone is spoken, over a connection that is not kept."""
        return None

    def close(self) -> None:
        """Close the socket."""
        self._sock.close()


class Dialler(httpcore.NetworkBackend):
    """Makes connections within a budget, and closes them at the end."""

    def __init__(self, budget: Budget, *, near: bool) -> None:
        self._budget, self._near = budget, near
        self._made: list[socket.socket] = []

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore.NetworkStream:
        """Return a connection to the first address of a host that takes one."""
        found = addresses(host, port, self._budget)
        for number, (family, kind, protocol, _, address) in enumerate(found):
            if self._near and not _is_near(str(address[0])):
                raise Unsafe(f"the name {host} does not lead to this machine")
            sock = socket.socket(family, kind, protocol)
            try:
                # an address that never answers leaves time for those after it
                sock.settimeout(self._budget.left() / (len(found) - number))
                sock.connect(address)
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            except OSError:
                sock.close()
                continue
            except BaseException:
                sock.close()
                raise
            return Stream(sock, self._budget, self._made)
        self._budget.left()
        raise httpcore.ConnectError

    def close(self) -> None:
        """Close whatever was opened."""
        for sock in self._made:
            sock.close()


def addresses(host: str, port: int, budget: Budget) -> list[Any]:
    """Return the addresses of a host as `socket.getaddrinfo` gives them.

    A number needs no look-up. A name is looked up by a thread, since a look-up cannot be
    stopped: it is waited for until the deadline, and ends by the resolver's own limit.

    Raises
    ------
    Transient
        Where the name is not found, or not in time.
    """
    if _is_ip(host):
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
    found: queue.SimpleQueue[list[Any]] = queue.SimpleQueue()

    def look() -> None:
        try:
            found.put(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
        except (OSError, UnicodeError):
            found.put([])

    threading.Thread(target=look, name="look-up", daemon=True).start()
    try:
        listed = found.get(timeout=budget.left())
    except queue.Empty:
        raise budget.late() from None
    if not listed:
        raise Transient("the name of the host was not found")
    return listed


def post(
    address: Address,
    path: str,
    body: bytes,
    headers: Mapping[bytes | str, bytes | str],
    *,
    route: Route,
    seconds: float,
    wanted: Callable[[int], bool],
) -> Answer:
    """Send a body and return the answer, whole and in time.

    Parameters
    ----------
    path : what follows the address
    headers : beside those that every question has
    seconds : for all of it, from the look-up of the name to the last byte
    wanted : whether the body of an answer with this status is read

    Raises
    ------
    Transient
        Where there is no whole answer in time, within its size, in HTTP.
    Unsafe
        Where the other side is not the one that was named.
    """
    budget = Budget(seconds)
    dialler = Dialler(budget, near=route.near)
    url = httpcore.URL(
        scheme=address.scheme, host=address.host, port=address.port, target=address.path + path
    )
    sent: dict[bytes | str, bytes | str] = {
        "Host": address.authority,
        "User-Agent": "exact-mdp",
        "Accept": "application/json",
        "Accept-Encoding": "identity",
        "Connection": "close",
        "Content-Type": "application/json",
        **headers,
    }
    try:
        with (
            _pool(route, dialler) as pool,
            pool.stream("POST", url, headers=sent, content=body) as response,
        ):
            budget.end_of_head()
            said = [(name.lower(), value.decode("latin-1")) for name, value in response.headers]
            forms = {value.strip().lower() for name, value in said if name == b"content-encoding"}
            data = bytearray()
            if wanted(response.status):
                for piece in response.iter_stream():
                    data += piece
                    budget.left()
            return Answer(
                status=response.status,
                retry_after=next((value for name, value in said if name == b"retry-after"), None),
                encoded=not forms <= {"identity", ""},
                data=bytes(data),
            )
    except FAILED as error:
        raise Transient(f"the connection failed ({type(error).__name__})") from None
    finally:
        dialler.close()


def _pool(route: Route, dialler: Dialler) -> httpcore.ConnectionPool:
    if route.proxy is None:
        return httpcore.ConnectionPool(ssl_context=route.context, network_backend=dialler)
    proxy = httpcore.URL(scheme="http", host=route.proxy.host, port=route.proxy.port, target="/")
    return httpcore.HTTPProxy(
        proxy, route.proxy_user, ssl_context=route.context, network_backend=dialler
    )


def _is_ip(host: str) -> bool:
    try:
        return "%" not in host and bool(ipaddress.ip_address(host))
    except ValueError:
        return False


def _is_near(address: str) -> bool:
    return ipaddress.ip_address(address.partition("%")[0]).is_loopback
