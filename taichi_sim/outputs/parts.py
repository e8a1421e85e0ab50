"""Parts: what files for other programs hold of a frame, object by object: surfaces, loose balls, springs, colliders."""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry.mesh import holes
from taichi_sim.render.bodies import COLLIDER_GREY, Bodies
from taichi_sim.render.palette import body_colours
from taichi_sim.render.styles import places_within
from taichi_sim.scene.colliders import Collider
from taichi_sim.scene.objects import mapped, named

__all__ = [
    "Body",
    "Parts",
    "Surface",
    "Texture",
    "Textures",
    "Together",
    "collider_names",
    "few_colours",
    "in_3d",
    "normals_of",
    "placed",
    "single",
    "textures_of",
]

Floats = NDArray[np.float64]
Texture = tuple[str, float]  # an image file, and how often it repeats along each side of 0..1
Textures = Mapping[str, Texture]  # by the names of shapes
MOST_COLOURS = 128  # of loose balls of one object, in files that give each colour a material
ROUND_FACES = 48  # of a round collider about its axis


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A surface of an object. Vertex k lies at the mean, by weights[k], of the balls corners[k]."""

    object: int
    name: str
    corners: NDArray[np.int32]  # (v, k)
    weights: Floats  # (v, k)
    embedded: NDArray[np.int32] | None  # (t, 3) its own triangles; None: those of the frame between its vertices
    colour: Floats  # (v, 3) sRGB
    uv: Floats | None  # (v, 2) in 0..1; where a texture has a seam, a vertex on each side of it
    smooth: NDArray[np.int64]  # (v,) the first vertex of each ball, for normals across seams

    def points(self, x: Floats) -> Floats:
        """Vertices (v, 3) [m] of the surface for balls at x (n, 3) [m]."""
        if self.corners.shape[1] == 1:
            return x[self.corners[:, 0]]
        return np.einsum("vk,vki->vi", self.weights, x[self.corners])

    def normals(self, points: Floats, triangles: NDArray) -> Floats:
        """Unit normals (v, 3) of its vertices at `points`."""
        return normals_of(points, self.smooth[triangles])[self.smooth]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A collider: its surface in its own frame, in 2D flat in the x-y plane."""

    name: str
    vertices: Floats  # (v, 3) m
    triangles: NDArray[np.int32]  # (t, 3)
    normals: Floats  # (v, 3)
    colour: tuple[float, float, float]  # sRGB


