"""Wind: air that presses on triangles, and drags on what moves through it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.part import Element, Row

__all__ = ["WIND", "Wind", "WindMethods"]

AIR = 1.2  # kg/m^3
PLATE = 1.28  # drag of a flat plate across the flow
SKIN_FRICTION = 0.05  # the same along it


@dataclass(frozen=True, slots=True)
class Wind:
    """Air that moves, or stands still and drags, see `WindMethods.add_wind`."""

    velocity: tuple[float, ...]  # m/s
    density: float  # kg/m^3
    drag: float
    skin_friction: float
    gust: float  # part of the speed
    gust_length: float  # m


class WindMethods:
    """The part of a Scene that holds the wind."""

    wind: Wind | None = None

    def add_wind(
        self: Any,
        velocity: ArrayLike,
        *,
        density: float = AIR,
        drag: float = PLATE,
        skin_friction: float = SKIN_FRICTION,
        gust: float = 0.0,
        gust_length: float = 1.0,
    ) -> None:
        """Let air act on all triangles of a 3D scene: density / 2 times area times the square of the relative speed.

        Args:
            velocity: of the air [m/s]; zeros for still air that only drags.
            density: of the air [kg/m^3]; drag: coefficient for flow across a triangle [1], as of a lone plate. No triangle lies
                in the lee of another: front and rear of a closed body both count, so that a cube has 2.6, and a real one 1.05.
            skin_friction: coefficient for flow along a triangle [1].
            gust: 0 to 1 [1], part of the speed by which it varies in waves that travel with the wind.
            gust_length: of the longest of them [m].
        """
        if self.dim != 3:
            raise SceneError("wind", says="acts on triangles, which a scene with dim = 3 has; this one has dim = 2")
        if self.wind is not None:
            raise SceneError("wind", says="there is one already; a scene has one at most")
        self.wind = Wind(
            tuple(validation.vector("wind.velocity", velocity, 3).tolist()),
            validation.number("wind.density", density, low=0),
            validation.number("wind.drag", drag, low=0),
            validation.number("wind.skin_friction", skin_friction, low=0),
            validation.number("wind.gust", gust, low=0, high=1),
            validation.number("wind.gust_length", gust_length, positive=True),
        )


class _Wind(Element):
    name, method, has_file = "wind", "add_wind", False
    is_one = is_single = gives_energy = True
    features: ClassVar = {
        "wind": lambda scene: scene.wind is not None and bool(np.any(np.asarray(scene.wind.velocity) != 0)),
        "gusts": lambda scene: scene.wind is not None and scene.wind.gust > 0,
    }

    def rows(self, scene: Any) -> list[Row]:
        return [] if scene.wind is None else [asdict(scene.wind)]

    def acts(self, scene: Any) -> bool:
        return scene.wind is not None and len(scene.triangles) > 0

    def corners(self, scene: Any) -> NDArray[np.int32]:
        """None: it joins no balls."""
        return np.zeros((0, 3), dtype=np.int32)

    def further_rates(self, scene: Any) -> tuple[float, float]:
        """The drag of a triangle changes with the speed u past it by density drag A u, and lambda is at most the largest of that
        times D = sum over its corners w_j t_j / 9, t_j the triangles at ball j. u: of the strongest gust, and of the fastest ball
        at the start."""
        if not self.acts(scene):
            return 0.0, 0.0
        wind, t, x = scene.wind, scene.triangles, scene.position
        w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
        give = (w * np.bincount(t.ravel(), minlength=scene.n_balls))[t].sum(axis=1) / 9.0
        area = 0.5 * np.linalg.norm(np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]), axis=1)
        speed = float(np.linalg.norm(wind.velocity)) * (1.0 + wind.gust)
        speed += float(np.linalg.norm(scene.velocity, axis=1).max(initial=0.0))
        return 0.0, wind.density * max(wind.drag, wind.skin_friction) * speed * float((give * area).max())


WIND = _Wind()
