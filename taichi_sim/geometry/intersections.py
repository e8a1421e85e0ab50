"""Intersections: which edges of a surface pierce its triangles. In double precision, and no part of a step."""

from collections.abc import Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.mesh import unique_edges

SEGMENTS_AT_ONCE = 1 << 14


def crossings(position: NDArray, triangles: NDArray) -> NDArray[np.int64]:
    """The pairs (k, 2) of an edge and a triangle, neither sharing a ball, of which the edge goes through the triangle's inside.

    position: (n, 3) m. triangles: (t, 3); edges are counted as `unique_edges` lists them. What only touches is no crossing.
    """
    t = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    x = np.asarray(position, dtype=np.float64)
    if not len(t):
        return np.zeros((0, 2), dtype=np.int64)
    edges = unique_edges(t)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for e, f in near(x[edges], x[t]):
        apart = np.all(edges[e][:, :, None] != t[f][:, None, :], axis=(1, 2))
        e, f = e[apart], f[apart]
        hit = _pierces(x[edges[e, 0]], x[edges[e, 1]], x[t[f, 0]], x[t[f, 1]], x[t[f, 2]])
        found.append(np.stack([e[hit], f[hit]], axis=1))
    return np.concatenate(found)


def _volume(a: NDArray, b: NDArray, c: NDArray, d: NDArray) -> NDArray:
    """Six times the signed volumes of tetrahedra."""
    return np.sum(np.cross(b - a, c - a) * (d - a), axis=-1)


def _pierces(p: NDArray, q: NDArray, a: NDArray, b: NDArray, c: NDArray) -> NDArray[np.bool_]:
    """True where segments p q go through triangles a b c: their ends on different sides, their line through the inside."""
    sides = _volume(a, b, c, p) * _volume(a, b, c, q) < 0
    one, two, three = _volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)
    return sides & (((one > 0) & (two > 0) & (three > 0)) | ((one < 0) & (two < 0) & (three < 0)))


def near(segments: NDArray, triangles: NDArray) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Pairs of a segment (e, 2, 3) and a triangle (t, 3, 3), or another one, whose boxes overlap, by chunks of segments.

    Triangles of about one size are searched together: a few large ones would widen the search among all the small ones. Those
    below the median are one group: an edge reaches about as far.
    """
    low, high = segments.min(axis=1), segments.max(axis=1)
    bottom, top = triangles.min(axis=1), triangles.max(axis=1)
    size = (top - bottom).max(axis=1)
    power = np.frexp(np.maximum(size, np.median(size)))[1] // 2
    from scipy.spatial import cKDTree  # slow to import, and few runs ask for crossings

    rounding = 4.0 * np.spacing(np.abs(triangles).max())
    for one in np.unique(power):
        alike = np.flatnonzero(power == one)
        tree = cKDTree(0.5 * (bottom + top)[alike])
        reach = 0.5 * ((high - low).max(axis=1) + size[alike].max()) + rounding
        for first in range(0, len(segments), SEGMENTS_AT_ONCE):
            part = slice(first, first + SEGMENTS_AT_ONCE)
            found = tree.query_ball_point(0.5 * (low[part] + high[part]), reach[part], p=np.inf)
            e = first + np.repeat(np.arange(len(found)), [len(near) for near in found])
            f = alike[np.fromiter(chain.from_iterable(found), dtype=np.int64, count=len(e))]
            over = np.all((low[e] <= top[f]) & (bottom[f] <= high[e]), axis=1)
            yield e[over], f[over]