class Parts:
    """Properties that the frames of one scene have in common, from the first of them.

    number (n,): of the object that each ball belongs to, by which `names` count. A ball is hidden where a surface is shown in
    place of it, or it is a corner of one, or within the closed one of its object; the others are loose. colour (n, 3): sRGB of
    the balls.
    """

    def __init__(self, first: Frame, textured: Collection[str] = ()) -> None:
        """textured: names of objects with an image, whose surfaces all get places on it."""
        n = len(first.position)
        self.number, self.names = named(n, first.objects)
        self.colour = body_colours(first) if n else np.zeros((0, 3))
        self.radius = first.radius
        covered = np.zeros(n, dtype=bool)
        for one in first.embedded_surfaces:
            covered |= one.covered(n)
        own = first.triangles.reshape(-1, 3)
        self._shown = ~covered
        own = own[self._shown[own].all(axis=1)]
        hidden = covered.copy()
        hidden[own] = True
        for k in range(len(self.names)):
            surface = own[self.number[own[:, 0]] == k]
            if len(surface) and not len(holes(surface)):
                low, high = first.position[surface].min(axis=(0, 1)), first.position[surface].max(axis=(0, 1))
                inside = np.all((first.position >= low) & (first.position <= high), axis=1)
                hidden |= inside & (self.number == k)
        self.hidden = hidden
        self.loose = np.flatnonzero(~hidden)
        uv = np.full((n, 2), np.nan)
        known = getattr(first, "scene", first).triangles.reshape(-1, 3)  # those, too, that have torn
        for thing in first.objects:
            if thing.is_sheet:
                uv[thing.balls] = thing.uv
        corners = {int(self.number[thing.balls[0]]): at for thing, *at in mapped(first.objects, known)}
        self.surfaces: list[Surface] = []
        self._vertex = np.full(n, -1, dtype=np.int64)  # which of its surface's vertices a ball is
        self._split = dict[int, dict[bytes, NDArray]]()  # of surfaces with seams: the vertices of each triangle
        for k, name in enumerate(self.names):
            mine = own[self.number[own[:, 0]] == k]
            if len(mine) and k in corners:
                self.surfaces.append(self._mapped(k, name, *corners[k]))
            elif len(mine):
                balls = np.unique(mine)
                self._vertex[balls] = np.arange(len(balls))
                self.surfaces.append(self._plain(k, name, balls, uv[balls]))
        for one in first.embedded_surfaces:
            k = int(self.number[one.corners[0, 0]])
            tint = np.einsum("vk,vki->vi", one.weights, self.colour[one.corners])
            tint = np.clip(tint if one.colour is None else np.tile(one.colour, (len(tint), 1)), 0.0, 1.0)
            if one.uv is None:
                shown = Surface(
                    k, self.names[k], one.corners, one.weights, one.triangles, tint, None, np.arange(len(tint))
                )
            else:
                at, faces, places, smooth = _at_seams(one.triangles, one.uv)
                shown = Surface(k, self.names[k], one.corners[at], one.weights[at], faces, tint[at], places, smooth)
            self.surfaces.append(shown)
        for name in textured:
            self._project(name, in_3d(first.position))
        self.bodies = _bodies(first, self.names)
        self._faces: tuple[Any, list[NDArray]] = (None, [])
        self._tied = self.springs(first)[1]

    def _project(self, name: str, x: Floats) -> None:
        """Put an image onto the surfaces of an object that say nothing of one, as in pictures: along z."""
        own = [k for k, one in enumerate(self.surfaces) if one.name == name and one.uv is None]
        points = [self.surfaces[k].points(x) for k in own]
        for k, here in zip(own, points):
            around = np.concatenate([*points, x[self.number == self.surfaces[k].object]])
            self.surfaces[k] = replace(self.surfaces[k], uv=places_within(here, around)[:, :2])

    def _plain(self, k: int, name: str, balls: NDArray, uv: Floats) -> Surface:
        corners = balls[:, None].astype(np.int32)
        whole = None if np.isnan(uv).any() else uv
        return Surface(k, name, corners, np.ones(corners.shape), None, self.colour[balls], whole, np.arange(len(balls)))

    def _mapped(self, k: int, name: str, triangles: NDArray, uv: Floats) -> Surface:
        """One whose triangles have places at their corners, (t, 3, 2): a vertex for each place of each ball."""
        balls, faces, places, smooth = _at_seams(triangles, uv)
        self._split[k] = {row.tobytes(): corners for row, corners in zip(triangles.astype(np.int64), faces)}
        corners = balls[:, None].astype(np.int32)
        return Surface(k, name, corners, np.ones(corners.shape), None, self.colour[balls], places, smooth)

    def _vertices(self, k: int, triangles: NDArray) -> NDArray[np.int32]:
        """The vertices (t, 3) of triangles of balls, on the surface of an object."""
        if k not in self._split:
            return self._vertex[triangles].astype(np.int32)
        known = [self._split[k][row.tobytes()] for row in triangles.astype(np.int64)]
        return np.reshape(known, (-1, 3)).astype(np.int32)

    def triangles(self, frame: Frame) -> list[NDArray[np.int32]]:
        """Triangles (t, 3) of each surface, by its vertices, counter-clockwise from outside; fewer where springs have torn."""
        if self._faces[0] is not frame.triangles:
            own = frame.triangles.reshape(-1, 3)
            own = own[self._shown[own].all(axis=1)]
            owner = self.number[own[:, 0]]
            faces = [
                self._vertices(one.object, own[owner == one.object]) if one.embedded is None else one.embedded
                for one in self.surfaces
            ]
            self._faces = (frame.triangles, faces)
        return self._faces[1]

    def springs(self, frame: Frame) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The balls (m, 2) of the springs between loose balls, and the object (m,) of each, that of its first ball."""
        pairs = frame.springs.reshape(-1, 2)
        pairs = pairs[~self.hidden[pairs].any(axis=1)]
        return pairs, self.number[pairs[:, 0]]

    def held(self) -> NDArray[np.int64]:
        """Number of parts of each object: surfaces, its loose balls, its springs between these."""
        found = [one.object for one in self.surfaces], np.unique(self.number[self.loose]), np.unique(self._tied)
        return np.bincount(np.concatenate(found).astype(np.int64), minlength=len(self.names))


def _at_seams(triangles: NDArray, uv: Floats) -> tuple[NDArray[np.int64], NDArray[np.int32], Floats, NDArray[np.int64]]:
    """A vertex for each place (t, 3, 2) on a texture of each corner of triangles (t, 3): the corner (v,) that it is, triangles
    (t, 3) by them, places (v, 2), and the first vertex (v,) that is the same corner."""
    rows = np.column_stack([triangles.ravel(), uv.reshape(-1, 2)])
    made, vertex = np.unique(rows, axis=0, return_inverse=True)
    corner = made[:, 0].astype(np.int64)
    _, first, same = np.unique(corner, return_index=True, return_inverse=True)
    return corner, vertex.reshape(-1, 3).astype(np.int32), made[:, 1:], first[same.reshape(-1)]


def in_3d(x: NDArray) -> Floats:
    """Places (n, 3) of 2D ones, which lie in the x-y plane, or of 3D ones as they are."""
    return x if x.shape[1] == 3 else np.column_stack([x, np.zeros(len(x))])


def normals_of(points: Floats, triangles: NDArray) -> Floats:
    """Unit normals (v, 3) of vertices: the mean of their triangles' by area; 0 where there is none."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normal, sums = np.cross(b - a, c - a), np.zeros_like(points)
    for axis in range(3):
        sums[:, axis] = np.bincount(triangles.ravel(), np.repeat(normal[:, axis], 3), minlength=len(points))
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, length, out=sums, where=length > 0)


