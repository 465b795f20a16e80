"""A headless Chromium, driven by its DevTools protocol over a pipe: no other package is needed."""

import base64
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, Self

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync "
    "--disable-background-networking --disable-component-update --remote-debugging-pipe"
)
KEYS = {
    "ArrowRight": 39,
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "Tab": 9,
    "Enter": 13,
    "Home": 36,
    "End": 35,
}


class Browser:
    """One tab; `folder` is where the browser keeps its files."""

    def __init__(self, folder: Path) -> None:
        assert CHROMIUM is not None
        (there, self.out), (self.back, here) = os.pipe(), os.pipe()
        # The browser reads commands from 3 and writes answers to 4.
        script = (
            f'exec "{CHROMIUM}" {FLAGS} --user-data-dir="{folder}" about:blank 3<&{there} 4>&{here}'
        )
        self.process = subprocess.Popen(
            ["bash", "-c", script], pass_fds=(there, here), stderr=subprocess.DEVNULL
        )
        os.close(there)
        os.close(here)
        self.number, self.buffer, self.session = 0, b"", None
        self.errors: list[str] = []
        self.asked: list[str] = []
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self.session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.wait()
        os.close(self.out)
        os.close(self.back)

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        message |= {} if self.session is None else {"sessionId": self.session}
        os.write(self.out, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self.number:
            pass
        assert "error" not in answer, answer
        result: dict[str, Any] = answer["result"]
        return result

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self.buffer:
            data = os.read(self.back, 2**20)
            assert data, "the browser has ended"
            self.buffer += data
        text, _, self.buffer = self.buffer.partition(b"\0")
        event: dict[str, Any] = json.loads(text)
        params = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"])[:500])
        if event.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])
        if event.get("method") == "Network.requestWillBeSent":
            self.asked.append(params["request"]["url"])
        return event

    def open(self, path: Path, *, wide: int, dark: bool = False, tall: int = 900) -> None:
        """Open a file at a width."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", features=[scheme])
        size = {"width": wide, "height": tall, "deviceScaleFactor": 1, "mobile": wide < 600}
        self.send("Emulation.setDeviceMetricsOverride", **size)
        self.asked.clear()
        self.send("Page.navigate", url=path.as_uri())
        while self._next().get("method") != "Page.loadEventFired":
            pass

    def js(self, expression: str) -> Any:
        reply = self.send("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in reply, reply
        return reply["result"].get("value")

    def press(self, key: str, times: int = 1) -> None:
        """Press a key, or type a text."""
        for _ in range(times):
            if key not in KEYS:
                self.send("Input.insertText", text=key)
                continue
            event = {"key": key, "code": key, "windowsVirtualKeyCode": KEYS[key]}
            text = {"text": "\r"} if key == "Enter" else {}
            self.send(
                "Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", **event, **text
            )
            self.send("Input.dispatchKeyEvent", type="keyUp", **event)

    def picture(self, path: Path, *, whole: bool = True) -> None:
        data = self.send("Page.captureScreenshot", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))
