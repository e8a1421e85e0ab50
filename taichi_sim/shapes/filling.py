"""Filling: what pictures show of a flat body in place of its balls, out to where these end."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.polygon_mesh import outer_edges

__all__ = ["filling"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
SHARPEST = 2.0  # of the reach: a corner is drawn out no further


def filling(points: Floats, triangles: Ints, reach: float) -> tuple[Ints, Floats]:
    """Points (n, 3), and their weights, that the vertices of a body's filled area follow, one for each of its n points.

    The body has triangles (t, 3), counter-clockwise, between points (n, 2) [m]. Points of its outline are moved outward, so that
    the sides of the area lie `reach` [m] beyond the outline; they follow the largest triangle there.
    """
    n = len(points)
    start, end = outer_edges(triangles).T
    along = points[end] - points[start]
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    total = np.zeros((n, 2))
    np.add.at(total, start, outward)
    np.add.at(total, end, outward)
    length = np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-9)
    moved = points + total / length * reach * np.minimum(2 / length, SHARPEST)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = _cross(b - a, c - a)
    largest = np.zeros(n, dtype=np.int64)
    order = np.argsort(area, kind="stable")
    largest[triangles[order].ravel()] = np.repeat(order, 3)  # the last one stays
    corners = triangles[largest]
    a, b, c = (points[corners[:, k]] for k in range(3))
    parts = np.stack([_cross(b - moved, c - moved), _cross(c - moved, a - moved), _cross(a - moved, b - moved)], axis=1)
    weights = parts / parts.sum(axis=1, keepdims=True)
    weights[np.abs(weights) < 1e-12] = 0.0
    return corners, weights / weights.sum(axis=1, keepdims=True)


def _cross(one: Floats, other: Floats) -> Floats:
    """Signed areas (k,) of the parallelograms of pairs of vectors (k, 2)."""
    found: Floats = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return found