def few_colours(colour: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return at most MOST_COLOURS colours (m, 3) and which of them (n,) each of n colours is, or comes closest to."""
    for bits in range(8, 0, -1):
        level = np.minimum(np.rint(colour * 255).astype(np.int64) >> (8 - bits), 255)
        _, kind = np.unique(level, axis=0, return_inverse=True)
        kind = kind.reshape(-1)
        if kind.max(initial=0) < MOST_COLOURS:
            break
    count = np.maximum(np.bincount(kind), 1)[:, None]
    means = np.stack([np.bincount(kind, colour[:, k]) for k in range(3)], axis=1) / count
    return means, kind


def single(values: Any) -> NDArray[np.float32]:
    """The values as an array in single precision, in one piece."""
    return np.ascontiguousarray(values, dtype=np.float32)


def textures_of(style: Mapping[str, Any], folder: Path) -> Textures:
    """The image files of the looks in the arguments of `Renderer`, as seen from a folder, and how often each repeats, by the
    names of shapes."""
    found = {}
    for look in style.get("looks") or ():
        if look.get("texture") is not None:
            name = os.path.relpath(look["texture"], folder).replace(os.sep, "/")
            found[look["of"]] = name, float(look.get("repeat") or 1.0)
    return found


def placed(frame: Frame) -> list[tuple[Floats, Floats]]:
    """Places of the colliders of a frame: centre (3,) [m] and rotation (3, 3)."""
    found = []
    for one in frame.colliders:
        rotation = np.eye(3)
        rotation[: frame.dim, : frame.dim] = one.rotation
        found.append((in_3d(one.centre[None])[0], rotation))
    return found


def collider_names(first: Frame, taken: Collection[str]) -> list[str]:
    """The names of colliders: those that were given, and else their kind and a number, which no object has; taken: theirs."""
    colliders = [one.collider for one in first.colliders]
    counts, names = dict[str, int](), list[str]()
    taken = {*taken, *(one.label for one in colliders)}
    for one in colliders:
        kind, name = one.name.lower(), one.label
        while not name or (name in taken and not one.label):
            count = counts.get(kind, 0)
            name, counts[kind] = f"{kind}_{count}", count + 1
        names.append(name)
    return names


def _bodies(first: Frame, taken: Collection[str]) -> list[Body]:
    colliders, names = [one.collider for one in first.colliders], collider_names(first, taken)
    tints = [one.colour or COLLIDER_GREY for one in colliders]
    if first.dim == 2:
        shapes: Sequence[tuple[NDArray, NDArray]] = [
            (in_3d(x), t) for x, t in (one.filled(ROUND_FACES) for one in colliders)
        ]
    else:
        all_ = Bodies.of(first, ROUND_FACES)
        shapes = []
        for k in range(len(colliders)):
            mine = np.flatnonzero(all_.owner == k)
            faces = all_.triangles[all_.owner[all_.triangles[:, 0]] == k]
            shapes.append((all_.vertices[mine], faces - (mine[0] if len(mine) else 0)))
    return [
        Body(name, *shape, _normals(one, *shape), tint)
        for name, one, shape, tint in zip(names, colliders, shapes, tints)
    ]


def _normals(one: Collider, vertices: Floats, triangles: NDArray) -> Floats:
    """Normals of a collider at its vertices; smooth ones of what is round."""
    own = one.form.normals(one, vertices) if len(one.half) == 3 else None
    return normals_of(vertices, triangles) if own is None else own


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """All parts of one frame in one list of v points: those of surfaces, loose balls, those of colliders. names count objects,
    and colliders after them."""

    names: list[str]
    points: Floats  # (v, 3) m
    velocity: Floats  # (v, 3) m/s; 0 on colliders
    normals: Floats  # (v, 3); 0 of loose balls
    colour: Floats  # (v, 3) sRGB in 0..1
    radius: Floats  # (v,) m; 0 but of loose balls
    number: NDArray[np.int32]  # (v,) of its object or collider
    ball: NDArray[np.int32]  # (v,) the ball that it is, or -1
    uv: Floats  # (v, 2); nan where there is none
    triangles: NDArray[np.int32]  # (t, 3) points, counter-clockwise from outside
    springs: NDArray[np.int32]  # (m, 2) points, between loose balls
    loose: NDArray[np.int32]  # (b,) points that are loose balls

    @classmethod
    def of(cls, parts: Parts, frame: Frame) -> "Together":
        """The parts of a frame, where they are."""
        x, v = in_3d(frame.position), in_3d(frame.velocity)
        rows: list[dict[str, Any]] = []
        triangles: list[NDArray] = []
        first = 0
        for one, faces in zip(parts.surfaces, parts.triangles(frame)):
            points = one.points(x)
            row: dict[str, Any] = {"points": points, "velocity": one.points(v), "normals": one.normals(points, faces)}
            row |= {"colour": one.colour, "number": one.object, "uv": np.nan if one.uv is None else one.uv}
            rows.append(row | {"ball": one.corners[:, 0] if one.embedded is None else -1})
            triangles.append(first + faces)
            first += len(points)
        loose, start = parts.loose, first
        row = {"points": x[loose], "velocity": v[loose], "colour": parts.colour[loose], "number": parts.number[loose]}
        rows.append(row | {"radius": parts.radius[loose], "ball": loose})
        first += len(loose)
        for k, (body, (centre, rotation)) in enumerate(zip(parts.bodies, placed(frame)), len(parts.names)):
            points, normals = body.vertices @ rotation.T + centre, body.normals @ rotation.T
            rows.append({"points": points, "normals": normals, "colour": np.array(body.colour), "number": k})
            triangles.append(first + body.triangles)
            first += len(points)
        pairs, _ = parts.springs(frame)
        lengths = [len(row["points"]) for row in rows]

        def column(name: str, *width: int, default: float = 0.0, kind: type = np.float64) -> NDArray:
            values = (np.broadcast_to(row.get(name, default), (n, *width)) for row, n in zip(rows, lengths))
            return np.concatenate(list(values)).astype(kind)

        return cls(
            [*parts.names, *(body.name for body in parts.bodies)],
            column("points", 3),
            column("velocity", 3),
            column("normals", 3),
            column("colour", 3),
            column("radius"),
            column("number", kind=np.int32),
            column("ball", default=-1, kind=np.int32),
            column("uv", 2, default=np.nan),
            np.concatenate([np.zeros((0, 3)), *triangles]).astype(np.int32),
            (start + np.searchsorted(loose, pairs)).astype(np.int32).reshape(-1, 2),
            np.arange(start, start + len(loose), dtype=np.int32),
        )
