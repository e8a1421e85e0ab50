"""Embedded surfaces: pictures show them; their vertices follow balls, finer than the springs and tetrahedra simulated."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.columns import sealed

__all__ = ["EmbeddedSurface", "build_surface"]

SUM_TOLERANCE = 1e-6  # how far the weights of a vertex may sum up to something else than 1


@dataclass(frozen=True, slots=True, eq=False)
class EmbeddedSurface:
    """A surface of s vertices, each at the weighted mean of k balls. Two are equal if they are the same object."""

    corners: NDArray[np.int32]  # (s, k) balls
    weights: NDArray[np.float64]  # (s, k), 1 in sum for each vertex
    triangles: NDArray[np.int32]  # (t, 3) its vertices, counter-clockwise from outside
    covers: NDArray[np.int32]  # (b,) balls that it is drawn in place of, besides those that its vertices follow
    colour: tuple[float, ...] | None = None  # sRGB, 0 to 1; None: that of the balls
    uv: NDArray[np.float64] | None = None  # (t, 3, 2) places of the corners of its triangles on a texture, v upward

    def covered(self, n: int) -> NDArray[np.bool_]:
        """Mask (n,) of the balls in place of which it is drawn."""
        covered = np.zeros(n, dtype=bool)
        covered[self.corners[self.weights != 0]] = True
        covered[self.covers] = True
        return covered


def build_surface(
    where: str,
    n_balls: int,
    corners: ArrayLike,
    weights: ArrayLike,
    triangles: ArrayLike,
    covers: ArrayLike | None,
    colour: tuple[float, ...] | None,
    uv: ArrayLike | None = None,
) -> EmbeddedSurface:
    """A checked surface on n_balls balls. Raises SceneError that names the argument of `where`."""
    shape = validation.as_array(corners).shape
    if len(shape) != 2 or 0 in shape:
        says = f"shape {shape} does not fit; it must be (s, k), k balls for each of s vertices"
        raise SceneError(f"{where}.corners", says=says)
    balls = validation.indices(f"{where}.corners", corners, n_balls, width=shape[1])
    shares = validation.vectors(f"{where}.weights", weights, None, shape[1])
    if len(shares) != len(balls):
        says = f"{len(shares)} rows do not fit; there must be {len(balls)}, as many as corners"
        raise SceneError(f"{where}.weights", says=says)
    whole = np.abs(shares.sum(axis=1) - 1.0) <= SUM_TOLERANCE
    validation.require(f"{where}.weights", shares, whole, "numbers that sum up to 1")
    faces = validation.indices(f"{where}.triangles", triangles, len(balls), width=3, what="vertex of the surface")
    hidden = validation.indices(f"{where}.covers", () if covers is None else covers, n_balls)
    places = None
    if uv is not None:
        shape = validation.as_array(uv).shape
        if shape != (len(faces), 3, 2):
            says = f"shape {shape} does not fit; it must be ({len(faces)}, 3, 2), two numbers for each corner of its triangles"
            raise SceneError(f"{where}.uv", says=says)
        places = validation.vectors(f"{where}.uv", np.reshape(uv, (-1, 2)), 3 * len(faces), 2).reshape(-1, 3, 2)
    return sealed(EmbeddedSurface(balls, shares, faces, hidden, colour, places))
