"""Forms: what a kind of collider is in its local frame, in NumPy: distances, surfaces and outlines. A class for each kind names
the Taichi function in kernels/contacts/colliders.py that has the same distances."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.mesh import Surface, area_distance, mesh_distance

__all__ = ["Drawn", "Floats", "Form", "Meshed"]

Floats = NDArray[np.float64]


class Form:
    """Geometry of a kind of collider `one`, a scene.colliders.Collider, in its local frame. All of it lies within `radius` [m] of
    the box |x| <= half [m], two numbers of each."""

    measured_by = ""  # name of the Taichi function of its distances
    is_rounded_box = False  # it is all that lies so near to that box: pictures in 2D paint it by that
    has_faces = False  # balls in a hollow one meet each of its 2 dim faces by itself

    @staticmethod
    def distances(one: Any, p: Floats) -> Floats:
        """Signed distances (n,) [m] of points (n, dim) [m] from its surface, as if it were not hollow."""
        raise NotImplementedError

    @staticmethod
    def triangulated(one: Any, around: int) -> tuple[Floats, NDArray[np.int32]]:
        """See Collider.surface."""
        raise NotImplementedError

    @staticmethod
    def normals(one: Any, x: Floats) -> Floats | None:
        """Normals (v, 3) of its surface at vertices of `triangulated` (v, 3) [m]; None: those of the triangles do."""
        return None

    @staticmethod
    def outline(one: Any, wider: float, around: int) -> Floats:
        """Its outline (r, 2) [m] in 2D, convex and counter-clockwise, `wider` [m] further out all around."""
        raise NotImplementedError

    @staticmethod
    def width(one: Any) -> tuple[float, bool] | None:
        """Half its width [m] where it is narrowest, and whether it is flat there, and not round; None: its triangles tell."""
        return None

    @staticmethod
    def roundness(one: Any) -> float:
        """Radius [m] of what has no edges; 0 of all else."""
        return 0.0

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


class Meshed(Form):
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


class Drawn(Meshed):
    """A shape of the user's own, which its distance function measures, drawn as triangles."""
