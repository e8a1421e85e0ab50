"""Camera: where a 3D picture is seen from, and how to place it so that a scene fills the picture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.scene.motion import turn_matrix

__all__ = [
    "AZIMUTH",
    "ELEVATION",
    "FOV",
    "Bounds",
    "Camera",
    "Flat",
    "Seen",
    "embedded_vertices",
    "ground_planes",
    "near_boxes",
    "robust_bounds",
    "rotated",
    "triple",
    "view_matrix",
]

Floats = NDArray[np.float64]
SAMPLED_BALLS = 20_000  # balls looked at: enough for a frame, quick for millions
FIT_MARGIN = 1.10
FEW_LOOSE = 30  # loose balls: all of fewer are shown
STAYING = 0.9  # part of loose balls that is always shown
MUCH_NEARER = 0.75  # of the distance to all balls: from nearer than that some are left out
LARGE = 4.0  # times as large as the balls' box is a collider of which only the part beside them needs to be shown
BESIDE = 0.25  # of the size of the balls' box
SLENDER = 0.1  # thickness of a pole or a rail as a part of its length: of it, too, only the part beside the balls
NEAR_WALL = 1.2  # sizes of the balls' box: a wall no farther below them is shown, where it is not known if they fall
AZIMUTH, ELEVATION, FOV = 32.0, 19.0, 34.0  # degrees; a three-quarter view


class Seen(NamedTuple):
    """Points in a picture: at (k, 2) px from its upper left corner, depth (k,) m along the view, scale (k,) px per m there; nan
    behind the eye."""

    at: Floats
    depth: Floats
    scale: Floats


@dataclass(frozen=True, slots=True)
class Camera:
    """A perspective camera: eye and target in metres, up a direction, fov the vertical angle of view in degrees."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov: float = FOV

    def axes(self) -> Floats:
        """Rows right, up and forward, (3, 3). A view along `up` takes another up."""
        forward = np.subtract(self.target, self.eye).astype(float)
        if not np.all(np.isfinite(forward)) or not np.any(forward):
            raise ValueError(f"camera: eye {self.eye} and target {self.target} must be finite and differ")
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        if np.linalg.norm(right) < 1e-9 * max(1e-30, float(np.linalg.norm(self.up))):
            right = np.cross(forward, (0.0, 0.0, -1.0) if abs(forward[2]) < 0.9 else (1.0, 0.0, 0.0))
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, forward), forward])

    @property
    def distance(self) -> float:
        """Distance of the eye from the target [m]."""
        return float(np.linalg.norm(np.subtract(self.eye, self.target)))

    def focal(self, height: float) -> float:
        """Pixels of a metre at a depth of one metre, in a picture so high [px]."""
        return height / 2 / math.tan(math.radians(self.fov) / 2)

    def see(self, points: Floats, size: tuple[int, int]) -> Seen:
        """Places of points (k, 3) [m] in a picture of a size (width, height) [px]."""
        local = (points - np.asarray(self.eye)) @ self.axes().T
        depth = np.where(local[:, 2] > 0, local[:, 2], np.nan)
        scale = self.focal(size[1]) / depth
        return Seen(np.array(size) / 2 + local[:, :2] * [1, -1] * scale[:, None], depth, scale)

    def aside(self, right: float, up: float) -> "Camera":
        """Camera with its eye so far [m] aside, towards the same target."""
        if not right and not up:
            return self
        axes = self.axes()
        return replace(self, eye=triple(np.array(self.eye) + right * axes[0] + up * axes[1]))

    @classmethod
    def fit(
        cls,
        frames: Frame | Sequence[Frame],
        aspect: float = 16 / 9,
        azimuth: float = AZIMUTH,
        elevation: float = ELEVATION,
        fov: float = FOV,
        target: tuple[float, ...] | None = None,
        orbit: float = 0.0,
    ) -> "Camera":
        """A camera that shows 3D frames but far-flung balls, and the walls that are near. Angles in degrees.

        target [m]: what it must look at; None: their middle. orbit: turning about it [degrees per second]; the camera is that of
        time 0.
        """
        frames = [frames] if isinstance(frames, Frame) else frames
        gap = NEAR_WALL if len(frames) == 1 else 0.0
        contents, radii, loose = zip(*(_content(frame, gap) for frame in frames))
        radius, ball = np.concatenate(radii), np.concatenate(loose)
        turned = [
            cls(triple(_back(azimuth + orbit * frame.time, elevation)), (0.0, 0.0, 0.0)).axes() for frame in frames
        ]
        tall = math.tan(math.radians(fov) / 2) / FIT_MARGIN
        slopes = np.array([tall * aspect, tall])

        def needed(place: Floats) -> tuple[Floats, Floats]:
            """Points seen from a place, and the distance at which each of them is in the picture."""
            local = np.concatenate([(points - place) @ axes.T for points, axes in zip(contents, turned)])
            return local, ((np.abs(local[:, :2]) + radius[:, None]) / slopes - local[:, 2:]).max(axis=1)

        every = np.concatenate(contents)
        middle = np.median(every, axis=0) if target is None else np.array(target)
        kept = ~_flown_off(needed(middle)[1], ball, len(contents[0]))
        low, high = every[kept].min(axis=0), every[kept].max(axis=0)
        place = (low + high) / 2 if target is None else np.array(target)
        distance = 1.0
        for _ in range(4):  # place, then shift so that the margins on both sides are equal
            local, need = needed(place)
            distance = max(float(need[kept].max()), 1e-30)
            if target is not None or orbit:
                break
            seen, wide = local[kept], radius[kept, None]
            depth = seen[:, 2:] + distance
            low = ((seen[:, :2] - wide) / depth).min(axis=0)
            high = ((seen[:, :2] + wide) / depth).max(axis=0)
            place = place + ((low + high) / 2 * distance * 0.7) @ turned[0][:2]
        return cls(triple(place + _back(azimuth, elevation) * distance), triple(place), fov=fov)


