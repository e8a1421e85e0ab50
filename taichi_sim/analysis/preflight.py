"""Cautions: what a user should know before a run, as sentences."""

from collections.abc import Iterator

import numpy as np

from taichi_sim.analysis import contact_loads, rebounds, sieves, strikes, turning
from taichi_sim.analysis.accuracy import Setup, nearer, single_precision
from taichi_sim.analysis.methods import IMPLICIT_EULER, TR_BDF2, VERLET, Method
from taichi_sim.analysis.outcome import DEEP, STARTS_DEEP
from taichi_sim.analysis.stability import (
    coarsest_spring,
    overload_step,
    overloaded_spring,
    sinking_spring,
    sinking_step,
)
from taichi_sim.analysis.touching import overlap_of_bodies
from taichi_sim.common.quantities import at_most
from taichi_sim.scene.bending import BENDING
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.materials import max_restitution
from taichi_sim.scene.objects import ball_in_words
from taichi_sim.scene.scene import Scene

__all__ = ["cautions"]

FASTEST = 4.0  # radii that a pin may move in a substep
MOST_TURNED = 0.5  # of its angular momentum, that a method may take from a body in a second
MOST_BORNE = 0.5  # of the weight, that elements may bear too much where bodies rest on each other
MOST_RETURNED = 0.225  # of the speed of an impact without restitution: by sweeps, of masses 1:27
RESOLVED = 0.5  # of the time in which a spring answers a pull: in longer steps others tear, or none
MOST_FLEXED = 0.1  # of a rest length, that a motor may change it by


def cautions(scene: Scene, setup: Setup) -> Iterator[str]:
    """Warnings where single precision cannot resolve the scene, something goes through cloth, balls come back that should not,
    or substeps let heavy balls sink."""
    method, h = setup.method, setup.h
    if setup.precision == "f32" and scene.n_balls:
        lost, shows = single_precision(scene, setup)
        if shows:
            yield f"precision: {lost}; {nearer(scene)}"
        found = coarsest_spring(scene)
        if found is not None:
            spring, stretch, rounding = found
            yield (
                f"precision: the weight at spring {spring} stretches it by {stretch:.2g} m, and single precision tells positions"
                f' there {rounding:.2g} m apart; use precision "f64", softer springs, or build the scene nearer to the origin'
            )
    if setup.rule != "off":
        yield from map(sieves.through, sieves.sieves(scene))
        if where := overlap_of_bodies(scene, DEEP):
            yield f"overlap: {where}; {STARTS_DEEP}, or energy comes out of it"
        if (part := rebounds.returned(scene, setup.impacts)) > MOST_RETURNED:
            yield f"rebound: {rebounds.sentence(part)}; {rebounds.cure(scene)}"
    yield from _of_pins(scene, h)
    yield from _of_motors(scene, h)
    yield from _of_tearing(scene, method, h)
    if setup.rule != "off":
        yield from _of_impacts(scene, method, h)
        yield from _of_loads(scene, method, h)
    if (turn := turning.at_start(scene, method, h)) is not None:
        if turn.rate(method, h) > MOST_TURNED:
            yield f"rotation: {turning.sentence(turn, method, h)}; {turning.cure(turn, method, h)}"
    if scene.wind is not None and not len(scene.triangles):
        yield "wind: acts on triangles, and this scene has none"
    sinking = sinking_spring(scene, h) if method.single_pass else None
    if sinking is not None:
        ball = ball_in_words(scene.objects, sinking.ball)
        yield (
            f"{method}: spring {sinking.spring} carries {sinking.load:.3g} N at {ball} and is left about"
            f" {sinking.depth:.2g} m too long by the two passes of a step of {h:.3g} s, and others of its body by up to tens of"
            f" times that; take {IMPLICIT_EULER}, {TR_BDF2} or steps of {at_most(sinking_step(scene))} s"
        )
    yield from _of_hanging(scene, method, h)


