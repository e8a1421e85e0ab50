"""A scene in USD, which Blender, Houdini, Omniverse, Unreal and Maya open: what pictures show, over time."""

import os
from fractions import Fraction
from os import PathLike
from pathlib import Path

from taichi_sim.common.atomic_file import naming
from taichi_sim.outputs.base import USUAL_FPS
from taichi_sim.outputs.extras import needed
from taichi_sim.outputs.scene_film import SceneFilm
from taichi_sim.outputs.usd_stage import Stage

MODULES = ("pxr", *(f"pxr.{name}" for name in ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdShade", "Vt")))  # that are used


class Usd(SceneFilm):
    """/World holds an Xform for each object, with its name, and in it a Mesh (points and normals over time, st where the object
    has places on a texture), a PointInstancer of spheres (scales: radii) for balls that no surface covers, and one of rods
    for springs. The only one of these is called as its object is; of several each ends with _surface, _balls, _springs.
    A Mesh for each collider, which a transform moves; a square for each wall, in the purpose `guide` where it is no floor;
    `camera`. Metres, y up, frame k at time code k, `fps` of which are a second. Colours are linear, as displayColor and as
    materials; a texture of a look is the material of a mesh with st.

    Frames wait in the log beside the file until it is complete. resume: go on where a run into the same name was cut off.
    """

    def __init__(self, path: str | PathLike[str], fps: float | None = None, resume: bool = False) -> None:
        # here, where no other thread loads a library: while these load they wait for the thread that runs Python
        for name in MODULES:
            needed(name, "usd", Path(path))
        super().__init__(path, fps, resume)

    def finish(self) -> None:
        """Write the file from the frames that were kept."""
        part = self.log.open() / f"stage{self.path.suffix.lower()}"
        part.unlink(missing_ok=True)
        with naming(self.path):
            fps = float(Fraction(self.fps or USUAL_FPS).limit_denominator(100_000))
            stage = Stage(part, self.log.first, fps, self.aspect, self.textures)
            self.fit_camera()
            for index, frame in self.log.frames():
                stage.add(index, frame, self.camera(frame))
            stage.save(self.frames)
            with open(part, "r+b") as file:
                os.fsync(file.fileno())
            os.replace(part, self.path)
        super().finish()