@dataclass(frozen=True, slots=True)
class Flat:
    """A view of a 2D scene: low (m) the lower left corner of the picture, scale px per metre."""

    low: tuple[float, float]
    scale: float

    def see(self, points: Floats, size: tuple[int, int]) -> Seen:
        """Places of points (k, 2) [m] in a picture of a size (width, height) [px]; all are as deep."""
        at = (points - np.asarray(self.low)) * self.scale
        at[:, 1] = size[1] - at[:, 1]
        return Seen(at, np.zeros(len(at)), np.full(len(at), self.scale))


@dataclass(frozen=True, slots=True)
class Bounds:
    """An axis-parallel box about most of a frame. low, high (dim,) m."""

    low: Floats
    high: Floats

    @property
    def centre(self) -> Floats:
        return (self.low + self.high) / 2

    @property
    def size(self) -> float:
        """Length of the diagonal, m; never 0."""
        return max(
            float(np.linalg.norm(self.high - self.low)), 1e-12 * float(np.abs(self.centre).max(initial=0)), 1e-30
        )


def robust_bounds(position: Floats, radius: Floats) -> tuple[Bounds, NDArray[np.bool_]]:
    """The box about all balls but far-flung ones, and which of the balls it holds. No ball: the unit box."""
    dim = position.shape[1]
    if len(position) == 0:
        return Bounds(np.full(dim, -0.5), np.full(dim, 0.5)), np.zeros(0, dtype=bool)
    low, high = np.quantile(position, 0.02, axis=0), np.quantile(position, 0.98, axis=0)
    reach = 0.75 * max(float((high - low).max()), float(np.median(radius)) * 4)
    kept = np.all((position >= low - reach) & (position <= high + reach), axis=1)
    if not kept.any() or len(position) < 30:
        kept = np.ones(len(position), dtype=bool)
    r = radius[kept, None]
    return Bounds((position[kept] - r).min(axis=0), (position[kept] + r).max(axis=0)), kept


