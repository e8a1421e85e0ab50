"""Positions, velocities, energy and contacts over time as NumPy arrays in an .npz file."""

import shutil
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from math import prod
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.analysis.lazy_frame import Moment
from taichi_sim.common.atomic_file import naming, replacing, require_place, synced
from taichi_sim.common.errors import SceneError
from taichi_sim.files.checkpoint import parts_of, text_of
from taichi_sim.outputs.base import USUAL_FPS, Image
from taichi_sim.outputs.kept_files import checksum
from taichi_sim.outputs.resumable import Resumable
from taichi_sim.outputs.run_log import Checkpoint
from taichi_sim.render.palette import body_colours
from taichi_sim.scene.objects import named

NUMBER, FLAG = "<f8", "|b1"
SCENE = "scene/"  # what the names of the arrays of the scene begin with
NAMES = ("time", "position", "velocity", "energy", "contacts", "penetration", "residual", "largest_speed")


class _Column:
    """An array that grows along its first axis on disk, so that a long run needs no memory. shape, dtype: of a row; rows: that
    are there already, whose bytes have this CRC-32."""

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: str, rows: int = 0, crc32: int = 0) -> None:
        self.shape, self.dtype, self._rows, self.crc32 = shape, dtype, rows, crc32
        self._file: IO[bytes] = open(path, "r+b" if rows else "w+b")  # noqa: SIM115  # closed with the column
        self._file.truncate(rows * bytes_of(shape, dtype))
        self._file.seek(0, 2)

    def append(self, row: NDArray) -> None:
        data = row.astype(self.dtype).tobytes()
        self._file.write(data)
        self._rows, self.crc32 = self._rows + 1, zlib.crc32(data, self.crc32)

    def hold(self) -> None:
        synced(self._file)

    def copy_to(self, out: IO[bytes]) -> None:
        descr = np.lib.format.dtype_to_descr(np.dtype(self.dtype))
        header = {"descr": descr, "fortran_order": False, "shape": (self._rows, *self.shape)}
        np.lib.format.write_array_header_2_0(out, header)
        self._file.seek(0)
        shutil.copyfileobj(self._file, out, 1 << 20)

    def close(self) -> None:
        with suppress(OSError):  # what a full disk did not take is not wanted any more
            self._file.close()


def bytes_of(shape: tuple[int, ...], dtype: str) -> int:
    """Of a row."""
    return np.dtype(dtype).itemsize * prod(shape)


def constants_of(first: Frame | None) -> dict[str, NDArray[Any]]:
    """What all frames share with the first, by name."""
    if first is None:
        return {}
    number, names = named(len(first.position), first.objects)
    return {
        "radius": first.radius,
        "colour": body_colours(first) if len(number) else np.zeros((0, 3)),
        "pinned": first.pinned,
        "springs": first.springs,
        "sticks": first.sticks,
        "triangles": first.triangles,
        "object": number,
        "names": np.array(names, dtype=np.str_),
        **_scene_of(first),
    }


def _scene_of(first: Frame) -> dict[str, Any]:
    """The scene that a frame is of, from which `Recording` makes frames again; nothing where it cannot be written, or the frame
    is from elsewhere."""
    if not isinstance(first, Moment):
        return {}
    try:
        about, arrays = parts_of(first.scene)
    except SceneError:
        return {}
    return {SCENE + name: np.asarray(array) for name, array in {"about": text_of(about), **arrays}.items()}


class Arrays(Resumable):
    """An .npz with time (f,) s, position (f, n, dim) m, velocity (f, n, dim) m/s, energy (f, 4) J, and of the contacts their
    number contacts (f,), penetration (f, 2) m, residual (f,) m/s and largest_speed (f,) m/s; and (f,) for each number of each
    probe, under its name, `load.tension`.

    And what stays the same: radius (n,) m, colour (n, 3) sRGB, pinned (n,), springs (m, 2) and sticks (m,), triangles (t, 3), all
    as in the first frame, and object (n,), which of names (k,) each ball belongs to; fps (1,) 1/s; and under names that begin
    with scene/ all that the scene is, by which `Recording` makes frames of it again. Where springs can tear, torn (f, m).

    The columns of energy are kinetic, spring, gravity, total, those of penetration largest and mean; nan where the frame does
    not know them. Frames wait on disk beside the file, which may be larger than the memory. resume: go on from the last
    checkpoint of a run into the same name.
    """

    needs_image = False

    def __init__(self, path: str | PathLike[str], resume: bool = False, fps: float | None = None) -> None:
        super().__init__(path, resume=resume)
        require_place(path)
        self.fps = fps
        self._columns: dict[str, _Column] = {}
        self._first: Frame | None = None

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        self._first = first

    def has(self, checkpoint: Checkpoint) -> bool:
        shapes = checkpoint.own["output"]["columns"].items()
        for k, (_, (shape, dtype, crc32)) in enumerate(shapes):
            file, size = self._place(k), checkpoint.frame * bytes_of(shape, dtype)
            if not file.is_file() or file.stat().st_size < size or checksum(file, size) != crc32:
                return False
        return True

    def holds(self, count: int) -> bool:
        damage = (OSError, ValueError, KeyError, zipfile.BadZipFile)
        with suppress(*damage), zipfile.ZipFile(self.path) as archive, archive.open("time.npy") as file:
            np.lib.format.read_magic(file)
            return bool(np.lib.format.read_array_header_2_0(file)[0] == (count,))
        return False

    def go_on(self, checkpoint: Checkpoint) -> None:
        self.frames = checkpoint.frame
        for name, (shape, dtype, crc32) in checkpoint.own["output"]["columns"].items():
            self._add(name, tuple(shape), dtype, checkpoint.frame, crc32)

    def hold(self) -> Mapping[str, Any]:
        for column in self._columns.values():
            column.hold()
        return {"columns": {name: (column.shape, column.dtype, column.crc32) for name, column in self._columns.items()}}

    def _place(self, number: int) -> Path:
        return self.log.folder / f"column_{number:03d}"

    def _add(self, name: str, shape: tuple[int, ...], dtype: str, rows: int = 0, crc32: int = 0) -> None:
        self._columns[name] = _Column(self._place(len(self._columns)), shape, dtype, rows, crc32)

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        energy = (np.nan,) * 4 if frame.energy is None else tuple(frame.energy)
        now = frame.contacts
        contacts: tuple[Any, ...] = (np.nan, (np.nan, np.nan), np.nan, np.nan)
        if now is not None:
            contacts = (now.number, (now.penetration, now.mean_penetration), now.residual, now.largest_speed)
        rows = (frame.time, frame.position, frame.velocity, energy, *contacts)
        self.log.open()
        self._first = self._first or frame
        with naming(self.path):
            torn = {"torn": frame.torn} if isinstance(frame, Moment) and frame.torn is not None else {}
            for name, value in [*zip(NAMES, rows, strict=True), *torn.items(), *frame.probes.items()]:
                row = np.asarray(value)
                if name not in self._columns:
                    self._add(name, row.shape, FLAG if row.dtype == np.bool_ else NUMBER)
                self._columns[name].append(row)

    def finish(self) -> None:
        """Join the columns into one file."""
        with replacing(self.path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, column in self._columns.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    column.copy_to(member)
            for name, array in {"fps": np.array([float(self.fps or USUAL_FPS)]), **constants_of(self._first)}.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)
        for column in self._columns.values():
            column.close()
        self.log.delete()

    def discard(self) -> None:
        """Give it up; what the last checkpoint needs stays beside it."""
        for column in self._columns.values():
            column.close()
        self.leave()
