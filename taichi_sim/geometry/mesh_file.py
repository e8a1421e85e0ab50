"""Mesh files, from anywhere: what a file would take is estimated from its size and headers before it is read."""

import codecs
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taichi_sim.common.errors import SceneError
from taichi_sim.common.memory import available
from taichi_sim.geometry import gltf_file, obj_file, ply_file, stl_file
from taichi_sim.geometry.polygons import FormatError, Polygons

__all__ = ["SUFFIXES", "load", "states_up"]

SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf")
READ_BYTES = 30  # of memory for each byte of a file while it is read and its vertices become one; measured: 10 to 23
TRIANGLE_BYTES = 600  # likewise for each triangle


def load(file: Path) -> Polygons:
    """Return the polygons of a mesh file. Raises SceneError about `mesh`."""
    kind = file.suffix[1:].lower()
    try:
        _affordable(file, READ_BYTES * file.stat().st_size)
        data = _without_mark(file.read_bytes(), kind)
        if kind in ("glb", "gltf"):
            header = gltf_file.header_of(data, kind)
            _check_gltf(file, header)
            return gltf_file.read(file, data, header, kind)
        return {"obj": obj_file, "ply": ply_file, "stl": stl_file}[kind].read(data)
    except SceneError:
        raise
    except Exception as error:  # a damaged file may lead anywhere
        reason = str(error) if isinstance(error, FormatError) else getattr(error, "strerror", None)
        says = f"cannot be read as {kind.upper()} with faces: {reason or 'it is damaged'}"
        raise SceneError("mesh", file, says=says) from error


def states_up(file: Path) -> bool:
    """Return whether a file, or the custom of its format, tells which axis is up: OBJ and glTF do, STL and most PLY do not."""
    if file.suffix.lower() == ".ply":
        with open(file, "rb") as opened:
            return bool(ply_file.up_of(opened.read(4096)))
    return file.suffix.lower() != ".stl"


def _affordable(file: Path, need: float) -> None:
    free = available()
    if need > free:
        says = f"needs about {need / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free"
        raise SceneError("mesh", file, says=says)


def _without_mark(data: bytes, kind: str) -> bytes:
    """The data without a byte order mark; an OBJ in UTF-16 as UTF-8."""
    if kind == "obj" and data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace").encode()
    return data.removeprefix(codecs.BOM_UTF8)


def _check_gltf(file: Path, header: Mapping[str, Any]) -> None:
    """Raise where it names files of other folders, or describes more than its bytes hold or the memory that is free."""
    outside = gltf_file.outer_files(file, header).values()
    held = file.stat().st_size + sum(one.stat().st_size for one in outside)
    _affordable(file, READ_BYTES * held)
    accessors = header.get("accessors", ())
    for number, accessor in enumerate(accessors):
        if accessor["count"] > held:
            raise FormatError(f"accessors[{number}] would have {accessor['count']} items in {held} bytes")
    faces = [
        sum(accessors[part["indices"]]["count"] / 3 if "indices" in part else held for part in mesh["primitives"])
        for mesh in header.get("meshes", ())
    ]
    drawn = math.fsum(faces[node["mesh"]] for node in header.get("nodes", ()) if "mesh" in node)
    _affordable(file, TRIANGLE_BYTES * drawn)
