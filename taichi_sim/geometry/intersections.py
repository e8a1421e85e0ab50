"""Crossings: which edges of a surface pierce its triangles. Plain NumPy in double precision, and no part of a step."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

__all__ = ["crossings"]

CHUNK = 1 << 20  # pairs of an edge and a triangle looked at together


def crossings(position: NDArray, triangles: NDArray) -> NDArray[np.int64]:
    """The pairs (k, 2) of an edge and a triangle, neither sharing a ball, of which the edge goes through the triangle's inside.

    position: (n, 3) m. triangles: (t, 3); edges are counted as `edges_of` lists them. What only touches is no crossing.
    """
    t = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    x = np.asarray(position, dtype=np.float64)
    if not len(t):
        return np.zeros((0, 2), dtype=np.int64)
    edges = edges_of(t)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for e, f in _near(x[edges], x[t]):
        apart = np.all(edges[e][:, :, None] != t[f][:, None, :], axis=(1, 2))
        e, f = e[apart], f[apart]
        hit = _pierces(x[edges[e, 0]], x[edges[e, 1]], x[t[f, 0]], x[t[f, 1]], x[t[f, 2]])
        found.append(np.stack([e[hit], f[hit]], axis=1))
    return np.concatenate(found)


def edges_of(triangles: NDArray) -> NDArray[np.int64]:
    """The edges (e, 2) of triangles, each once, sorted."""
    t = np.asarray(triangles, dtype=np.int64)
    return np.unique(np.sort(np.concatenate([t[:, :2], t[:, 1:], t[:, ::2]]), axis=1), axis=0)


def _volume(a: NDArray, b: NDArray, c: NDArray, d: NDArray) -> NDArray:
    """Six times the signed volumes of tetrahedra."""
    return np.sum(np.cross(b - a, c - a) * (d - a), axis=-1)


def _pierces(p: NDArray, q: NDArray, a: NDArray, b: NDArray, c: NDArray) -> NDArray[np.bool_]:
    """Whether segments p q go through triangles a b c: their ends on different sides, their line through the inside."""
    sides = _volume(a, b, c, p) * _volume(a, b, c, q) < 0
    one, two, three = _volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)
    return sides & (((one > 0) & (two > 0) & (three > 0)) | ((one < 0) & (two < 0) & (three < 0)))


def _near(segments: NDArray, triangles: NDArray) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Pairs of a segment (e, 2, 3) and a triangle (t, 3, 3) whose boxes overlap, by chunks: looked up by their middles in cells
    as wide as the largest box."""
    low, high = segments.min(axis=1), segments.max(axis=1)
    bottom, top = triangles.min(axis=1), triangles.max(axis=1)
    width = max(float((high - low).max()), float((top - bottom).max()), 1e-300)
    cell, home = (np.floor(0.5 * (a + b) / width).astype(np.int64) for a, b in ((low, high), (bottom, top)))
    least = np.minimum(cell.min(axis=0), home.min(axis=0)) - 1
    size = np.maximum(cell.max(axis=0), home.max(axis=0)) - least + 2
    strides = np.array([size[1] * size[2], size[2], 1])
    key = (home - least) @ strides
    order = np.argsort(key, kind="stable")
    key = key[order]
    for shift in np.ndindex(3, 3):
        row = (cell - least + [shift[0] - 1, shift[1] - 1, 0]) @ strides
        first, last = np.searchsorted(key, row - 1), np.searchsorted(key, row + 1, side="right")
        count = last - first
        ends = np.cumsum(count)
        at = 0
        while at < len(count):
            stop = max(at + 1, int(np.searchsorted(ends, (ends[at - 1] if at else 0) + CHUNK)))
            part = count[at:stop]
            e = np.repeat(np.arange(at, min(stop, len(count))), part)
            begin = np.repeat(first[at:stop] - (np.cumsum(part) - part), part)
            f = order[begin + np.arange(len(e))]
            over = np.all((low[e] <= top[f]) & (bottom[f] <= high[e]), axis=1)
            yield e[over], f[over]
            at = stop
