"""Forms of colliders in NumPy: distances, surfaces and outlines, a class for each kind. The same distances in Taichi, and the
numbers of the kinds, are in kernels/contacts/colliders.py."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.mesh import Surface, area_distance, mesh_distance

__all__ = ["BOX", "CUSTOM", "FORMS", "MESH", "ROUND", "Form"]

Floats = NDArray[np.float64]
ROUND, BOX, MESH, CUSTOM = "round", "box", "mesh", "custom"


class Form:
    """Geometry of one kind of collider `one`, a scene.colliders.Collider, in its local frame."""

    @staticmethod
    def distances(one: Any, p: Floats) -> Floats:
        """Signed distances (n,) [m] of points (n, dim) [m] from its surface, as if it were not hollow."""
        raise NotImplementedError

    @staticmethod
    def triangulated(one: Any, around: int) -> tuple[Floats, NDArray[np.int32]]:
        """See Collider.surface."""
        raise NotImplementedError

    @staticmethod
    def outline(one: Any, wider: float, around: int) -> Floats:
        """Its outline (r, 2) [m] in 2D, convex and counter-clockwise, `wider` [m] further out all around."""
        raise NotImplementedError

    @classmethod
    def filled(cls, one: Any, around: int) -> tuple[Floats, NDArray[np.int32]]:
        """See Collider.filled."""
        rim = cls.outline(one, 0.0, around)
        here = np.arange(len(rim))
        if one.hollow == 0.0:
            inner = here[1:-1]
            return rim, np.stack([0 * inner, inner, inner + 1], axis=1).astype(np.int32)
        after, out = np.roll(here, -1), here + len(rim)
        ring = [np.stack([here, out, after], axis=1), np.stack([after, out, after + len(rim)], axis=1)]
        return np.concatenate([rim, cls.outline(one, one.hollow, around)]), np.concatenate(ring).astype(np.int32)


class _Meshed(Form):
    """Triangles."""

    @classmethod
    def filled(cls, one: Any, around: int) -> tuple[Floats, NDArray[np.int32]]:
        return one.vertices, one.triangles

    @staticmethod
    def distances(one: Any, p: Floats) -> Floats:
        measure = mesh_distance if p.shape[1] == 3 else area_distance
        return measure(Surface(one.vertices, one.triangles), p)

    @staticmethod
    def triangulated(one: Any, around: int) -> tuple[Floats, NDArray[np.int32]]:
        return one.vertices, one.triangles


class _Round(Form):
    """All points within a radius of a stretch of the x axis."""

    @staticmethod
    def distances(one: Any, p: Floats) -> Floats:
        return np.linalg.norm(p - np.clip(p, -one.half, one.half), axis=1) - one.radius

    @staticmethod
    def triangulated(one: Any, around: int) -> tuple[Floats, NDArray[np.int32]]:
        per_cap = around // 4
        second = 0 if one.half[0] > 0 else 1  # of the rings at 90 degrees, which a sphere has one of
        rings = np.concatenate([np.linspace(0, 90, per_cap + 1), np.linspace(90, 180, per_cap + 1)[second:]])
        angle = np.radians(rings)[:, None]
        about = np.linspace(0, 2 * np.pi, around, endpoint=False)[None]
        x = np.where(np.arange(len(rings)) > per_cap, -1.0, 1.0)  # the second ring at 90 degrees lies at the other end
        middle = np.broadcast_to((x * one.half[0])[:, None], (len(rings), around))
        r = one.radius
        axes = middle + r * np.cos(angle) * np.ones_like(about), r * np.sin(angle) * np.cos(about)
        points = np.stack([*axes, r * np.sin(angle) * np.sin(about)], axis=-1)
        row, column = np.meshgrid(np.arange(len(rings) - 1), np.arange(around), indexing="ij")
        a, b = row * around + column, row * around + (column + 1) % around
        a_next, b_next = a + around, b + around
        sides = ((a, a_next, b), (b, a_next, b_next))
        triangles = np.concatenate([np.stack(side, -1).reshape(-1, 3) for side in sides])
        return points.reshape(-1, 3), triangles.astype(np.int32)

    @staticmethod
    def outline(one: Any, wider: float, around: int) -> Floats:
        angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, around + 1)
        right = one.half + (one.radius + wider) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.concatenate([right, -right])


class _Cuboid(Form):
    """|x| <= half."""

    @staticmethod
    def distances(one: Any, p: Floats) -> Floats:
        q = np.abs(p) - one.half
        return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)

    @staticmethod
    def triangulated(one: Any, around: int) -> tuple[Floats, NDArray[np.int32]]:
        signs = np.array([[(k >> a & 1) * 2 - 1 for a in range(3)] for k in range(8)])
        faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
        quads = np.arange(24).reshape(6, 4)
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        return signs[np.array(faces).ravel()] * one.half, triangles.astype(np.int32)

    @staticmethod
    def outline(one: Any, wider: float, around: int) -> Floats:
        return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (one.half + wider)


FORMS: dict[str, type[Form]] = {ROUND: _Round, BOX: _Cuboid, MESH: _Meshed, CUSTOM: _Meshed}
