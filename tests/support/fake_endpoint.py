"""An endpoint on loopback that speaks chat completions, and misbehaves as a test tells it to.

`fake_endpoint` answers HTTP and errs in what it says; `raw_server` errs in HTTP itself, or plays
another part, such as that of a proxy, and keeps what it was sent.
"""

from __future__ import annotations

import gzip
import json
import re
import select
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

CERTIFICATE = Path(__file__).parent / "localhost.pem"

GOOD: dict[str, dict[str, Any]] = {
    "behaviour": {"nonverbal": "Looks at the shelf.", "verbal": "Here it is."},
    "perception": {"forgetfulness": 0, "confusion": 0, "anger": 0, "disengagement": 0},
    "execution": {"speech": "Take the red can."},
}


class Quiet(ThreadingHTTPServer):
    """A server that says nothing of the connections that it cannot serve."""

    def handle_error(self, *_: object) -> None:
        return


@dataclass
class FakeEndpoint:
    """Answers well unless `faults` names something else for the next request, oldest first.

    A fault is a number (an HTTP status), or one of: slow, drop, not-json, not-object,
    no-choice, malformed, wrong-schema, fenced, cut, refusal, filtered, echo and say, which give
    the key away, bomb, and twice, which names a part twice.
    """

    faults: list[int | str] = field(default_factory=list)
    headers: dict[str, str] = field(default_factory=dict)
    bodies: list[dict[str, Any]] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)
    asked: list[dict[str, str]] = field(default_factory=list)
    url: str = ""
    halt: threading.Event = field(default_factory=threading.Event)


def _purpose(body: dict[str, Any]) -> str:
    system = body["messages"][0]["content"]
    if "perception of an assistive robot" in system:
        return "perception"
    return "execution" if "voice of an assistive robot" in system else "behaviour"


def _completion(content: str, **choice: Any) -> dict[str, Any]:
    message = {"role": "assistant", "content": content} | choice.pop("message", {})
    return {
        "choices": [{"index": 0, "finish_reason": "stop", "message": message} | choice],
        "usage": {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110},
    }


def _answer(fault: int | str, body: dict[str, Any], key: str) -> tuple[int, bytes]:
    good = json.dumps(GOOD[_purpose(body)])
    if isinstance(fault, int):
        return fault, b'{"error": {"message": "told to fail"}}'
    if fault == "echo":
        told = {"error": {"message": f"Incorrect: {key}"}}
        return 401, json.dumps(told).encode()
    if fault == "say":
        said = GOOD["behaviour"] | {"verbal": f"So: {key}."}
        return 200, json.dumps(_completion(json.dumps(said))).encode()
    if fault == "bomb":
        return 200, gzip.compress(gzip.compress(good.encode() + b" " * 30_000_000))
    if fault == "twice":
        return 200, json.dumps(_completion(good[:-1] + f", {good[1:]}")).encode()
    if fault == "not-json":
        return 200, b"<html>busy</html>"
    if fault == "not-object":
        return 200, b"[1, 2]"
    if fault == "no-choice":
        return 200, b'{"choices": []}'
    found = {
        "malformed": _completion('{"nonverbal": "Looks'),
        "wrong-schema": _completion('{"nonverbal": 5, "mood": "fine"}'),
        "fenced": _completion(f"```json\n{good}\n```"),
        "cut": _completion(good, finish_reason="length"),
        "refusal": _completion("", message={"content": None, "refusal": "I cannot."}),
        "filtered": _completion(good, finish_reason="content_filter"),
    }.get(fault, _completion(good))
    return 200, json.dumps(found).encode()


