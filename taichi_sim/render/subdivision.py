"""Loop subdivision: a surface with four triangles for each, whose new vertices are fixed weighted means of the old ones.

C. Loop, Smooth subdivision surfaces based on triangles, 1987; the weights of inner vertices after J. Warren.
"""

import numpy as np
from numpy.typing import NDArray

__all__ = ["Rows", "compose", "subdivide"]

Rows = tuple[
    NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]
]  # row, column and value of a sparse matrix's entries


def subdivide(triangles: NDArray, n: int) -> tuple[NDArray[np.int64], Rows]:
    """The finer triangles (4 t, 3), and the weights of their vertices over the n old ones: first the moved old vertices, then
    one for each edge. Borders depend on no inner vertex; corners, where at most two triangles meet, stay where they are."""
    a, b, c = triangles.T.astype(np.int64)
    start, end, across = np.concatenate([a, b, c]), np.concatenate([b, c, a]), np.concatenate([c, a, b])
    key = np.minimum(start, end) * n + np.maximum(start, end)
    edges, edge, sides = np.unique(key, return_inverse=True, return_counts=True)
    low, high = edges // n, edges % n
    inner = sides == 2  # an edge of three triangles is treated as a border of each
    half = inner[edge]
    new = n + np.arange(len(edges))
    ends = np.where(inner, 3 / 8, 1 / 2)
    border = np.bincount(np.concatenate([low[~inner], high[~inner]]), minlength=n)
    degree = np.bincount(np.concatenate([low, high]), minlength=n)
    share = np.where(degree == 3, 3 / 16, 3 / 8 / np.maximum(degree, 1))
    rim = (border == 2) & (degree > 3)
    own = np.where(border == 0, 1 - degree * share, np.where(rim, 3 / 4, 1.0))
    one, other = np.concatenate([low, high]), np.concatenate([high, low])
    along = np.where(border[one] == 0, share[one], np.where(rim[one] & ~np.tile(inner, 2), 1 / 8, 0.0))
    row = np.concatenate([np.arange(n), one, new, new, n + edge[half]])
    column = np.concatenate([np.arange(n), other, low, high, across[half]])
    value = np.concatenate([own, along, ends, ends, np.full(np.count_nonzero(half), 1 / 8)])
    ab, bc, ca = (n + edge).reshape(3, -1)
    finer = np.stack([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]).reshape(-1, 3)
    return finer, _merged(row, column, value, n)


def compose(outer: Rows, inner: Rows, width: int) -> Rows:
    """The product of two sparse matrices; the rows of `inner` stand in order, its columns are fewer than `width`."""
    row, column, value = outer
    start = np.searchsorted(inner[0], np.arange(inner[0][-1] + 2 if len(inner[0]) else 1))
    count = start[column + 1] - start[column]
    first = np.cumsum(count) - count
    entry = np.repeat(start[column] - first, count) + np.arange(int(count.sum()))
    return _merged(np.repeat(row, count), inner[1][entry], np.repeat(value, count) * inner[2][entry], width)


def _merged(row: NDArray, column: NDArray, value: NDArray, width: int) -> Rows:
    """Entries in order of rows and columns, each place once, without zeros."""
    places, which = np.unique(row * width + column, return_inverse=True)
    total = np.bincount(which, value, minlength=len(places))
    kept = total != 0
    return places[kept] // width, places[kept] % width, total[kept]
