"""Rods: cylinders that stand for springs, and the turns that let them point anywhere."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["ROD", "from_z", "rod"]

ROD = 0.28  # radius of a spring, of that of its thinner ball, as in pictures
SIDES = 12


def rod() -> tuple[NDArray, NDArray, NDArray]:
    """Return vertices, triangles and normals of a cylinder about the z axis, of radius and length 1, open at its ends."""
    angle = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
    normals = np.tile(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), (2, 1))
    vertices = normals + np.repeat([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]], SIDES, axis=0)
    here = np.arange(SIDES)
    after = np.roll(here, -1)
    low, high = [here, after, here + SIDES], [after, after + SIDES, here + SIDES]
    return vertices, np.concatenate([np.stack(low, axis=1), np.stack(high, axis=1)]), normals


def from_z(along: NDArray, length: NDArray) -> NDArray[np.float64]:
    """Return quaternions (m, 4), imaginary parts first, that turn the z axis to directions (m, 3) of these lengths."""
    x, y, z = np.divide(
        along, length[:, None], out=np.tile([0.0, 0.0, 1.0], (len(along), 1)), where=length[:, None] > 0
    ).T
    half = np.sqrt(np.maximum(0.5 * (1.0 + z), 0.0))  # cosine of half the angle
    over = half < 1e-6  # straight down: half a turn about x
    scale = 0.5 / np.where(over, 1.0, half)
    return np.stack(
        [np.where(over, 1.0, -y * scale), np.where(over, 0.0, x * scale), 0 * z, np.where(over, 0.0, half)], axis=1
    )
