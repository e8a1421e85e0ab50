"""Rope and wheel."""

from __future__ import annotations

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
    lattice_pairs,
    or_default,
    stable_stiffness,
)

__all__ = ["rope", "wheel"]

ROPE_DENSITY = 0.1  # kg/m


@takes_color
def rope(
    scene: Scene,
    start: Sequence[float],
    end: Sequence[float],
    n: int = 32,
    *,
    mass: float | None = None,
    stiffness: float | None = None,
    bending_stiffness: float = 0.0,
    damping: float | None = None,
    radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
) -> Shape:
    """A rope of n balls from start to end, in 2D or 3D; ball 0 lies at the start.

    Args:
        start, end: (dim,) of its first and its last ball [m]; n: how many balls, at least 2.
        mass: of all of it [kg], shared out equally; 0.1 kg per m by default.
        stiffness: of each piece [N/m]; bending_stiffness: between balls two apart [N/m], none by default.
        radius: of each ball [m]; 0.45 of their distance by default.
    """
    a = validation.vectors("rope.start", start, 1, scene.dim)[0]
    b = validation.vectors("rope.end", end, 1, scene.dim)[0]
    number = (validation.whole("rope.n", n, 2),)
    affordable("rope.n", n, number[0], 2 * number[0])
    length = float(np.linalg.norm(b - a))
    if length == 0:
        raise SceneError("rope.end", b, "another point than start")
    points = a + np.linspace(0.0, 1.0, number[0])[:, None] * (b - a)
    bend = validation.number("rope.bending_stiffness", bending_stiffness, low=0)
    kinds = [Springs(lattice_pairs(number, (1,)), 1.0)]
    total = or_default("rope.mass", mass, ROPE_DENSITY * length)
    strength = at_least_0("rope.stiffness", stiffness, stable_stiffness(kinds, len(points), total))
    if bend > 0:
        kinds.append(Springs(lattice_pairs(number, (2,)), 0.0, bend))
    part = Part(
        total,
        or_default("rope.radius", radius, 0.45 * length / (number[0] - 1)),
        pinned,
        material,
        colour,
        self_collision,
        velocity=velocity,
        position=position,
        border=np.isin(np.arange(number[0]), [0, number[0] - 1]),
    )
    return build(scene, "rope", points, kinds, np.zeros((0, 3)), part, strength, at_least_0("rope.damping", damping))


@takes_color
def wheel(
    scene: Scene,
    centre: Sequence[float],
    radius: float,
    spokes: int = 12,
    *,
    mass: float = 1.0,
    stiffness: float | None = None,
    damping: float | None = None,
    ball_radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: float | Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
) -> Shape:
    """A wheel in the x-y plane: a hub (ball 0) at the centre and one rim ball at the end of each spoke.

    Args:
        centre: (dim,) of the hub [m]; radius: from the hub to the rim balls' centres [m]; spokes: at least 3.
        mass: of all of it [kg], shared out equally over the hub and the rim.
        stiffness: of each spoke and each piece of the rim [N/m].
        pinned: [0] holds the hub, about which the wheel then turns.
        ball_radius: of each ball [m]; 0.3 of the distance along the rim by default.
    """
    reach = validation.number("wheel.radius", radius, positive=True)
    number = validation.whole("wheel.spokes", spokes, 3)
    affordable("wheel.spokes", spokes, number, 2 * number)
    middle = validation.vectors("wheel.centre", centre, 1, scene.dim)[0]
    angle = 2 * np.pi * np.arange(number) / number
    points = np.zeros((number + 1, scene.dim))
    points[1:, 0], points[1:, 1] = reach * np.cos(angle), reach * np.sin(angle)
    if position is not None:
        middle = middle + validation.vector("wheel.position", position, scene.dim)
    rim = 1 + np.arange(number)
    spoke_pairs = np.stack([np.zeros(number, dtype=np.int64), rim], axis=1)
    kinds = [Springs(spoke_pairs, 1.0), Springs(np.stack([rim, np.roll(rim, -1)], axis=1), 1.0)]
    total = or_default("wheel.mass", mass, 1.0)
    strength = at_least_0("wheel.stiffness", stiffness, stable_stiffness(kinds, len(points), total))
    side = 2 * reach * float(np.sin(np.pi / number))
    part = Part(
        total,
        or_default("wheel.ball_radius", ball_radius, 0.3 * side),
        pinned,
        material,
        colour,
        self_collision,
        velocity=velocity,
        position=middle,
        rotation=rotation,
        border=np.arange(number + 1) > 0,
    )
    return build(scene, "wheel", points, kinds, np.zeros((0, 3)), part, strength, at_least_0("wheel.damping", damping))
