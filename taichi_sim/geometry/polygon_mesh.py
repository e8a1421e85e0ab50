"""Triangles that fill a polygon with holes: its corners kept, its outline divided, and points about a spacing apart within.

The triangulation is Delaunay's (scipy) of the points of the outline and of a triangular lattice within; a piece of the outline
that it does not have is divided until it does (Ruppert 1995, "A Delaunay refinement algorithm for quality 2-dimensional mesh
generation").
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError

__all__ = ["extruded", "filled", "outer_edges"]

Floats = NDArray[np.float64]
CORNER = np.radians(20.0)  # an outline that turns by more at a point has a corner there
ROUND = 8  # pieces of a closed curve at least
CLEAR = 0.55  # of the spacing: points within keep that far from the outline
TRIES = 30
SMOOTHED = 6  # times that the points within go to the mean of their neighbours
HEX = np.sqrt(0.75)


def filled(where: str, polygon: Any, spacing: float) -> tuple[Floats, NDArray[np.int64], int]:
    """Points (n, 2) [m], those of the outline first, triangles (t, 3), counter-clockwise, and the number of points of the
    outline.

    polygon: of shapely [m]. Raises SceneError where the spacing [m] is too coarse for what is thin in it.
    """
    import shapely

    fine = spacing
    for _ in range(6):
        rings = [_divided(np.asarray(ring.coords)[:-1], fine) for ring in (polygon.exterior, *polygon.interiors)]
        coarse = shapely.Polygon(rings[0], rings[1:]) if all(len(ring) >= 3 for ring in rings) else None
        if coarse is not None and coarse.is_valid and abs(coarse.area - polygon.area) < 0.05 * polygon.area:
            break
        fine *= 0.5
    else:
        raise SceneError(where, spacing, says="is too coarse for what is thin in its outline; take a smaller one")
    points, edges = _loops(rings)
    inner = _lattice(coarse.bounds, spacing)
    kept = coarse.buffer(-CLEAR * spacing)
    inner = inner[shapely.contains_xy(kept, *inner.T)] if not kept.is_empty else inner[:0]
    for _ in range(SMOOTHED):
        points, edges, triangles = _conforming(where, points, edges, inner, spacing)
        inner = _smoothed(points, inner, triangles)
    points, edges, triangles = _conforming(where, points, edges, inner, spacing)
    vertices = np.concatenate([points, inner])
    middle = vertices[triangles].mean(axis=1)
    triangles = triangles[shapely.contains_xy(shapely.Polygon(*_as_rings(points, edges)), *middle.T)]
    used, compact = np.unique(triangles, return_inverse=True)
    border = int(np.searchsorted(used, len(points)))
    return vertices[used], compact.reshape(-1, 3).astype(np.int64), border


def _divided(ring: Floats, spacing: float) -> Floats:
    """A closed ring (k, 2) with its corners and, between them, points at equal distances of at most the spacing."""
    ring = ring[np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1) > 1e-9 * spacing]
    along = np.roll(ring, -1, axis=0) - ring
    angle = np.arctan2(along[:, 1], along[:, 0])
    turn = np.abs((angle - np.roll(angle, 1) + np.pi) % (2 * np.pi) - np.pi)
    corners = np.flatnonzero(turn > CORNER)
    if not len(corners):
        corners = np.zeros(1, dtype=int)
    least = ROUND if len(corners) == 1 else 1
    pieces = []
    for here, there in zip(corners, np.roll(corners, -1)):
        stretch = np.arange(here, there + 1 if there > here else there + len(ring) + 1) % len(ring)
        x = ring[stretch]
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
        many = max(least, int(np.ceil(at[-1] / spacing - 1e-9)))
        to = np.linspace(0.0, at[-1], many + 1)[:-1]
        pieces.append(np.stack([np.interp(to, at, x[:, k]) for k in range(2)], axis=1))
    return np.concatenate(pieces)


def _loops(rings: list[Floats]) -> tuple[Floats, NDArray[np.int64]]:
    """The points of all rings, and their edges (e, 2)."""
    edges, first = [], 0
    for ring in rings:
        k = np.arange(len(ring))
        edges.append(first + np.stack([k, np.roll(k, -1)], axis=1))
        first += len(ring)
    return np.concatenate(rings), np.concatenate(edges)


def _as_rings(points: Floats, edges: NDArray) -> tuple[Floats, list[Floats]]:
    """The rings that edges form, the first one outside."""
    after = dict(edges.tolist())
    rings, left = [], dict(after)
    while left:
        start = next(iter(left))
        ring, at = [], start
        while at in left:
            ring.append(at)
            at = left.pop(at)
        rings.append(points[ring])
    return rings[0], rings[1:]


def _lattice(bounds: tuple[float, float, float, float], spacing: float) -> Floats:
    """Corners (k, 2) of equilateral triangles over a box."""
    left, low, right, high = bounds
    rows = np.arange(low + 0.5 * spacing, high, HEX * spacing)
    columns = np.arange(left, right + spacing, spacing)
    x, y = np.meshgrid(columns, rows)
    return np.stack([(x + 0.5 * spacing * (np.arange(len(rows)) % 2)[:, None]).ravel(), y.ravel()], axis=1)


def _conforming(
    where: str, points: Floats, edges: NDArray[np.int64], inner: Floats, spacing: float
) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Delaunay triangles (t, 3) that have all edges of the outline, which is divided where they do not; a point added to the
    outline is one of its points, so that those within keep their order behind them."""
    from scipy.spatial import Delaunay

    for _ in range(TRIES):
        triangles = Delaunay(np.concatenate([points, inner])).simplices.astype(np.int64)
        sides = np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
        n = len(points) + len(inner)
        there = np.isin(np.sort(edges, axis=1) @ [n, 1], sides @ [n, 1])
        if there.all():
            return points, edges, _counter_clockwise(np.concatenate([points, inner]), triangles)
        broken = edges[~there]
        if np.linalg.norm(points[broken[:, 0]] - points[broken[:, 1]], axis=1).min() < 1e-4 * spacing:
            break
        new = len(points) + np.arange(len(broken))
        points = np.concatenate([points, points[broken].mean(axis=1)])
        halves = [np.stack([broken[:, 0], new], axis=1), np.stack([new, broken[:, 1]], axis=1)]
        edges = np.concatenate([edges[there], *halves])
    raise SceneError(where, spacing, says="is too coarse for what is thin in its outline; take a smaller one")


