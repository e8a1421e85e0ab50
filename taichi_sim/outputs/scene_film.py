"""SceneFilm: base of files that hold a scene over time, with its camera and the images of its looks."""

from collections.abc import Mapping
from os import PathLike
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.outputs.base import Deferred
from taichi_sim.outputs.parts import Textures, textures_of
from taichi_sim.render.camera import Camera
from taichi_sim.render.renderer import evenly
from taichi_sim.render.tracker import Tracker

__all__ = ["SceneFilm"]


class SceneFilm(Deferred):
    """Scene over time in one file, written by `finish` from the frames in the log. aspect: width of the picture by its height;
    textures: images of surfaces, as seen from the file's folder."""

    needs_image = False
    apart = True
    is_film = True

    def __init__(self, path: str | PathLike[str], fps: float | None = None, resume: bool = False) -> None:
        super().__init__(path, fps, resume)
        self.aspect = 16 / 9
        self.textures: Textures = {}
        self._tracker: Tracker | None = None

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        self.aspect = size[0] / size[1]
        self.textures = textures_of(style, self.path.parent)
        self._place_camera(first, style.get("camera"))

    def options(self) -> Mapping[str, Any]:
        return {"aspect": self.aspect, "textures": dict(self.textures)}

    def fit_camera(self) -> None:
        """Place a camera that is to show all of the run, as that of pictures is placed."""
        if self._tracker is None and self.log.first is not None:
            self._place_camera(self.log.first, None)
        if self._tracker is not None and self._tracker.is_open and self.frames:
            shown = evenly(self.frames)
            self._tracker.fit([frame for index, frame in self.log.frames() if index in shown])

    def camera(self, frame: Frame) -> Camera | None:
        """Camera of a frame, asked for in order of time; None in 2D."""
        return None if self._tracker is None else self._tracker.at(frame)

    def _place_camera(self, first: Frame, camera: Any) -> None:
        if first.dim == 3:
            self._tracker = Tracker(first, camera, self.aspect)
