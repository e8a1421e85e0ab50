"""Colliders as triangles: all of them for pictures in 3D, shapes of the user's own in 2D."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.render.smoothing import CREASE, Smoothing
from taichi_sim.scene.colliders import BOX, CUSTOM, Collider

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
    """Corners (t, 3, 2) [m] of the triangles that fill the custom colliders of a 2D frame, and the collider of each (t,)."""
    custom = [(k, placed) for k, placed in enumerate(frame.colliders) if placed.collider.kind == CUSTOM]
    corners = [p.collider.vertices[p.collider.triangles] @ p.rotation.T + p.centre for _, p in custom]
    owner = np.repeat(np.array([k for k, _ in custom], dtype=np.int64), [len(part) for part in corners])
    return np.concatenate([np.zeros((0, 3, 2)), *corners]), owner


def _surface(collider: Collider, around: int, crease: float) -> tuple[NDArray, NDArray]:
    """Vertices and triangles; one vertex for each smooth part of the surface that meets there."""
    if collider.is_meshed:
        split = Smoothing.of(collider.vertices, collider.triangles, crease).normal_of
        first = np.unique(split, return_index=True)[1]
        return collider.vertices[collider.triangles.ravel()[first]], split
    if collider.kind == BOX:
        signs = np.array([[(k >> a & 1) * 2 - 1 for a in range(3)] for k in range(8)])
        faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
        corners = np.array(faces).ravel()
        quads = np.arange(24).reshape(6, 4)
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        return signs[corners] * collider.half, triangles
    per_cap = around // 4
    second = 0 if collider.half[0] > 0 else 1  # of the rings at 90 degrees, which a sphere has one of
    rings = np.concatenate([np.linspace(0, 90, per_cap + 1), np.linspace(90, 180, per_cap + 1)[second:]])
    angle = np.radians(rings)[:, None]
    about = np.linspace(0, 2 * np.pi, around, endpoint=False)[None]
    x = np.where(np.arange(len(rings)) > per_cap, -1.0, 1.0)  # the second ring at 90 degrees lies at the other end
    middle = np.broadcast_to((x * collider.half[0])[:, None], (len(rings), around))
    r = collider.radius
    points = np.stack(
        [
            middle + r * np.cos(angle) * np.ones_like(about),
            r * np.sin(angle) * np.cos(about),
            r * np.sin(angle) * np.sin(about),
        ],
        axis=-1,
    )
    row, column = np.meshgrid(np.arange(len(rings) - 1), np.arange(around), indexing="ij")
    a, b = row * around + column, row * around + (column + 1) % around
    a_next, b_next = a + around, b + around
    sides = ((a, a_next, b), (b, a_next, b_next))
    triangles = np.concatenate([np.stack(side, -1).reshape(-1, 3) for side in sides])
    return points.reshape(-1, 3), triangles
