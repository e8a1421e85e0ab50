"""Colliders as triangles: all of them for pictures in 3D, shapes of the user's own in 2D."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.render.smoothing import CREASE, Smoothing
from taichi_sim.scene.colliders import Collider

__all__ = ["Bodies", "filled"]

COLLIDER_GREY = (0.64, 0.66, 0.70)  # sRGB
FACES_AROUND = 96  # faces of a round shape about its axis; a quarter of it along each of its caps


class Bodies(NamedTuple):
    """The surfaces of all colliders of a frame, each in its own frame: vertices (v, 3) m, triangles (t, 3), and for each vertex
    the collider (v,), its sRGB colour (v, 3), for each triangle whether it shows from within only (t,)."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    owner: NDArray[np.int64]
    colour: NDArray[np.float64]
    hollow: NDArray[np.bool_]

    @classmethod
    def of(cls, frame: Frame, around: int = FACES_AROUND, crease: float = CREASE) -> "Bodies":
        """Surfaces of the colliders of a 3D frame. around: faces of a round one about its axis, a multiple of 4; crease:
        degrees between triangles of a mesh, from which their edge is sharp."""
        parts = [_surface(placed.collider, around, crease) for placed in frame.colliders]
        sizes = [len(vertices) for vertices, _ in parts]
        first = np.cumsum([0, *sizes])
        shapes = [placed.collider for placed in frame.colliders]
        return cls(
            np.concatenate([np.zeros((0, 3)), *(vertices for vertices, _ in parts)]),
            np.concatenate(
                [np.zeros((0, 3), dtype=np.int32), *(t + first[k] for k, (_, t) in enumerate(parts))]
            ).astype(np.int32),
            np.repeat(np.arange(len(parts)), sizes),
            np.repeat(np.array([c.colour or COLLIDER_GREY for c in shapes]).reshape(-1, 3), sizes, axis=0),
            np.repeat(np.array([c.hollow > 0 for c in shapes], dtype=bool), [len(t) for _, t in parts]),
        )

    def place(self, frame: Frame) -> NDArray[np.float64]:
        """The vertices (v, 3) [m] where the colliders of a frame are."""
        if not len(self.vertices):
            return self.vertices
        rotation = np.array([placed.rotation for placed in frame.colliders])[self.owner]
        centre = np.array([placed.centre for placed in frame.colliders])[self.owner]
        return np.einsum("vij,vj->vi", rotation, self.vertices) + centre

    def seen(self, placed: NDArray, eye: NDArray) -> NDArray[np.int32]:
        """The triangles with those of hollow colliders that face the eye shrunk to nothing: one looks into the room."""
        if not self.hollow.any():
            return self.triangles
        a, b, c = (placed[self.triangles[:, k]] for k in range(3))
        facing = np.einsum("ti,ti->t", np.cross(b - a, c - a), eye - a) > 0
        return np.where((self.hollow & facing)[:, None], self.triangles[:, :1], self.triangles)


def filled(frame: Frame) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners (t, 3, 2) [m] of the triangles that fill colliders of a 2D frame other than rounded boxes, and whose they are."""
    custom = [(k, placed) for k, placed in enumerate(frame.colliders) if not placed.collider.form.is_rounded_box]
    corners = []
    for _, placed in custom:
        vertices, triangles = placed.collider.filled(FACES_AROUND)
        corners.append(vertices[triangles] @ placed.rotation.T + placed.centre)
    owner = np.repeat(np.array([k for k, _ in custom], dtype=np.int64), [len(part) for part in corners])
    return np.concatenate([np.zeros((0, 3, 2)), *corners]), owner


def _surface(collider: Collider, around: int, crease: float) -> tuple[NDArray, NDArray]:
    """Vertices and triangles; one vertex for each smooth part of the surface that meets there."""
    if collider.is_meshed:
        split = Smoothing.of(collider.vertices, collider.triangles, crease).normal_of
        first = np.unique(split, return_index=True)[1]
        return collider.vertices[collider.triangles.ravel()[first]], split
    return collider.surface(around)
