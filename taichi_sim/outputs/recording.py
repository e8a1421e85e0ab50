"""Recording: the frames that a run wrote as arrays, `x.npz`, one by one, to be drawn without simulating again."""

import json
import math
import zipfile
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from taichi_sim.analysis.lazy_frame import Moment, MomentsOf
from taichi_sim.common.errors import SceneError
from taichi_sim.common.npz import read_npz
from taichi_sim.files.checkpoint import FORMAT, scene_of
from taichi_sim.outputs.arrays import SCENE

__all__ = ["Recording"]

ALWAYS, SOMETIMES = ("time", "fps", "position", "velocity"), ("energy", "torn")  # arrays of the run
# bytes before the name of a member of a zip archive; the last four are the lengths of name and extra field
LOCAL_HEADER = 30


class Recording(Sequence[Moment]):
    """The frames of an .npz, read from disk when they are asked for. scene: that they are of; fps [1/s].

    Raises FileNotFoundError, and SceneError for a file of another kind, or of another version."""

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = Path(path)
        arrays = read_npz(self.path, SCENE)
        if "about" not in arrays:
            says = "holds no scene that could be drawn; give an .npz that `taichi-sim run SCENE -o x.npz` has written"
            raise SceneError((), says=says, file=self.path)
        try:
            about = json.loads(str(arrays["about"]))
            if about["format"] != FORMAT:
                says = f"was written by another version (format {about['format']}, this one reads {FORMAT})"
                raise SceneError((), says=says, file=self.path)
            self.scene = scene_of(about, arrays)
            with zipfile.ZipFile(self.path) as archive:
                members = {member.filename: member for member in archive.infolist()}
            names = [*ALWAYS, *(name for name in SOMETIMES if f"{name}.npy" in members)]
            columns = {name: _column(self.path, members[f"{name}.npy"]) for name in names}
            self._check(columns)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, zipfile.BadZipFile) as error:
            if isinstance(error, SceneError):
                error.file = error.file or self.path
                raise
            raise SceneError((), says=f"is damaged ({error})", file=self.path) from None
        self._columns, self._moments = columns, MomentsOf(self.scene)
        self.fps = float(columns.pop("fps")[0])

    def _check(self, columns: dict[str, NDArray]) -> None:
        scene, count = self.scene, len(columns["time"])
        moved = (count, scene.n_balls, scene.dim)
        shapes = {
            "time": (count,),
            "fps": (1,),
            "position": moved,
            "velocity": moved,
            "energy": (count, 4),
            "torn": (count, scene.n_springs),
        }
        for name, column in columns.items():
            if column.shape != shapes[name] or column.dtype.kind != ("b" if name == "torn" else "f"):
                raise ValueError(f"{name} is {column.dtype} {column.shape}")
        if count == 0 or not np.all(np.isfinite(columns["time"])) or not 0.0 < columns["fps"][0] < np.inf:
            raise ValueError("it has no frame, or one at no time")

    def __len__(self) -> int:
        return len(self._columns["time"])

    @overload
    def __getitem__(self, k: int) -> Moment: ...
    @overload
    def __getitem__(self, k: slice) -> list[Moment]: ...
    def __getitem__(self, k: int | slice) -> Any:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        row = {name: np.array(column[k]) for name, column in self._columns.items()}
        spin = np.zeros((self.scene.n_balls, 1 if self.scene.dim == 2 else 3))  # no picture shows it
        frame = self._moments.at(float(row["time"]), row["position"], row["velocity"], spin, row.get("torn"))
        if "energy" in row:
            frame.energy = tuple(row["energy"].tolist())
        return frame


def _column(path: Path, member: zipfile.ZipInfo) -> NDArray:
    """An array of the archive as it lies in the file, which is not read before it is asked for."""
    name = member.filename
    if member.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{name} is packed")
    with open(path, "rb") as file:
        file.seek(member.header_offset)
        lengths = file.read(LOCAL_HEADER)[-4:]
        file.seek(int.from_bytes(lengths[:2], "little") + int.from_bytes(lengths[2:], "little"), 1)
        begin = file.tell()
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read(file)
        size = file.tell() - begin + dtype.itemsize * math.prod(shape)
        if fortran or dtype.hasobject or not all(shape) or size != member.file_size:
            raise ValueError(f"{name} is {dtype} {shape} in {member.file_size} bytes")
        return np.memmap(path, dtype, "r", file.tell(), shape)
