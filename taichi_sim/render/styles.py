"""Styles: how surfaces look, and where their patterns lie on them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.render.binding import Binding
from taichi_sim.render.bodies import Bodies
from taichi_sim.render.palette import to_linear
from taichi_sim.scene.looks import PATTERNS, Look
from taichi_sim.scene.objects import SceneObject

__all__ = ["Styles", "places_within"]

PLAIN = Look("")
TEXTURE = 3  # its number after those of patterns
SHEET_LIGHT = 0.4  # share of the light that comes through a sheet
WITHIN = 0.998  # of a place on a surface: whole numbers lie beside it, or its faces would lie between two fields


class Styles(NamedTuple):
    """rows (s, 8): gloss, share of the light that comes through, opacity, number of the pattern, linear colour (3,) of every
    other field, or first texel, width and height of a texture, and how often it repeats; of_triangle (t,): the row of each;
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
    ) -> "Styles":
        """Styles of triangles (t, 3) of balls and what is bound to them, and of bodies; sheet: those of a sheet; rest (n, 3)
        [m]: where the balls show how patterns lie in what has no places on a texture of its own; uv (t, 3, 2): such places
        of corners, or nan."""
        texels, rows = [np.zeros((0, 3))], list[tuple[float, ...]]()
        for look in (PLAIN, *looks):
            pattern = (float(PATTERNS.index(look.pattern)), *to_linear(np.array(look.pattern_colour)))
            if sizes := look.sizes():
                pattern = (TEXTURE, sum(map(len, texels)), sizes[0].shape[1], sizes[0].shape[0])
                texels += [to_linear(image.reshape(-1, 3) / 255) for image in sizes]
            rows += [(look.gloss, light, look.opacity, *pattern, look.repeat or 1.0) for light in (0.0, SHEET_LIGHT)]
        n, named = len(frame.position), {one.of: k + 1 for k, one in enumerate(looks)}
        number, place = np.zeros(n, dtype=np.int64), np.zeros((n, 3))
        first = binding.weights.indices[binding.weights.indptr[:-1]]
        for thing in frame.objects:
            if thing.name in named and len(thing.balls):
                number[thing.balls] = named[thing.name]
                bound = binding.apply(rest)[np.isin(first, thing.balls)]  # may reach beyond the balls
                place[thing.balls] = (
                    _flat(thing, frame.triangles, n) if thing.is_sheet else places_within(rest[thing.balls], bound)
                )
        number = np.concatenate([number, number[first]])
        bodies_number = np.array([named.get(p.collider.label, 0) for p in frame.colliders], dtype=np.int64)
        of_bodies = (
            bodies_number[bodies.owner[bodies.triangles[:, 0]]] if len(frame.colliders) else np.zeros(0, np.int64)
        )
        of_triangle = 2 * np.concatenate([number[triangles[:, 0]], of_bodies]) + sheet
        places = np.zeros((0, 3))
        if any(row[3] > 0 for row in rows):
            own = np.zeros_like(bodies.vertices)
            for k in range(len(frame.colliders)):
                mine = bodies.owner == k
                own[mine] = places_within(bodies.vertices[mine], np.zeros((0, 3)))
            surfaces = np.concatenate([place, binding.apply(place)])[triangles]
            on_image = np.array([row[3] == TEXTURE for row in rows])[of_triangle[: len(triangles)]]
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
    def are_see_through(self) -> bool:
        """True if any row hides but a part of what is behind."""
        return bool(np.any(self.rows[:, 2] < 1))


def places_within(x: NDArray, bound: NDArray) -> NDArray[np.float64]:
    """Places (v, 3) in the box about points (v, 3) and those bound to them (k, 3), whose longest side is 1."""
    points = np.concatenate([x, bound])
    low, size = points.min(axis=0), np.ptp(points, axis=0).max()
    return 0.5 * (1 - WITHIN) + WITHIN * (x - low) / max(size, 1e-300)


def _flat(thing: SceneObject, triangles: NDArray, n: int) -> NDArray[np.float64]:
    """Places (k, 3) of the balls of a thing of n by its own on a texture, turned over where that would be mirrored in front."""
    uv, own = np.zeros((n, 2)), np.zeros(n, dtype=bool)
    uv[thing.balls], own[thing.balls] = thing.uv, True
    a, b, c = (uv[triangles[own[triangles].all(axis=1), k]] for k in range(3))
    one, other = b - a, c - a
    if np.sum(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) < 0:
        uv[:, 1] = 1 - uv[:, 1]
    return np.column_stack([uv[thing.balls], np.full(len(thing.balls), 0.5)]) * WITHIN + 0.5 * (1 - WITHIN)
