"""Choice of what is drawn of a frame: balls as spheres or discs, springs as rods, surfaces, and their colours."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry.graph import components
from taichi_sim.geometry.mesh import Edges
from taichi_sim.render.binding import Binding
from taichi_sim.render.bodies import Bodies
from taichi_sim.render.palette import body_colours
from taichi_sim.render.smoothing import CREASE, Smoothing
from taichi_sim.render.styles import Styles
from taichi_sim.render.subdivision import subdivided_corners
from taichi_sim.scene.colliders import Collider
from taichi_sim.scene.embedded_surfaces import EmbeddedSurface
from taichi_sim.scene.looks import Look
from taichi_sim.scene.objects import SceneObject, mapped

__all__ = ["Content"]


@dataclass(frozen=True, slots=True)
class Content:
    """The unchanging part of a frame, ready to draw.

    radius (n,) m, 0 for balls on triangles; rods: indices of the springs drawn; rod_ends (k, 2); rod_radius (k,) m;
    rod_stick (k,). Vertices are the n balls and, after them, those of surfaces and of finer surfaces, which `binding` holds to
    the balls; colour (n + s, 3) sRGB and triangles (t, 3) are theirs. bodies: colliders, in 3D. smoothing, styles: of these
    triangles and those of colliders after them, in 3D.
    """

    source: tuple[NDArray, ...]
    radius: NDArray[np.float64]
    colour: NDArray[np.float64]
    rods: NDArray[np.int64]
    rod_ends: NDArray[np.int32]
    rod_radius: NDArray[np.float64]
    rod_stick: NDArray[np.bool_]
    triangles: NDArray[np.int32]
    binding: Binding
    bodies: Bodies | None
    smoothing: Smoothing | None
    styles: Styles | None
    colliders: tuple[Collider, ...]
    embedded_surfaces: tuple[EmbeddedSurface, ...]
    objects: tuple[SceneObject, ...]

    @classmethod
    def of(
        cls,
        frame: Frame,
        size: float,
        subdivide: int = 0,
        crease: float = CREASE,
        rest: NDArray | None = None,
        looks: Sequence[Look] = (),
    ) -> "Content":
        """size: of the scene in metres, for rods between balls without a radius. subdivide: surfaces so many times. crease:
        see `Smoothing`; rest: where the balls (n, 3) [m] show it, those of the frame by default; looks: of surfaces."""
        n = len(frame.position)
        covered = np.zeros(n, dtype=bool)
        for one in frame.embedded_surfaces:
            covered |= one.covered(n)
        own = frame.triangles.reshape(-1, 3)
        bare = own[~covered[own].all(axis=1)]
        triangles, binding = Binding.finer(frame.embedded_surfaces, bare, n, subdivide)
        hidden = covered | enclosed(frame)
        hidden[own.ravel()] = True
        hidden[frame.torn_triangles.ravel()] = True  # threads and crumbs of what has torn are too fine to be seen
        springs = frame.springs.reshape(-1, 2)
        rods = np.flatnonzero(~(hidden[springs[:, 0]] | hidden[springs[:, 1]]))  # inner ones would poke through
        ends = np.ascontiguousarray(springs[rods], dtype=np.int32)
        colour = body_colours(frame)
        bodies, smoothing, styles = None, None, None
        if frame.dim == 3:
            bodies = Bodies.of(frame, crease=crease)
            rest = frame.position if rest is None or rest.shape != frame.position.shape else rest
            smoothing = _smoothing(frame, triangles, binding, bodies, 180.0 if subdivide else crease, rest)
            uv = np.full((len(triangles) >> 2 * subdivide, 3, 2), np.nan)
            uv[: len(bare)] = _on_texture(frame, bare)
            first = len(bare)
            for one in frame.embedded_surfaces:
                if one.uv is not None:
                    uv[first : first + len(one.triangles)] = one.uv
                first += len(one.triangles)
            for _ in range(subdivide):
                uv = subdivided_corners(uv)
            styles = Styles.of(frame, looks, triangles, binding, bodies, smoothing.sheet, rest, uv, size)
        stick = frame.sticks[rods] if len(frame.sticks) == len(springs) else np.zeros(len(rods), dtype=bool)
        return cls(
            source=_source(frame),
            radius=np.where(hidden, 0.0, frame.radius),
            colour=np.concatenate([colour, binding.colours(colour)]),
            rods=rods,
            rod_ends=ends,
            rod_radius=_rod_radius(frame, ends, stick, size),
            rod_stick=stick,
            bodies=bodies,
            smoothing=smoothing,
            styles=styles,
            colliders=_colliders(frame),
            embedded_surfaces=frame.embedded_surfaces,
            objects=frame.objects,
            triangles=np.ascontiguousarray(triangles, dtype=np.int32),
            binding=binding,
        )

    def matches(self, frame: Frame) -> bool:
        """True if a frame has what this was made from; frames of one simulation share the very arrays."""
        if self.colliders != _colliders(frame) or self.embedded_surfaces != frame.embedded_surfaces:
            return False
        if self.objects != frame.objects:
            return False
        return all(a is b or np.array_equal(a, b, equal_nan=True) for a, b in zip(self.source, _source(frame)))


def enclosed(frame: Frame) -> NDArray[np.bool_]:
    """The balls (n,) within closed surfaces: joined by springs to one, and of the same object, which nothing has torn open."""
    n, triangles = len(frame.position), frame.triangles.reshape(-1, 3)
    if not len(triangles) or not frame.objects:
        return np.zeros(n, dtype=bool)
    number = np.full(n, len(frame.objects))
    for k, one in enumerate(frame.objects):
        number[one.balls] = k
    edges = Edges.of(triangles)
    one, other = number[edges.ends].T
    is_open = np.zeros(len(frame.objects) + 1, dtype=bool)
    is_open[-1] = True
    is_open[one[edges.triangles != 2]] = True
    is_open[np.concatenate([one[one != other], other[one != other]])] = True
    joined = components(n, np.concatenate([frame.springs.reshape(-1, 2), triangles[:, :2], triangles[:, 1:]]))
    body = joined.astype(np.int64) * len(is_open) + number
    return np.isin(body, np.unique(body[triangles])) & ~is_open[number]


def _smoothing(
    frame: Frame, triangles: NDArray, binding: Binding, bodies: Bodies, crease: float, x: NDArray
) -> Smoothing:
    """Smoothing of surfaces and colliders. Sheets that are flat by nature, those with places on a texture, have no sharp edges.
    Their normals are evened: of their squares, cut in turns, all those under a slanted fold may be cut across it, and shading
    between corners would show teeth. What is finer than the balls is smooth already."""
    flat = np.zeros(len(x) + len(binding), dtype=bool)
    for one in frame.objects:
        flat[one.balls] = one.is_sheet
    flat[len(x) :] = binding.apply(flat[: len(x)]) > 0.5
    points = np.concatenate([x, binding.apply(x)])
    soft = flat[triangles].all(axis=1)
    own = Smoothing.of(points, triangles, crease, soft)
    own = own._replace(evened=np.unique(own.normal_of[soft & (triangles < len(x)).all(axis=1)]))
    return own.joined(Smoothing.of(bodies.vertices, bodies.triangles, 180.0).closed())


def _on_texture(frame: Frame, triangles: NDArray) -> NDArray[np.float64]:
    """Places (t, 3, 2) of the corners of triangles of balls on a texture, as a mesh says them; nan where none does."""
    found = np.full((len(triangles), 3, 2), np.nan)
    whole = getattr(frame, "scene", frame).triangles.reshape(-1, 3)  # those, too, that have torn
    for thing, own, uv in mapped(frame.objects, whole):
        at = {row.tobytes(): k for k, row in enumerate(own.astype(np.int64))}
        for k in np.flatnonzero(np.isin(triangles, thing.balls).all(axis=1)).tolist():
            found[k] = uv[at[triangles[k].astype(np.int64).tobytes()]]
    return found


def _colliders(frame: Frame) -> tuple[Collider, ...]:
    return tuple(placed.collider for placed in frame.colliders)


def _source(frame: Frame) -> tuple[NDArray, ...]:
    return frame.radius, frame.springs, frame.sticks, frame.triangles, frame.colour, frame.pinned


def _rod_radius(frame: Frame, ends: NDArray, stick: NDArray, size: float) -> NDArray[np.float64]:
    """A share of the thinner ball, a share of the scene where that is nothing, never more than a part of its length."""
    if len(ends) == 0:
        return np.zeros(0)
    thin = np.minimum(frame.radius[ends[:, 0]], frame.radius[ends[:, 1]])
    length = np.linalg.norm(frame.position[ends[:, 0]] - frame.position[ends[:, 1]], axis=1)
    thin = np.where(thin > 0, thin, 0.006 * size)
    return np.minimum(np.where(stick, 0.55, 0.28) * thin, np.where(length > 0, 0.2 * length, np.inf))
