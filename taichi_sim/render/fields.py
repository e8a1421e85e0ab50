"""Buffers: the fields of what a 3D scene is drawn from. It frees its memory on close()."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.device import backend
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.render import raster, triangles, vertex_binding
from taichi_sim.render.content import Content
from taichi_sim.render.palette import to_linear
from taichi_sim.render.smoothing import Smoothing
from taichi_sim.render.styles import Styles

__all__ = ["Buffers", "padded"]


class Buffers:
    """Balls, rods and triangles in scene units. `has_*`: what there is of; kernels compile only for that.

    After the balls come the vertices of surfaces and those of colliders, as balls without a radius; the triangles of colliders
    follow all others.
    """

    def __init__(self, content: Content) -> None:
        self.capacity = _sizes(content)
        n, m, t = self.capacity[:3]
        self.has_spheres = bool(np.any(content.radius > 0))
        self.has_rods, self.has_triangles, self.has_bound = m > 0, t > 0, len(content.binding) > 0
        self.has_light_inside = False
        self._fields = fields = Fields(ti.f32, backend.has_wide_numbers())
        # ball: place and radius, 0 where none is drawn; colour: linear
        self.ball, self.colour = fields.vectors(n, 4), fields.vectors(n, 3)
        if self.has_rods:
            self.rod, self.rod_radius, self.rod_strain = fields.cells(m, 2), fields.reals(m), fields.reals(m)
        if self.has_triangles:
            # corner: the vertices of a triangle; normal_of: the normals there; part: number of its smooth part of a surface
            self.corner, self.normal_of, self.part = fields.cells(t, 3), fields.cells(t, 3), fields.integers(t)
            assert content.styles is not None  # in 3D
            self.is_patterned, self.is_see_through = content.styles.are_patterned, content.styles.are_see_through
            self.has_light_inside = content.styles.have_light_inside
            self.style_of, self.style = fields.integers(t), fields.vectors(*content.styles.rows.shape)
            # place of each corner in its pattern, of which 0 to 1 is a period
            self.place = fields.vectors(3 * t if self.is_patterned else 1, 3)
            # colours of textures, row after row from the top, each followed by its smaller sizes
            self.texel = fields.vectors(len(content.styles.texel), 3)
            self.incident = fields.integers(3 * t)
            self.start, self.normal = fields.integers(3 * t + 1), fields.vectors(3 * t, 3)
            self.has_evened = _has_evened(content)
            room = 3 * t if self.has_evened else 1
            self.evened = fields.table({"of": ti.i32, "mean": ti.types.vector(3, ti.f32)}, room)
        if self.has_bound:
            entries = content.binding.weights.nnz
            self.bound_start = fields.integers(len(content.binding) + 1)
            self.bound_entry, self.bound_weight = fields.integers(entries), fields.reals(entries)
        fields.build()
        self.ball.fill(0.0)  # a tree that is destroyed before any kernel ran leaves Taichi with dangling fields
        self._upload = np.zeros((max(n, 1), 4), dtype=np.float32)
        self.vertices, self.rods, self.triangles = n, m, t
        self.balls, self.bound = len(content.radius), len(content.binding)
        self.squares = 0.0  # sum of squared radii
        self._radius = np.zeros(self.balls, dtype=np.float32)

    def holds(self, content: Content) -> bool:
        """True if this content fits and draws the kinds of things that the buffers are for."""
        sizes = _sizes(content)
        fits = all(0 < now <= capacity or now == capacity for now, capacity in zip(sizes[1:3], self.capacity[1:3]))
        same = (sizes[0], *sizes[3:]) == (self.capacity[0], *self.capacity[3:])
        kinds = self.has_spheres == bool(np.any(content.radius > 0))
        return fits and same and kinds and (not self.has_triangles or self.has_evened == _has_evened(content))

    def load(self, content: Content, colour: NDArray, unit: float) -> None:
        """Take over what does not change from frame to frame; colour linear."""
        n = self.vertices
        _, self.rods, self.triangles = _sizes(content)[:3]  # fewer than there is capacity for, where springs tore
        self.bodies = content.bodies
        if n == 0:
            return
        if self.bodies is not None:
            colour = np.concatenate([colour, to_linear(self.bodies.colour)])
        self.colour.from_numpy(colour.astype(np.float32))
        self._radius = (content.radius / unit).astype(np.float32)
        self.squares = float(np.square(self._radius, dtype=np.float64).sum())
        if self.has_rods:
            self.rod.from_numpy(padded(content.rod_ends, self.capacity[1]))
            self.rod_radius.from_numpy(padded((content.rod_radius / unit).astype(np.float32), self.capacity[1]))
        if self.has_triangles:
            self._corners = content.triangles
            if self.bodies is not None:
                first = self.balls + self.bound
                self._corners = np.concatenate([content.triangles, self.bodies.triangles + first]).astype(np.int32)
            self.corner.from_numpy(padded(self._corners, self.capacity[2]))
            assert content.smoothing is not None  # in 3D
            assert content.styles is not None
            self._load_smoothing(content.smoothing)
            self._load_styles(content.styles)
        if self.has_bound:
            self.bound_start.from_numpy(content.binding.weights.indptr.astype(np.int32))
            self.bound_entry.from_numpy(content.binding.weights.indices.astype(np.int32))
            self.bound_weight.from_numpy(content.binding.weights.data.astype(np.float32))

    def _load_smoothing(self, smoothing: Smoothing) -> None:
        t = self.capacity[2]
        normal_of, self.normals = smoothing.normal_of.ravel(), smoothing.normals
        start = np.zeros(3 * t + 1, dtype=np.int32)
        start[1 : self.normals + 1] = np.cumsum(np.bincount(normal_of, minlength=self.normals))
        self.start.from_numpy(start)
        order = np.argsort(normal_of, kind="stable")
        self.incident.from_numpy(padded((order // 3).astype(np.int32), 3 * t))
        self.normal_of.from_numpy(padded(smoothing.normal_of, t))
        self.part.from_numpy(padded(smoothing.part, t))
        if self.has_evened:
            self.evened.of.from_numpy(padded(smoothing.evened + 1, 3 * t) - 1)

    def _load_styles(self, styles: Styles) -> None:
        self.style.from_numpy(styles.rows)
        self.style_of.from_numpy(padded(styles.of_triangle, self.capacity[2]))
        if self.is_patterned:
            self.place.from_numpy(padded(styles.place, 3 * self.capacity[2]))
        if len(styles.texel):
            self.texel.from_numpy(styles.texel)

    def move(self, frame: Frame, origin: NDArray, unit: float, strain: NDArray | None, eye: NDArray) -> None:
        """Take over positions (m) and strains; eye (m)."""
        if self.vertices == 0:
            return
        n = self.balls + self.bound
        np.subtract(frame.position, origin, out=self._upload[: self.balls, :3], casting="same_kind")
        if self.bodies is not None and len(self.bodies.vertices):
            placed = self.bodies.place(frame)
            self._upload[n : self.vertices, :3] = placed - origin
            if self.bodies.hollow.any():
                self._corners[len(self._corners) - len(self.bodies.triangles) :] = self.bodies.seen(placed, eye) + n
                self.corner.from_numpy(padded(self._corners, self.capacity[2]))
        self._upload[:, :3] *= 1.0 / unit
        self._upload[: self.balls, 3] = self._radius
        self._send()
        if self.has_rods and strain is not None:
            self.rod_strain.from_numpy(padded(strain.astype(np.float32), self.capacity[1]))

    def paint(self, values: NDArray, table: NDArray[np.float32]) -> None:
        """Colour balls and the surfaces on them by values (n,) from 0 to 1 along a table of linear colours (k, 3)."""
        value = np.zeros(max(self.balls, 1), dtype=np.float32)
        value[: self.balls] = values
        vertex_binding.paint_balls(value, table, self.colour, self.balls)
        if self.has_bound:
            start, entry, weight = self.bound_start, self.bound_entry, self.bound_weight
            vertex_binding.paint_bound(value, table, self.colour, start, entry, weight, self.balls, self.bound)

    def thin_out(self, view: NDArray, area: float) -> None:
        """Leave out the farthest spheres of a view beyond a total area (px) of all discs: buried layers deep."""
        points = self._upload[: self.balls]
        depth = points[:, :3] @ view[2, :3] + view[2, 3]
        scale = view[3, 0] / np.maximum(depth, raster.NEAR_PLANE)
        order = np.argsort(depth - points[:, 3], kind="stable")
        covered = np.minimum(np.pi * (points[order, 3] * scale[order]) ** 2, 4 * view[3, 1] * view[3, 2])
        points[order[np.cumsum(covered) > area], 3] = 0.0
        self._send()

    def _send(self) -> None:
        """Balls to the device, and the vertices of surfaces after them."""
        self.ball.from_numpy(self._upload)
        if self.has_bound:
            vertex_binding.bind(
                self.ball, self.bound_start, self.bound_entry, self.bound_weight, self.balls, self.bound
            )

    def find_normals(self) -> None:
        triangles.find_normals(self.ball, self.corner, self.start, self.incident, self.normal, self.normals)
        if self.has_evened:
            corners = self.normal_of, self.start, self.incident
            triangles.even_normals(*corners, self.normal, self.evened)

    def close(self) -> None:
        self._fields.free()


def _sizes(content: Content) -> tuple[int, ...]:
    """Vertices (balls, those of surfaces and of colliders), rods, triangles; balls, and entries of surfaces."""
    bodies, binding = content.bodies, content.binding
    more = (0, 0) if bodies is None else (len(bodies.vertices), len(bodies.triangles))
    n = len(content.radius)
    return n + len(binding) + more[0], len(content.rods), len(content.triangles) + more[1], n, binding.weights.nnz


def _has_evened(content: Content) -> bool:
    return content.smoothing is not None and len(content.smoothing.evened) > 0


def padded(values: NDArray, rows: int) -> NDArray:
    """The values and zeros after them, so many rows in all."""
    if len(values) == rows:
        return values
    return np.concatenate([values, np.zeros((rows - len(values), *values.shape[1:]), dtype=values.dtype)])
