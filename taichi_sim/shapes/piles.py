"""Pile and tower."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from taichi_sim.common import validation
from taichi_sim.common.errors import about
from taichi_sim.common.spelling import takes_color
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes.base import (
    Part,
    Pins,
    Shape,
    affordable,
    at_least_0,
    build,
    counts,
    lengths,
    or_default,
    with_preset,
)
from taichi_sim.shapes.jelly import jelly

__all__ = ["pile", "tower"]


@takes_color
def pile(
    scene: Scene,
    resolution: Sequence[int],
    radius: float,
    *,
    smallest_radius: float | None = None,
    spacing: float | None = None,
    jitter: float = 0.05,
    seed: int = 0,
    mass: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: float | Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
) -> Shape:
    """A heap of loose balls on a lattice from the origin toward the positive axes. They collide with each other.

    Args:
        resolution: balls along each axis; radius: of each [m].
        smallest_radius: where balls differ [m]: their radii lie between it and `radius`, all alike likely.
        mass: of each [kg], of those of `radius` where balls differ, others by their volume; by default 1, or as heavy as a preset
            is.
        spacing: between centres [m]; 2.2 radii by default.
        jitter: the balls are moved at random by up to this fraction of a radius per axis, so that no column stands by
            luck [1]. seed: of chance: the same one gives the same heap.
    """
    dim = scene.dim
    number = counts("pile.resolution", resolution, dim, 1)
    size = validation.number("pile.radius", radius, positive=True)
    affordable("pile.resolution", resolution, math.prod(number), 0)
    step = or_default("pile.spacing", spacing, 2.2 * size)
    shake = validation.number("pile.jitter", jitter, low=0, high=1) * size
    points = np.stack(np.meshgrid(*map(np.arange, number), indexing="ij"), axis=-1).reshape(-1, dim) * step
    chance = np.random.default_rng(validation.whole("pile.seed", seed, 0))
    points = points + chance.uniform(-shake, shake, points.shape)
    each = or_default("pile.mass", mass, _mass(scene, material, size))
    total: Any = each * len(points)
    radii: Any = size
    if smallest_radius is not None:
        least = validation.number("pile.smallest_radius", smallest_radius, high=size, positive=True)
        radii = chance.uniform(least, size, len(points))
        total = each * (radii / size) ** dim
    placed: dict[str, Any] = {"velocity": velocity, "position": position, "rotation": rotation}
    part = Part(total, radii, pinned, material, colour, self_collision=True, **placed)
    return build(scene, "pile", points, [], np.zeros((0, 3)), part, 0.0, None)


def _mass(scene: Scene, material: str, radius: float) -> float:
    """Mass of a ball of a preset [kg], in 2D of a disc as thick as a slab; else 1."""
    density = with_preset(scene, material, {"density": None, "poisson_ratio": None})["density"]
    if density is None:
        return 1.0
    return density * math.pi * radius**2 * (1.0 if scene.dim == 2 else 4 / 3 * radius)


@takes_color
def tower(
    scene: Scene,
    levels: int = 3,
    size: Sequence[float] | None = None,
    resolution: Sequence[int] | None = None,
    *,
    gap: float = 0.0,
    mass: float | None = None,
    young_modulus: float | None = None,
    poisson_ratio: float | None = None,
    damping: float | None = None,
    radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
) -> Shape:
    """Blocks of jelly on each other, along y, the corner of the lowest at `position`. Blocks collide with each other.

    Args:
        levels: how many blocks; size: of each, along each axis [m]; resolution: balls of each along each axis.
        young_modulus: of each block [Pa, in 2D N/m]; poisson_ratio: of each block [1], as for a jelly.
        gap: between the balls of a block and of the next [m]. mass: of each block [kg].
        radius: of each ball [m]; 0.45 of the smallest spacing by default.
    """
    dim = scene.dim
    number = validation.whole("tower.levels", levels, 1)
    extent = lengths("tower.size", (0.4,) * dim if size is None else size, dim)
    many = counts("tower.resolution", (4,) * dim if resolution is None else resolution, dim, 2)
    reach = or_default("tower.radius", radius, 0.45 * float((extent / (np.array(many) - 1)).min()))
    step = float(extent[1]) + 2 * reach + at_least_0("tower.gap", gap, 0.0)
    low = np.zeros(dim) if position is None else validation.vectors("tower.position", position, 1, dim)[0]
    count = number * math.prod(many)
    affordable("tower.levels", levels, count, 13 * count)
    blocks = []
    with scene.all_or_nothing(), about("tower"):
        for level in range(number):
            block = jelly(
                scene,
                extent,  # type: ignore[arg-type]
                many,
                mass=mass,
                young_modulus=young_modulus,
                poisson_ratio=1 / (dim + 1)
                if poisson_ratio is None and scene.preset(material) is None
                else poisson_ratio,
                damping=damping,
                radius=reach,
                velocity=velocity,
                material=material,
                position=low + level * step * np.eye(dim)[1],  # type: ignore[arg-type]
                colour=colour,
            )
            blocks.append(block)
        balls = np.concatenate([block.balls for block in blocks])
        scene.set_balls(balls, pinned=pinned)
    return Shape.of(blocks)
