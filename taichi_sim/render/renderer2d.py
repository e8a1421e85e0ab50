"""Pictures of 2D frames: discs, rods, triangles and walls with analytic edges."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.device import backend
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.geometry.mesh import Edges
from taichi_sim.kernels.render import paint2d
from taichi_sim.render.bodies import filled
from taichi_sim.render.camera import Bounds, Flat, near_boxes, robust_bounds
from taichi_sim.render.canvas import finished
from taichi_sim.render.colouring import FULL_STRAIN, Colouring
from taichi_sim.render.content import Content
from taichi_sim.render.fields import padded
from taichi_sim.render.palette import background_colours, to_linear
from taichi_sim.render.stages import DAY, Stage
from taichi_sim.render.tiles import tile_lists
from taichi_sim.render.tracker import Follower
from taichi_sim.scene.camera_path import CameraPath

__all__ = ["Renderer2D", "flat_view"]

COMPRESSED_COLOUR, NEUTRAL_COLOUR, STRETCHED_COLOUR = (
    (0.13, 0.40, 0.67),
    (0.60, 0.60, 0.62),
    (0.78, 0.16, 0.17),
)  # sRGB, colour-blind safe
MANY_SHAPES = 4000  # shapes: from here smaller tiles are faster
STICK_COLOUR, STICK_COLOUR_ON_DARK = (0.27, 0.29, 0.34), (0.62, 0.65, 0.70)
VIEW_MARGIN, SHOWN_WALL = 0.06, 26.0  # of the picture; px of a wall to show
NO_BODY = -2e9  # px, a radius: nothing is nearer to it than to anything else
THINNEST = {"disc": 0.6, "spring": 0.65, "stick": 1.4, "outline": 0.8}  # px


class Renderer2D:
    """Renderer of 2D frames, see `Renderer`. The view is placed by the first frame and stays, but for what a CameraPath
    says."""

    def __init__(
        self,
        frame: Frame,
        size: tuple[int, int],
        background: Any = None,
        transparent: bool = False,
        colouring: Colouring | None = None,
        subdivide: int = 0,
        camera: Any = None,
        stage: Stage = DAY,
    ) -> None:
        self.size = size
        self._transparent, self._colouring, self._subdivide = transparent, colouring, subdivide
        self._extent = robust_bounds(frame.position, frame.radius)[0].size
        path = CameraPath.of(camera, 2, len(frame.position)) if isinstance(camera, Mapping) else camera
        self._path: CameraPath = path or CameraPath()
        self._follower = None if self._path.follow is None else Follower(self._path.follow, frame)
        self.camera: Flat
        self.fit([frame])
        self._top, bottom = background_colours(background, stage.flat_top, stage.flat_bottom)
        self._dark = float(bottom.mean()) < 0.2
        wall, hatch, edge = (
            (bottom + shift for shift in (0.05, 0.14, 0.35))
            if self._dark
            else (bottom * share for share in (0.72, 0.47, 0.13))
        )
        self._wall_colour = wall
        self._look = paint2d.Look(np.stack([self._top, bottom, wall, hatch, edge]).tolist())
        self._content: Any = None
        self.buffers: Any = None
        self._capacity = (-1, -1, -1)
        self._prepare(frame)

    def render(self, frame: Frame, coarse: int = 1, aside: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.uint8]:
        """The picture of a frame, (height, width, 3 or 4), sRGB, row 0 at the top; quick enough never to be coarse. aside: of no
        account, all is as far away."""
        self._prepare(frame)
        self.skip(frame)
        width, height = self.size
        shape, low, high = self._shapes(frame)
        tile = 8 if len(shape) > MANY_SHAPES else 16
        entry, start = tile_lists(low, high, self.size, tile)
        canvas = self.buffers
        if len(shape):
            canvas.shape.from_numpy(padded(shape, self._capacity[0]))
            canvas.colour.from_numpy(padded(np.concatenate([self._filling, self._colours(frame)]), self._capacity[0]))
        walls = self._walls(frame)[: 0 if self._transparent else None]
        if len(walls):
            canvas.wall.from_numpy(walls)
        if frame.colliders:
            canvas.body.from_numpy(self._bodies(frame))
        numbers = (len(walls), len(frame.colliders), tile, width, height)
        paint2d.paint(canvas, entry, start, self._look, *numbers)
        return finished(canvas.packed, self._transparent, width, height)

    def skip(self, frame: Frame) -> None:
        """Take note of a frame that is not drawn."""
        if self._follower is not None:
            low = self._begin + self._follower.at(frame) - self._follower.begin
            self.camera = Flat((float(low[0]), float(low[1])), self.camera.scale)

    def memory(self) -> dict[str, Any]:
        """See `Renderer`."""
        return {} if self._follower is None else {"follower": self._follower.memory()}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """See `Renderer`."""
        if self._follower is not None:
            self._follower.recall(memory["follower"])

    def look(self, camera: Flat) -> None:
        """Look there from now on, whatever a CameraPath says."""
        self.camera, self._follower = camera, None

    def fit(self, frames: Sequence[Frame]) -> None:
        """See `Renderer`."""
        path, follower, half = self._path, self._follower, np.array(self.size) / 2
        low, scale = flat_view(frames, self.size)
        shown = low + half / scale
        middle = shown if follower is None else follower.begin
        middle = middle if path.centre is None else np.array(path.centre)
        scale = float(np.min(half / (half / scale + np.abs(middle - shown))))  # all is shown from there, too
        scale = scale if path.width is None else self.size[0] / path.width
        self._begin = middle - half / scale
        self.camera = Flat((float(self._begin[0]), float(self._begin[1])), scale)

    def close(self) -> None:
        """Free the fields."""
        if self.buffers is not None:
            self.buffers.close()
        self._content, self.buffers = None, None

    def _prepare(self, frame: Frame) -> None:
        fixed = (len(frame.walls) if frame.walls.size else 0, len(frame.colliders))
        if self._content is not None and self._content.matches(frame) and fixed == self._capacity[1:]:
            return
        content = Content.of(frame, self._extent, self._subdivide)
        self._content = content
        self._discs = np.flatnonzero(content.radius > 0)
        self._rods = np.argsort(content.rod_stick, kind="stable")  # springs below sticks
        self._outline = _outline(content.triangles)
        owner = filled(frame)[1]
        counts = (len(owner) + len(content.triangles), len(self._outline), len(self._rods), len(self._discs))
        if self._capacity[0] < sum(counts) or self._capacity[1:] != fixed:  # springs that tear leave room
            if self.buffers is not None:
                self.buffers.close()
            self._capacity = (sum(counts), *fixed)
            self.buffers = Canvas(*self._capacity, self.size[0] * self.size[1], self._transparent)
        kind = np.repeat([paint2d.TRIANGLE, paint2d.ROD, paint2d.ROD, paint2d.DISC], counts).astype(np.int32)
        if len(kind):
            self.buffers.kind.from_numpy(padded(kind, self._capacity[0]))
        if frame.colliders:
            tints = [p.collider.colour for p in frame.colliders]
            linear = [np.full(3, -1.0) if tint is None else to_linear(np.array(tint)) for tint in tints]
            self.buffers.tint.from_numpy(np.array(linear, dtype=np.float32))
            linear = [self._wall_colour if tint[0] < 0 else tint for tint in linear]
        self._filling = np.array(linear, dtype=np.float32)[owner] if len(owner) else np.zeros((0, 3), dtype=np.float32)
        self._base = self._base_colours(content)

    def _shapes(self, frame: Frame) -> tuple[NDArray[np.float32], NDArray, NDArray]:
        """Shapes in drawing order, and the corners of their boxes, px."""
        content = self._content
        n = len(frame.position)
        p = (
            np.concatenate([frame.position, content.binding.apply(frame.position)]) - self.camera.low
        ) * self.camera.scale
        p[:, 1] = self.size[1] - p[:, 1]
        t, o, m = len(content.triangles), len(self._outline), len(self._rods)
        shape = np.zeros((t + o + m + len(self._discs), 8), dtype=np.float32)
        low, high = np.zeros((len(shape), 2)), np.zeros((len(shape), 2))
        corners = p[content.triangles]
        shape[:t, :6] = corners.reshape(t, 6)
        low[:t], high[:t] = corners.min(axis=1, initial=np.inf) - 1, corners.max(axis=1, initial=-np.inf) + 1
        ends = np.concatenate([self._outline, content.rod_ends[self._rods]])
        stick = content.rod_stick[self._rods]
        thinnest = np.where(stick, THINNEST["stick"], THINNEST["spring"])
        thick = np.maximum(content.rod_radius[self._rods] * self.camera.scale, thinnest)
        thick = np.concatenate([np.full(o, THINNEST["outline"]), thick])[:, None]
        rods = slice(t, t + o + m)
        a, b = p[ends[:, 0]], p[ends[:, 1]]
        shape[rods, :2], shape[rods, 2:4], shape[rods, 4:5] = a, b, thick
        shape[t : t + o, 5] = 1.0  # blunt
        low[rods], high[rods] = np.minimum(a, b) - thick - 1, np.maximum(a, b) + thick + 1
        discs = slice(t + o + m, None)
        r = np.maximum(content.radius[self._discs] * self.camera.scale, THINNEST["disc"])[:, None]
        centre = p[self._discs]
        shape[discs, :2], shape[discs, 2:3] = centre, r
        if len(frame.pinned) == n:
            shape[discs, 3] = frame.pinned[self._discs]
        low[discs], high[discs] = centre - r - 1, centre + r + 1
        if len(self._filling):  # under everything else
            corners = (filled(frame)[0] - self.camera.low) * self.camera.scale
            corners[:, :, 1] = self.size[1] - corners[:, :, 1]
            under = np.zeros((len(corners), 8), dtype=np.float32)
            under[:, :6] = corners.reshape(-1, 6)
            shape = np.concatenate([under, shape])
            low, high = np.concatenate([corners.min(axis=1) - 1, low]), np.concatenate([corners.max(axis=1) + 1, high])
        return shape, low, high

    def _base_colours(self, content: Content) -> NDArray[np.float32]:
        """Linear colours of all shapes; those of springs come with every frame."""
        colour = to_linear(content.colour)
        t, o, m = len(content.triangles), len(self._outline), len(self._rods)
        result = np.zeros((t + o + m + len(self._discs), 3), dtype=np.float32)
        result[:t] = 0.55 * colour[content.triangles].mean(axis=1) + 0.45 * self._top
        result[t : t + o] = 0.6 * colour[self._outline[:, 0]]
        result[t + o : t + o + m] = to_linear(np.array(STICK_COLOUR_ON_DARK if self._dark else STICK_COLOUR))
        result[t + o + m :] = colour[self._discs]
        return result

    def _colours(self, frame: Frame) -> NDArray[np.float32]:
        content = self._content
        spring = ~content.rod_stick[self._rods]
        if spring.any() and len(frame.strain) == len(frame.springs):
            strain = np.tanh(frame.strain[content.rods[self._rods[spring]]] / FULL_STRAIN)[:, None]
            ends = np.where(strain > 0, to_linear(np.array(STRETCHED_COLOUR)), to_linear(np.array(COMPRESSED_COLOUR)))
            first = len(content.triangles) + len(self._outline)
            share = np.abs(strain)
            self._base[first : first + len(strain)] = to_linear(np.array(NEUTRAL_COLOUR)) * (1 - share) + ends * share
        if self._colouring is not None:
            value = self._colouring.values(frame)[:, None]
            value = np.concatenate([value, content.binding.apply(value)])[:, 0]
            table = Colouring.table()
            along = np.rint(np.clip(value, 0.0, 1.0) * (len(table) - 1)).astype(int)
            t = len(content.triangles)
            self._base[:t] = table[along[content.triangles]].mean(axis=1)
            self._base[len(self._base) - len(self._discs) :] = table[along[self._discs]]
        return self._base

    def _bodies(self, frame: Frame) -> NDArray[np.float32]:
        """The colliders as kernels.render.paint2d wants them, (k, 8) px from the top left."""
        rows = np.zeros((len(frame.colliders), 8), dtype=np.float32)
        for row, placed in zip(rows, frame.colliders):
            shape, along = placed.collider, placed.rotation[:, 0]
            x, y = (placed.centre - self.camera.low) * self.camera.scale
            row[:4] = x, self.size[1] - y, along[0], -along[1]
            row[4:] = np.array([*shape.half, shape.radius, shape.hollow]) * self.camera.scale
            if not shape.form.is_rounded_box:  # triangles show it
                row[6] = NO_BODY
        return rows

    def _walls(self, frame: Frame) -> NDArray[np.float32]:
        """Rows (a, b, c): a x + b y + c px above a wall, for pixels counted from the top left."""
        if frame.walls.size == 0:
            return np.zeros((0, 3), dtype=np.float32)
        normal, offset = frame.walls[:, :2], frame.walls[:, 2]
        constant = (normal @ self.camera.low - offset) * self.camera.scale + normal[:, 1] * self.size[1]
        return np.column_stack([normal[:, 0], -normal[:, 1], constant]).astype(np.float32)


class Canvas:
    """Fields that the kernel reads and writes: shapes, walls and bodies, at least one of each, and the picture."""

    def __init__(self, shapes: int, walls: int, bodies: int, pixels: int, transparent: bool) -> None:
        self._fields = fields = Fields(ti.f32, backend.has_wide_numbers())
        # shape: see kernels.render.paint2d; kind: DISC, ROD or TRIANGLE
        self.shape, self.colour, self.kind = (
            fields.vectors(shapes, 8),
            fields.vectors(shapes, 3),
            fields.integers(shapes),
        )
        self.wall = fields.vectors(walls, 3)  # (a, b, c): a x + b y + c px above it
        # body: see kernels.render.paint2d; tint: linear colour, negative for that of walls
        self.body, self.tint = fields.vectors(bodies, 8), fields.vectors(bodies, 3)
        self.packed = fields.integers(pixels + 3)  # bytes of the picture
        self.transparent = transparent
        fields.build()
        self.wall.fill(0.0)  # a tree that is destroyed before any kernel ran leaves Taichi with dangling fields

    def close(self) -> None:
        """Free the fields."""
        self._fields.free()


def _covered(frame: Frame, bounds: Bounds) -> tuple[NDArray, NDArray]:
    """Lowest and highest coordinates of the balls and of the colliders near them."""
    points = np.concatenate([bounds.low[None], bounds.high[None], near_boxes(frame, bounds)])
    return points.min(axis=0), points.max(axis=0)


def flat_view(frames: Sequence[Frame], size: tuple[int, int]) -> tuple[NDArray, float]:
    """Lower left corner (m) and px per metre that show frames: balls but far-flung ones, and near walls."""
    lows, highs, shown, sizes = zip(*map(_content, frames))
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    extent = np.maximum(high - low, 1e-9 * max(sizes))
    border = np.array(size) * VIEW_MARGIN + (min(SHOWN_WALL, 0.05 * min(size)) if any(shown) else 0.0)
    scale = float(((np.array(size) - 2 * border) / extent).min())
    return (low + high) / 2 - np.array(size) / 2 / scale, scale


def _content(frame: Frame) -> tuple[NDArray, NDArray, bool, float]:
    """Lowest and highest coordinates (m) of what of a frame is to be seen, whether there are walls, and the size of the balls'
    box (m)."""
    bounds, kept = robust_bounds(frame.position, frame.radius)
    low, high = _covered(frame, bounds)
    points = frame.position[kept] if len(kept) else np.stack([low, high])
    shown = False
    for wall in frame.walls if frame.walls.size else ():
        gap = float((points @ wall[:2]).min() - wall[2])
        if -bounds.size < gap < 1.5 * bounds.size:
            foot = np.where(wall[:2] < 0, bounds.high, bounds.low)
            foot = foot - (foot @ wall[:2] - wall[2]) * wall[:2]
            axis = int(np.argmax(np.abs(wall[:2])))
            low[axis], high[axis] = min(low[axis], foot[axis]), max(high[axis], foot[axis])
            shown = True
    return low, high, shown, bounds.size


def _outline(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Edges that belong to one triangle only, (k, 2)."""
    edges = Edges.of(triangles)
    return edges.ends[edges.triangles == 1]
