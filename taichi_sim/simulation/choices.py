"""Choices of an assembly: the driver, the contact rule, the order of springs, compensated sums, the balls that turn."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.touching import may_collide
from taichi_sim.common.errors import SceneError
from taichi_sim.contacts import CONTACT_RULES, ContactRule
from taichi_sim.device.backend import Backend
from taichi_sim.device.engine import another
from taichi_sim.forces.element import Element
from taichi_sim.forces.spring_colours import MOST_COLOURS
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.scene import Scene, used_materials
from taichi_sim.simulation.settings import Settings

__all__ = ["compensates", "divides", "is_serial", "is_small", "order_of_springs", "rule_of", "turning"]

# balls + springs and their like, up to which one thread is faster than two. A substep that looks for contacts has some fifty
# parallel loops, which two threads take 1.2 ms to begin: a jelly of 24 000 takes 0.5 ms fused, 1.5 ms on two threads
FUSED_UP_TO, FUSED_WITH_SEARCH = 20_000, 60_000
SEARCHED = 2  # added for each ball there: 20 000 balls alone
FINEST_ROUNDING = 1e-11  # of a radius: rounding of positions that adds up to 1e-9 in some thousand steps


def rule_of(settings: Settings, cpu: bool) -> ContactRule:
    """A fixed order of pairs is what Gauss-Seidel is made of; atomics take all at once. It needs half the iterations, and
    impacts one by one, which need the blocks of a CPU, keep the energy of what bounces."""
    ordered = cpu and settings.accumulate in ("auto", "ordered")
    rule = settings.contacts
    if isinstance(rule, str):
        rule = CONTACT_RULES[("gauss_seidel" if ordered else "jacobi") if rule == "auto" else rule]()
    if rule.in_turn and not ordered:
        atomic = cpu or settings.accumulate == "atomic"
        why = f"accumulate: {settings.accumulate!r}" if atomic else "a GPU"
        raise SceneError(
            "contacts",
            says=f"{rule.name!r} changes velocities in a fixed order, which {why} does not have; use 'jacobi' or 'sum'"
            + (", or accumulate 'ordered'" if cpu else ""),
        )
    return another(rule)  # one object may serve several simulations


def divides(settings: Settings, integrator: Any, contacts: ContactRule) -> bool:
    """True if substeps that gain energy are to be divided: of methods that solve stages, before they know of contacts."""
    return (
        settings.substeps == "auto" and settings.tolerance is None and contacts.active and bool(integrator.counters())
    )


def order_of_springs(scene: Scene, integrator: Any, fixed: str, *, cpu: bool, atomic: bool, parallel: bool) -> str:
    """Order in which forces of springs are added: the `fixed` one, but where the method visits each spring once or in turn."""
    once = integrator.each_once  # in blocks, padded or not; a GPU has more threads than there are
    coloured = once and integrator.in_turn and np.bincount(scene.pairs.ravel()).max() <= MOST_COLOURS // 2
    if atomic:
        return "atomic"
    if once and parallel and not integrator.in_turn:
        return "ends"
    if coloured and (parallel or not cpu):  # ordered alike on both
        return "colours"
    if once and not cpu:
        return "atomic"
    if once and fixed == "gather":
        return "blocks"
    return "batches" if integrator.in_turn and fixed == "padded" else fixed


def _size(scene: Scene) -> int:
    """Work of a substep: balls and springs, and elements by what they take of these."""
    return scene.n_balls + scene.n_springs + sum(one.work * one.count(scene) for one in ELEMENTS if one.work)


def is_small(scene: Scene) -> bool:
    return _size(scene) <= FUSED_UP_TO


def is_serial(scene: Scene, settings: Settings, threads: int) -> bool:
    """True if a CPU runs the scene on one thread: where that was asked for, or more threads would gain nothing."""
    if settings.driver != "auto":
        return settings.driver == "fused"
    if threads == 1 or is_small(scene):
        return True
    if settings.contacts == "off" or _size(scene) + SEARCHED * scene.n_balls > FUSED_WITH_SEARCH:
        return False
    return may_collide(scene) or bool(scene.solid.any() or scene.collides.any())


def compensates(scene: Scene, backend: Backend, integrator: Any) -> bool:
    """True if sums keep what rounding takes from them. Large scenes are bound by memory, where that would cost a tenth of the
    speed of explicit methods."""
    return (is_small(scene) or integrator.refines(scene)) and _rounds(scene, backend)


def _rounds(scene: Scene, backend: Backend) -> bool:
    """True if sums of many small steps lose digits that show: in single precision, or far from the origin."""
    if backend.precision == "f32" or not scene.n_balls:
        return backend.precision == "f32"
    return float(np.max(np.abs(scene.position))) * float(np.finfo(np.float64).eps) > FINEST_ROUNDING * float(
        np.min(scene.radius)
    )


def turning(scene: Scene, settings: Settings, forces: Sequence[Any] = ()) -> NDArray[np.bool_]:
    """Mask (n,) of the balls that turn: "auto" selects loose ones where Coulomb friction can make them turn. Those of cloth and
    jelly, which springs, cells and the like, user-defined elements too, join at their centres, would only roll under it like
    casters."""
    if settings.contacts == "off" or settings.spin is False:
        return np.zeros(scene.n_balls, dtype=bool)
    if settings.spin is True:
        return np.ones(scene.n_balls, dtype=bool)
    joined = scene.joined()
    for force in forces:
        if isinstance(force, Element):
            joined[force.corners(scene)] = True
    return ~scene.pinned & ~joined & any(m.friction > 0 for m in used_materials(scene))
