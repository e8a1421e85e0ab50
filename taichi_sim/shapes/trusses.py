"""Truss and net: bars and ropes between knots."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.spelling import takes_color
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes.base import (
    Part,
    Pins,
    Shape,
    Springs,
    affordable,
    at_least_0,
    build,
    counts,
    lattice_pairs,
    lengths,
    or_default,
    stable_stiffness,
)

__all__ = ["net", "truss"]

ROPE_DENSITY = 0.1  # kg/m
BAR_DENSITY = 1.0  # kg/m


@takes_color
def truss(
    scene: Scene,
    size: Sequence[float],
    cells: int = 8,
    *,
    mass: float | None = None,
    stiffness: float | None = None,
    damping: float | None = None,
    radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: float | Sequence[float] | None = None,
    scale: float = 1.0,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
) -> Shape:
    """A beam of cells in a row along x, from the origin: bars along their edges and both diagonals of each face.

    In 2D ball (i, j) has index 2 i + j, in 3D ball (i, j, k) has 4 i + 2 j + k, i from 0 to `cells`: the first two (four) are
    the end that one pins.

    Args:
        size: length, height and in 3D width [m]; cells: how many, at least 1.
        mass: of all of it [kg], shared out equally; 1 kg per m of bars by default.
        stiffness: of each bar [N/m].
        radius: of each ball [m]; 0.15 of the height by default.
    """
    dim = scene.dim
    extent = lengths("truss.size", size, dim)
    number = (validation.whole("truss.cells", cells, 1) + 1, *(2,) * (dim - 1))
    affordable("truss.cells", cells, number[0] * 2 ** (dim - 1), number[0] * 18)
    factor = validation.number("truss.scale", scale, positive=True)
    spacing = extent / (np.array(number) - 1)
    points = np.stack(np.meshgrid(*map(np.arange, number), indexing="ij"), axis=-1).reshape(-1, dim) * spacing
    steps = [s for s in itertools.product((-1, 0, 1), repeat=dim) if s > (0,) * dim and sum(map(abs, s)) <= 2]
    kinds = [Springs(lattice_pairs(number, *steps), 1.0)]
    ends = points[kinds[0].pairs]
    bars = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()) * factor
    total = or_default("truss.mass", mass, BAR_DENSITY * bars)
    strength = at_least_0("truss.stiffness", stiffness, stable_stiffness(kinds, len(points), total))
    part = Part(
        total,
        or_default("truss.radius", radius, 0.15 * float(extent[1]) * factor),
        pinned,
        material,
        colour,
        self_collision,
        velocity=velocity,
        position=position,
        rotation=rotation,
        scale=factor,
    )
    return build(scene, "truss", points, kinds, np.zeros((0, 3)), part, strength, at_least_0("truss.damping", damping))


@takes_color
def net(
    scene: Scene,
    size: Sequence[float] | None = None,
    meshes: Sequence[int] = (8, 8),
    pieces: int = 3,
    *,
    mass: float | None = None,
    stiffness: float | None = None,
    damping: float | None = None,
    radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: Sequence[float] | None = None,
    scale: float = 1.0,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
) -> Shape:
    """A net of ropes in 3D, in the x-z plane from the origin toward +x and +z.

    The knots come first: knot (i, j) along x and z has index i * (meshes[1] + 1) + j. Then the balls between them.

    Args:
        size: along x and z [m], (1, 1) by default; meshes: how many along x and z; pieces: springs along each side of a mesh.
        mass: of all of it [kg], shared out equally; 0.1 kg per m of rope by default.
        stiffness: of each piece [N/m].
        radius: of each ball [m]; 0.3 of the shorter distance along the ropes by default.
    """
    if scene.dim != 3:
        raise SceneError("net", says="needs a scene with dim = 3; in 2D use rope or truss")
    extent = lengths("net.size", (1.0, 1.0) if size is None else size, 2)
    number, cut = counts("net.meshes", meshes, 2, 1), validation.whole("net.pieces", pieces, 1)
    affordable("net.meshes", meshes, 2 * number[0] * number[1] * cut, 2 * number[0] * number[1] * cut)
    factor = validation.number("net.scale", scale, positive=True)
    lines = [cut * n + 1 for n in number]
    i, j = (line.ravel() for line in np.meshgrid(*map(np.arange, lines), indexing="ij"))
    here = np.flatnonzero((i % cut == 0) | (j % cut == 0))
    here = here[np.argsort((i[here] % cut != 0) | (j[here] % cut != 0), kind="stable")]
    new = np.full(len(i), -1)
    new[here] = np.arange(len(here))
    along, across = lattice_pairs((lines[0], lines[1]), (0, 1)), lattice_pairs((lines[0], lines[1]), (1, 0))
    pairs = new[np.concatenate([along[i[along[:, 0]] % cut == 0], across[j[across[:, 0]] % cut == 0]])]
    spacing = extent / (np.array(lines) - 1)
    points = np.stack([i[here] * spacing[0], np.zeros(len(here)), j[here] * spacing[1]], axis=1)
    rope = (extent[0] * (number[1] + 1) + extent[1] * (number[0] + 1)) * factor
    kinds = [Springs(pairs, 1.0)]
    total = or_default("net.mass", mass, ROPE_DENSITY * float(rope))
    strength = at_least_0("net.stiffness", stiffness, stable_stiffness(kinds, len(points), total))
    part = Part(
        total,
        or_default("net.radius", radius, 0.3 * float(spacing.min()) * factor),
        pinned,
        material,
        colour,
        self_collision,
        velocity=velocity,
        position=position,
        rotation=rotation,
        scale=factor,
    )
    return build(scene, "net", points, kinds, np.zeros((0, 3)), part, strength, at_least_0("net.damping", damping))
