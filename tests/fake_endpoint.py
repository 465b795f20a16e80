"""An endpoint on loopback that speaks chat completions, and misbehaves as a test tells it to."""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

GOOD = {
    "behaviour": {"nonverbal": "Looks at the shelf.", "verbal": "Here it is."},
    "perception": {"forgetfulness": 0, "confusion": 0, "anger": 0, "disengagement": 0},
    "execution": {"speech": "Take the red can."},
}


@dataclass
class FakeEndpoint:
    """Answers well unless `faults` names something else for the next request, oldest first.

    A fault is a number (an HTTP status), or one of: slow, drip, drop, not-json, not-object,
    no-choice, malformed, wrong-schema, fenced, cut, refusal, filtered, echo-key.
    """

    faults: list[int | str] = field(default_factory=list)
    headers: dict[str, str] = field(default_factory=dict)
    bodies: list[dict[str, Any]] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)
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
    if fault == "echo-key":
        return 401, json.dumps({"error": {"message": f"Incorrect key provided: {key}"}}).encode()
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
def fake_endpoint(*faults: int | str, **headers: str) -> Iterator[FakeEndpoint]:
    """Serve on a free loopback port until the block ends."""
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
            fault = state.faults.pop(0) if state.faults else "none"
            if fault == "drop":
                self.close_connection = True
                return
            if fault == "slow":
                state.halt.wait(5)
            status, data = _answer(fault, body, key)
            self.send_response(status)
            for name, value in state.headers.items():
                if status != 200:
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            try:
                if fault == "drip":
                    for number in range(len(data)):
                        self.wfile.write(data[number : number + 1])
                        self.wfile.flush()
                        time.sleep(0.02)
                        if state.halt.is_set():
                            return
                else:
                    self.wfile.write(data)
            except OSError:
                return

        def log_message(self, *_: object) -> None:
            return

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    state.url = f"http://127.0.0.1:{server.server_address[1]}/v1"
    try:
        yield state
    finally:
        state.halt.set()
        server.shutdown()
        thread.join()
        server.server_close()
