"""An endpoint on loopback that speaks chat completions, and misbehaves as a test tells it to."""

import gzip
import json
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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
HEAD = b"HTTP/1.1 200 OK\r\n"
DRIPS = {  # what comes first, and what comes then without end, a byte at a time
    "headers": (HEAD, b"X: y\r\n"),
    "body": (HEAD + b"Content-Length: 1000000\r\n\r\n", b" "),
    "chunks": (HEAD + b"Transfer-Encoding: chunked\r\n\r\n", b"1\r\n \r\n"),
    "silence": (b"", b""),
}
RAW = {"not-json": b"<html>busy</html>", "not-object": b"[1, 2]", "no-choice": b'{"choices": []}',
       "flood": b" " * 9_000_000}  # fmt: skip


@dataclass
class FakeEndpoint:
    """Answers well unless `faults` names something else for the next request, oldest first.

    A fault is a number (an HTTP status), a key of DRIPS or RAW, or one of `answer`, or drop.
    """

    faults: list[int | str] = field(default_factory=list)
    headers: dict[str, str] = field(default_factory=dict)
    bodies: list[dict[str, Any]] = field(default_factory=list)
    asked: list[dict[str, str]] = field(default_factory=list)
    url: str = ""
    halt: threading.Event = field(default_factory=threading.Event)


def completion(content: str | None, **choice: Any) -> bytes:
    message = {"role": "assistant", "content": content} | choice.pop("message", {})
    choice = {"index": 0, "finish_reason": "stop", "message": message} | choice
    return json.dumps({"choices": [choice]}).encode()


def answer(fault: int | str, body: dict[str, Any], key: str) -> tuple[int, bytes]:
    system = body["messages"][0]["content"]
    names = {"perception of an assistive robot": "perception", "voice of an": "execution"}
    purpose = next((name for words, name in names.items() if words in system), "behaviour")
    good = json.dumps(GOOD[purpose])
    if isinstance(fault, int):
        return fault, b'{"error": {"message": "told to fail"}}'
    if fault == "echo":  # the key, in an error
        return 401, json.dumps({"error": {"message": f"Incorrect: {key}"}}).encode()
    return 200, RAW.get(fault) or {
        "say": completion(json.dumps(GOOD["behaviour"] | {"verbal": f"So: {key}."})),
        "bomb": gzip.compress(gzip.compress(good.encode() + b" " * 30_000_000 * (fault == "bomb"))),
        "twice": completion(good[:-1] + f", {good[1:]}"),
        "malformed": completion('{"nonverbal": "Looks'),
        "wrong-schema": completion('{"nonverbal": 5, "mood": "fine"}'),
        "fenced": completion(f"```json\n{good}\n```"),
        "cut": completion(good, finish_reason="length"),
        "refusal": completion(None, message={"refusal": "I cannot."}),
        "filtered": completion(good, finish_reason="content_filter"),
    }.get(fault, completion(good))


@contextmanager
def fake_endpoint(*faults: int | str, tls: bool = False, **headers: str) -> Iterator[FakeEndpoint]:
    """Serve on a free loopback port until the block ends; errors bear the headers."""
    state = FakeEndpoint(list(faults), {key.replace("_", "-"): v for key, v in headers.items()})

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            state.bodies.append(body)
            state.asked.append(dict(self.headers))
            fault = state.faults.pop(0) if state.faults else "none"
            with suppress(OSError):  # the other side has left
                if fault in DRIPS:
                    self.drip(*DRIPS[str(fault)])
                elif fault != "drop":
                    key = self.headers.get("Authorization", "").removeprefix("Bearer ")
                    self.reply(fault, *answer(fault, body, key))

        def drip(self, first: bytes, drop: bytes) -> None:
            self.wfile.write(first)
            while not state.halt.wait(0.02):
                for number in range(len(drop)):
                    self.wfile.write(drop[number : number + 1])
                    self.wfile.flush()

        def reply(self, fault: int | str, status: int, data: bytes) -> None:
            self.send_response(status)
            sent = state.headers if status != 200 else {}
            sent = sent | ({"Content-Encoding": "gzip, gzip"} if fault == "bomb" else {})
            for name, value in (sent | {"Content-Length": str(len(data))}).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *_: object) -> None:
            return

    class Server(ThreadingHTTPServer):
        def handle_error(self, *_: object) -> None:
            """Say nothing of connections that cannot be served."""

    server = Server(("127.0.0.1", 0), Handler)
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
