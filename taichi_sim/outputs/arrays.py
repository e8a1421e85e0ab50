"""Positions, velocities, energy and contacts over time as NumPy arrays in an .npz file."""

import zipfile
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.analysis.lazy_frame import Moment
from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.errors import SceneError
from taichi_sim.files.checkpoint import parts_of, text_of
from taichi_sim.outputs.base import USUAL_FPS, Deferred, Image
from taichi_sim.outputs.parts import collider_names
from taichi_sim.render.palette import body_colours
from taichi_sim.scene.objects import named

NUMBER, FLAG = "<f8", "|b1"
LONG = ("position", "velocity", "torn")  # columns whose rows are as long as the scene is large
SCENE = "scene/"  # what the names of the arrays of the scene begin with


def constants_of(first: Frame | None) -> dict[str, NDArray[Any]]:
    """Arrays, by name, that all frames share with the first; none without a first frame."""
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
        "colliders": np.array(collider_names(first, names), dtype=np.str_),
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


class Arrays(Deferred):
    """An .npz with time (f,) s, position (f, n, dim) m, velocity (f, n, dim) m/s, energy (f, 4) J, and of the contacts their
    number contacts (f,), penetration (f, 2) m, residual (f,) m/s and largest_speed (f,) m/s; and (f,) for each number of each
    probe, under its name, `load.tension`.

    And what stays the same: radius (n,) m, colour (n, 3) sRGB, pinned (n,), springs (m, 2) and sticks (m,), triangles (t, 3), all
    as in the first frame, and object (n,), which of names (k,) each ball belongs to; colliders (c,), their names; fps (1,) 1/s;
    and under names that begin with scene/ all that the scene is, by which `Recording` makes frames of it again. Where springs can
    tear, torn (f, m).

    The columns of energy are kinetic, spring, gravity, total, those of penetration largest and mean; nan where the frame does
    not know them. Frames wait in the log beside the file, which may be larger than the memory. resume: go on from the last
    checkpoint of a run into the same name.
    """

    needs_image = False

    def holds(self, count: int) -> bool:
        damage = (OSError, ValueError, KeyError, zipfile.BadZipFile)
        with suppress(*damage), zipfile.ZipFile(self.path) as archive, archive.open("time.npy") as file:
            np.lib.format.read_magic(file)
            return bool(np.lib.format.read_array_header_2_0(file)[0] == (count,))
        return False

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        frame.energy  # noqa: B018  # known from here on, so that it is kept
        super().write(index, frame, image)

    def finish(self) -> None:
        """Join the frames into one file, one column after another: only short rows are in memory all at once."""
        rows: dict[str, list[NDArray]] = {}
        for _, frame in self.log.frames():
            for name, row in _rows(frame):
                if name not in LONG:
                    rows.setdefault(name, []).append(row)
                elif name not in rows:
                    rows[name] = [row]  # its shape and kind
        count = len(rows.get("time", ()))
        with replacing(self.path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, short in rows.items():
                dtype = FLAG if short[0].dtype == np.bool_ else NUMBER
                header = {"descr": dtype, "fortran_order": False, "shape": (count, *short[0].shape)}
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array_header_2_0(member, header)
                    for row in self._long(name) if name in LONG else short:
                        member.write(row.astype(dtype).tobytes())
            for name, array in {
                "fps": np.array([float(self.fps or USUAL_FPS)]),
                **constants_of(self.log.first),
            }.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)
        super().finish()

    def _long(self, name: str) -> Iterator[NDArray]:
        """Rows that are read again, as all of them may not fit into the memory."""
        return (getattr(frame, name) for _, frame in self.log.frames())


def _rows(frame: Frame) -> Iterator[tuple[str, NDArray]]:
    """Values of a frame in each column, with the column's name; nan where the frame does not know them."""
    now, nan = frame.contacts, np.nan
    yield "time", np.asarray(frame.time)
    yield "position", frame.position
    yield "velocity", frame.velocity
    yield "energy", np.array([nan] * 4 if frame.energy is None else frame.energy)
    yield "contacts", np.asarray(nan if now is None else now.number)
    yield "penetration", np.array([nan, nan] if now is None else [now.penetration, now.mean_penetration])
    yield "residual", np.asarray(nan if now is None else now.residual)
    yield "largest_speed", np.asarray(nan if now is None else now.largest_speed)
    if isinstance(frame, Moment) and frame.torn is not None:
        yield "torn", frame.torn
    for name, value in frame.probes.items():
        yield name, np.asarray(value)
