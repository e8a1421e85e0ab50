"""Wall squares: squares that stand for walls, which have no end, in files for other programs."""

from dataclasses import dataclass

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.outputs.parts import Body, in_3d
from taichi_sim.render.camera import robust_bounds

__all__ = ["WallSquare", "wall_squares"]

LEVEL = 0.7  # cosine of the angle to the vertical up to which a wall is a floor
SIDE = 4.0  # of a square, of the size of the scene
GREY = (0.8, 0.8, 0.8)  # sRGB


@dataclass(frozen=True, slots=True, eq=False)
class WallSquare:
    """Square of a wall about the scene, its corners counter-clockwise seen from the free side; in 2D the first two lie along the
    wall. is_floor: pictures show it."""

    body: Body
    is_floor: bool


def wall_squares(first: Frame) -> list[WallSquare]:
    """Squares of the walls of a frame, called wall_0, wall_1 and so on."""
    bounds, _ = robust_bounds(in_3d(first.position), first.radius)
    reach, found = 0.5 * SIDE * max(float(bounds.size), 1e-6), []
    for k, plane in enumerate(first.walls if first.walls.size else ()):
        normal, offset = in_3d(plane[None, :-1])[0], plane[-1]
        along = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        along /= np.linalg.norm(along)
        across = np.cross(normal, along)
        foot = bounds.centre + (offset - bounds.centre @ normal) * normal
        corners = foot + reach * np.array([-along - across, along - across, along + across, across - along])
        body = Body(f"wall_{k}", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.tile(normal, (4, 1)), GREY)
        found.append(WallSquare(body, bool(normal[1] >= LEVEL) and first.dim == 3))
    return found
