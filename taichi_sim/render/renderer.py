"""Renderer: frames to pictures, without OpenGL, window or display."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim import backend
from taichi_sim.frame import Frame
from taichi_sim.render.camera import Camera

__all__ = ["Renderer"]


class Renderer:
    """Draws the frames of one scene.

    Args: the first frame (it places the camera); size (width, height) px; background None (the renderer's own), one
    sRGB colour in 0..1 or a pair (top, bottom); ambient_occlusion, shadow and camera for 3D only. Raises ValueError for
    a bad argument. `render` returns uint8 (height, width, 3), row 0 at the top, sRGB.
    """

    def __init__(
        self,
        frame: Frame,
        size: tuple[int, int] = (1280, 720),
        background: Any = None,
        ambient_occlusion: bool = False,
        shadow: bool = True,
        camera: Camera | None = None,
    ) -> None:
        width, height = (int(a) for a in size)
        if width < 1 or height < 1:
            raise ValueError(f"size: {size} is not allowed; width and height must be at least 1")
        backend.start()
        self.size = (width, height)
        self._painter: Any
        if frame.dim == 3:
            from taichi_sim.render.renderer3d import Renderer3D

            self._painter = Renderer3D(frame, self.size, background, ambient_occlusion, shadow, camera)
        else:
            from taichi_sim.render.renderer2d import Renderer2D

            self._painter = Renderer2D(frame, self.size, background)

    def render(self, frame: Frame, coarse: int = 1) -> NDArray[np.uint8]:
        """The picture of a frame of the same scene. In 3D it may be `coarse` times less wide and high, and so much quicker."""
        if self._painter is None:
            raise RuntimeError("this renderer is closed")
        return self._painter.render(frame, coarse)

    @property
    def camera(self) -> Any:
        """Where pictures are seen from: a Camera in 3D, a Flat in 2D. It may be replaced between two pictures."""
        return self._painter.camera

    @camera.setter
    def camera(self, camera: Any) -> None:
        self._painter.camera = camera

    def close(self) -> None:
        """Free its memory. Calling it twice does no harm."""
        if self._painter is not None:
            self._painter.close()
            self._painter = None

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
