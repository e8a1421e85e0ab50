"""Positions, velocities, energy and contacts over time as NumPy arrays in an .npz file."""

import shutil
import tempfile
import zipfile
from os import PathLike
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import PartFile
from taichi_sim.outputs.base import Image, Output

NAMES = ("time", "position", "velocity", "energy", "contacts", "penetration", "residual", "largest_speed")


class _Column:
    """An array that grows along its first axis on disk, so that a long run needs no memory."""

    def __init__(self, folder: str) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # closed with the column
        self._rows = 0
        self._like: NDArray = np.zeros(0)

    def append(self, row: Any) -> None:
        self._like = np.asarray(row)
        self._file.write(self._like.tobytes())
        self._rows += 1

    def copy_to(self, out: IO[bytes]) -> None:
        descr, shape = np.lib.format.dtype_to_descr(self._like.dtype), (self._rows, *self._like.shape)
        header = {"descr": descr, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_2_0(out, header)
        self._file.seek(0)
        shutil.copyfileobj(self._file, out, 1 << 20)

    def close(self) -> None:
        self._file.close()


class Arrays(Output):
    """An .npz with time (f,) s, position (f, n, dim) m, velocity (f, n, dim) m/s, energy (f, 4) J, and of the contacts their
    number contacts (f,), penetration (f, 2) m, residual (f,) m/s and largest_speed (f,) m/s; and (f,) for each number of each
    probe, under its name, `load.tension`.

    The columns of energy are kinetic, spring, gravity, total, those of penetration largest and mean; nan where the frame does
    not know them. Frames wait on disk in the target folder, so the file may be larger than the memory.
    """

    needs_image = False

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path
        self._part = PartFile(path)
        self._folder = str(self._part.path.parent)
        self._columns = {name: _Column(self._folder) for name in NAMES}

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        energy = (np.nan,) * 4 if frame.energy is None else tuple(frame.energy)
        now = frame.contacts
        contacts: tuple[Any, ...] = (np.nan, (np.nan, np.nan), np.nan, np.nan)
        if now is not None:
            contacts = (now.number, (now.penetration, now.mean_penetration), now.residual, now.largest_speed)
        rows = (frame.time, frame.position, frame.velocity, energy, *contacts)
        for name, row in [*zip(NAMES, rows, strict=True), *frame.probes.items()]:
            if name not in self._columns:
                self._columns[name] = _Column(self._folder)
            self._columns[name].append(np.asarray(row, dtype=np.float64))

    def finish(self) -> None:
        """Join the columns into one file."""
        with zipfile.ZipFile(self._part.file, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, column in self._columns.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    column.copy_to(member)
                column.close()
        self._part.finish()

    def discard(self) -> None:
        for column in self._columns.values():
            column.close()
        self._part.discard()
