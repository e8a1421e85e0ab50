"""Level set: the closed surface where a function of place is zero, as a mesh."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.geometry.mesh import Surface


def level_set(
    function: Callable[[NDArray], NDArray], low: Sequence[float], high: Sequence[float], spacing: float
) -> Surface:
    """The surface on which `function`, negative inside, is zero: naive surface nets.

    A vertex lies in each cell of a lattice that the surface passes through, at the mean of where it cuts the cell's edges; a
    square, as two triangles, crosses each edge of the lattice that is cut. The mesh is closed, and each edge has two triangles:
    where two opposite corners of a square of the lattice alone are inside, one of the others, the nearest, is taken inside.

    Args:
        function: of places (..., 3) [m], gives (...).
        low, high: corners of the box to look in [m]; the surface must lie inside. spacing: of the lattice [m].

    Raises SceneError where there is no surface in the box, or it leaves the box.
    """
    a, b = validation.vector("level_set.low", low, 3), validation.vector("level_set.high", high, 3)
    step = validation.number("level_set.spacing", spacing, positive=True)
    if np.any(b - a < 2 * step):
        raise SceneError("level_set.high", b, "above low by two spacings at least")
    axes = [np.linspace(x, y, max(3, round((y - x) / step) + 1)) for x, y in zip(a, b)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    value = np.array(function(lattice), dtype=np.float64)
    while _join(value):
        pass
    inside = value < 0
    if not inside.any():
        raise SceneError("level_set.function", says="is nowhere negative in the box; there is no surface")
    rim = np.ones(inside.shape, dtype=bool)
    rim[1:-1, 1:-1, 1:-1] = False
    if inside[rim].any():
        raise SceneError("level_set.low", says="the surface leaves the box; make low less or high more")
    corners = [tuple(slice(k >> s & 1, (k >> s & 1) - 1 or None) for s in (2, 1, 0)) for k in range(8)]
    mixed = np.sum([inside[c] for c in corners], axis=0) % 8 > 0
    total, weight = np.zeros((*mixed.shape, 3)), np.zeros((*mixed.shape, 1))
    for k, bit in ((k, bit) for k in range(8) for bit in (1, 2, 4) if not k & bit):
        v, w = value[corners[k]], value[corners[k | bit]]
        cut = ((v < 0) != (w < 0))[..., None]
        part = np.divide(v, v - w, out=np.zeros_like(v), where=cut[..., 0])[..., None]
        start, end = lattice[corners[k]], lattice[corners[k | bit]]
        total += np.where(cut, start + part * (end - start), 0.0)
        weight += cut
    number = np.cumsum(mixed.ravel()).reshape(mixed.shape) - 1
    squares = [
        _squares(inside.transpose(order), number.transpose(order)) for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    ]
    square = np.concatenate(squares)
    triangles = np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    return Surface(total[mixed] / weight[mixed], triangles.astype(np.int32))


def _join(value: NDArray) -> bool:
    """Take inside, by turning its sign, the nearer of the outer corners of each square of which two opposite corners alone are
    inside. Four squares of the mesh would meet in one edge there. False if there was none."""
    found = False
    for axes in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        v = value.transpose(axes)
        four = np.stack([v[:-1, :-1], v[1:, :-1], v[1:, 1:], v[:-1, 1:]])
        inside = four < 0
        place = np.argwhere((inside[0] == inside[2]) & (inside[1] == inside[3]) & (inside[0] != inside[1]))
        if len(place):
            found = True
            around = four[:, place[:, 0], place[:, 1], place[:, 2]]
            step = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
            corner = place + step[np.argmin(np.where(around < 0, np.inf, around), axis=0)]
            v[tuple(corner.T)] = -np.maximum(np.abs(v[tuple(corner.T)]), np.finfo(float).tiny)
    return found


def _squares(inside: NDArray, number: NDArray) -> NDArray:
    """Squares (k, 4) of vertices around the edges of the lattice along its first axis, counter-clockwise from outside."""
    place = np.argwhere(inside[:-1] != inside[1:])
    around = [number[tuple((place - (0, *by)).T)] for by in ((1, 1), (0, 1), (0, 0), (1, 0))]
    square = np.stack(around, axis=1)
    upward = inside[tuple(place.T)]  # the outside lies further along the axis
    square[~upward] = square[~upward][:, ::-1]
    return square
