"""Surfaces that collide and are nearer to themselves at rest than they are thick: contacts then keep less than their thickness.
No Taichi."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.quantities import at_most
from taichi_sim.geometry.graph import components
from taichi_sim.geometry.intersections import near
from taichi_sim.geometry.mesh import unique_edges
from taichi_sim.scene.objects import owner
from taichi_sim.scene.scene import Scene

__all__ = ["findings", "fits"]

MOST_TRIANGLES = 10_000  # a second
INSIDE = 1e-4  # of an edge or a triangle: nearer to its end, a hit is one of the ball there
SMALLEST_ANGLE = 1e-6  # squared sine between edges that have one closest point each
SLACK = 1e-6  # of the thickness

Floats = NDArray[np.float64]
Near = tuple[NDArray[np.int64], Floats, Floats]  # four balls (k, 4), distances and thicknesses (k,) [m]


def findings(scene: Scene) -> Iterator[tuple[str, str]]:
    """Warning of the surface of which two parts are nearer at rest than their thickness, by the largest factor, and the cure:
    the largest radius that fits. None for a scene of more than MOST_TRIANGLES."""
    worst, least, spacing = _nearest(scene, scene.radius)
    if worst < 0:
        return
    of = owner(scene.objects, worst)
    name = of.name if of else "a surface"
    fits = least * float(scene.radius[worst])
    yield (
        f"of {name} are as near as {spacing:.2g} m at rest, {least:.2g} of the distance at which they touch: there contacts"
        " keep no more than that",
        f"take a radius of at most {at_most(fits)} m, or larger triangles, for contacts as thick as the balls",
    )


def fits(scene: Scene, times: float) -> bool:
    """True if surfaces that collide are nowhere nearer at rest than they were thick with so many times the radii, as far as is
    known: see `findings`."""
    return _nearest(scene, times * scene.radius)[0] < 0


def _nearest(scene: Scene, radius: Floats) -> tuple[int, float, float]:
    """A ball of the parts that are nearest by their thickness with radii (n,) [m], that part of it, and their distance [m]; -1
    for the ball where none are nearer than that."""
    t = scene.triangles[scene.solid].astype(np.int64)
    worst, least, spacing = -1, 1.0 - SLACK, 0.0
    if scene.dim == 2 or not 0 < len(t) <= MOST_TRIANGLES:
        return worst, least, spacing
    body = components(scene.n_balls, np.concatenate([t[:, :2], t[:, 1:]]))
    x = scene.position
    for balls, distance, thickness in (_faces(x, radius, t), _edges(x, radius, unique_edges(t).astype(np.int64))):
        part = np.where(body[balls[:, 0]] == body[balls[:, 3]], distance / thickness, np.inf)
        k = int(np.argmin(part)) if len(part) else -1
        if k >= 0 and part[k] < least:
            worst, least, spacing = int(balls[k, 0]), float(part[k]), float(distance[k])
    return worst, least, spacing


def _faces(x: Floats, radius: Floats, t: NDArray[np.int64]) -> Near:
    """Balls over the inside of triangles."""
    balls = np.unique(t)
    reach = radius[balls] + float(radius[balls].max())
    i, k = _pairs(x[balls] - reach[:, None], x[balls] + reach[:, None], x[t])
    i = balls[i]
    apart = np.all(i[:, None] != t[k], axis=1)
    i, k = i[apart], k[apart]
    a, b, c = (x[t[k, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    square = np.maximum(np.sum(normal**2, axis=1), 1e-300)
    second, third = (
        np.sum(np.cross(one, other) * normal, axis=1) / square for one, other in ((x[i] - a, c - a), (b - a, x[i] - a))
    )
    weight = np.stack([1.0 - second - third, second, third], axis=1)
    inside = np.all(weight > INSIDE, axis=1)
    distance = np.abs(np.sum((x[i] - a) * normal, axis=1)) / np.sqrt(square)
    thickness = radius[i] + np.sum(weight * radius[t[k]], axis=1)
    return np.column_stack([i, t[k]])[inside], distance[inside], thickness[inside]


def _edges(x: Floats, radius: Floats, edges: NDArray[np.int64]) -> Near:
    """Edges that pass each other."""
    reach = radius[edges].max(axis=1)[:, None] + float(radius[edges].max())
    e, f = _pairs(x[edges].min(axis=1) - reach, x[edges].max(axis=1) + reach, x[edges])
    apart = (e < f) & np.all(edges[e][:, :, None] != edges[f][:, None, :], axis=(1, 2))
    one, other = edges[e[apart]], edges[f[apart]]
    u, v, r = x[one[:, 1]] - x[one[:, 0]], x[other[:, 1]] - x[other[:, 0]], x[one[:, 0]] - x[other[:, 0]]
    uu, uv, vv, ur, vr = (np.sum(p * q, axis=1) for p, q in ((u, u), (u, v), (v, v), (u, r), (v, r)))
    square = uu * vv - uv**2
    crossed = square > SMALLEST_ANGLE * uu * vv
    square = np.where(crossed, square, 1.0)
    s, t = (uv * vr - vv * ur) / square, (uu * vr - uv * ur) / square
    inside = crossed & (np.minimum(s, t) > INSIDE) & (np.maximum(s, t) < 1.0 - INSIDE)
    s, t, one, other = s[inside], t[inside], one[inside], other[inside]
    distance = np.linalg.norm(r[inside] + s[:, None] * u[inside] - t[:, None] * v[inside], axis=1)
    thickness = (1 - s) * radius[one[:, 0]] + s * radius[one[:, 1]]
    thickness = thickness + (1 - t) * radius[other[:, 0]] + t * radius[other[:, 1]]
    return np.column_stack([one, other]), distance, thickness


def _pairs(low: Floats, high: Floats, others: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Boxes from low to high (k, 3), and things with corners (m, n, 3), that are near: the numbers of both."""
    first, second = zip(*near(np.stack([low, high], axis=1), others))
    return np.concatenate(first), np.concatenate(second)
