"""Shapes of colliders by a formula: what each is called and takes, and beside it its form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.spelling import takes_centre, takes_color
from taichi_sim.scene.collider_forms import Floats, Form
from taichi_sim.scene.mesh_colliders import ColliderShape, Mesh
from taichi_sim.scene.motion import turn_matrix
from taichi_sim.scene.placed import Checked, Placed

__all__ = ["SHAPES", "Box", "Capsule", "Sphere"]


class Round(Form):
    """All points within a radius of a stretch of the x axis."""

    measured_by = "round_distance"
    is_rounded_box = True

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
    def normals(one: Any, x: Floats) -> Floats:
        return (x - np.clip(x, -one.half, one.half)) / one.radius

    @staticmethod
    def width(one: Any) -> tuple[float, bool]:
        return one.radius, False

    @staticmethod
    def roundness(one: Any) -> float:
        return float(one.radius)

    @staticmethod
    def outline(one: Any, wider: float, around: int) -> Floats:
        angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, around + 1)
        right = one.half + (one.radius + wider) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.concatenate([right, -right])


@dataclass(frozen=True)
class Sphere(Placed):
    """A solid sphere, in 2D a disc.

    Args:
        center: (dim,) of the sphere [m]; radius: of the sphere [m].
        hollow: thickness of a shell around the radius, inside which balls stay [m]; 0: it is solid.
    """

    center: ArrayLike
    radius: float
    hollow: float = 0.0

    def _checked(self, dim: int, where: str) -> Checked:
        hollow, radius = self._number(where, "hollow", low=0), self._number(where, "radius", positive=True)
        return Checked(Round, self._vector(where, "center", dim), np.zeros(dim), radius, hollow)


@dataclass(frozen=True)
class Capsule(Placed):
    """All points within a radius of a line.

    Args:
        start, end: (dim,) of the line [m]; radius: around it [m].
        hollow: thickness of a shell around it, inside which balls stay [m]; 0: it is solid.
    """

    start: ArrayLike
    end: ArrayLike
    radius: float
    hollow: float = 0.0

    def _checked(self, dim: int, where: str) -> Checked:
        hollow, radius = self._number(where, "hollow", low=0), self._number(where, "radius", positive=True)
        start, end = self._vector(where, "start", dim), self._vector(where, "end", dim)
        length = float(np.linalg.norm(end - start))
        if length == 0.0:
            raise SceneError(f"{where}.end", end, "another point than start (or take a Sphere)")
        half = np.zeros(dim)
        half[0] = 0.5 * length
        return Checked(Round, 0.5 * (start + end), half, radius, hollow, _onto((end - start) / length))


class Cuboid(Form):
    """|x| <= half."""

    measured_by = "box_distance"
    is_rounded_box = has_faces = True

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
    def width(one: Any) -> tuple[float, bool]:
        return float(one.half.min()), True

    @staticmethod
    def outline(one: Any, wider: float, around: int) -> Floats:
        return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (one.half + wider)


@dataclass(frozen=True)
class Box(Placed):
    """A solid box.

    Args:
        center: (dim,) of the box [m]; size: (dim,) from side to side [m].
        hollow: thickness of a shell around it, whose inside is of the given size [m]; 0: it is solid.
    """

    center: ArrayLike
    size: ArrayLike
    hollow: float = 0.0

    def _checked(self, dim: int, where: str) -> Checked:
        hollow, centre = self._number(where, "hollow", low=0), self._vector(where, "center", dim)
        size = validation.per_item(f"{where}.size", self._vector(where, "size", dim), dim, positive=True)
        return Checked(Cuboid, centre, 0.5 * size, hollow=hollow)


def _onto(axis: Floats) -> Floats:
    """A rotation (dim, dim) that takes the x axis to a unit vector."""
    if len(axis) == 2:
        return np.array([[axis[0], -axis[1]], [axis[1], axis[0]]])
    across = np.cross([1.0, 0.0, 0.0], axis)
    sine = float(np.linalg.norm(across))
    if sine < 1e-12:
        return np.eye(3) if axis[0] > 0 else np.diag([-1.0, -1.0, 1.0])
    return turn_matrix((across / sine * np.arctan2(sine, axis[0]))[None])[0]


SHAPES: dict[str, type[Placed]] = {"sphere": Sphere, "box": Box, "capsule": Capsule, "mesh": Mesh}
for _kind in (*SHAPES.values(), ColliderShape):
    _kind.__init__ = takes_color(takes_centre(_kind.__init__))  # type: ignore[misc]
