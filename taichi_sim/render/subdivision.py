"""Loop subdivision: a surface with four triangles for each, whose new vertices are fixed weighted means of the old ones.

C. Loop, Smooth subdivision surfaces based on triangles, 1987; the weights of inner vertices after J. Warren.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from taichi_sim.geometry.mesh import Edges

__all__ = ["subdivide", "subdivided_corners"]


def subdivide(triangles: NDArray, n: int) -> tuple[NDArray[np.int64], csr_array]:
    """The finer triangles (4 t, 3), and the weights of their vertices over the n old ones: first the moved old vertices, then
    one for each edge. Borders depend on no inner vertex; corners, where at most two triangles meet, stay where they are."""
    edges = Edges.of(triangles)
    low, high = edges.ends.T.astype(np.int64)
    inner = edges.triangles == 2  # an edge of three triangles is treated as a border of each
    half = inner[edges.of_side]
    new = n + np.arange(len(low))
    ends = np.where(inner, 3 / 8, 1 / 2)
    border = np.bincount(np.concatenate([low[~inner], high[~inner]]), minlength=n)
    degree = np.bincount(np.concatenate([low, high]), minlength=n)
    share = np.where(degree == 3, 3 / 16, 3 / 8 / np.maximum(degree, 1))
    rim = (border == 2) & (degree > 3)
    own = np.where(border == 0, 1 - degree * share, np.where(rim, 3 / 4, 1.0))
    one, other = np.concatenate([low, high]), np.concatenate([high, low])
    along = np.where(border[one] == 0, share[one], np.where(rim[one] & ~np.tile(inner, 2), 1 / 8, 0.0))
    across = triangles[:, [2, 0, 1]].T.ravel()  # of each side
    row = np.concatenate([np.arange(n), one, new, new, n + edges.of_side[half]])
    column = np.concatenate([np.arange(n), other, low, high, across[half]])
    value = np.concatenate([own, along, ends, ends, np.full(np.count_nonzero(half), 1 / 8)])
    weights = coo_array((value, (row, column)), shape=(n + len(low), n)).tocsr()
    weights.eliminate_zeros()
    a, b, c = triangles.T.astype(np.int64)
    ab, bc, ca = (n + edges.of_side).reshape(3, -1)
    finer = np.stack([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]).reshape(-1, 3)
    return finer, weights


def subdivided_corners(values: NDArray) -> NDArray[np.float64]:
    """Values (4 t, 3, width) at the corners of finer triangles, from those (t, 3, width) of the old ones, linear between."""
    a, b, c = (values[:, k] for k in range(3))
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    return np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