def near_boxes(frame: Frame, bounds: Bounds, least: float = 0.0) -> Floats:
    """Corners (k, dim) of the boxes about colliders near the balls: of a much larger one, such as a floor, and of a slender one
    in 3D, such as a pole, those of the part beside the balls. least [m]: what is no further from them is near in any case."""
    reach, beside = max(0.75 * bounds.size, least), max(BESIDE * bounds.size, least)
    low, high = bounds.low - beside, bounds.high + beside
    corners = [np.zeros((0, frame.dim))]
    for box in (p.box for p in frame.colliders):
        if _meet(box, bounds.low - reach, bounds.high + reach):
            sides = np.sort(box[1] - box[0])
            is_slender = frame.dim == 3 and sides[1] < SLENDER * sides[2]
            if is_slender or np.linalg.norm(sides) > LARGE * bounds.size:
                box = np.maximum(box[0], np.minimum(low, box[1])), np.minimum(box[1], np.maximum(high, box[0]))
            corners.append(_corners(*box))
    return np.concatenate(corners)


def _corners(low: Floats, high: Floats) -> Floats:
    """Corners (2^dim, dim) of a box."""
    return np.stack(np.meshgrid(*zip(low, high), indexing="ij"), axis=-1).reshape(-1, len(low))


def _meet(box: tuple[Floats, Floats], low: Floats, high: Floats) -> bool:
    return bool(np.all(box[0] < high) and np.all(box[1] > low))


