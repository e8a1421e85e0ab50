"""Cloth over what is finer than its mesh: colliders and balls that go between its balls, and solids that its triangles reach
into, since colliders touch balls alone. No Taichi.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis import near_at_rest
from taichi_sim.geometry.mesh import Edges
from taichi_sim.geometry.support import farthest
from taichi_sim.scene.colliders import Collider
from taichi_sim.scene.collision_groups import meet
from taichi_sim.scene.objects import ball_in_words, owner
from taichi_sim.scene.scene import Scene

__all__ = ["Sieve", "dip", "edge_dip", "findings", "holes", "sieves", "through"]

Floats = NDArray[np.float64]

DEEP_EDGE = (
    0.25  # of the radius: edges that come through cloth so far are spoken of; 90 degrees at the usual radius give 0.16
)
FLAT = 1e-9  # rad: edges of a sheet
FACES_AROUND = 96  # of what is round about an axis
SAME_PLACE = 1e-9  # of its extent: vertices that lie so close are one
SLACK = 0.25  # strain up to which cloth that hangs on something opens


class Sieve(NamedTuple):
    """Something that goes between the balls of a surface: `what` it is, `width` [m] across, the strain [1] of the surface at
    which it fits, 0 or less at rest, the spacing [m] of the same balls that would hold it, and the surface's name."""

    what: str
    width: float
    strain: float
    spacing: float
    surface: str = "the surface"


def holes(scene: Scene) -> tuple[Floats, Floats, Floats]:
    """Holes of each triangle (t,), as it is at the start, without the radii of its balls: the radius [m] of the widest
    circle that passes between its corners, half the width [m] of the widest slit between rows of balls, and its shortest
    side [m]."""
    x = scene.position[scene.triangles]
    sides = np.sort(np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2), axis=1)
    a, b, c = sides.T
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    full = area > 1e-12 * c * c
    around = np.divide(a * b * c, 4.0 * area, out=0.5 * c, where=full & (a * a + b * b > c * c))
    slit = np.divide(area, a, out=np.zeros_like(a), where=full)
    return around, slit, a


def _width(collider: Collider) -> tuple[float, bool]:
    """Half the width [m] of a solid collider where it is narrowest, and whether only between two rows of balls does it fit."""
    told = collider.form.width(collider)
    if told is not None:
        return told
    vertices, _ = _skin(collider)
    hull = _hull(vertices)
    corners, normals = vertices[hull.vertices], hull.equations[:, :3]
    return 0.5 * float((farthest(corners, normals) + farthest(corners, -normals)).min()), True


def _skin(collider: Collider) -> tuple[Floats, NDArray[np.int32]]:
    """Vertices (v, 3) [m] and triangles (t, 3) of a collider's surface, which share the vertices at edges."""
    vertices, triangles = collider.surface(FACES_AROUND)
    if collider.is_meshed:
        return vertices, triangles
    grid = np.round(vertices / (SAME_PLACE * collider.extent))
    _, first, number = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    return vertices[first], number.ravel()[triangles].astype(np.int32)


def _solids(scene: Scene) -> Iterator[tuple[int, Collider, NDArray[np.bool_]]]:
    """Colliders that are not hollow, with their numbers, and the triangles (t,) whose balls they collide with, where there are
    some."""
    for k, collider in enumerate(scene.colliders):
        minds = meet(scene.group, scene.mask, collider.group, collider.mask)[scene.triangles].all(axis=1)
        if collider.hollow <= 0.0 and minds.any():
            yield k, collider, minds


def sieves(scene: Scene) -> Iterator[Sieve]:
    """Colliders, and loose balls, that the cloth of a scene lets through, at rest or where it is stretched by up to SLACK."""
    if scene.dim == 3 and len(scene.triangles):
        yield from _sieves(scene, *holes(scene))


def _sieves(scene: Scene, around: Floats, slit: Floats, side: Floats) -> Iterator[Sieve]:
    """See `sieves`; around, slit, side: see `holes`."""
    radius = scene.radius[scene.triangles].min(axis=1)
    for k, collider, minds in _solids(scene):
        half, flat = _width(collider)
        found = _sieve(scene, collider.in_words(k), half, slit if flat else around, radius, side, minds)
        if found is not None:
            yield found
    yield from _loose_through(scene, around, radius, side)


