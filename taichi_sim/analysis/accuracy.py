"""Accuracy: what the step gets wrong in a scene, by how much, and the cure, worked out from the laws of the methods before
anything runs. Figures are orders of magnitude: tests hold them to runs within a factor of two where no other is named. No Taichi.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis import (
    coarse_meshes,
    contact_loads,
    late_impacts,
    lumped_inertia,
    near_at_rest,
    rebounds,
    shared_loads,
    sieves,
    turning,
)
from taichi_sim.analysis.diagnostics import inverted
from taichi_sim.analysis.methods import VERLET, Method
from taichi_sim.analysis.stability import stability
from taichi_sim.scene.scene import Scene, max_restitution

__all__ = [
    "Finding",
    "Setup",
    "findings",
    "impact_step",
    "layers",
    "rounding_error",
    "single_precision",
]

Floats = NDArray[np.float64]

LOW_BOUNCE = 0.01  # of the smallest radius: bounces that end below it are not missed
SMALL_ANGLE = 0.05  # rad: directions after impacts that are off by less are not spoken of
DEEP_OVERLAP = 0.1  # of the radius: overlap at rest that shows
VISIBLE_LOSS = 0.005  # of the smallest radius: loss of single precision that shows
FAR = 4.0  # half sizes of a scene from the origin: from there on a nearer place makes rounding smaller
WRONG_BEND = 0.003  # of a curvature: loss of single precision that is reported
# of the weight above, the part along each contact with the layer below: two, three contacts at 30, 35 degrees in close packs
LOAD_SHARE = {2: 0.577, 3: 0.408}
FILLED_SHARE = {2: 0.84, 3: 0.62}  # of the space, by discs and balls that fell


class Setup(NamedTuple):
    """Settings with which a scene is run: method, seconds per substep, precision ("f32", "f64"), contacts (`rule`, "off"
    where there are none). compensated: sums of positions keep what rounding takes. give: depth of a soft contact as a part
    of h^2 F / m, F [N] being the load of one solve and m [kg] the contact's mass; 0 where contacts are rigid. loses: crowds
    are held to their energy by scaling what bounces. impacts: how those of balls are solved, see `rebounds`. at_touch: whether
    those that bounce are solved at the moment of touch, see `late_impacts`."""

    method: Method
    h: float
    precision: str
    rule: str = "off"
    compensated: bool = True
    give: float = 0.0
    loses: bool = False
    impacts: str = rebounds.IN_TURN
    at_touch: bool = False


class Finding(NamedTuple):
    """One error: its subject, how much it is, and the cure, empty where it is small."""

    subject: str
    what: str
    cure: str = ""


def findings(scene: Scene, setup: Setup) -> Iterator[Finding]:
    """All that can be said of this scene and step."""
    if setup.rule != "off" and np.any(~scene.pinned):
        in_time = setup.at_touch and late_impacts.touch_in_time(scene)
        yield from _bounces(scene, setup.h, in_time)
        if not in_time:
            yield from _impacts(scene, setup.h)
        if (late := late_impacts.late_share(scene, scene.velocity, setup.h, setup.at_touch)) > 0.0:
            yield Finding("impact energy", late_impacts.sentence(late), late_impacts.cure(late, setup.h))
        yield from _overlap(scene, setup)
        if part := rebounds.returned(scene, setup.impacts):
            yield Finding("rebound", rebounds.sentence(part), rebounds.cure(scene))
        if (excess := contact_loads.at_contacts(scene, setup.method, setup.h)) is not None:
            words = contact_loads.sentence(excess, setup.method, setup.h)
            yield Finding("load at contacts", words, contact_loads.cure(excess, setup.method, setup.h))
        if shared_loads.are_read(scene):
            yield Finding("load", shared_loads.SENTENCE, shared_loads.CURE)
        if setup.loses:
            yield Finding(
                "crowds",
                "that should keep their energy, at restitution 1, lose about half of it in 2 s (measured, at any step)",
                'take contacts = "gauss_seidel"'
                if setup.rule == "jacobi"
                else "leave sticks, and surfaces that collide, out of such a scene",
            )
        for what, cure in sieves.findings(scene):
            yield Finding("surface", what, cure)
        for what, cure in near_at_rest.findings(scene):
            yield Finding("parts", what, cure)
    yield from _cells(scene)
    for what, cure in (
        *coarse_meshes.bent_findings(scene),
        *coarse_meshes.few_across(scene),
        *coarse_meshes.beyond_bricks(scene),
        *lumped_inertia.sluggish(scene),
    ):
        yield Finding("mesh", what, cure)
    yield from _turning(scene, setup)
    if setup.precision == "f32" and scene.n_balls:
        yield from _rounding(scene, setup)
        yield from _bending(scene)


def _turning(scene: Scene, setup: Setup) -> Iterator[Finding]:
    """Angular momentum that the method takes from the body that turns fastest at the start."""
    method, h = setup.method, setup.h
    if (turn := turning.at_start(scene, method, h)) is not None:
        yield Finding("rotation", turning.sentence(turn, method, h), turning.cure(turn, method, h))


# Bounces and impacts ---------------------------------------------------------------------------------------------------


def _bounces(scene: Scene, h: float, in_time: bool) -> Iterator[Finding]:
    """A ball that arrives with less than 2 g h is held: what would bounce lower than (2 g h)^2 / (2 g) = 2 g h^2 does not. The
    bounces left out would have taken 2 v e / (g (1 - e)) with v up to 2 g h. Another ball is hit h / 2 late, u h / 2 deep: at
    rest against gravity it takes (1 - e^2) m g u h / 2 too much of the (e u)^2 m / 2 that bounces.
    Walls are hit in time, and balls where impacts are solved at the moment of touch: in_time."""
    g, e = _gravity(scene), max_restitution(scene)
    if g == 0.0 or e == 0.0:
        return
    low, radius = 2.0 * g * h * h, float(scene.radius[~scene.pinned].min())
    early = f"; rest comes up to {4.0 * h * e / (1.0 - e):.2g} s early" if e < 1.0 else ""
    speed = _fastest(scene)
    if speed > 0.0 and scene.pinned.any() and not in_time and e < 1.0:
        lost = (1.0 / e**2 - 1.0) * g * h / speed
        early += f"; each bounce off a pinned ball is too low by {lost:.2g} of its height"
    wanted = np.sqrt(0.5 * LOW_BOUNCE * radius / g)
    yield Finding(
        "bounces",
        f"lower than {low:.2g} m, {low / radius:.2g} of the smallest radius, are left out{early}",
        f"take substeps of {wanted:.2g} s for bounces down to {LOW_BOUNCE:g} of the radius" if h > wanted else "",
    )


def _impacts(scene: Scene, h: float) -> Iterator[Finding]:
    turn = _turned(scene) * h
    if turn > 0.0:
        yield Finding(
            "impacts",
            f"of balls are noticed up to {h:.2g} s late; at {_fastest(scene):.3g} m/s, the largest speed that the start and a"
            f" fall give, they then leave in a direction that is wrong by about {turn:.2g} rad ({np.degrees(turn):.2g} degrees)",
            f"take substeps of {impact_step(scene):.2g} s, or a tolerance" if turn > SMALL_ANGLE else "",
        )


def impact_step(scene: Scene) -> float:
    """The step [s] that is advised for impacts of loose balls; infinite where there are none."""
    rate = _turned(scene)
    return 0.5 * SMALL_ANGLE / rate if rate > 0.0 else np.inf


def _turned(scene: Scene) -> float:
    """Angle by which balls part in a wrong direction, over the step h [1/s]. They are found to touch up to h late. By then the
    line between them has turned by u sin(a) t / d, with t = h / 2 and sin(a) = 1/2 (3D: 2/3) on average, and the direction in
    which they part by twice as much."""
    loose = scene.loose()
    if np.count_nonzero(loose) < 1 or scene.n_balls < 2:
        return 0.0
    return {2: 0.5, 3: 2.0 / 3.0}[scene.dim] * _fastest(scene) / (2.0 * float(np.median(scene.radius[loose])))


def _fastest(scene: Scene) -> float:
    """Speed [m/s] of a ball that starts as fast as any and falls by the height of the scene."""
    v = np.linalg.norm(scene.velocity[~scene.pinned], axis=1).max(initial=0.0)
    drop = float(np.ptp(scene.position @ scene.gravity)) if scene.n_balls else 0.0
    for wall in scene.walls:
        g2 = float(scene.gravity @ scene.gravity)
        if g2 > 0.0 and scene.gravity @ wall.normal < 0.0:  # a floor
            gap = (scene.position @ wall.normal - wall.offset).max()
            drop = max(drop, float(gap * g2 / -(scene.gravity @ wall.normal)))
    return float(np.sqrt(v * v + 2.0 * drop))


def _gravity(scene: Scene) -> float:
    return float(np.linalg.norm(scene.gravity))


# Piles -----------------------------------------------------------------------------------------------------------------


def _overlap(scene: Scene, setup: Setup) -> Iterator[Finding]:
    """A soft contact lets go of a part LEAK of its impulse F h in each pass and pushes out PUSH of its depth: they balance at
    the depth h^2 F LEAK / (SOFT PUSH m). F is the weight of the layers above."""
    g = _gravity(scene)
    loose = scene.loose()
    if setup.give == 0.0 or g == 0.0 or np.count_nonzero(loose) < 2:
        return
    radius = float(np.median(scene.radius[loose]))
    high = layers(scene, loose)
    column = np.count_nonzero(loose) < 1.5 * high  # one ball in each
    share = 1.0 if column else LOAD_SHARE[scene.dim]
    load = 1.0 / setup.method.contact_solves
    depth = 2.0 * setup.give * share * load * high * g * setup.h**2
    wanted = setup.h * np.sqrt(DEEP_OVERLAP * radius / depth)
    yield Finding(
        "overlap at rest",
        f"{depth:.2g} m, {depth / radius:.2g} of the radius, on average under {high:.2g} layers"
        f"{'' if column else '; ten times that where few carry many'}",
        f"take substeps of {wanted:.2g} s" if depth > DEEP_OVERLAP * radius else "",
    )


def layers(scene: Scene, loose: NDArray[np.bool_]) -> float:
    """Layers of a pile of these balls that is as wide, across gravity, as they lie now."""
    across = np.linalg.svd(scene.gravity[None])[2][1:]  # (dim - 1, dim), orthonormal
    radius = scene.radius[loose]
    width = np.ptp(scene.position[loose] @ across.T, axis=0) + 2.0 * float(np.max(radius))
    size = np.pi * radius**2 if scene.dim == 2 else 4.0 / 3.0 * np.pi * radius**3
    height = float(np.sum(size)) / (FILLED_SHARE[scene.dim] * float(np.prod(width)))
    return max(1.0, height / (2.0 * float(np.median(radius))))


# Single precision ------------------------------------------------------------------------------------------------------


def rounding_error(scene: Scene, setup: Setup) -> tuple[float, float, float]:
    """Loss of single precision: the distance [m] from the origin that counts, the distance [m] of neighbouring numbers
    there, and the error [m] after a second.

    A position is off by ulp / sqrt(12). Plain sums of 1/h steps walk off by sqrt(1 / h) times that. Where sums are compensated,
    forces still see the rounded places: springs of frequency w kick by h w^2 times it, which swings by h w sqrt(1 / h). A ball
    rests at a wall within 4 eps of its coordinates.
    """
    far = float(np.abs(scene.position).max())
    surfaces = [float(np.abs(c.motion.positions).max()) for c in scene.colliders]
    far = max([far, *surfaces])
    ulp = float(np.spacing(np.float32(far)))
    error, steps = ulp / np.sqrt(12.0), 1.0 / setup.h
    if setup.compensated:
        safe = stability(scene, VERLET).dt_any_shape  # 2 / w, or 0.63 of it
        error *= max(1.0, 2.0 * setup.h / safe * np.sqrt(steps)) if safe > 0.0 else 1.0
    else:
        error *= max(1.0, np.sqrt(steps))
    if setup.rule != "off" and (scene.walls or scene.colliders):
        error = max(error, 4.0 * float(np.finfo(np.float32).eps) * far)
    return far, ulp, float(error)


def single_precision(scene: Scene, setup: Setup) -> tuple[str, bool]:
    """Words on what single precision loses in this scene, and True if that shows."""
    far, ulp, error = rounding_error(scene, setup)
    small = float(scene.radius.min())
    still = "" if setup.compensated else f"; balls slower than {0.5 * ulp / setup.h:.2g} m/s stand still there"
    return (
        f"{far:.4g} m from the origin single precision tells positions {ulp:.2g} m apart, and is off by {error:.2g} m after a"
        f" second, {error / small:.2g} of the smallest radius{still}",
        error > VISIBLE_LOSS * small,
    )


def _cells(scene: Scene) -> Iterator[Finding]:
    """Cells that are inverted at the start, and those that nothing keeps from it."""
    if turned := inverted(scene, scene.position):
        yield Finding(
            "cells",
            f"{turned} of {scene.n_volumes()} are inverted at the start",
            "check their rest volumes and positions",
        )
    idle = (scene.bulk_modulus == 0.0) & (scene.crush_modulus == 0.0)
    if idle.any():
        yield Finding(
            "cells",
            f"{np.count_nonzero(idle)} of {len(scene.cells)} are only counted where they invert: nothing keeps their volume",
            "give the jelly a young_modulus in place of a stiffness; its cells then resist being crushed",
        )


def _rounding(scene: Scene, setup: Setup) -> Iterator[Finding]:
    what, shows = single_precision(scene, setup)
    yield Finding("rounding", what, nearer(scene) if shows else "")


def bending_error(scene: Scene) -> float:
    """Relative error of single precision in a bending element that is bent to a radius as large as the scene."""
    x, balls, w = scene.position, scene.bends, scene.bend_weights
    twice = 2.0 * w[:, 0] * w[:, 1] * (balls[:, 0] == balls[:, 1])  # a ball that is named twice has one rounding
    off = np.sqrt((np.sum(w**2, axis=1) + twice) / 12.0) * np.spacing(np.float32(np.abs(x).max()))
    apart = np.sum((x[balls] - x[balls[:, :1]]) ** 2, axis=2)
    bent = 0.5 * np.sum(np.abs(w) * apart, axis=1) / max(1e-300, float(np.ptp(x, axis=0).max()))
    acts = scene.bend_stiffness > 0.0
    return float(np.divide(off, bent, out=np.zeros_like(off), where=(bent > 0.0) & acts).max(initial=0.0))


def _bending(scene: Scene) -> Iterator[Finding]:
    error = bending_error(scene)
    if error > WRONG_BEND:
        yield Finding(
            "bending",
            f"elements are so small that single precision is off by {error:.2g} of the curvature of one bent to a radius as"
            " large as the scene",
            'use precision "f64", or fewer balls',
        )


def nearer(scene: Scene) -> str:
    """Cure of rounding, which a place nearer to the origin is only for a scene that is far from it by its size."""
    wide = 0.5 * float(np.ptp(scene.position, axis=0).max())
    far = float(np.abs(scene.position).max())
    return f'use precision "f64"{", or build the scene nearer to the origin" * (far > FAR * wide)}'
