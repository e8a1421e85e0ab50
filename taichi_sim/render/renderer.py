"""Renderer: frames to pictures, without OpenGL, window or display."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.device import backend
from taichi_sim.render.camera import Camera
from taichi_sim.render.colouring import Colouring
from taichi_sim.render.exposure import EXPOSURES, Exposure, Mean
from taichi_sim.render.smoothing import CREASE
from taichi_sim.render.stages import STAGES
from taichi_sim.scene.camera_path import CameraPath, require_depth
from taichi_sim.scene.looks import Look, Subjects

__all__ = ["Renderer"]

MOST_SHOWN = 60  # frames that a camera is fitted to, evenly spread over all


def evenly(number: int) -> set[int]:
    """Numbers of the frames, evenly spaced among so many, to which a camera is fitted that is to show all of them."""
    return {k * (number - 1) // (MOST_SHOWN - 1) for k in range(MOST_SHOWN)}


class Renderer:
    """Draws the frames of one scene.

    Args: the first frame (it places the camera); size (width, height) px; background None (the renderer's own), one
    sRGB colour in 0..1 or a pair (top, bottom); ambient_occlusion and shadow for 3D only; camera: a CameraPath or its keys,
    or, in 3D, a fixed Camera; None: one that shows all; transparent: neither
    background nor ground, and alpha; colour: "object", or "strain" or "speed" of balls and surfaces on a scale from the first
    to the second of colour_range (see `Colouring`); subdivide: surfaces 0, 1 or 2 times into four, smoothly; crease: in 3D,
    the angle between triangles in the first frame from which their edge is sharp [degrees], where surfaces are not subdivided;
    stage: "day", "paper", "dusk", "studio" or "blueprint", the light and what lies behind, in place of which a background may
    be; looks: in 3D, the keys of a `Look` for each of some shapes and colliders; shutter [s], aperture [m], exposures: see
    `Exposure`; shadow_catcher: in 3D, transparent pictures hold the shadows on the ground, as black with alpha. Raises ValueError
    for a bad argument.
    `render` returns uint8 (height, width, 3), or (height, width, 4) with alpha, by which colours are not multiplied; row 0 at
    the top, sRGB.
    """

    def __init__(
        self,
        frame: Frame,
        size: tuple[int, int] = (1280, 720),
        background: Any = None,
        ambient_occlusion: bool = True,
        shadow: bool = True,
        camera: Camera | CameraPath | Mapping[str, Any] | None = None,
        transparent: bool = False,
        colour: str = "object",
        colour_range: tuple[float, float] | None = None,
        subdivide: int = 0,
        crease: float = CREASE,
        stage: str = "day",
        looks: Sequence[Mapping[str, Any]] | None = None,
        shutter: float = 0.0,
        aperture: float = 0.0,
        exposures: int = EXPOSURES,
        shadow_catcher: bool = False,
    ) -> None:
        width, height = (int(side) for side in validation.vector("size", size, 2))
        if width < 1 or height < 1:
            raise SceneError("size", size, "a width and a height of at least 1 [pixels]")
        if subdivide not in (0, 1, 2):
            raise ValueError(f"subdivide: {subdivide!r} is not allowed; it must be 0, 1 or 2")
        if not 0 <= crease <= 180:
            raise ValueError(f"crease: {crease!r} is not allowed; it must be an angle from 0 to 180 degrees")
        validation.one_of("stage", stage, STAGES)
        self._exposure = Exposure(shutter, aperture, exposures)
        require_depth(aperture, frame.dim)
        look = (transparent, Colouring.of(frame, colour, colour_range), int(subdivide))
        known = getattr(frame, "scene", frame).triangles  # those, too, that have torn
        labels = (placed.collider.label for placed in frame.colliders)
        subjects = Subjects.of(frame.dim, frame.objects, known, frame.embedded_surfaces, labels)
        styles = Look.listed(looks, subjects)
        backend.start()
        self.size = (width, height)
        self._painter: Any
        if frame.dim == 3:
            from taichi_sim.render.renderer3d import Renderer3D

            given = (
                frame,
                self.size,
                background,
                ambient_occlusion,
                shadow,
                camera,
                *look,
                crease,
                STAGES[stage],
                styles,
            )
            self._painter = Renderer3D(*given, shadow_catcher)
        else:
            from taichi_sim.render.renderer2d import Renderer2D

            self._painter = Renderer2D(frame, self.size, background, *look, camera, STAGES[stage])

    def render(self, frame: Frame, coarse: int = 1) -> NDArray[np.uint8]:
        """The picture of a frame of the same scene. In 3D it may be `coarse` times less wide and high, and so much quicker."""
        painter = self._open()
        if self._exposure.is_sharp:
            return painter.render(frame, coarse)
        mean = Mean()
        for moved, aside in self._exposure.moments(frame):
            mean.add(painter.render(moved, coarse, aside))
        return mean.picture()

    @property
    def camera(self) -> Any:
        """Camera of the pictures: a Camera in 3D, a Flat in 2D. Once replaced, it stays, whatever a CameraPath says."""
        return self._painter.camera

    @camera.setter
    def camera(self, camera: Any) -> None:
        self._painter.look(camera)

    @property
    def buffers(self) -> Any:
        """The fields of what is drawn, `Buffers` in 3D, a `Canvas` in 2D; made anew only where a frame has more of anything."""
        return self._open().buffers

    def fit(self, frames: Sequence[Frame]) -> None:
        """Place a CameraPath, as far as it leaves that open, so that all of these frames are shown."""
        if frames:
            self._open().fit([frames[k] for k in sorted(evenly(len(frames)))])

    def skip(self, frame: Frame) -> None:
        """Take note of a frame that is not drawn, for later ones to look as if it had been."""
        self._open().skip(frame)

    def memory(self) -> dict[str, Any]:
        """State from which pictures follow, beside their frame and the first one, as plain values for `recall`."""
        return self._open().memory()

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on as the renderer of the same first frame and arguments did that this is the memory of."""
        self._open().recall(memory)

    def _open(self) -> Any:
        if self._painter is None:
            raise RuntimeError("this renderer is closed")
        backend.check_thread()
        return self._painter

    def close(self) -> None:
        """Free its memory. Calling it twice does no harm."""
        if self._painter is not None:
            self._painter.close()
            self._painter = None

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