def _loose_through(scene: Scene, around: Floats, radius: Floats, side: Floats) -> Iterator[Sieve]:
    """The smallest ball that belongs to nothing; where triangles collide nothing goes through."""
    thin = ~scene.solid
    loose = scene.loose()
    loose[scene.triangles] = False
    for material in np.unique(scene.group[loose]) if thin.any() else ():
        some = np.flatnonzero(loose & (scene.group == material))
        ball = int(some[np.argmin(scene.radius[some])])
        own = meet(scene.group, scene.mask, int(scene.group[ball]), int(scene.mask[ball]))
        minds = thin & own[scene.triangles].all(axis=1)
        if minds.any():
            one = ball_in_words(scene.objects, ball)
            found = _sieve(scene, one, float(scene.radius[ball]), around, radius, side, minds)
            if found is not None:
                yield found


def _sieve(
    scene: Scene, what: str, half: float, hole: Floats, radius: Floats, side: Floats, minds: NDArray[np.bool_]
) -> Sieve | None:
    """The triangle, of those that mind, that lets something of half a width [m] through at the least strain, or None."""
    strain = (half + radius) / np.where(hole > 0.0, hole, np.inf)
    strain = np.where((hole > 0.0) & minds, strain, np.inf) - 1.0
    worst = int(np.argmin(strain))
    if strain[worst] >= SLACK:
        return None
    spacing = half * side[worst] / ((1.0 + SLACK) * hole[worst] - radius[worst])
    of = owner(scene.objects, int(scene.triangles[worst, 0]))
    return Sieve(what, 2.0 * half, float(strain[worst]), float(spacing), *([of.name] if of else []))


def through(sieve: Sieve) -> str:
    """A sieve as a sentence."""
    how = "" if sieve.strain <= 0.0 else f" where it is stretched by {sieve.strain:.2g}"
    ball = sieve.what.startswith("ball")
    cure = f"give {sieve.surface} surface_collision = true, or take" if ball else "take"
    return (
        f"{sieve.what}, {sieve.width:.2g} m across, goes between the balls of {sieve.surface}{how}: {cure} balls at most"
        f" {sieve.spacing:.2g} m apart, or larger ones"
    )


def dip(radius: float, ball: float, hole: float) -> float:
    """Depth [m] to which triangles reach into a sphere of `radius` [m], on which their corners, balls of a radius [m], lie:
    their centres are sqrt((radius + ball)^2 - hole^2) from its own, hole [m] being the radius of the circle around a
    triangle."""
    reach = (radius + ball) ** 2 - hole**2
    return max(0.0, radius - float(np.sqrt(reach))) if reach > 0.0 else radius


def _flush(radius: float, ball: float) -> float:
    """The circle [m] around triangles whose centres just touch such a sphere."""
    return float(np.sqrt(ball * (2.0 * radius + ball)))


def edge_dip(angle: float | Floats, ball: float, side: float) -> float | Floats:
    """Depth [m] to which a triangle's side [m] across an edge of a solid lies below that edge, where the balls at the side's ends
    (their radius [m]) touch the two faces at equal distances; angle [rad]: of the solid at its edge. 0 where it stays above.
    The faces have no end here."""
    half = 0.5 * np.maximum(angle, FLAT)
    return np.maximum(0.0, (0.5 * side * np.cos(half) - ball) / np.sin(half))


