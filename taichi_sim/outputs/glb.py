"""Glb: a binary glTF 2.0 file under construction, its JSON and its buffer."""

import json
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.version import __version__
from taichi_sim.geometry.gltf_file import CHUNK, HEADER
from taichi_sim.geometry.gltf_rules import COMPONENTS

__all__ = ["Glb"]

VERTICES, CORNERS = 34962, 34963  # targets of buffer views: what vertices have, and indices of them
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
CODES = {np.dtype(kind): code for code, kind in COMPONENTS.items()}
JSON_CHUNK, BUFFER_CHUNK = 0x4E4F534A, 0x004E4942


class Glb:
    """A binary glTF 2.0 file under construction. Items refer to each other by the numbers that `add` and `array` return."""

    def __init__(self) -> None:
        self._tables: dict[str, list[dict[str, Any]]] = {}
        self._buffer: list[bytes] = []
        self._length = 0

    def add(self, table: str, **item: Any) -> int:
        """Append an item to a table of the file, without the keys that are None, and return its number."""
        items = self._tables.setdefault(table, [])
        items.append({key: value for key, value in item.items() if value is not None})
        return len(items) - 1

    def view(self, data: bytes, target: int | None = None) -> int:
        """Append bytes to the buffer and return the number of the view that shows them."""
        offset = self._length
        self._buffer.append(data + bytes(-len(data) % 4))
        self._length += len(self._buffer[-1])
        return self.add("bufferViews", buffer=0, byteOffset=offset, byteLength=len(data), target=target)

    def array(self, values: NDArray, target: int | None = None, bounds: bool = False, share: bool = False) -> int:
        """Append an array (n,) or (n, width) of f4, u2 or u4, and return the number of its accessor. bounds: state its least
        and largest values; share: whole numbers stand for shares from 0 to 1."""
        return self.arrays(values[None], target, bounds, share)[0]

    def arrays(
        self, values: NDArray, target: int | None = None, bounds: bool = False, share: bool = False
    ) -> list[int]:
        """Append the arrays of a stack (k, n) or (k, n, width) one after another, and return the numbers of their accessors."""
        values = np.ascontiguousarray(values)
        wide = values.reshape(*values.shape[:2], -1)
        view, made = self.view(values.tobytes(), target), []
        for k, one in enumerate(wide):
            low, high = (one.min(axis=0).tolist(), one.max(axis=0).tolist()) if bounds else (None, None)
            about = {"min": low, "max": high, "normalized": share or None, "byteOffset": k * one.nbytes or None}
            kind = {"componentType": CODES[values.dtype], "type": TYPES[wide.shape[2]], "count": len(one)}
            made.append(self.add("accessors", bufferView=view, **kind, **about))
        return made

    def write(self, file: IO[bytes], roots: list[int], about: Mapping[str, Any]) -> None:
        """Write the file, whose scene has these nodes as roots. about: what readers may find of the run, as extras."""
        asset = {"version": "2.0", "generator": f"taichi_sim {__version__}"}
        whole = {"asset": asset, "extras": dict(about), "scene": 0, "scenes": [{"nodes": roots}], **self._tables}
        if self._length:
            whole["buffers"] = [{"byteLength": self._length}]
        text = json.dumps(whole, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        rest = CHUNK.size + self._length if self._length else 0
        file.write(HEADER.pack(b"glTF", 2, HEADER.size + len(text) + rest, len(text), JSON_CHUNK))
        file.write(text)
        if self._length:
            file.write(CHUNK.pack(self._length, BUFFER_CHUNK))
            for part in self._buffer:
                file.write(part)