@contextmanager
def fake_endpoint(*faults: int | str, tls: bool = False, **headers: str) -> Iterator[FakeEndpoint]:
    """Serve on a free loopback port until the block ends; errors bear the headers."""
    state = FakeEndpoint(
        faults=list(faults), headers={re.sub("_", "-", k): v for k, v in headers.items()}
    )

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            length = int(self.headers["Content-Length"])
            body = json.loads(self.rfile.read(length))
            key = self.headers.get("Authorization", "").removeprefix("Bearer ")
            state.bodies.append(body)
            state.keys.append(key)
            state.asked.append(dict(self.headers))
            fault = state.faults.pop(0) if state.faults else "none"
            if fault == "drop":
                self.close_connection = True
                return
            if fault == "slow":
                state.halt.wait()  # longer than anybody waits
            status, data = _answer(fault, body, key)
            self.send_response(status)
            for name, value in state.headers.items():
                if status != 200:
                    self.send_header(name, value)
            if fault == "bomb":
                self.send_header("Content-Encoding", "gzip, gzip")
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            try:
                self.wfile.write(data)
            except OSError:
                return

        def log_message(self, *_: object) -> None:
            return

    server = (Quiet if tls else ThreadingHTTPServer)(("127.0.0.1", 0), Handler)
    if tls:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(CERTIFICATE)
        server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    state.url = f"http{'s' * tls}://127.0.0.1:{server.server_address[1]}/v1"
    try:
        yield state
    finally:
        state.halt.set()
        server.shutdown()
        thread.join()
        server.server_close()


@dataclass
class RawServer:
    """What a raw server was sent."""

    port: int = 0
    received: bytearray = field(default_factory=bytearray)
    halt: threading.Event = field(default_factory=threading.Event)

    @property
    def url(self) -> str:
        """The address of an endpoint here."""
        return f"http://127.0.0.1:{self.port}/v1"


@contextmanager
def raw_server(script: Callable[[RawServer, socket.socket], None]) -> Iterator[RawServer]:
    """Listen on a free loopback port until the block ends, and play a script for each connection.

    After the script the connection stays open until the other side ends it.
    """
    state, threads = RawServer(), list[threading.Thread]()

    def serve(line: socket.socket) -> None:
        with line:
            line.settimeout(0.05)
            try:
                script(state, line)
                while not state.halt.is_set():
                    if listen(state, line) == b"":
                        break
            except OSError:
                pass

    def accept() -> None:
        while not state.halt.is_set():
            if select.select([listener], [], [], 0.02)[0]:
                line, _ = listener.accept()
                threads.append(threading.Thread(target=serve, args=(line,)))
                threads[-1].start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        state.port = listener.getsockname()[1]
        accepting = threading.Thread(target=accept)
        accepting.start()
        try:
            yield state
        finally:
            state.halt.set()
            for thread in [accepting, *threads]:
                thread.join()


def listen(state: RawServer, line: socket.socket) -> bytes | None:
    """Keep what comes in; return it, or None where nothing came in for a moment."""
    try:
        data = line.recv(65_536)
    except TimeoutError:
        return None
    state.received += data
    return data


def hear(state: RawServer, line: socket.socket) -> None:
    """Keep what comes in until a whole question is there."""
    while not state.halt.is_set():
        head, end, body = bytes(state.received).partition(b"\r\n\r\n")
        length = re.search(rb"(?i)content-length: *(\d+)", head)
        if end and length and len(body) >= int(length[1]):
            return
        listen(state, line)


def saying(answer: bytes) -> Callable[..., None]:
    """Return a script that answers a question with these bytes."""

    def script(state: RawServer, line: socket.socket) -> None:
        hear(state, line)
        line.sendall(answer)

    return script


def dripping(first: bytes, drop: bytes, pause: float = 0.02) -> Callable[..., None]:
    """Return a script that waits for a question, and answers one byte after the other."""

    def script(state: RawServer, line: socket.socket) -> None:
        while listen(state, line) is None and not state.halt.is_set():
            pass
        line.sendall(first)
        while not state.halt.is_set():
            for number in range(len(drop)):
                line.sendall(drop[number : number + 1])
                if state.halt.wait(pause):
                    return

    return script