def embedded_vertices(frame: Frame, bounds: Bounds) -> Floats:
    """A sample (k, dim) of the vertices of embedded surfaces that follow balls within the bounds."""
    found = [np.zeros((0, frame.position.shape[1]))]
    for surface in frame.embedded_surfaces:
        every = max(1, len(surface.corners) // SAMPLED_BALLS)
        balls = frame.position[surface.corners[::every]]
        near = np.all((balls[:, 0] >= bounds.low) & (balls[:, 0] <= bounds.high), axis=1)
        found.append(np.einsum("sk,ski->si", surface.weights[::every], balls)[near])
    return np.concatenate(found)


def ground_planes(frame: Frame) -> Floats:
    """Walls of a 3D frame that face mostly upward, at most four: (k, 4) unit normal and offset."""
    if frame.walls.size == 0:
        return np.zeros((0, 4))
    walls = np.asarray(frame.walls, dtype=float)
    return walls[walls[:, 1] > 0.7][:4]


def view_matrix(
    axes: Floats, eye: Floats, scale: float, centre: tuple[float, float], far: float = 0.0
) -> NDArray[np.float32]:
    """The 4x4 matrix of the kernels. scale: px at unit depth (perspective) or px per unit (far > 0: parallel)."""
    matrix = np.zeros((4, 4), dtype=np.float32)
    matrix[:3, :3] = axes
    matrix[:3, 3] = -axes @ eye
    matrix[3] = (scale, *centre, far)
    return matrix


def rotated(vector: Floats, axis: Floats, angle: float) -> Floats:
    """A vector (3,) rotated by an angle [rad] about an axis, counter-clockwise seen from its tip."""
    return turn_matrix((angle / np.linalg.norm(axis) * axis)[None])[0] @ vector


def triple(vector: Any) -> tuple[float, float, float]:
    """The numbers of a vector (3,)."""
    return float(vector[0]), float(vector[1]), float(vector[2])


def _back(azimuth: float, elevation: float) -> Floats:
    """The direction from what a camera looks at to it, by angles in degrees."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])


def _flown_off(need: Floats, ball: NDArray[np.int64], start: int) -> NDArray[np.bool_]:
    """Mask (k,) of the points of loose balls (-1: no loose ball) that fly off: at most a tenth of them, without which the camera
    comes much nearer, and which are beyond all that is seen at the start. need (k,): distance of the camera that has a point in
    the picture; start: points of the first frame."""
    loose = ball >= 0
    numbers, own = np.unique(ball[loose], return_inverse=True)
    gone = np.zeros(len(ball), dtype=bool)
    if len(numbers) < FEW_LOOSE:
        return gone
    reach = np.zeros(len(numbers))
    np.maximum.at(reach, own, need[loose])
    near = max(float(np.quantile(reach, STAYING)), float(need[~loose].max(initial=0.0)), float(need[:start].max()))
    if near < MUCH_NEARER * reach.max():
        gone[loose] = reach[own] > near
    return gone


def _content(frame: Frame, gap: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Points and radii that the picture must hold: samples of balls and embedded surfaces, and the places to which they may fall,
    on walls nearer than `gap` sizes of the balls' box at the lowest; and the loose ball that each is of, or -1."""
    seen = np.ones(len(frame.position), dtype=bool)
    seen[frame.torn_triangles] = False
    seen[frame.triangles] = True
    shown = np.flatnonzero(seen)[:: max(1, len(seen) // SAMPLED_BALLS)]
    position, radius = frame.position[shown], frame.radius[shown]
    bounds, kept = robust_bounds(position, radius)
    if len(position) == 0:
        return np.stack([bounds.low, bounds.high]), np.zeros(2), np.full(2, -1)
    drawn = embedded_vertices(frame, bounds)
    held = np.zeros(len(frame.position), dtype=bool)
    for parts in (frame.springs, frame.triangles):
        held[parts] = True
    ball = np.concatenate([np.where(held[shown], -1, shown)[kept], np.full(len(drawn), -1)])
    points = np.concatenate([position[kept], drawn])
    sizes = np.concatenate([radius[kept], np.zeros(len(drawn))])
    walls = frame.walls if frame.walls.size else np.zeros((0, 4))
    scene = getattr(frame, "scene", None)
    hung = np.zeros(len(points), dtype=bool)
    if gap and scene is not None and scene.gravity.any():
        pin = np.append(_hung(frame, shown[kept]), np.full(len(drawn), -1))
        hung = pin >= 0
        at, down = frame.position[pin[hung]], scene.gravity / np.linalg.norm(scene.gravity)
        off = points[hung] - at
        low = at + np.linalg.norm(off, axis=1, keepdims=True) * down
        beyond = at - off + 2.0 * np.outer(off @ down, down)
        swung = np.concatenate([low, beyond])  # straight down, and to the other side
        for plane in walls:
            swung += np.maximum(plane[3] - swung @ plane[:3], 0.0)[:, None] * plane[:3]
        points, sizes, ball = (
            np.concatenate(some) for some in ((points, swung), (sizes, *[sizes[hung]] * 2), (ball, *[ball[hung]] * 2))
        )
    falls = np.append(~hung, np.zeros(len(points) - len(hung), dtype=bool))
    for plane in walls:
        height = points @ plane[:3] - plane[3]
        if 0 < height.min() < gap * bounds.size and falls.any():
            feet = points[falls] - height[falls, None] * plane[:3]
            points, sizes = np.concatenate([points, feet]), np.concatenate([sizes, np.zeros(len(feet))])
            ball = np.concatenate([ball, ball[falls]])
            falls = np.append(falls, np.ones(len(feet), dtype=bool))
    sizes = np.maximum(sizes, 0.02 * bounds.size)
    corners = near_boxes(frame, bounds)
    numbers = np.concatenate([ball, np.full(len(corners), -1)])
    return np.concatenate([points, corners]), np.concatenate([sizes, np.zeros(len(corners))]), numbers


def _hung(frame: Frame, balls: NDArray[np.int64]) -> NDArray[np.int64]:
    """The nearest pinned ball that springs and triangles join each of some balls (k,) to; -1 where there is none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    n, pins = len(frame.position), np.flatnonzero(frame.pinned)
    if not len(pins):
        return np.full(len(balls), -1)
    triangles = frame.triangles.reshape(-1, 3)
    pairs = np.concatenate([frame.springs.reshape(-1, 2), triangles[:, :2], triangles[:, 1:]])
    joined = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n)), directed=False)[1]
    apart = 4.0 * float(np.ptp(frame.position, axis=0).max()) or 1.0  # more than between any two balls
    places = np.column_stack([frame.position, apart * joined])
    near, nearest = cKDTree(places[pins]).query(places[balls])
    return np.where(near < 0.5 * apart, pins[nearest], -1)
