"""Meshes as OBJ or PLY files, one for each frame, for other programs to render."""

import glob
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import replacing, sweep
from taichi_sim.outputs.base import FileOutput, Image, require_there
from taichi_sim.outputs.obj import Obj
from taichi_sim.outputs.parts import Parts, Textures, Together, textures_of


class Geometry(FileOutput):
    """name_00000.ply, name_00001.ply, ... (or .obj) beside each other in a folder that is there, for the name `name.ply`.

    Each holds all parts of the frame, see `Parts`: surfaces in place of what they cover, loose balls (in PLY as points with their
    radius, in OBJ as spheres), springs between these as edges, colliders; with normals, colours, and texture coordinates where
    there are some. An OBJ has objects with names, and materials in name_frames.mtl, that of all frames; a PLY is one mesh, in
    which each vertex has the number of its object, and comments their names. A file that is there
    is replaced when the new one is complete; what was written before an error or Ctrl-C stays. resume: go on from the last
    checkpoint of a run into the same name.
    """

    needs_image = False
    apart = True
    keeps_frames = True
    suffix = ""  # of the files, where it is not that of the name

    def __init__(self, path: str | PathLike[str], resume: bool = False) -> None:
        super().__init__(path, resume=resume)
        self.suffix = self.suffix or self.path.suffix.lower()
        sweep(self.path.parent, f"{glob.escape(self.path.stem)}_*{self.suffix}")
        self.pattern = str(self.path.with_name(f"{self.path.stem}_*{self.suffix}"))
        self._next = 0  # frame
        self._parts: Parts | None = None
        self._obj: Obj | None = None
        self._textures: Textures = {}

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        self._textures = textures_of(style, self.path.parent)
        self._know(first)

    def _know(self, first: Frame) -> None:
        """Know what all frames have in common, by the first of the run."""
        self._parts = Parts(first, self._textures)
        if self.suffix == ".obj":
            library = self.path.with_name(f"{self.path.stem}_frames.mtl")
            self._obj = Obj(Together.of(self._parts, first), library, self._textures)

    def contains(self, count: int) -> bool:
        return all(map(Path.is_file, map(self._file, range(count))))

    def holds(self, count: int) -> bool:
        return self.contains(count) and not self._file(count).exists()

    def _file(self, index: int) -> Path:
        return self.path.with_name(f"{self.path.stem}_{index:05d}{self.suffix}")

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        self.log.open()
        if self._parts is None:
            self._know(frame)
        assert self._parts is not None
        with replacing(self._file(index), swept=True) as file:
            self.fill(file, Together.of(self._parts, frame))
        self._next = index + 1

    def fill(self, file: IO[bytes], parts: Together) -> None:
        """Write a frame to its file."""
        if self.suffix == ".ply":
            _write_ply(file, parts)
            return
        assert self._obj is not None
        self._obj.write(file, parts)

    def finish(self) -> None:
        """Raises OSError where a file was removed meanwhile."""
        require_there(map(self._file, range(self._next)))
        super().finish()


def _write_ply(file: IO[bytes], parts: Together) -> None:
    columns: dict[str, Any] = {name: parts.points[:, k] for k, name in enumerate("xyz")}
    columns |= {f"n{name}": parts.normals[:, k] for k, name in enumerate("xyz")}
    columns["radius"] = parts.radius
    if np.isfinite(parts.uv).any():
        columns |= {name: np.nan_to_num(parts.uv[:, k]) for k, name in enumerate("st")}
    kinds = [(name, "<f4") for name in columns]
    columns |= {name: np.rint(255.0 * parts.colour[:, k]) for k, name in enumerate(("red", "green", "blue"))}
    columns["object"] = parts.number
    kinds += [("red", "u1"), ("green", "u1"), ("blue", "u1"), ("object", "<i4")]
    words = {"<f4": "float", "u1": "uchar", "<i4": "int"}
    head = ["ply", "format binary_little_endian 1.0"]
    head.append("comment up y")
    head += [f"comment object {k} {' '.join(name.split())}" for k, name in enumerate(parts.names)]
    head += [f"element vertex {len(parts.points)}", *(f"property {words[kind]} {name}" for name, kind in kinds)]
    head += [f"element face {len(parts.triangles)}", "property list uchar int vertex_indices"]
    if len(parts.springs):
        head += [f"element edge {len(parts.springs)}", "property int vertex1", "property int vertex2"]
    file.write("\n".join([*head, "end_header", ""]).encode())
    vertices = np.empty(len(parts.points), dtype=kinds)
    for name, column in columns.items():
        vertices[name] = column
    file.write(vertices.tobytes())
    rows = np.empty(len(parts.triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, parts.triangles
    file.write(rows.tobytes())
    file.write(parts.springs.astype("<i4").tobytes())
