"""Pictures of 3D frames: balls, rods and triangles with light and shadow, drawn by Taichi kernels alone."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.kernels.render import occlusion, raster, shading_pass, shadow, shadow_lattice, triangles
from taichi_sim.render.camera import (
    Bounds,
    Camera,
    embedded_vertices,
    ground_planes,
    near_boxes,
    robust_bounds,
    view_matrix,
)
from taichi_sim.render.canvas import Canvas, Planes, matrix_of, vector_of
from taichi_sim.render.colouring import Colouring
from taichi_sim.render.content import Content
from taichi_sim.render.fields import Buffers
from taichi_sim.render.palette import background_colours, to_linear
from taichi_sim.render.smoothing import CREASE
from taichi_sim.render.stages import DAY, Stage
from taichi_sim.render.tracker import Tracker
from taichi_sim.scene.looks import Look

__all__ = ["Renderer3D"]

PINNED_COLOUR = (0.24, 0.25, 0.28)
MANY_PRIMITIVES = 150_000  # primitives: from here one sample per pixel and a smoothing pass instead of four samples
MOST_TESTS = 1.5e8  # ray tests of spheres in one picture

IN_SIGHT = 0.4  # of the camera's distance from its target: colliders so near to the balls have shadows


class Renderer3D:
    """Renderer of 3D frames, see `Renderer`. Inside, lengths are in units of the scene's size about its centre: f32
    suffices."""

    camera: Camera

    def __init__(
        self,
        frame: Frame,
        size: tuple[int, int],
        background: Any = None,
        ambient_occlusion: bool = True,
        shadow: bool = True,
        camera: Any = None,
        transparent: bool = False,
        colouring: Colouring | None = None,
        subdivide: int = 0,
        crease: float = CREASE,
        stage: Stage = DAY,
        looks: Sequence[Look] = (),
        shadow_catcher: bool = False,
    ) -> None:
        self.size, self._shadow_catcher = size, shadow_catcher
        self._transparent, self._colouring, self._subdivide = transparent, colouring, subdivide
        self._stage, self._looks = stage, looks
        self._crease, self._rest = crease, frame.position.copy()
        self._table = Colouring.table()
        self._tracker: Tracker | None = Tracker(frame, camera, size[0] / size[1])
        self._aim_from(self._tracker.first)
        self._bounds = self._extent(frame, np.inf)
        self._origin, self._unit = np.asarray(self._bounds.centre), self._bounds.size
        self._ambient_occlusion, self._shadow = ambient_occlusion, shadow
        self._zenith, self._horizon = background_colours(background, stage.zenith, stage.horizon)
        self._glow = float(background is None)
        self._spacing = _nice(self._bounds.size / 6)
        self._content: Any = None
        self.buffers: Any = None
        self._canvas: Any = None
        self._prepare(frame)

    def render(self, frame: Frame, coarse: int = 1, aside: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.uint8]:
        """The picture of a frame, (height, width, 3 or 4) / coarse, sRGB, row 0 at the top. aside [m]: so far to the right of
        the camera and above it, towards the same target."""
        self._prepare(frame)
        self._aim(frame)
        standing = self.camera
        self.camera = standing.aside(*aside)
        try:
            return self._drawn(frame, coarse)
        finally:
            self.camera = standing

    def _drawn(self, frame: Frame, coarse: int) -> NDArray[np.uint8]:
        rods, strain = self._content.rods, None
        if len(rods) and len(frame.strain) == len(frame.springs):
            strain = frame.strain[rods]
        self.buffers.move(frame, self._origin, self._unit, strain, np.asarray(self.camera.eye))
        if self._colouring is not None:
            self.buffers.paint(self._colouring.values(frame), self._table)
        width, height = (max(1, side // coarse) for side in self.size)
        view = self._view(width, height)
        self._spare(view)
        eye = (np.asarray(self.camera.eye) - self._origin) / self._unit
        planes = self._planes(frame, eye, view)
        if self.buffers.has_triangles:
            self.buffers.find_normals()
        light = self._cast_shadows(frame) if self._shadow else None
        canvas = self._canvas
        canvas.seen.clear(width, height)
        for _ in canvas.seen.stages():
            self._draw(canvas.seen, canvas.samples, view, width, height, True)
        scene, look = canvas.scene(self.buffers), self._look_matrix()
        canvas.fit_backdrop(scene, (width, height), view, light, planes, eye, look)
        camera = matrix_of(view), vector_of(eye)
        ground = matrix_of(planes.normals), matrix_of(planes.on_screen), planes.number
        lamp = camera[0] if light is None else matrix_of(light)
        last = (camera[1], matrix_of(look), width, height)
        if self._shadow or self._ambient_occlusion:
            shadow_lattice.sample(scene, canvas.seen, camera[0], lamp, *ground[:2], *last)
        if self._ambient_occlusion:
            occlusion.occlude(scene, canvas.seen, camera[0], ground[2], width, height)
        shading_pass.find_busy(scene, canvas.seen, width, height)
        shading_pass.resolve(scene, canvas.seen, camera[0], lamp, *ground, *last)
        return np.asarray(canvas.finish(width, height))

    def fit(self, frames: Sequence[Frame]) -> None:
        """See `Renderer`."""
        if self._tracker is not None:
            self._tracker.fit(frames)
            self._aim_from(self._tracker.first)
            now = [self._bounds, *(self._extent(frame, self._sight) for frame in frames)]
            self._bounds = Bounds(np.min([one.low for one in now], axis=0), np.max([one.high for one in now], axis=0))

    def _aim_from(self, camera: Camera) -> None:
        """Begin with a camera, whose lights stay when it moves."""
        self.camera = camera
        self._lamp, self._fill = (_around(camera, *at) for at in (self._stage.lamp_angle, self._stage.fill_angle))

    def _planes(self, frame: Frame, eye: NDArray, view: NDArray) -> Planes:
        """The walls that the eye is above."""
        planes = ground_planes(frame)
        planes[:, 3] = (planes[:, 3] - planes[:, :3] @ self._origin) / self._unit
        planes = planes[planes[:, :3] @ eye > planes[:, 3]]
        normals = np.zeros((4, 4), dtype=np.float32)
        normals[: len(planes)] = planes
        return Planes(normals, _on_screen(planes, self.camera.axes(), eye, view), len(planes))

    def skip(self, frame: Frame) -> None:
        """Take note of a frame that is not drawn."""
        self._aim(frame)
        self._widen(frame)

    def memory(self) -> dict[str, Any]:
        """See `Renderer`."""
        follower = None if self._tracker is None else self._tracker.follower
        about = {"bounds": [self._bounds.low.tolist(), self._bounds.high.tolist()]}
        return about if follower is None else about | {"follower": follower.memory()}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """See `Renderer`."""
        self._bounds = Bounds(*map(np.array, memory["bounds"]))
        if self._tracker is not None and self._tracker.follower is not None:
            self._tracker.follower.recall(memory["follower"])

    def look(self, camera: Camera) -> None:
        """Look from there from now on, whatever a CameraPath says."""
        self.camera, self._tracker = camera, None

    def _aim(self, frame: Frame) -> None:
        if self._tracker is not None:
            self.camera = self._tracker.at(frame)

    def close(self) -> None:
        """Free the fields."""
        for owner in (self.buffers, self._canvas):
            if owner is not None:
                owner.close()
        self.buffers, self._canvas, self._content = None, None, None

    def _prepare(self, frame: Frame) -> None:
        """Take over what changed beyond positions; allocate again where a frame has more of anything."""
        if self._content is not None and self._content.matches(frame):
            return
        content = Content.of(frame, self._unit, self._subdivide, self._crease, self._rest, self._looks)
        self._content = content
        if self.buffers is None or not self.buffers.holds(content):
            if self.buffers is not None:
                self.buffers.close()
            self.buffers = Buffers(content)
        if self._canvas is None:
            drawn = int(np.count_nonzero(content.radius)) + len(content.rods)
            samples = 1 if drawn > MANY_PRIMITIVES and not self._transparent else 4
            ground = self._transparent, self._shadow_catcher
            self._canvas = Canvas(self.size, samples, self._stage, self._shadow, self._ambient_occlusion, *ground)
        colour = to_linear(content.colour)
        if len(frame.pinned) == len(colour) and not len(frame.triangles):
            colour = np.where(
                frame.pinned[:, None] & (frame.colour.size == 0), to_linear(np.array(PINNED_COLOUR)), colour
            )
        self.buffers.load(content, colour, self._unit)

    def _look_matrix(self) -> NDArray[np.float64]:
        """Rows: lamp and the spacing of the grid, fill and the glow's share, zenith, horizon."""
        look = np.zeros((4, 4))
        look[:, :3] = self._lamp, self._fill, self._zenith, self._horizon
        look[0, 3], look[1, 3] = self._spacing / self._unit, self._glow
        return look

    def _view(self, width: int, height: int) -> NDArray[np.float32]:
        eye = (np.asarray(self.camera.eye) - self._origin) / self._unit
        return view_matrix(self.camera.axes(), eye, self.camera.focal(height), (width / 2, height / 2))

    def _spare(self, view: NDArray[np.float32]) -> None:
        """Bound the work where balls share one spot and their spheres would be drawn over each other endlessly."""
        distance = self.camera.distance / self._unit
        shadow = (self._canvas.shadow_size * self._unit / self._bounds.size) ** 2 if self._shadow else 0.0
        per_square = float(view[3, 0] / distance) ** 2  # px for a unit square at the target
        tests = self._canvas.samples + shadow / per_square  # for a px of disc
        if np.pi * self.buffers.squares * per_square * tests > MOST_TESTS:
            self.buffers.thin_out(view, MOST_TESTS / tests)

    def _draw(self, seen: Any, samples: int, view: NDArray, width: int, height: int, exact: bool) -> None:
        b, v = self.buffers, matrix_of(view)
        if b.has_spheres:
            raster.draw_spheres(b.ball, seen, samples, exact, v, width, height, b.balls)
        if b.has_rods:
            raster.draw_rods(b.ball, b.rod, b.rod_radius, seen, samples, v, width, height, b.rods)
        if b.has_triangles:
            styles = (b.style_of, b.style, b.is_see_through)
            triangles.draw_triangles(b.ball, b.corner, *styles, seen, samples, v, width, height, b.triangles)

    def _extent(self, frame: Frame, most: float) -> Bounds:
        """Bounds of what shadows are made for: balls, embedded surfaces, and the colliders near them or in sight. They reach at
        most `most` [m] from the camera's target: a ball flung away farther would leave no detail to all others' shadows."""
        step = max(1, len(frame.position) // 4096)
        bounds = robust_bounds(frame.position[::step], frame.radius[::step])[0]
        near = near_boxes(frame, bounds, IN_SIGHT * self.camera.distance)
        points = np.concatenate([bounds.low[None], bounds.high[None], near, embedded_vertices(frame, bounds)])
        target = np.asarray(self.camera.target)
        return Bounds(
            *(np.clip(ends, target - most, target + most) for ends in (points.min(axis=0), points.max(axis=0)))
        )

    @property
    def _sight(self) -> float:
        """Distance [m] from the camera's target to which shadows reach: that of the camera, but no less than the size of the
        scene at its start."""
        return max(self.camera.distance, self._unit)

    def _cast_shadows(self, frame: Frame) -> NDArray[np.float32]:
        """Draw the shadow map; return its view, which covers the bounds."""
        bounds = self._widen(frame)
        axes = Camera(eye=tuple(self._lamp), target=(0.0, 0.0, 0.0)).axes()
        side = self._canvas.shadow_size
        radius = 0.53 * bounds.size / self._unit
        centre = (bounds.centre - self._origin) / self._unit
        eye = centre - axes[2] * 3 * radius
        light = view_matrix(axes, eye, side / 2 / radius, (side / 2, side / 2), far=8 * radius)
        shadow_map = self._canvas.shadow
        shadow_map.clear(side, side)
        self._draw(shadow_map, 1, light, side, side, False)
        shadow.coarsen(shadow_map, self._canvas.cell, self._canvas.coarse, self._canvas.thin, side)
        return light

    def _widen(self, frame: Frame) -> Bounds:
        """The scene's bounds, which grow in steps as balls spread."""
        now = self._extent(frame, self._sight)
        low, high = np.minimum(now.low, self._bounds.low), np.maximum(now.high, self._bounds.high)
        grown = Bounds(low, high)
        if grown.size > 1.02 * self._bounds.size:
            pad = 0.15 * grown.size
            self._bounds = Bounds(low - pad, high + pad)
        return self._bounds


def _around(camera: Camera, azimuth: float, height: float) -> NDArray[np.float64]:
    """A direction `azimuth` degrees to the right of the camera's place and `height` degrees above the ground."""
    axes = camera.axes()
    flat = np.array([-axes[2][0], 0.0, -axes[2][2]])
    flat = flat / np.linalg.norm(flat) if np.linalg.norm(flat) > 1e-6 else np.array([0.0, 0.0, 1.0])
    side = np.array([flat[2], 0.0, -flat[0]])  # to the right of the camera
    level = flat * math.cos(math.radians(azimuth)) + side * math.sin(math.radians(azimuth))
    return np.array([0.0, math.sin(math.radians(height)), 0.0]) + level * math.cos(math.radians(height))


def _nice(length: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(length))
    return min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(math.log(m * power / length))) * power


def _on_screen(planes: NDArray, axes: NDArray, eye: NDArray, view: NDArray) -> NDArray[np.float32]:
    """Rows (a, b, c): closeness a x + b y + c of each plane (unit normal, offset) on the screen."""
    rows = np.zeros((4, 4), dtype=np.float32)
    focal, cx, cy = (float(a) for a in view[3, :3])
    for k, plane in enumerate(planes):
        right, up, forward = axes @ plane[:3] / (plane[3] - plane[:3] @ eye)
        rows[k, :3] = right / focal, -up / focal, forward - right * cx / focal + up * cy / focal
    return rows
