"""glTF 2.0, as JSON or binary: the triangles that its scene shows, each mesh where its nodes put it."""

import base64
import json
import re
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.atomic_file import kind_of
from taichi_sim.common.errors import SceneError, short
from taichi_sim.geometry.gltf_rules import COMPONENTS, WIDTHS, check
from taichi_sim.geometry.ply_file import unrolled
from taichi_sim.geometry.polygons import FormatError, Polygons

__all__ = ["header_of", "outer_files", "read"]

HEADER = struct.Struct("<4sIIII")  # magic, version, length; of the first chunk its length and kind
CHUNK = struct.Struct("<II")
COMPRESSIONS = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
}
INSTANCES = "EXT_mesh_gpu_instancing"
HARMLESS = re.compile("material|texture|light|mesh_quantization|xmp")  # extensions that change no shape, or are known
TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives; others are points and lines


def header_of(data: bytes, kind: str) -> dict[str, Any]:
    """Return the JSON of a glTF file, kind "glb" or "gltf", of which what is read keeps the rules. Raises FormatError."""
    if kind == "glb":
        if len(data) < HEADER.size or data[:4] != b"glTF":
            raise FormatError("it does not begin with glTF")
        data = data[HEADER.size : HEADER.size + HEADER.unpack_from(data)[3]]
    try:
        header = json.loads(data)
    except (ValueError, RecursionError) as error:
        at = f" at line {error.lineno}, column {error.colno}" if isinstance(error, json.JSONDecodeError) else ""
        raise FormatError(f"its JSON is damaged{at}") from None
    if not isinstance(header, dict):
        raise FormatError("its JSON is no table")
    check(header)
    version = header.get("asset", {}).get("version", "2.0")
    if not version.startswith("2."):
        raise FormatError(f"it is glTF of version {version[:9]}; version 2 is read")
    return header


def outer_files(file: Path, header: Mapping[str, Any]) -> dict[int, Path]:
    """Return the files of buffers that lie beside a glTF file, by the buffer's number. Raises SceneError for one in another
    folder."""
    folder, found = file.resolve().parent, {}
    for number, buffer in enumerate(header.get("buffers", ())):
        name = unquote(buffer.get("uri", ""))
        if name and not name.startswith("data:"):
            if not name.isprintable():
                raise SceneError("mesh", file, says=f"names {short(name)}, which no file is called")
            found[number] = (folder / name).resolve()
            if not found[number].is_relative_to(folder):
                raise SceneError("mesh", file, says=f"names {short(name)}, which lies outside its folder")
            if (kind := kind_of(found[number])) != "file":
                is_a = f"is a {kind}, and no file" if kind else "is not there"
                raise SceneError("mesh", file, says=f"names {short(name)}, which {is_a}")
    return found