class _Edges(NamedTuple):
    """Convex edges of a solid: their angles (e,) [rad]; how far (e,) [m] it reaches from each along the bisector, below which
    nothing dips, for there all of the solid is above; and the width (e,) [m] of the narrower face."""

    angle: Floats
    reach: Floats
    face: Floats

    @classmethod
    def of(cls, collider: Collider) -> "_Edges":
        """Those of a solid collider; none where it is round."""
        if collider.form.roundness(collider) > 0.0:
            return cls(*np.zeros((3, 0)))
        vertices, triangles = _skin(collider)
        corners, edges = vertices[triangles], Edges.of(triangles)
        sides = np.argsort(edges.of_side, kind="stable")
        sides = sides[edges.triangles[edges.of_side[sides]] == 2].reshape(-1, 2)
        one, other = sides.T % len(corners)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        middle = corners.mean(axis=1)
        convex = np.einsum("ei,ei->e", middle[other] - middle[one], normal[one]) < 0.0
        one, other, ends = normal[one[convex]], normal[other[convex]], edges.ends[edges.of_side[sides[convex, 0]]]
        cosine = np.einsum("ei,ei->e", one, other)[:, None]
        tip, hull = vertices[ends[:, 0]], vertices[_hull(vertices).vertices]

        def reach(direction: Floats) -> Floats:
            direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
            return farthest(hull, direction) - np.sum(tip * direction, axis=1)

        face = np.minimum(reach(cosine * one - other), reach(cosine * other - one))  # in each face, away from the edge
        return cls(math.pi - np.arccos(np.clip(cosine[:, 0], -1.0, 1.0)), reach(-one - other), face)

    def fit(self, ball: float, side: float) -> "_Edges":
        """Those whose faces are so wide that both balls of a side (radius and length [m]) touch them, see `edge_dip`."""
        half = 0.5 * np.maximum(self.angle, FLAT)
        wide = 0.5 * side - ball * np.cos(half) <= self.face * np.sin(half)
        return _Edges(*(of[wide] for of in self))

    def deepest(self, ball: float, side: float) -> tuple[float, float]:
        """The largest depth [m] of all edges below a side, see `edge_dip`, and the angle [rad] there; 0 and pi without edges."""
        depth = np.minimum(edge_dip(self.angle, ball, side), self.reach)
        worst = int(np.argmax(depth)) if len(depth) else -1
        return (float(depth[worst]), float(self.angle[worst])) if len(depth) else (0.0, math.pi)


def _hull(vertices: Floats) -> Any:
    """Convex hull of the vertices (v, 3) of a collider, by a package that is slow to import."""
    from scipy.spatial import ConvexHull

    return ConvexHull(vertices, qhull_options="QJ")  # joggled: a thin one is no fault


def _at_edges(scene: Scene, ball: Floats, least: Floats, named: set[str]) -> Iterator[tuple[str, str]]:
    """Edges of colliders that come through cloth between its balls, see `edge_dip`. ball, least (t,): radius of the balls and
    shortest side of each triangle [m]; named: colliders of which it is said that all of them go through."""
    x = scene.position[scene.triangles]
    side = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
    for k, collider, minds in _solids(scene):
        edges = _Edges.of(collider)
        sharpest = math.cos(0.5 * float(edges.angle.min(initial=math.pi)))
        worst = int(np.argmax(np.where(minds, 0.5 * side * sharpest - ball, -np.inf)))
        span = float(ball[worst]), float(side[worst])
        deep, angle = (edges.fit(*span) if collider.in_words(k) in named else edges).deepest(*span)
        if deep <= DEEP_EDGE * ball[worst]:
            continue
        larger = 0.5 * float(side[worst]) * math.cos(0.5 * angle)
        spacing = float(least[worst] * ball[worst]) / larger
        cure = f"take a radius of {larger:.2g} m, or, with this radius, balls at most {spacing:.2g} m apart"
        if scene.solid[worst] and not near_at_rest.fits(scene, larger / float(ball[worst])):
            cure = (
                f"a radius of {larger:.2g} m, which keeps them out, is thicker than its parts are apart; with balls nearer to"
                " each other, and radii in proportion, they come less deep"
            )
        yield (
            f"edges of {collider.in_words(k)}, {np.degrees(angle):.2g} degrees sharp, come through by up to {deep:.2g} m"
            " between its balls",
            cure,
        )


def findings(scene: Scene) -> Iterator[tuple[str, str]]:
    """Solids that come through the cloth of a scene, or into it: what is said of each, and the cure."""
    if scene.dim == 2 or not len(scene.triangles):
        return
    around, slit, side = holes(scene)
    found = list(_sieves(scene, around, slit, side))
    for sieve in found:
        what, cure = through(sieve).split(": ", 1)
        yield what, cure
    ball = scene.radius[scene.triangles].min(axis=1)
    for k, collider, minds in _solids(scene):
        radius = collider.form.roundness(collider)
        if radius == 0.0:
            continue
        worst = int(np.argmax(np.where(minds, around - ball, -np.inf)))
        if radius + ball[worst] <= around[worst]:  # it goes through
            continue
        deep = dip(radius, float(ball[worst]), float(around[worst]))
        spacing = float(side[worst] / around[worst]) * _flush(radius, float(ball[worst]))
        if deep > 0.0:
            yield (
                f"its triangles reach up to {deep:.2g} m into {collider.in_words(k)}",
                f"take balls at most {spacing:.2g} m apart, or larger ones",
            )
    yield from _at_edges(scene, ball, side, {sieve.what for sieve in found if sieve.strain <= 0.0})
