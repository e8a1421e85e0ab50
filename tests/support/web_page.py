"""A page without a browser: what its script would say to a server, and what it hears."""

import threading
import time
from contextlib import suppress
from typing import Any

import msgspec
import zstandard
from viser import __version__ as version
from viser import _messages
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

CAMERA: dict[str, Any] = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 3.0), "look_at": (0.0, 0.0, 0.0)}
CAMERA |= {
    "fov": 1.0,
    "near": 0.01,
    "far": 100.0,
    "image_height": 480,
    "image_width": 640,
    "up_direction": (0.0, 1.0, 0.0),
}


class Page:
    """A connection to `url`. It keeps the last value of each property by the name of its part, and counts bytes; slow: seconds
    that it waits before it reads on; own: of the camera's fields. `camera` keeps where it is told to look from."""

    def __init__(self, url: str, slow: float = 0.0, **own: Any) -> None:
        self.parts: dict[str, dict[str, Any]] = {}
        self.said: list[dict[str, Any]] = []  # messages for whoever looks at it
        self.kinds: set[str] = set()  # of messages so far
        self.camera: dict[str, tuple[float, float, float]] = {}  # by the kind of message, the start left out
        self.bytes, self.slow = 0, slow
        self.starts = 0  # messages on where pages look from at first
        self.size = tuple((CAMERA | own)[name] for name in ("image_width", "image_height"))  # px
        address = url.replace("http://", "ws://").rstrip("/")
        self.socket = connect(address, subprotocols=[Subprotocol(f"viser-v{version}")], max_size=None, compression=None)
        self.say("ViewerCameraMessage", **CAMERA | own)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def say(self, kind: str, **fields: Any) -> None:
        """Send a message."""
        self.socket.send(msgspec.msgpack.encode(getattr(_messages, kind)(**fields).as_serializable_dict([])))

    def _listen(self) -> None:
        with suppress(ConnectionClosed):
            for message in self.socket:
                assert isinstance(message, bytes)
                self.bytes += len(message)
                self._take(message)
                time.sleep(self.slow)

    def _take(self, message: bytes) -> None:
        size = int.from_bytes(message[8:16], "little")
        whole = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(message[16 : 16 + size]))
        for one in whole["messages"]:
            self.kinds.add(one["type"])
            self.starts += one["type"].startswith("SetCamera") and one.get("initial", False)
            if one["type"].startswith("SetCamera") and not one.get("initial"):
                self.camera[one["type"]] = one.get("position") or one.get("look_at")
            if one["type"] == "NotificationShowMessage":
                self.said.append(one["props"])
            name = one.get("name") or one.get("uuid")
            if name is None:
                continue
            part = self.parts.setdefault(name, {})
            part.update({"type": one["type"]} if "props" in one else {})
            part.update(one.get("props") or one.get("updates") or {})
            part.update({"visible": one["visible"]} if "visible" in one else {})
            part.setdefault("updates", 0)
            part["updates"] += 1

    def until(self, happened: Any, wait: float = 60.0) -> None:
        """Wait for it."""
        end = time.monotonic() + wait
        while not happened():
            assert time.monotonic() < end, f"waited in vain; heard of {list(self.parts)}"
            time.sleep(0.02)

    @property
    def closed(self) -> bool:
        """True if the server has ended the connection."""
        return not self._thread.is_alive()

    @property
    def figures(self) -> str:
        """Text of the panel."""
        return next((one["content"] for one in self.parts.values() if one.get("type") == "GuiHtmlMessage"), "")

    @property
    def labels(self) -> list[str]:
        """Labels of all buttons of the panel."""
        return [label for one in self.parts.values() for label in one.get("options", ())]

    def press(self, label: str) -> None:
        """Press a button of the panel."""
        uuid = next(k for k, one in self.parts.items() if label in one.get("options", ()))
        self.say("GuiUpdateMessage", uuid=uuid, updates={"value": label})

    def drag(self, name: str, phase: str, to: Any, instance: int | None = None) -> None:
        """A moment of a drag of a part."""
        self.say(
            "SceneNodeDragMessage", phase=phase, name=name, instance_index=instance, start_position=tuple(to),
            start_screen_pos=(0.5, 0.5), end_position=tuple(to), end_screen_pos=(0.5, 0.5), button="left", modifier=None,
        )  # fmt: skip

    def vanish(self) -> None:
        """Go without a word."""
        self.socket.socket.shutdown(2)

    def close(self) -> None:
        self.socket.close()

    def __enter__(self) -> "Page":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
