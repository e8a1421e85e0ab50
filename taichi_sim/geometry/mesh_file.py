"""Mesh files, from anywhere: what a file would take is estimated from its size and headers before a library reads it."""

import io
import json
import math
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from taichi_sim.common.atomic_file import require_file
from taichi_sim.common.errors import SceneError
from taichi_sim.common.memory import available

__all__ = ["SUFFIXES", "load"]

SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf")
READ_BYTES = 30  # of memory for each byte of a file while it is read and its vertices become one; measured: 10 to 23
TRIANGLE_BYTES = 600  # likewise for each triangle
STL_HEADER, STL_TRIANGLE = 84, 50  # bytes of a binary STL
GLB_HEADER = struct.Struct("<4sIIII")  # magic, version, length; of the first chunk its length and kind


def load(file: Path) -> Any:
    """What trimesh makes of a file: an object with vertices and faces. Raises SceneError about `mesh`."""
    try:
        import trimesh
    except ImportError:
        raise SceneError("mesh", says='reading meshes needs one more package: pip install "taichi-sim[mesh]"') from None
    kind = file.suffix[1:].lower()
    try:
        require_file(file)
        _affordable(file, READ_BYTES * file.stat().st_size)
        data = file.read_bytes()
        resolver = None
        if kind in ("glb", "gltf"):
            _check_gltf(file, _json_of(data, kind))
            resolver = trimesh.resolvers.FilePathResolver(str(file.resolve().parent)) if kind == "gltf" else None
        else:
            data = _readable(data, kind)
        return trimesh.load_mesh(
            io.BytesIO(data), file_type=kind, resolver=resolver, process=False, skip_materials=True
        )
    except SceneError:
        raise
    except Exception as error:  # a parser for foreign files may raise anything
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        says = f"cannot be read as {kind.upper()} with faces: {reason}"
        raise SceneError("mesh", file, says=says) from error


def _affordable(file: Path, need: float) -> None:
    free = available()
    if need > free:
        says = f"needs about {need / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free"
        raise SceneError("mesh", file, says=says)


def _readable(data: bytes, kind: str) -> bytes:
    """The data with all text in UTF-8: names and comments may be in any encoding, and mean nothing here."""
    if kind == "stl":
        number = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
        if len(data) >= STL_HEADER and len(data) == STL_HEADER + STL_TRIANGLE * number:
            return bytes(STL_HEADER - 4) + data[STL_HEADER - 4 :]
        if not data.lstrip().startswith(b"solid"):
            raise ValueError(
                f"it is no text, which begins with solid, and no binary one: of {number} triangles that would have"
                f" {STL_HEADER + STL_TRIANGLE * number} bytes, and it has {len(data)}"
            )
    if kind == "ply":
        head, end, body = data.partition(b"end_header")
        if b"binary" in head:
            return _as_text(head) + end + body
    return _as_text(data)


def _as_text(data: bytes) -> bytes:
    return data.decode("utf-8", errors="replace").encode()


def _json_of(data: bytes, kind: str) -> Any:
    if kind == "gltf":
        return json.loads(data)
    if len(data) < GLB_HEADER.size or data[:4] != b"glTF":
        raise ValueError("it does not begin with glTF")
    return json.loads(data[GLB_HEADER.size : GLB_HEADER.size + GLB_HEADER.unpack_from(data)[3]])


def _check_gltf(file: Path, header: dict[str, Any]) -> None:
    """Raise where it names files of other folders, or describes more than its bytes hold or the memory that is free."""
    folder = file.resolve().parent
    held = file.stat().st_size
    for buffer in header.get("buffers", ()):
        name = unquote(buffer.get("uri", ""))
        if name and not name.startswith("data:"):
            beside = (folder / name).resolve()
            if not beside.is_relative_to(folder):
                raise SceneError("mesh", file, says=f"names {name!r}, which lies outside its folder")
            require_file(beside)
            held += beside.stat().st_size
    _affordable(file, READ_BYTES * held)
    accessors = header.get("accessors", ())
    for number, accessor in enumerate(accessors):
        if not 0 <= int(accessor["count"]) <= held:
            raise ValueError(f"accessor {number} would have {accessor['count']} items in {held} bytes")
    faces = [
        sum(accessors[part["indices"]]["count"] / 3 if "indices" in part else held for part in mesh["primitives"])
        for mesh in header.get("meshes", ())
    ]
    drawn = math.fsum(faces[node["mesh"]] for node in header.get("nodes", ()) if "mesh" in node)
    _affordable(file, TRIANGLE_BYTES * drawn)
