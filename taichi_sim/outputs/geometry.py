"""Surfaces as OBJ or PLY files, one for each frame, for other programs to render."""

import glob
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import replacing, require_place, sweep
from taichi_sim.outputs.base import Image
from taichi_sim.outputs.resumable import Resumable, require_there
from taichi_sim.outputs.run_log import Checkpoint


class Geometry(Resumable):
    """name_00000.ply, name_00001.ply, ... (or .obj) beside each other in a folder that is there, for the name `name.ply`.

    Each holds the triangles of the frame, surfaces in place of what they cover, with the vertices that they use; a frame without
    any triangle its balls as points, with their radius in PLY. A file that is there is replaced when the new one is complete;
    what was written before an error or Ctrl-C stays. resume: go on from the last checkpoint of a run into the same name.
    """

    needs_image = False
    apart = True

    def __init__(self, path: str | PathLike[str], resume: bool = False) -> None:
        super().__init__(path, resume=resume)
        require_place(path)
        sweep(self.path.parent, f"{glob.escape(self.path.stem)}_*{self.path.suffix}")
        self.pattern = str(self.path.with_name(f"{self.path.stem}_*{self.path.suffix}"))
        self._ply = self.path.suffix.lower() == ".ply"
        self._next = 0  # frame

    def has(self, checkpoint: Checkpoint) -> bool:
        return all(self._file(index).is_file() for index in range(checkpoint.frame))

    def go_on(self, checkpoint: Checkpoint) -> None:
        self.frames = self._next = checkpoint.frame

    def hold(self) -> Mapping[str, Any]:
        return {}  # each file is on the disk when it appears

    def kept(self) -> int:
        return 0 if self.log.checkpoint is None else self.log.checkpoint.frame

    def _file(self, index: int) -> Path:
        return self.path.with_name(f"{self.path.stem}_{index:05d}{self.path.suffix}")

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        vertices, triangles = surface_of(frame)
        radius = None
        if not len(triangles):
            vertices, radius = _in_3d(frame.position), frame.radius
        self.log.open()
        with replacing(self._file(index), swept=True) as file:
            (_write_ply if self._ply else _write_obj)(file, vertices, triangles, radius)
        self._next = index + 1

    def finish(self) -> None:
        """Raises OSError where a file was removed meanwhile."""
        require_there(map(self._file, range(self._next)))
        self.log.delete()

    def discard(self) -> None:
        """Give it up; files that were written stay."""
        self.leave()


def surface_of(frame: Frame) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (v, 3) [m] and triangles (t, 3), counter-clockwise from outside, of all that a frame shows as a surface."""
    x = _in_3d(frame.position)
    covered = np.zeros(len(x), dtype=bool)
    for skin in frame.embedded_surfaces:
        covered |= skin.covered(len(x))
    plain = frame.triangles[~covered[frame.triangles].any(axis=1)] if len(frame.triangles) else frame.triangles
    used, new = np.unique(plain, return_inverse=True)
    vertices, first = [x[used]], len(used)
    triangles: list[NDArray] = [new.reshape(-1, 3)]
    for skin in frame.embedded_surfaces:
        vertices.append(np.einsum("sk,ski->si", skin.weights, x[skin.corners]))
        triangles.append(first + skin.triangles)
        first += len(skin.corners)
    return np.concatenate(vertices), np.concatenate(triangles)


def _in_3d(x: NDArray) -> NDArray[np.float64]:
    return x if x.shape[1] == 3 else np.column_stack([x, np.zeros(len(x))])


def _write_ply(file: IO[bytes], vertices: NDArray, triangles: NDArray, radius: NDArray | None) -> None:
    columns = vertices if radius is None else np.column_stack([vertices, radius])
    names = ("x", "y", "z", "radius")[: columns.shape[1]]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(columns)}"]
    head += [f"property float {name}" for name in names]
    head += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header", ""]
    file.write("\n".join(head).encode())
    file.write(columns.astype("<f4").tobytes())
    rows = np.empty(len(triangles), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, triangles
    file.write(rows.tobytes())


def _write_obj(file: IO[bytes], vertices: NDArray, triangles: NDArray, radius: NDArray | None) -> None:
    np.savetxt(file, vertices, fmt="v %.9g %.9g %.9g")
    np.savetxt(file, triangles + 1, fmt="f %d %d %d")
