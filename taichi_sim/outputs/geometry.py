"""Meshes as OBJ or PLY files, one for each frame, for other programs to render."""

import glob
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import replacing, require_place, sweep
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs.base import Image
from taichi_sim.outputs.parts import Parts, Texture, Textures, Together, few_colours, textures_of
from taichi_sim.outputs.resumable import Resumable, require_there
from taichi_sim.outputs.run_log import Checkpoint
from taichi_sim.render.palette import to_linear

BALL_TRIANGLES, MOST_CUTS = 50_000, 2  # of the balls of a frame of an OBJ together, and cuts of the triangles of each


class Geometry(Resumable):
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
    suffix = ""  # of the files, where it is not that of the name

    def __init__(self, path: str | PathLike[str], resume: bool = False) -> None:
        super().__init__(path, resume=resume)
        require_place(path)
        self.suffix = self.suffix or self.path.suffix.lower()
        sweep(self.path.parent, f"{glob.escape(self.path.stem)}_*{self.suffix}")
        self.pattern = str(self.path.with_name(f"{self.path.stem}_*{self.suffix}"))
        self._next = 0  # frame
        self._parts: Parts | None = None
        self._obj: _Obj | None = None
        self._textures: Textures = {}

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        self._textures = textures_of(style, self.path.parent)
        self._parts = Parts(first)

    def has(self, checkpoint: Checkpoint) -> bool:
        return all(self._file(index).is_file() for index in range(checkpoint.frame))

    def go_on(self, checkpoint: Checkpoint) -> None:
        self.frames = self._next = checkpoint.frame

    def hold(self) -> Mapping[str, Any]:
        return {}  # each file is on the disk when it appears

    def _file(self, index: int) -> Path:
        return self.path.with_name(f"{self.path.stem}_{index:05d}{self.suffix}")

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        self.log.open()
        if self._parts is None:
            self._parts = Parts(frame)
        with replacing(self._file(index), swept=True) as file:
            self.fill(file, Together.of(self._parts, frame))
        self._next = index + 1

    def fill(self, file: IO[bytes], parts: Together) -> None:
        """Write a frame to its file."""
        if self.suffix == ".ply":
            _write_ply(file, parts)
            return
        if self._obj is None:
            library = self.path.with_name(f"{self.path.stem}_frames.mtl")
            self._obj = _Obj(parts, library.name, self._textures)
            with replacing(library, swept=True) as materials:
                self._obj.write_materials(materials)
        self._obj.write(file, parts)

    def finish(self) -> None:
        """Raises OSError where a file was removed meanwhile."""
        require_there(map(self._file, range(self._next)))
        self.log.delete()

    def discard(self) -> None:
        """Give it up; files that were written stay."""
        self.leave()


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


class _Obj:
    """What all frames of an OBJ have in common: names, materials, and spheres for loose balls, which its readers pass over."""

    def __init__(self, parts: Together, library: str, textures: Textures) -> None:
        self._library = library
        self.materials: list[tuple[str, NDArray, Texture | None]] = []
        names = self._names = ["_".join(name.split()) for name in parts.names]
        loose = parts.loose
        cuts = max((k for k in range(MOST_CUTS + 1) if len(loose) * 20 * 4**k <= BALL_TRIANGLES), default=0)
        self._ball = icosphere(cuts)
        self._of_surface: dict[int, str] = {}
        self._of_ball = np.zeros(len(loose), dtype=np.int64)  # which material
        for k, name in enumerate(names):
            whole = parts.triangles[parts.number[parts.triangles[:, 0]] == k]
            if len(whole):
                mapped = textures.get(parts.names[k]) if np.isfinite(parts.uv[whole]).all() else None
                self._of_surface[k] = name
                self.materials.append((name, parts.colour[np.unique(whole)].mean(axis=0), mapped))
            mine = np.flatnonzero(parts.number[loose] == k)
            if len(mine):
                colours, kind = few_colours(parts.colour[loose[mine]])
                self._of_ball[mine] = len(self.materials) + kind
                plain = len(colours) == 1 and k not in self._of_surface
                self.materials += [
                    (name if plain else f"{name}_ball_{m}", colour, None) for m, colour in enumerate(colours)
                ]

    def write_materials(self, file: IO[bytes]) -> None:
        """The library of materials; colours are linear, as Blender reads them."""
        for name, colour, texture in self.materials:
            red, green, blue = to_linear(colour)
            file.write(f"newmtl {name}\nKd {red:.4f} {green:.4f} {blue:.4f}\nNs 60\nillum 2\n".encode())
            if texture is not None:
                image, repeat = texture
                often = "" if repeat == 1.0 else f"-s {repeat:g} {repeat:g} 1 "
                file.write(f"map_Kd {often}{image}\n".encode())

    def write(self, file: IO[bytes], parts: Together) -> None:
        """A frame."""
        loose, ball = parts.loose, self._ball
        n, m = len(parts.points), len(ball.vertices)
        around = parts.points[loose, None] + parts.radius[loose, None, None] * ball.vertices
        points = np.concatenate([parts.points, around.reshape(-1, 3)])
        colour = np.concatenate([parts.colour, np.repeat(parts.colour[loose], m, axis=0)])
        file.write(f"mtllib {self._library}\n".encode())
        np.savetxt(file, np.column_stack([points, colour]), fmt="v %.9g %.9g %.9g %.4g %.4g %.4g")
        np.savetxt(file, np.concatenate([parts.normals, ball.vertices]), fmt="vn %.6g %.6g %.6g")
        mapped = bool(np.isfinite(parts.uv).any())
        if mapped:
            np.savetxt(file, np.nan_to_num(parts.uv), fmt="vt %.6g %.6g")
        whole = np.isfinite(parts.uv[:, 0])
        faces = ball.triangles[None] + m * np.arange(len(loose))[:, None, None]  # (b, t, 3)
        for k, name in enumerate(self._names):
            file.write(f"o {name}\n".encode())
            own = parts.triangles[parts.number[parts.triangles[:, 0]] == k]
            if len(own):
                file.write(f"usemtl {self._of_surface[k]}\n".encode())
                corner, times = (" %d/%d/%d", 3) if mapped and whole[own].all() else (" %d//%d", 2)
                np.savetxt(file, np.repeat(own, times, axis=1) + 1, fmt="f" + 3 * corner)
            mine = np.flatnonzero(parts.number[loose] == k)
            for material in np.unique(self._of_ball[mine]).tolist():
                file.write(f"usemtl {self.materials[material][0]}\n".encode())
                of_these = faces[mine[self._of_ball[mine] == material]]
                with_normals = np.stack([of_these + n, np.broadcast_to(ball.triangles + n, of_these.shape)], axis=-1)
                np.savetxt(file, with_normals.reshape(-1, 6) + 1, fmt="f %d//%d %d//%d %d//%d")
            np.savetxt(file, parts.springs[parts.number[parts.springs[:, 0]] == k] + 1, fmt="l %d %d")
