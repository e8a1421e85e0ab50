"""Balloon: a ball of skin with gas in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.spelling import takes_center, takes_color
from taichi_sim.geometry.mesh import Surface, surface_area
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes import cloth_material
from taichi_sim.shapes.base import Part, Pins, Shape, Springs, affordable, at_least_0, build, or_default

__all__ = ["balloon"]

RUBBER_DENSITY = 0.2  # kg/m^2
RUBBER_STIFFNESS = 100.0  # N/m
MOST_CUTS = 30  # more balls than any memory holds
STRAIN = 0.1  # of the skin, by default
MOST_STRETCH = 0.5  # part of the present length by which the skin may be stretched


@takes_center
@takes_color
def balloon(
    scene: Scene,
    centre: Sequence[float],
    radius: float,
    subdivisions: int = 3,
    *,
    pressure: float | None = None,
    mass: float | None = None,
    stretch_stiffness: float = RUBBER_STIFFNESS,
    damping: float | None = None,
    ball_radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
) -> Shape:
    """A balloon in 3D: an icosahedron whose triangles are cut in four again and again, and gas in it.

    Its skin is stretched so that it holds the gas at the start, tension = pressure radius / 2.

    Args:
        centre: (3,) of the balloon [m]; radius: of its skin [m].
        subdivisions: how often each triangle is cut in four; s times give 10 4^s + 2 balls.
        pressure: of the gas over that outside [Pa]; by default what stretches the skin by a tenth.
        mass: of the skin [kg]; 0.2 kg per m^2 by default.
        stretch_stiffness: of the skin [N/m], as of a cloth.
        damping: of the skin [N s/m], shared out as the stretch stiffness is.
        ball_radius: of each ball [m]; 0.4 of the mean edge by default.
    """
    if scene.dim != 3:
        raise SceneError("balloon", says="needs a scene with dim = 3")
    middle = validation.vectors("balloon.centre", centre, 1, 3)[0]
    reach = validation.number("balloon.radius", radius, positive=True)
    cuts = validation.whole("balloon.subdivisions", subdivisions, 0, MOST_CUTS)
    balls = 10 * 4**cuts + 2
    affordable("balloon.subdivisions", subdivisions, balls, 3 * balls)
    stretch = validation.number("balloon.stretch_stiffness", stretch_stiffness, positive=True)
    holds = 8 * stretch / (3 * reach)  # Pa, for each part by which the skin is stretched
    inner = at_least_0("balloon.pressure", pressure, holds * STRAIN / (1 + STRAIN))
    if inner > MOST_STRETCH * holds:
        raise SceneError(
            "balloon.pressure",
            inner,
            f"at most {MOST_STRETCH * holds:.4g} Pa, where its skin is twice as long as at rest; give a larger stretch_stiffness",
        )
    surface = icosphere(cuts)
    surface = Surface(surface.vertices * reach, surface.triangles)
    total = or_default("balloon.mass", mass, RUBBER_DENSITY * surface_area(surface))
    parts = cloth_material.of_mesh(
        surface, cloth_material.Fabric(total / surface_area(surface), stretch, 0.0, 0.0, 0.0)
    )
    pairs, strength = parts.springs[0]
    edges = surface.vertices[pairs[:, 1]] - surface.vertices[pairs[:, 0]]
    pull = 0.5 * inner * reach * cloth_material.tension_shares(surface)  # N/m of the edge's length
    size = or_default("balloon.ball_radius", ball_radius, 0.4 * float(np.linalg.norm(edges, axis=1).mean()))
    drag = at_least_0("balloon.damping", damping)
    if position is not None:
        middle = middle + validation.vector("balloon.position", position, 3)
    shape = build(
        scene,
        "balloon",
        surface.vertices,
        [Springs(pairs, 0.0, strength)],
        surface.triangles,
        Part(parts.mass, size, pinned, material, colour, self_collision, velocity=velocity, position=middle),
        0.0,
        None if drag is None else drag / stretch * strength,
        stretched=pull / (strength - pull),
    )
    scene.add_gas(shape.triangles, pressure=inner)
    return shape
