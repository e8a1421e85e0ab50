"""Wall squares: squares that stand for walls, which have no end, in files for other programs."""

from dataclasses import dataclass

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.outputs.parts import Body, in_3d, wall_square
from taichi_sim.render.camera import robust_bounds

__all__ = ["WallSquare", "wall_squares"]

LEVEL = 0.7  # cosine of the angle to the vertical up to which a wall is a floor
GREY = (0.8, 0.8, 0.8)  # sRGB


@dataclass(frozen=True, slots=True, eq=False)
class WallSquare:
    """Square of a wall about the scene. is_floor: pictures show it."""

    body: Body
    is_floor: bool


def wall_squares(first: Frame) -> list[WallSquare]:
    """Squares of the walls of a frame, called wall_0, wall_1 and so on."""
    bounds, _ = robust_bounds(in_3d(first.position), first.radius)
    found = []
    for k, plane in enumerate(first.walls if first.walls.size else ()):
        corners, normal = wall_square(plane, bounds)
        body = Body(f"wall_{k}", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.tile(normal, (4, 1)), GREY)
        found.append(WallSquare(body, bool(normal[1] >= LEVEL) and first.dim == 3))
    return found
