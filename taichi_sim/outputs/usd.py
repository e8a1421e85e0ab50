"""A scene in USD, which Blender, Houdini, Omniverse, Unreal and Maya open: what pictures show, over time."""

import io
import json
import os
from collections.abc import Mapping
from fractions import Fraction
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame, Placed
from taichi_sim.common.atomic_file import naming, require_place
from taichi_sim.outputs.base import USUAL_FPS, Image
from taichi_sim.outputs.extras import needed
from taichi_sim.outputs.parts import Textures, placed, textures_of
from taichi_sim.outputs.resumable import Recorded
from taichi_sim.outputs.usd_stage import Stage
from taichi_sim.render.camera import Camera
from taichi_sim.render.renderer import evenly
from taichi_sim.render.tracker import Tracker


class Usd(Recorded):
    """/World holds an Xform for each object, with its name, and in it a Mesh (points and normals over time, st where the object
    has places on a texture), a PointInstancer of spheres (scales: radii) for balls that no surface covers, and one of rods
    for springs. The only one of these is called as its object is; of several each ends with _surface, _balls, _springs.
    A Mesh for each collider, which a transform moves; a square for each wall, in the purpose `guide` where it is no floor;
    `camera`. Metres, y up, frame k at time code k, `fps` of which are a second. Colours are linear, as displayColor and as
    materials; a texture of a look is the material of a mesh with st.

    Frames wait on disk beside the file until it is complete. resume: go on where a run into the same name was cut off.
    """

    needs_image = False
    apart = True
    is_film = True

    def __init__(self, path: str | PathLike[str], fps: float | None = None, resume: bool = False) -> None:
        needed("pxr", "usd", Path(path))
        super().__init__(path, "frames", resume=resume)
        require_place(path)
        self.fps = fps
        self._first: Frame | None = None
        self._tracker: Tracker | None = None
        self._aspect = 16 / 9
        self._textures: Textures = {}

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        self._first, self._aspect = first, size[0] / size[1]
        self._textures = textures_of(style, self.path.parent)
        if first.dim == 3:
            self._tracker = Tracker(first, style.get("camera"), self._aspect)

    def options(self) -> Mapping[str, Any]:
        return {"aspect": self._aspect, "textures": dict(self._textures)}

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Keep what changes."""
        self.log.open()
        if self._first is None:
            self.prepare(frame, (16, 9), {})
        assert self._first is not None
        if self._kept and index == self._kept:
            self._recall()
        now: dict[str, Any] = {"position": frame.position.astype(np.float32), "time": np.array(frame.time)}
        for name in ("springs", "triangles"):
            if not np.array_equal(getattr(frame, name), getattr(self._first, name)):  # something has torn
                now[name] = getattr(frame, name)
        if len(frame.torn_triangles):
            now["torn_triangles"] = frame.torn_triangles
        if frame.colliders:
            now["centres"], now["rotations"] = (np.array(part) for part in zip(*placed(frame)))
        if self._tracker is not None:
            camera, follower = self._tracker.at(frame), self._tracker.follower
            now["camera"] = _as_row(camera)
            now["follower"] = np.array(json.dumps(None if follower is None else follower.memory()))
        data = io.BytesIO()
        np.savez(data, **now)
        with naming(self.path):
            self._records.append(data.getvalue())

    def _recall(self) -> None:
        """Let the camera go on from the last frame that was kept."""
        if self._tracker is not None and self._tracker.follower is not None:
            *_, last = self._records
            self._tracker.follower.recall(json.loads(str(_read(last)["follower"])))

    def finish(self) -> None:
        """Write the file from the frames that were kept."""
        part = self.log.open() / f"stage{self.path.suffix.lower()}"
        part.unlink(missing_ok=True)
        with naming(self.path):
            fps = float(Fraction(self.fps or USUAL_FPS).limit_denominator(100_000))
            stage = Stage(part, self._first, fps, self._aspect, self._textures)
            shows_all = self._fit()
            for index, data in enumerate(self._records):
                if index < self.frames:
                    now = _read(data)
                    if shows_all:
                        assert self._tracker is not None
                        now["camera"] = _as_row(self._tracker.at(self._moment(now)))
                    stage.add(index, now)
            stage.save(self.frames)
            with open(part, "r+b") as file:
                os.fsync(file.fileno())
            os.replace(part, self.path)
        self._records.close()
        self.log.delete()

    def _fit(self) -> bool:
        """Whether the camera is to show all of the run; then it is placed so, as that of pictures is."""
        if self._tracker is None or not self._tracker.is_open or not self.frames:
            return False
        shown = evenly(self.frames)
        self._tracker.fit([self._moment(_read(data)) for k, data in enumerate(self._records) if k in shown])
        return True

    def _moment(self, now: Mapping[str, NDArray]) -> Any:
        """What a camera looks at in a frame that was kept."""
        first = self._first
        assert first is not None
        places = zip(first.colliders, now.get("centres", ()), now.get("rotations", ()))
        return SimpleNamespace(
            dim=first.dim,
            time=float(now["time"]),
            position=now["position"].astype(np.float64),
            radius=first.radius,
            triangles=now.get("triangles", first.triangles),
            torn_triangles=now.get("torn_triangles", first.triangles[:0]),
            walls=first.walls,
            colliders=tuple(Placed(one.collider, centre, rotation) for one, centre, rotation in places),
        )

    def discard(self) -> None:
        """Give it up; its frames stay beside it, for resume."""
        self._records.close()
        self.leave()


def _as_row(camera: Camera) -> NDArray[np.float64]:
    return np.array([*camera.eye, *camera.target, *camera.up, camera.fov])


def _read(data: bytes) -> dict[str, NDArray]:
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        return dict(file)
