"""Colliders whose surface is triangles: meshes, and shapes of the user's own as they are drawn."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.quantities import counted
from taichi_sim.geometry.mesh import Surface, given_surface, holes, volume
from taichi_sim.scene.collider_forms import Drawn, Meshed
from taichi_sim.scene.placed import Checked, Placed

__all__ = ["ColliderShape", "Mesh"]

FLATTEST = 1e-9  # of the cube around a mesh: what encloses less is a sheet
MOST_CELLS = 512  # of a mesh's grid along its longest side


@dataclass(frozen=True)
class Mesh(Placed):
    """A closed triangle mesh in 3D, solid inside.

    Args:
        mesh: an OBJ, PLY, STL or GLB file, or (vertices (v, 3) [m], triangles (t, 3)).
        position: (3,) where its origin goes [m]; scale: its size in relation to the file's [1].
        up: axis of the mesh that points up, "y" or "z"; y by default, with a warning for STL and PLY files, which do not tell.
        resolution: cells along the longest side of the grid on which distances are kept. Where the grid is too coarse, at edges
            and thin walls, distances are taken from the triangles.
    """

    mesh: str | PathLike[str] | tuple[Any, Any]
    position: Any = None
    scale: float = 1.0
    resolution: int = 64
    up: Literal["y", "z"] | None = None

    def _checked(self, dim: int, where: str) -> Checked:
        surface = _surface(self, dim, where)
        resolution = validation.whole(f"{where}.resolution", self.resolution, 4, MOST_CELLS)
        centre = np.zeros(3) if self.position is None else self._vector(where, "position", 3)
        return Checked(Meshed, centre, np.zeros(dim), surface=surface, resolution=resolution)


@dataclass(frozen=True)
class ColliderShape(Placed):
    """Base of user-defined collider shapes.

    center (dim,) [m]: where the origin of its own frame is. It has

    `distance(p)`: a Taichi function, the signed distance [m] of the point p (dim,) [m] of its own frame from its surface,
    negative inside; true within a ball's radius, and nowhere more than that, for balls on their way are led by it.
    `surface()`: vertices (v, dim) [m] and triangles (t, 3), to draw it and to see that no ball starts inside: in 3D its closed
    surface, in 2D triangles that fill it. They reach as far as the shape does.

    A cone, upright, with its center in the middle of its base:

        @ti.data_oriented
        class Cone(ts.ColliderShape):
            def __init__(self, center, radius, height, **placed):
                super().__init__(center, **placed)
                self.radius, self.height = radius, height

            @ti.func
            def distance(self, p):
                r, h, out = self.radius, self.height, ti.sqrt(p[0] ** 2 + p[2] ** 2)
                up = ti.math.clamp(((r - out) * r + p[1] * h) / (r * r + h * h), 0.0, 1.0)  # nearest on its side, from the rim
                side, base = ti.Vector([out - r * (1.0 - up), p[1] - h * up]), ti.Vector([ti.max(out - r, 0.0), p[1]])
                inside = p[1] > 0.0 and (out - r) * h + p[1] * r < 0.0
                return ti.select(inside, -1.0, 1.0) * ti.min(side.norm(), base.norm())

            def surface(self):
                k, angle = np.arange(48), np.linspace(0, 2 * np.pi, 48, endpoint=False)
                rim = self.radius * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
                base, side = ([k, np.roll(k, -1), 48 + 0 * k], [np.roll(k, -1), k, 49 + 0 * k])
                vertices = np.concatenate([rim, [[0, 0, 0], [0, self.height, 0]]])
                return vertices, np.concatenate([np.stack(base, axis=1), np.stack(side, axis=1)])

        scene.add_collider(Cone((0, 0, 0), radius=1.0, height=0.5))

    A file holds what `saved_as` returns.
    """

    center: ArrayLike

    def surface(self) -> tuple[ArrayLike, ArrayLike]:
        """Vertices (v, dim) [m] and triangles (t, 3) in its own frame."""
        raise NotImplementedError

    def saved_as(self) -> Any:
        """The Sphere, Box, Capsule or Mesh that a file holds in its place; None: it cannot be saved."""
        return None

    def _checked(self, dim: int, where: str) -> Checked:
        surface = _drawn(self, dim, where)
        return Checked(Drawn, self._vector(where, "center", dim), np.zeros(dim), surface=surface)


def _surface(shape: Mesh, dim: int, where: str) -> Surface:
    """The triangles of a mesh collider, scaled, closed and facing outward."""
    if dim != 3:
        raise SceneError(where, says="a mesh needs a scene in 3D")
    scale = validation.number(f"{where}.scale", shape.scale, positive=True)
    name = repr(str(shape.mesh)) if isinstance(shape.mesh, (str, PathLike)) else "the mesh"
    surface = given_surface(where, shape.mesh, shape.up)
    surface = _closed(surface, f"{where}.mesh", name)
    return Surface(surface.vertices * scale, surface.triangles)


def _closed(surface: Surface, where: str, name: str) -> Surface:
    """A surface that encloses something, facing outward."""
    open_edges = holes(surface.triangles)
    if len(open_edges) or not len(surface.triangles):
        at = ""
        if len(open_edges):
            at = f"; the first lies at {(surface.vertices[open_edges[0]].mean(axis=0)).round(6).tolist()}"
        edges = counted(len(open_edges), "edge does", "edges do")
        raise SceneError(
            where,
            says=f"{name} is not closed: {edges} not lie between exactly two triangles that"
            f" face the same way{at}; a collider needs an inside",
        )
    inside = volume(surface)
    if abs(inside) <= FLATTEST * float(np.max(np.ptp(surface.vertices, axis=0))) ** 3:
        raise SceneError(where, says=f"{name} is flat: it encloses {inside:.2g} m^3; a collider needs an inside")
    triangles = surface.triangles[:, ::-1] if inside < 0.0 else surface.triangles
    return Surface(surface.vertices, np.ascontiguousarray(triangles))


def _drawn(shape: ColliderShape, dim: int, where: str) -> Surface:
    """Surface that the renderer shows of a shape of the user's own. Checks it, and its distance function; raises SceneError."""
    name = type(shape).__name__
    validation.taichi_function(where, shape, "distance", "p")
    if type(shape).surface is ColliderShape.surface:
        raise SceneError(where, says=f"{name} needs a function surface(self) that returns (vertices, triangles)")
    where, drawn = f"{where}.surface()", shape.surface()
    if not isinstance(drawn, (tuple, list)) or len(drawn) != 2:
        raise SceneError(where, drawn, "a pair (vertices, triangles)")
    vertices, triangles = drawn
    points = validation.vectors(f"{where}.vertices", vertices, None, dim)
    corners = validation.indices(f"{where}.triangles", triangles, len(points), 3, "vertex")
    if dim == 3:
        return _closed(Surface(points, corners), where, "what it draws")
    if not len(corners):
        raise SceneError(where, says="there are no triangles; they fill the shape")
    return Surface(points, corners)
