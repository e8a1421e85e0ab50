"""Recording: the frames that a run wrote as arrays, `x.npz`, one by one, to be drawn without simulating again."""

import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Contacts
from taichi_sim.analysis.lazy_frame import Moment, MomentsOf
from taichi_sim.analysis.probe_readings import units_of
from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.npz import read_npz
from taichi_sim.files.checkpoint import FORMAT, parts_of, scene_of
from taichi_sim.outputs.arrays import SCENE
from taichi_sim.scene.scene import Scene

__all__ = ["Recording", "require_drawable"]

# arrays of the run
ALWAYS = ("time", "fps", "position", "velocity", "contacts", "penetration", "residual", "largest_speed")
SOMETIMES = ("energy", "torn")
# bytes before the name of a member of a zip archive; the last four are the lengths of name and extra field
LOCAL_HEADER = 30


class Recording(Sequence[Moment]):
    """The frames of an .npz, read from disk when they are asked for, with what the run said of contacts and probes at each.
    scene: that they are of; fps [1/s]; lacks: numbers of the scene's probes that are not in it, as where frames were not an
    export's.

    Raises FileNotFoundError, and SceneError for a file of another kind, or of another version, or that is damaged; of positions
    and velocities that are no numbers, or beyond 1e50, when their frame is asked for."""

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
            probes = units_of(self.scene)
            self._probes = tuple(name for name in probes if f"{name}.npy" in members)
            self.lacks = tuple(name for name in probes if name not in self._probes)
            names = [*ALWAYS, *self._probes, *(name for name in SOMETIMES if f"{name}.npy" in members)]
            columns = {name: _column(self.path, members, name) for name in names}
            self._check(columns)
        except SceneError as error:
            error.file = error.file or self.path
            raise
        except Exception as error:  # a damaged file raises whatever its parts raise
            if isinstance(error, OSError) and error.filename is not None:  # it cannot be opened
                raise
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise SceneError((), says=f"is damaged ({reason})", file=self.path) from None
        self._columns, self._moments = columns, MomentsOf(self.scene)
        self.fps = float(columns.pop("fps")[0])

    def _check(self, columns: dict[str, NDArray]) -> None:
        """Raise ValueError where these cannot be of a run of its scene, or their times fall."""
        scene, count = self.scene, len(columns["time"])
        moved = (count, scene.n_balls, scene.dim)
        shapes = {
            "time": (count,),
            "fps": (1,),
            "position": moved,
            "velocity": moved,
            "energy": (count, 4),
            "torn": (count, scene.n_springs),
            "penetration": (count, 2),
        }
        for name, column in columns.items():
            if column.shape != shapes.get(name, (count,)) or column.dtype.kind != ("b" if name == "torn" else "f"):
                raise ValueError(f"{name} is {column.dtype} {column.shape}")
        if count == 0 or not np.all(np.isfinite(columns["time"])) or not 0.0 < columns["fps"][0] < np.inf:
            raise ValueError("it has no frame, or one at no time")
        back = np.diff(columns["time"]) < 0.0
        if back.any():
            k = int(np.argmax(back)) + 1
            raise ValueError(f"time[{k}] is {columns['time'][k]:g}, before that of the frame before")

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
        for name in ("position", "velocity"):
            if not np.all(np.abs(row[name]) <= validation.MOST_MAGNITUDE):  # nan is not
                says = f"has values that are no numbers, or more than {validation.MOST_MAGNITUDE:g} in magnitude"
                raise SceneError((name, int(k)), says=says, file=self.path)
        frame = self._moments.at(
            float(row["time"]), row["position"], row["velocity"], None, row.get("torn")
        )  # no picture shows spin
        if "energy" in row:
            frame.energy = tuple(row["energy"].tolist())
        frame.contacts, frame.probes = _contacts(row), {name: float(row[name]) for name in self._probes}
        return frame


def require_drawable(scene: Scene) -> None:
    """Raises SceneError where pictures of a recording of the scene would not be those of its run."""
    parts_of(scene)
    for k, collider in enumerate(scene.colliders):
        if collider.shape is not None:
            name = collider.name
            says = f"a recording holds no {name}, a shape of your own, but what saved_as() gives for it; leave --workers out"
            raise SceneError(f"colliders[{k}]", says=says)


def _contacts(row: Mapping[str, NDArray]) -> Contacts | None:
    """Recorded values of the contacts of a moment, the rest nan; None where the run did not know them."""
    if np.isnan(row["contacts"]):
        return None
    largest, mean = row["penetration"].tolist()
    nan = float("nan")
    return Contacts(
        int(row["contacts"]), largest, mean, nan, nan, float(row["residual"]), nan, 0, 0, float(row["largest_speed"]), 0
    )


def _column(path: Path, members: Mapping[str, zipfile.ZipInfo], of: str) -> NDArray:
    """An array of the archive as it lies in the file, which is not read before it is asked for."""
    name = f"{of}.npy"
    if name not in members:
        raise ValueError(f"it has no {name}")
    member = members[name]
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
