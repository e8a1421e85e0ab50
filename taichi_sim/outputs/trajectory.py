"""A trajectory in GSD, the format of HOOMD-blue: OVITO opens it, and `gsd.hoomd` reads it frame by frame."""

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.outputs.extras import needed
from taichi_sim.outputs.growing import Growing
from taichi_sim.outputs.parts import Parts, in_3d
from taichi_sim.render.palette import body_colours

BOX_SIDE = 4.0  # of the longest side of the scene: bonds across half a box would be shown the other way around


class Trajectory(Growing):
    """Particles are balls: position [m], velocity [m/s], diameter [m], and as their type the name of their object. Bonds are
    springs that have not torn; their type is spring or stick. configuration.step is the number of the frame. In `log`: time [s],
    energy (4,) [J] (kinetic, spring, gravity, total), each number of each probe; of the first frame particles/colour (n, 3) sRGB,
    particles/pinned and triangles (t, 3). All in single precision but for time, energy and probes. The box only frames the scene.
    """

    def __init__(self, path: str | PathLike[str], resume: bool = False) -> None:
        self._hoomd, self._fl = (needed(f"gsd.{name}", "gsd", Path(path)) for name in ("hoomd", "fl"))
        super().__init__(path, resume=resume)
        self._box = 0.0  # m
        self._parts: Parts | None = None

    def begun(self, part: Path, frame: Frame) -> None:
        self._parts = Parts(frame)
        with self._hoomd.open(str(part), "w") as file:
            one = self._frame(0, frame)
            one.log["particles/colour"] = body_colours(frame).astype(np.float32)
            one.log["particles/pinned"] = frame.pinned.astype(np.uint8)
            one.log["triangles"] = frame.triangles.astype(np.int32)
            one.log = {name: value for name, value in one.log.items() if np.size(value)}
            file.append(one)

    def length(self) -> int:
        try:
            with self._fl.open(name=str(self.path), mode="r") as file:
                return int(file.nframes)
        except (OSError, RuntimeError):  # another kind of file, or a damaged one
            return 0

    def opened(self) -> Any:
        return self._hoomd.open(str(self.path), "r+")

    def more(self, index: int, frame: Frame) -> None:
        self._file.append(self._frame(index, frame))
        self._file.flush()

    def _frame(self, index: int, frame: Frame) -> Any:
        assert self._parts is not None
        x = in_3d(frame.position)
        one = self._hoomd.Frame()
        reach = BOX_SIDE * float(np.abs(x).max(initial=0.0) + frame.radius.max(initial=0.0))
        self._box = float(
            np.float32(max(self._box, reach or 1.0))
        )  # what equals the first frame's is not written again
        one.configuration.step, one.configuration.box = index, [self._box] * 3 + [0.0] * 3
        one.configuration.dimensions = 3  # also of a flat scene, whose balls OVITO shows as such
        balls, bonds = one.particles, one.bonds
        balls.N, balls.position, balls.velocity = len(x), x, in_3d(frame.velocity)
        balls.diameter = np.float32(2.0 * frame.radius)
        balls.types, balls.typeid = [_plain(name) for name in self._parts.names] or ["balls"], self._parts.number
        bonds.N, bonds.group, bonds.types = len(frame.springs), frame.springs.reshape(-1, 2), ["spring", "stick"]
        bonds.typeid = frame.sticks if len(frame.sticks) else np.zeros(bonds.N, dtype=np.uint32)
        one.log["time"] = np.array([frame.time])
        if frame.energy is not None:
            one.log["energy"] = np.array(frame.energy, dtype=np.float64)
        one.log |= {name: np.array([value], dtype=np.float64) for name, value in frame.probes.items()}
        return one


def _plain(name: str) -> str:
    """Name in ASCII, as the format has names."""
    return name.encode("ascii", "replace").decode()
