"""Windows of headless Chromium, which are spoken to by its own protocol, over a websocket."""

import base64
import json
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image
from websockets.sync.client import connect

BROWSER = shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("chromium-browser")
OPTIONS = (
    "--headless=new", "--no-sandbox", "--no-first-run", "--remote-debugging-port=0", "--hide-scrollbars",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
)  # fmt: skip


class Window:
    """A window of so many pixels, open at nothing. It has no focus, as one that lies behind others.

    `errors` holds what the console called an error, and exceptions; `said` all that scripts wrote there.
    """

    def __init__(self, address: str, width: int, height: int, dark: bool) -> None:
        self.socket = connect(address, max_size=None, compression=None)
        self.errors: list[str] = []
        self.said: list[str] = []
        self._number = 0
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setFocusEmulationEnabled", enabled=False)
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
        )
        theme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[theme])

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command of the protocol."""
        self._number += 1
        self.socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            heard = json.loads(self.socket.recv(timeout=120))
            if heard.get("id") == self._number:
                assert "error" not in heard, heard
                return heard["result"]
            self._note(heard.get("method"), heard.get("params"))

    def _note(self, method: str | None, told: Any) -> None:
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(told["exceptionDetails"].get("exception", told["exceptionDetails"])))
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(told["entry"]["text"])
        elif method == "Runtime.consoleAPICalled":
            words = " ".join(str(one.get("value", one.get("description"))) for one in told["args"])
            self.said.append(words)
            self.errors.extend([words] if told["type"] in ("error", "assert") else [])

    def open(self, url: str) -> None:
        """Go there, and wait for nothing."""
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """Value of an expression of JavaScript."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, script: str, wait: float = 60.0) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + wait
        while not self.run(script):
            assert time.monotonic() < end, f"waited in vain for {script}; the page says {self.text!r}, {self.said}"
            time.sleep(0.1)

    def until_it_says(self, words: str, wait: float = 60.0) -> None:
        """Wait until words are on the page."""
        self.until(f"document.body?.innerText.includes({json.dumps(words)})", wait)

    @property
    def text(self) -> str:
        """Words on the page."""
        return self.run("document.body?.innerText ?? ''")

    def picture(self) -> np.ndarray:
        """Pixels (height, width, 3), as signed numbers."""
        data = self.call("Page.captureScreenshot")["data"]
        return np.array(Image.open(BytesIO(base64.b64decode(data))).convert("RGB")).astype(int)

    def close(self) -> None:
        """Close it, as its button does."""
        self.call("Page.close")
        self.socket.close()


class Chromium:
    """A browser that draws in software; place: where its protocol is spoken, as in localhost:9222/devtools/browser/1."""

    def __init__(self, place: str) -> None:
        self.place = place

    def window(self, width: int = 640, height: int = 360, dark: bool = False) -> Window:
        """A new window."""
        with connect(f"ws://{self.place}") as line:
            made = {"url": "about:blank", "newWindow": True}  # a tab behind another one would draw nothing
            line.send(json.dumps({"id": 1, "method": "Target.createTarget", "params": made}))
            answers = (json.loads(heard) for heard in line)
            number = next(one["result"]["targetId"] for one in answers if one.get("id") == 1)
        host = self.place.partition("/")[0]
        return Window(f"ws://{host}/devtools/page/{number}", width, height, dark)


@contextmanager
def chromium() -> Iterator[Chromium]:
    """A browser, for the time of the block."""
    assert BROWSER is not None
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
        command = [BROWSER, *OPTIONS, f"--user-data-dir={folder}"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        stack.callback(process.wait)
        stack.callback(process.kill)
        assert process.stderr is not None
        found = (re.search(r"listening on ws://(\S+)", line) for line in process.stderr)
        yield Chromium(next(one[1] for one in found if one))