def read(file: Path, data: bytes, header: Mapping[str, Any], kind: str) -> Polygons:
    """Return the triangles of a glTF file. Raises FormatError and SceneError."""
    _refuse_compressed(file, header)
    buffers = _buffers(file, data, header, kind)
    accessors = _Accessors(header, buffers)
    vertices, corners, places = [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
    first = 0
    for mesh, matrix in _shown(file, header):
        for part in header["meshes"][mesh]["primitives"]:
            if part.get("mode", TRIANGLES) not in (TRIANGLES, STRIP, FAN) or "POSITION" not in part["attributes"]:
                continue
            x = accessors.at(part["attributes"]["POSITION"], "VEC3").astype(np.float64)
            index = np.arange(len(x))
            if "indices" in part:
                found = accessors.at(part["indices"], "SCALAR")
                if found.dtype.kind != "u":
                    raise FormatError(
                        f"accessors[{part['indices']}] holds indices; they must be whole and not negative"
                    )
                index = found.astype(np.int64).ravel()
            triangles = _triangles(index, part.get("mode", TRIANGLES))
            if np.linalg.det(matrix[:3, :3]) < 0.0:  # a mirror
                triangles = triangles[:, ::-1]
            uv = np.full((triangles.size, 2), np.nan)
            if (
                "TEXCOORD_0" in part["attributes"]
                and triangles.size
                and 0 <= triangles.min() <= triangles.max() < len(x)
            ):
                uv = accessors.at(part["attributes"]["TEXCOORD_0"], "VEC2")[triangles.ravel()] * [1.0, -1.0] + [
                    0.0,
                    1.0,
                ]
            vertices.append(x @ matrix[:3, :3].T + matrix[:3, 3])
            corners.append(first + triangles.ravel())
            places.append(uv)
            first += len(x)
    found, uv = np.concatenate(corners), np.concatenate(places)
    counts = np.full(len(found) // 3, 3)
    return Polygons(np.concatenate(vertices), found, counts, None if np.isnan(uv).all() else uv)


def _refuse_compressed(file: Path, header: Mapping[str, Any]) -> None:
    for name in header.get("extensionsRequired", ()):
        if name in COMPRESSIONS:
            says = f"is compressed with {COMPRESSIONS[name]} ({name}), which is not read; export it without compression"
            raise SceneError("mesh", file, says=says)
        if name == INSTANCES:
            raise _instances(file)
        if not HARMLESS.search(name):
            says = f"needs the extension {short(name)}, which is not read; export it without"
            raise SceneError("mesh", file, says=says)


def _instances(file: Path) -> SceneError:
    return SceneError("mesh", file, says=f"has instances ({INSTANCES}), which are not read; export them as meshes")


def _buffers(file: Path, data: bytes, header: Mapping[str, Any], kind: str) -> list[bytes]:
    outside, found = outer_files(file, header), []
    for number, buffer in enumerate(header.get("buffers", ())):
        uri = buffer.get("uri", "")
        if number in outside:
            found.append(outside[number].read_bytes())
        elif uri:
            found.append(base64.b64decode(uri.partition(",")[2]))
        else:
            found.append(_chunk(data) if kind == "glb" else b"")
    return found


def _chunk(data: bytes) -> bytes:
    """The buffer of a binary file, which follows its JSON."""
    at = HEADER.size + HEADER.unpack_from(data)[3]
    if at + CHUNK.size > len(data):
        return b""
    length, _ = CHUNK.unpack_from(data, at)
    return data[at + CHUNK.size : at + CHUNK.size + length]


class _Accessors:
    """Arrays of a glTF file by their numbers."""

    def __init__(self, header: Mapping[str, Any], buffers: list[bytes]) -> None:
        self._accessors, self._views = header.get("accessors", ()), header.get("bufferViews", ())
        self._buffers = buffers

    def at(self, number: int, type: str) -> NDArray:
        """The array (count, width) of an accessor of this type; whole numbers that stand for 0..1 or -1..1 as such."""
        one = self._accessors[number]
        if one["type"] != type:
            raise FormatError(f"accessors[{number}].type is {one['type']!r}; it must be {type!r} there")
        count, width, kind = one["count"], WIDTHS[type], np.dtype(COMPONENTS[one["componentType"]])
        found = np.zeros((count, width), kind)
        if "bufferView" in one:
            found = self._view(number, one["bufferView"], one.get("byteOffset", 0), count, width, kind)
        elif "sparse" not in one:
            raise FormatError(f"accessors[{number}] has no data")
        if "sparse" in one:
            found, sparse = found.copy(), one["sparse"]
            index, values, many = sparse["indices"], sparse["values"], sparse["count"]
            of_index = np.dtype(COMPONENTS[index["componentType"]])
            at = self._view(number, index["bufferView"], index.get("byteOffset", 0), many, 1, of_index)[:, 0]
            if (at >= count).any():
                raise FormatError(f"accessors[{number}].sparse.indices names item {at.max()}, and there are {count}")
            found[at] = self._view(number, values["bufferView"], values.get("byteOffset", 0), many, width, kind)
        if one.get("normalized") and kind.kind in "iu":
            return np.maximum(found / float(np.iinfo(kind).max), -1.0)
        return found

    def _view(self, number: int, view: int, offset: int, count: int, width: int, kind: np.dtype) -> NDArray:
        one = self._views[view]
        buffer = self._buffers[one["buffer"]]
        first, size = one.get("byteOffset", 0), width * kind.itemsize
        step = one.get("byteStride", size)
        last = offset + step * (count - 1) + size
        if step < size or last > one["byteLength"] or first + last > len(buffer):
            raise FormatError(f"accessors[{number}] reaches beyond its buffer")
        return (
            np.ndarray((count, width), kind, buffer, first + offset, (step, kind.itemsize))
            if count
            else np.zeros((0, width))
        )


def _triangles(index: NDArray, mode: int) -> NDArray[np.int64]:
    """Triangles (t, 3) of a list, a strip or a fan."""
    if mode == TRIANGLES:
        if len(index) % 3:
            raise FormatError(f"a list of triangles has {len(index)} corners; there must be three for each")
        return index.reshape(-1, 3)
    if len(index) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == STRIP:
        return unrolled(index)
    return np.stack([np.full(len(index) - 2, index[0]), index[1:-1], index[2:]], axis=1)


def _shown(file: Path, header: Mapping[str, Any]) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """The meshes that the scene shows, and the matrix (4, 4) that places each."""
    nodes, scenes = header.get("nodes", ()), header.get("scenes", ())
    if scenes:
        roots = scenes[header.get("scene", 0)].get("nodes", ())
    elif nodes:
        inner = {child for node in nodes for child in node.get("children", ())}
        roots = [number for number in range(len(nodes)) if number not in inner]
    else:
        yield from ((mesh, np.eye(4)) for mesh in range(len(header.get("meshes", ()))))
        return
    waiting, seen = [(number, np.eye(4)) for number in reversed(roots)], set[int]()
    while waiting:
        number, outer = waiting.pop()
        if number in seen:
            raise FormatError(f"node {number} is shown more than once")
        seen.add(number)
        node = nodes[number]
        if INSTANCES in node.get("extensions", {}):
            raise _instances(file)
        matrix = outer @ _placed(node)
        if "mesh" in node:
            _require_rigid(file, node, header["meshes"][node["mesh"]])
            yield node["mesh"], matrix
        waiting += [(child, matrix) for child in reversed(node.get("children", ()))]


def _require_rigid(file: Path, node: Mapping[str, Any], mesh: Mapping[str, Any]) -> None:
    """Raise SceneError where bones or shape keys give a mesh another shape than its vertices have."""
    if "skin" in node:
        raise SceneError(
            "mesh", file, says="has a skin, whose bones are not read; apply the armature, and export it without"
        )
    if any(node.get("weights", mesh.get("weights", ()))):
        raise SceneError(
            "mesh", file, says="has shape keys in use, which are not read; apply them, and export it without"
        )


def _placed(node: Mapping[str, Any]) -> NDArray[np.float64]:
    """The matrix (4, 4) of a node."""
    if "matrix" in node:
        return np.reshape(np.array(node["matrix"], dtype=np.float64), (4, 4)).T
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix
