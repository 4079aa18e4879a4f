"""A headless Chromium without a network, driven over its debugging protocol: what a reader's browser makes of a page.

tornado, which comes with bokeh, speaks the protocol; nothing else is needed. Tests that use it skip where no Chromium
is installed (`apt-get install chromium`).
"""

import asyncio
import base64
import json
import os
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
LIMIT_S = 120.0

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")


class Browser:
    """One tab; use it as a context manager. `local` lets it reach servers of this machine."""

    def __init__(self, profile: Path, *, local: bool = False) -> None:
        self._profile = profile
        self._names = "MAP * ~NOTFOUND" + (", EXCLUDE 127.0.0.1" if local else "")
        self._loop = asyncio.new_event_loop()
        self._events: list[dict[str, Any]] = []
        self._number = 0

    def __enter__(self) -> "Browser":
        from tornado.websocket import websocket_connect

        options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run"]
        options += [
            "--disable-background-networking",
            f"--host-resolver-rules={self._names}",
            "--disable-dev-shm-usage",
        ]
        options += ["--remote-debugging-port=0", f"--user-data-dir={self._profile}", "about:blank"]
        self._process = subprocess.Popen([str(CHROMIUM), *options], stderr=subprocess.DEVNULL)
        port = self._profile / "DevToolsActivePort"
        wait(lambda: port.exists() and port.read_text().strip(), "the browser's port")
        root = f"http://127.0.0.1:{port.read_text().split()[0]}/json"
        tabs: list[dict[str, Any]] = []

        def found() -> bool:
            with urllib.request.urlopen(root) as answer:
                tabs[:] = [tab for tab in json.load(answer) if tab["type"] == "page"]
            return bool(tabs)

        wait(found, "the browser's tab")
        address = tabs[0]["webSocketDebuggerUrl"]

        async def connect():
            return await websocket_connect(address, max_message_size=1 << 28)

        self._socket = self._loop.run_until_complete(connect())
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(LIMIT_S)
        self._loop.close()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command; return its result."""
        self._number += 1
        number = self._number

        async def ask() -> dict[str, Any]:
            await self._socket.write_message(json.dumps({"id": number, "method": method, "params": parameters}))
            while True:
                text = await self._socket.read_message()
                assert text is not None, "the browser went away"
                message = json.loads(text)
                if message.get("id") == number:
                    assert "error" not in message, message
                    return dict(message["result"])
                self._events.append(message)

        return self._loop.run_until_complete(asyncio.wait_for(ask(), LIMIT_S))

    def js(self, code: str) -> Any:
        """Return the value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=code, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def open(self, page: Path, width: int = 1280, height: int = 900, *, dark: bool = False) -> None:
        """Load a page from disk; return when its text is there."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self._events.clear()
        self.call("Page.navigate", url=page.resolve().as_uri())
        wait(lambda: self.js("document.readyState") == "complete", "the page")

    def draw_all(self) -> None:
        """Wait until every chart is drawn."""
        wait(lambda: self.js("document.documentElement.dataset.drawn") == "all", "the charts")

    def complaints(self) -> list[str]:
        """Return exceptions, console errors and warnings, and whatever was asked of a network."""
        self.js("new Promise((done) => requestAnimationFrame(() => setTimeout(done, 0)))")
        out = []
        for event in self._events:
            kind, what = event["method"], event["params"]
            if kind == "Runtime.exceptionThrown":
                out.append(json.dumps(what["exceptionDetails"])[:2000])
            elif kind == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning", "assert"):
                out.append(json.dumps(what["args"])[:2000])
            elif kind == "Log.entryAdded" and what["entry"]["level"] in ("error", "warning"):
                out.append(json.dumps(what["entry"])[:2000])
            elif kind == "Network.requestWillBeSent":
                address = what["request"]["url"]
                if not address.startswith(("file:", "data:", "blob:")):
                    out.append(f"asks for {address}")
        return out

    def key(self, key: str) -> None:
        """Press a key."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Move or press the pointer, or turn the wheel."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def picture(self, path: Path) -> None:
        """Write what is in sight as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))


def wait(condition: Callable[[], object], what: str) -> None:
    """Wait until a condition holds."""
    limit = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < limit, f"no sign of {what} in {LIMIT_S:.0f} s"
        time.sleep(0.02)
