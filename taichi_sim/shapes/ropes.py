"""Rope and wheel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.spelling import takes_center, takes_color
from taichi_sim.scene.pins import ends
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes.base import (
    Part,
    Pins,
    Shape,
    Springs,
    affordable,
    at_least_0,
    bends_along,
    build,
    exclusive,
    given_of,
    lattice_pairs,
    or_default,
    stable_stiffness,
)

__all__ = ["rope", "wheel"]

ROPE_DENSITY = 0.1  # kg/m
NARROWEST = 1e-3  # of the length between the ends, sideways, from which more balls make a fold
FIRMNESS = (
    1000 * 10.0
)  # m/s^2, stretch stiffness for each kg: a rope that hangs straight down is a thousandth longer at its top
LEAST_LENGTH = 1e-3  # of the distance from its start to its end: a rope that is stretched more is a mistake
STRETCH_DAMPING = 0.01  # of critical, for the slowest motion along a rope that is held at one end


@takes_color
def rope(
    scene: Scene,
    start: Sequence[float],
    end: Sequence[float],
    n: int = 32,
    *,
    length: float | None = None,
    mass: float | None = None,
    mass_per_length: float | None = None,
    EA: float | None = None,
    EI: float | None = None,
    young_modulus: float | None = None,
    stiffness: float | None = None,
    bending_stiffness: float | None = None,
    damping: float | None = None,
    radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
) -> Shape:
    """A rope or rod of n balls from start to end, in 2D or 3D; ball 0 lies at the start.

    It is made of a material and the same at every n: it stretches, bends, swings and is damped alike. With stiffness or
    bending_stiffness it is a chain of equal balls and springs instead, whose material depends on n. It does not resist twisting.
    With a radius and a preset as material it is a solid round rod of that: its mass, EA and EI are those where none is given.

    Args:
        start: (dim,) of its first ball [m].
        end: (dim,) of its last ball [m]; n: how many balls, at least 2.
        pinned: "start", "end" or "ends" holds its first ball, its last one, or both.
        length: unstretched [m]; the distance from start to end by default. A longer rope hangs between them as a catenary along
            the gravity of the scene, or along -y without gravity. A shorter one is straight and under tension.
        mass: of all of it [kg]; mass_per_length: in place of mass [kg/m]; that of a rod of the preset, else 0.1.
        EA: stretch stiffness, force per strain [N]; that of a rod of the preset, else 1000 times the weight of the rope, at
            10 m/s^2.
        EI: bending stiffness, moment per curvature [N m^2]; that of a rod of the preset where EA is not given, else 0: a rope
            that is perfectly flexible.
        young_modulus: in place of EA and EI [Pa], those of a solid round rod of this radius, which then has to be given.
        stiffness: of each piece [N/m], in place of EA.
        bending_stiffness: of each three neighbouring balls [N/m], EI over the cube of their distance, in place of EI.
        damping: force per rate of strain [N s]; by default that which damps the slowest motion along a rope held at one end
            by 0.01 of critical. With stiffness or bending_stiffness of each piece, along it [N s/m]; a tenth of critical.
        radius: of each ball [m]; 0.45 of their distance by default.
    """
    a = validation.vectors("rope.start", start, 1, scene.dim)[0]
    b = validation.vectors("rope.end", end, 1, scene.dim)[0]
    number = validation.whole("rope.n", n, 2)
    affordable("rope.n", n, number, number, bends=number)
    distance = float(np.linalg.norm(b - a))
    if distance == 0:
        raise SceneError("rope.end", b, "another point than start")
    given_length, length = length, or_default("rope.length", length, distance)
    if length < LEAST_LENGTH * distance:
        allowed = f"at least {LEAST_LENGTH * distance:.4g}, {LEAST_LENGTH:g} of the distance from start to end"
        raise SceneError("rope.length", length, allowed)
    chain = {"stiffness": stiffness, "bending_stiffness": bending_stiffness}
    elastic = {"EA": EA, "EI": EI, "young_modulus": young_modulus}
    exclusive("rope", elastic | {"mass_per_length": mass_per_length}, chain)
    exclusive("rope", {"mass_per_length": mass_per_length}, {"mass": mass})
    exclusive("rope", {"young_modulus": young_modulus}, {"EA": EA, "EI": EI})
    if length > distance:
        points = _hanging(a, b, length, number, scene.gravity)
    else:
        points = a + np.linspace(0.0, 1.0, number)[:, None] * (b - a)
    of_material = all(value is None for value in chain.values())
    solid = scene.preset(material) if of_material and radius is not None else None
    per_length = ROPE_DENSITY
    if solid is not None and solid.density is not None:
        per_length = solid.density * _area(radius)
    total = or_default("rope.mass", mass, or_default("rope.mass_per_length", mass_per_length, per_length) * length)
    spacing = length / (number - 1)
    drag = at_least_0("rope.damping", damping)
    masses: float | NDArray = total
    pairs = lattice_pairs((number,), (1,))
    if of_material:
        usual = (FIRMNESS * total, 0.0)
        if solid is not None and solid.young_modulus is not None:
            usual = _of_rod(solid.young_modulus, radius)
        stretch, bend = _moduli(elastic, radius, usual)
        if drag is None:  # 2 zeta / omega times EA, omega = pi / (2 L) sqrt(EA L / m)
            drag = STRETCH_DAMPING * 4 / np.pi * float(np.sqrt(stretch * total * length))
        strength, bend, drag = stretch / spacing, bend / spacing**3, drag / spacing
        masses = np.full(number, total / (number - 1))
        masses[[0, -1]] /= 2
    else:
        strength = at_least_0("rope.stiffness", stiffness, stable_stiffness([Springs(pairs, 1.0)], number, total))
        bend = at_least_0("rope.bending_stiffness", bending_stiffness, 0.0)
    part = Part(
        masses,
        or_default("rope.radius", radius, 0.45 * spacing),
        pinned,
        material,
        colour,
        self_collision,
        velocity=velocity,
        position=position,
        words=ends(number),
    )
    bends = bends_along(np.arange(number), bend) if bend > 0 else None
    kinds = [Springs(pairs, 1.0)]
    tight = np.full(number - 1, distance / length - 1) if length < distance else None
    made_of = {
        "balls.mass": given_of(mass=mass, mass_per_length=mass_per_length, length=given_length),
        "springs.stiffness": given_of(EA=EA, young_modulus=young_modulus, radius=radius),
        "springs.damping": given_of(damping=damping),
        "bending.stiffness": given_of(EI=EI, young_modulus=young_modulus, radius=radius),
    }
    given: dict[str, Any] = {"stretched": tight, "bends": bends, "made_of": made_of}
    return build(scene, "rope", points, kinds, np.zeros((0, 3)), part, strength, drag, **given)


def _hanging(a: NDArray, b: NDArray, length: float, number: int, gravity: NDArray) -> NDArray[np.float64]:
    """Points (number, dim) [m] of a chain at rest between a and b, of equal masses and inextensible pieces. Raises SceneError."""
    piece = length / (number - 1)
    down = -np.eye(len(a))[1] if not gravity.any() else gravity / np.linalg.norm(gravity)
    drop = float((b - a) @ down)
    side = b - a - drop * down
    span = float(np.linalg.norm(side))
    if number == 2 or span < piece:
        more = f" more balls (n = {math.ceil(length / span) + 1}), or" if span > NARROWEST * length else ""
        says = (
            f"makes a fold narrower than a piece of {piece:.3g} m, where start and end are {span:.3g} m apart sideways"
        )
        raise SceneError("rope.length", length, says=f"{says}; give{more} ends that are further apart sideways")
    sideways, downward = _directions(span / piece, drop / piece, number - 1)
    steps = piece * (sideways[:, None] * side / span + downward[:, None] * down)
    return np.concatenate([a[None], a + np.cumsum(steps[:-1], axis=0), b[None]])


def _directions(span: float, drop: float, pieces: int) -> NDArray[np.float64]:
    """Unit directions (2, pieces), sideways and down, of the pieces of a hanging chain; span, drop: of all of it, in pieces.

    The slopes of its pieces fall by one weight of a ball over the sideways tension from each to the next. Newton's method finds
    the first slope and this difference from those of the catenary.
    """
    from scipy.optimize import brentq, root  # slow to import, and few ropes hang

    stretch = max(1.0, float(np.sqrt(pieces**2 - drop**2)) / span)
    half = brentq(lambda x: np.sinh(x) / x - stretch, 1e-9, 700.0, xtol=1e-14)
    bend = 2 * half / span
    unknown = np.array([np.sinh(np.arctanh(drop / pieces) + half) - bend / 2, bend])
    k = np.arange(pieces)

    def directions(unknown: NDArray) -> NDArray[np.float64]:
        slope = unknown[0] - k * unknown[1]
        return np.stack([np.ones(pieces), slope]) / np.hypot(1.0, slope)

    def off(unknown: NDArray) -> NDArray[np.float64]:
        return directions(unknown).sum(axis=1) - (span, drop)

    def change(unknown: NDArray) -> NDArray[np.float64]:
        sideways, down = directions(unknown)
        by_slope = np.stack([-down * sideways**2, sideways**3])
        return np.stack([by_slope.sum(axis=1), -by_slope @ k], axis=1)

    return directions(root(off, unknown, jac=change, tol=1e-14).x)


def _moduli(elastic: dict[str, float | None], radius: float | None, usual: tuple[float, float]) -> tuple[float, float]:
    """Stretch stiffness EA [N] and bending stiffness EI [N m^2] of a rope; usual: both, where nothing tells them."""
    stretch, bend, modulus = elastic["EA"], elastic["EI"], elastic["young_modulus"]
    if modulus is None:
        limp = usual[1] if stretch is None else 0.0
        return or_default("rope.EA", stretch, usual[0]), at_least_0("rope.EI", bend, limp)
    if radius is None:
        raise SceneError(
            "rope.young_modulus", says="needs the radius of the rope; give radius, or EA and EI in its place"
        )
    return _of_rod(validation.number("rope.young_modulus", modulus, positive=True), radius)


def _of_rod(modulus: float, radius: float | None) -> tuple[float, float]:
    """EA [N] and EI [N m^2] of a solid round rod with Young's modulus [Pa] and a radius [m]."""
    area = _area(radius)
    return modulus * area, modulus * area * area / (4 * np.pi)


def _area(radius: float | None) -> float:
    """Area of the cross section [m^2] of a rod with a radius [m]. Raises SceneError."""
    return float(np.pi * validation.number("rope.radius", radius, positive=True) ** 2)


@takes_center
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
        words={"border": np.arange(number + 1) > 0},
    )
    return build(scene, "wheel", points, kinds, np.zeros((0, 3)), part, strength, at_least_0("wheel.damping", damping))
