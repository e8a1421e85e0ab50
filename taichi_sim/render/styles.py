"""Styles: how surfaces look, and where their patterns lie on them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.render.binding import Binding
from taichi_sim.render.bodies import Bodies
from taichi_sim.render.palette import to_linear
from taichi_sim.scene.looks import FINISHES, PATTERNS, Finish, Look
from taichi_sim.scene.objects import SceneObject

__all__ = ["WITHIN", "Styles", "places_within", "unmirrored"]

PLAIN = Look("")
TEXTURE = len(PATTERNS)  # its number after those of patterns
MOST_INSIDE = 0.97  # of the light, left after a quarter of a body
WITHIN = 0.998  # of a place on a surface: whole numbers lie beside it, or its faces would lie between two fields


class Styles(NamedTuple):
    """rows (s, 9): gloss, share of the light that comes through, or below 0 the rate [1/unit] at which it fades inside, opacity,
    number of the pattern, linear colour (3,) of every other field, -1 for the surface's own, or first texel, width and height of
    a texture, how often it repeats, and width of the hem; of_triangle (t,): the row of each;
    place (3 t, 3) of each corner in its pattern, of which 0 to 1 is a period, or (0, 3) where there is none; texel (k, 3): linear
    colours."""

    rows: NDArray[np.float32]
    of_triangle: NDArray[np.int32]
    place: NDArray[np.float32]
    texel: NDArray[np.float32]

    @classmethod
    def of(
        cls,
        frame: Frame,
        looks: Sequence[Look],
        triangles: NDArray,
        binding: Binding,
        bodies: Bodies,
        sheet: NDArray,
        rest: NDArray,
        uv: NDArray,
        unit: float = 1.0,
    ) -> "Styles":
        """Styles of triangles (t, 3) of balls and what is bound to them, and of bodies; sheet: those of a sheet; rest (n, 3)
        [m]: where the balls show how patterns lie in what has no places on a texture of its own; uv (t, 3, 2): such places
        of corners, or nan; unit [m]: of lengths in the picture."""
        texels, patterns = [np.zeros((0, 3))], list[tuple[float, ...]]()
        looks = (PLAIN, *looks)
        for look in looks:
            own = (-1.0,) * 3 if look.pattern_colour is None else to_linear(np.array(look.pattern_colour))
            pattern = (float(PATTERNS.index(look.pattern)), *own)
            if sizes := look.sizes():
                pattern = (TEXTURE, sum(map(len, texels)), sizes[0].shape[1], sizes[0].shape[0])
                texels += [to_linear(image.reshape(-1, 3) / 255) for image in sizes]
            patterns.append((*pattern, look.repeat or 1.0, look.hem))
        kinds = [(0, Finish(), 1.0)]  # number of the look, finish, size [m]: two rows of each, of a body and of a sheet
        n, named = len(frame.position), {one.of: k for k, one in enumerate(looks) if one.of}
        number, place = np.zeros(n, dtype=np.int64), np.zeros((n, 3))
        first = binding.weights.indices[binding.weights.indptr[:-1]]
        for thing in frame.objects:
            if not len(thing.balls):
                continue
            finish = _finish(frame, thing)
            if thing.name in named or finish != Finish():
                kinds.append((named.get(thing.name, 0), finish, float(np.ptp(rest[thing.balls], axis=0).max())))
                number[thing.balls] = len(kinds) - 1
            if thing.name in named:
                bound = binding.apply(rest)[np.isin(first, thing.balls)]  # may reach beyond the balls
                place[thing.balls] = (
                    _flat(thing, frame.triangles, n) if thing.is_sheet else places_within(rest[thing.balls], bound)
                )
        number = np.concatenate([number, number[first]])
        bodies_number = np.zeros(len(frame.colliders), dtype=np.int64)
        for k, placed in enumerate(frame.colliders):
            if placed.collider.label in named:
                low, high = placed.box
                kinds.append((named[placed.collider.label], Finish(), float(np.max(high - low))))
                bodies_number[k] = len(kinds) - 1
        of_bodies = (
            bodies_number[bodies.owner[bodies.triangles[:, 0]]] if len(frame.colliders) else np.zeros(0, np.int64)
        )
        rows = [
            _row(looks[k], finish, patterns[k], size / unit, is_sheet)
            for k, finish, size in kinds
            for is_sheet in (False, True)
        ]
        of_triangle = 2 * np.concatenate([number[triangles[:, 0]], of_bodies]) + sheet
        places = np.zeros((0, 3))
        if any(row[3] > 0 or row[8] > 0 for row in rows):
            own = np.zeros_like(bodies.vertices)
            for k in range(len(frame.colliders)):
                mine = bodies.owner == k
                own[mine] = places_within(bodies.vertices[mine], np.zeros((0, 3)))
            surfaces = np.concatenate([place, binding.apply(place)])[triangles]
            on_image = np.array([row[3] >= PATTERNS.index("weave") for row in rows])[of_triangle[: len(triangles)]]
            mapped = on_image & np.isfinite(uv).all(axis=(1, 2))
            surfaces[mapped, :, :2] = uv[mapped]
            places = np.concatenate([surfaces.reshape(-1, 3), own[bodies.triangles].reshape(-1, 3)])
        return cls(
            np.array(rows, dtype=np.float32),
            of_triangle.astype(np.int32),
            places.astype(np.float32),
            np.concatenate(texels).astype(np.float32),
        )

    @property
    def are_patterned(self) -> bool:
        """True if any row has a pattern."""
        return len(self.place) > 0

    @property
    def have_light_inside(self) -> bool:
        """True if light comes through any body."""
        return bool(np.any(self.rows[:, 1] < 0))

    @property
    def are_see_through(self) -> bool:
        """True if any row hides but a part of what is behind."""
        return bool(np.any(self.rows[:, 2] < 1))


def _finish(frame: Frame, thing: SceneObject) -> Finish:
    """Finish of the preset that a thing is made of, if it is of one."""
    scene = getattr(frame, "scene", None)
    if scene is None:
        return Finish()
    name = scene.materials[scene.material[thing.balls[0]]].name
    return FINISHES.get(name, Finish()) if scene.preset(name) is not None else Finish()


def _row(look: Look, finish: Finish, pattern: tuple[float, ...], size: float, is_sheet: bool) -> tuple[float, ...]:
    """One of `Styles.rows`, of a sheet or of a body of a size [unit]."""
    gloss = finish.gloss if look.gloss is None else look.gloss
    through = look.translucency
    if through is None:
        through = finish.sheet if is_sheet else finish.body
    if not is_sheet and through > 0:
        through = 4 / max(size, 1e-9) * math.log(min(through, MOST_INSIDE))
    return (gloss, through, look.opacity, *pattern)


def places_within(x: NDArray, bound: NDArray) -> NDArray[np.float64]:
    """Places (v, 3) in the box about points (v, 3) and those bound to them (k, 3), whose longest side is 1."""
    points = np.concatenate([x, bound])
    low, size = points.min(axis=0), np.ptp(points, axis=0).max()
    return 0.5 * (1 - WITHIN) + WITHIN * (x - low) / max(size, 1e-300)


def _flat(thing: SceneObject, triangles: NDArray, n: int) -> NDArray[np.float64]:
    """Places (k, 3) of the balls of a thing of n by its own on a texture, turned over where that would be mirrored in front."""
    uv, own = np.zeros((n, 2)), np.zeros(n, dtype=bool)
    uv[thing.balls], own[thing.balls] = thing.uv, True
    uv = unmirrored(uv, triangles[own[triangles].all(axis=1)])
    return np.column_stack([uv[thing.balls], np.full(len(thing.balls), 0.5)]) * WITHIN + 0.5 * (1 - WITHIN)


def unmirrored(uv: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """Places (v, 2) of a sheet on a texture, turned over where triangles (t, 3) would show it mirrored in front."""
    a, b, c = (uv[triangles[:, k]] for k in range(3))
    one, other = b - a, c - a
    return uv * [1, -1] + [0, 1] if np.sum(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) < 0 else uv