def _of_hanging(scene: Scene, method: Method, h: float) -> Iterator[str]:
    """Of methods that solve for elements between two passes over springs."""
    over = overloaded_spring(scene, h) if method.single_pass and method.solves_elements else None
    if over is not None:
        yield (
            f"{method}: spring {over.spring} carries {over.load:.3g} N at {ball_in_words(scene.objects, over.ball)} and shows"
            f" about {over.part:.0%} more at rest, because steps of {h:.3g} s solve for elements between two passes over"
            f" springs; take {IMPLICIT_EULER}, {TR_BDF2} or steps of {min(h, overload_step(scene)):.2g} s"
        )


def _of_tearing(scene: Scene, method: Method, h: float) -> Iterator[str]:
    """Of methods whose steps springs do not limit."""
    if method.limit is None or method.limit.by_springs or not np.isfinite(scene.break_strain).any():
        return
    answer = _time_of_what_tears(scene)
    if h > RESOLVED * answer:
        yield (
            f"tearing: springs that may tear answer to a pull within {answer:.2g} s, which steps of {h:.3g} s by {method} do not"
            f" resolve: others may tear, or none; take {VERLET}, or steps of {at_most(RESOLVED * answer)} s"
        )


def _of_impacts(scene: Scene, method: Method, h: float) -> Iterator[str]:
    """One sentence on impacts that give energy, with one step, where balls strike springs or bodies bounce."""
    why, cure = strikes.unanswered(scene, method, h)
    if why:
        yield f"impacts: {why}; {cure}"
        return
    bounced, resolved = strikes.bounce_step(scene, method), strikes.resolved_bounce_step(scene, method)
    if h > min(bounced, resolved) * (1.0 + 1e-9):
        restitution = f"restitution of {max_restitution(scene):g}"
        what = f"bounce by their elasticity alone, without the {restitution}, where contacts press along what holds their balls"
        if h <= resolved:
            what = f"that bounce at a {restitution} may gain energy"
        yield (
            f"bounce: bodies of springs or elements {what}, because steps of {h:.3g} s by {method} do not resolve how fast"
            f" their balls swing; take steps of {at_most(min(bounced, resolved))} s"
        )


def _of_loads(scene: Scene, method: Method, h: float) -> Iterator[str]:
    """One sentence on bodies that rest on others and are squeezed too much."""
    excess = contact_loads.at_contacts(scene, method, h)
    if excess is not None and excess.on_balls and excess.most(method, h) > MOST_BORNE:
        yield f"load: {contact_loads.sentence(excess, method, h)}; {contact_loads.cure(excess, method, h)}"


def _time_of_what_tears(scene: Scene) -> float:
    """The shortest 1 / omega [s] of a spring that may tear, or an element whose sides may, by its own stiffness and masses.
    Bending pulls at no side."""
    inverse = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    tears = np.isfinite(scene.break_strain)
    rate = (scene.stiffness * inverse[scene.pairs].sum(axis=1))[tears].max()
    for form in (form for one in ELEMENTS if one is not BENDING and one.acts(scene) for form in one.stiffness(scene)):
        own = form.strength * ((form.gradient**2).sum(axis=2) * inverse[form.corners]).sum(axis=1)
        rate = max(rate, own[np.isin(form.corners, scene.pairs[tears]).all(axis=1)].max(initial=0.0))
    return float(1.0 / np.sqrt(rate)) if rate > 0.0 else np.inf


def _of_motors(scene: Scene, h: float) -> Iterator[str]:
    for k, motor in enumerate(scene.motors):
        if motor.fastest * h > MOST_FLEXED:
            yield (
                f"motors[{k}]: changes rest lengths by {motor.fastest * h:.2g} of themselves in a substep of {h:.3g} s: its"
                " springs cannot follow; make it slower, or give a smaller dt"
            )


def _of_pins(scene: Scene, h: float) -> Iterator[str]:
    for k, pins in enumerate(scene.moving_pins):
        centre = pins.motion.at(0.0)[0][0]
        arm = float(np.linalg.norm(scene.position[pins.balls] - centre, axis=1).max())
        speed, frame = pins.motion.fastest(arm)
        radius = float(scene.radius[pins.balls].min())
        if speed * h > FASTEST * radius:
            leap = speed * h / radius
            yield (
                f"moving_pins[{k}].path[{frame}]: from there on balls are led at {speed:.3g} m/s, {leap:.3g} radii in a substep"
                f" of {h:.3g} s: they may pass what they meet, and tear at their springs; give more time, or a smaller dt"
            )