def _counter_clockwise(x: Floats, triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Without those that have no area."""
    a, b = x[triangles[:, 1]] - x[triangles[:, 0]], x[triangles[:, 2]] - x[triangles[:, 0]]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    square = np.maximum(np.sum(a * a, axis=1), np.sum(b * b, axis=1))
    turned = np.where((area < 0)[:, None], triangles[:, ::-1], triangles)
    kept: NDArray[np.int64] = turned[np.abs(area) > 1e-9 * square]
    return kept


def _smoothed(points: Floats, inner: Floats, triangles: NDArray[np.int64]) -> Floats:
    """The points within, each at the mean of its neighbours."""
    if not len(inner):
        return inner
    x = np.concatenate([points, inner])
    sides = np.unique(np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0)
    both = np.concatenate([sides, sides[:, ::-1]])
    count = np.bincount(both[:, 0], minlength=len(x))
    mean = np.stack([np.bincount(both[:, 0], x[both[:, 1], k], minlength=len(x)) for k in range(2)], axis=1)
    return mean[len(points) :] / count[len(points) :, None]


def outer_edges(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """The edges (e, 2) that one triangle alone has, as it runs along them."""
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    _, inverse, count = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True)
    return sides[count[inverse.reshape(-1)] == 1]


def extruded(
    points: Floats, triangles: NDArray[np.int64], depth: float, layers: int
) -> tuple[Floats, NDArray[np.int64]]:
    """Points (n (layers + 1), 3) from -depth/2 to depth/2 along z, layer by layer, and tetrahedra (3 t layers, 4) of positive
    volume.

    Each prism over a triangle a < b < c is cut into a b c c', a b c' b', a b' c' a', so that neighbours share their diagonals.
    """
    n = len(points)
    z = np.repeat(np.linspace(-0.5 * depth, 0.5 * depth, layers + 1), n)
    x = np.column_stack([np.tile(points, (layers + 1, 1)), z])
    a, b, c = np.sort(triangles, axis=1).T
    cut = np.concatenate(
        [np.stack(four, axis=1) for four in ((a, b, c, c + n), (a, b, c + n, b + n), (a, b + n, c + n, a + n))]
    )
    cells = np.concatenate([cut + layer * n for layer in range(layers)])
    sides = x[cells[:, 1:]] - x[cells[:, :1]]
    turned = np.einsum("ci,ci->c", sides[:, 0], np.cross(sides[:, 1], sides[:, 2])) < 0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    return x, cells
