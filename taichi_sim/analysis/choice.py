"""The method that `auto` takes for a scene: Verlet, or a method that solves for what would make its steps short. No Taichi."""

from typing import NamedTuple

import numpy as np

from taichi_sim.analysis.element_rates import Declared
from taichi_sim.analysis.methods import IMPLICIT_EULER, TR_BDF2, VERLET, Method
from taichi_sim.analysis.stability import stability
from taichi_sim.analysis.strikes import strike_step
from taichi_sim.analysis.touching import may_touch
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.scene import Scene

__all__ = ["FRAME_STEP", "LONGEST_STEP", "SECOND_ORDER", "Choice", "Demand", "choose", "passes_of_stage"]

FRAME_STEP = 1.0 / 120.0  # s, of an implicit method for pictures: half a frame of 60 a second
LONGEST_STEP = 1e-3  # s, the article's step; what dt = "auto" takes where springs would allow more
CHEAP = 0.01  # s of work a simulated second, that nobody waits for
WORTH = 1.25  # times faster than Verlet, from which an implicit method is worth the motion that it damps
WORTH_TOUCHING = 2.0  # the same where contacts act, which the estimate knows least of
FEWEST_PASSES = 6.0  # of a stage
PASSES_PER_RADIAN = 0.12  # more, of the step times the frequency of the fastest motion
RIGID = 200.0  # rad: levels carry what is faster across a body, so that it needs no more passes than at that angle
# passes per radian of sheets that fold on something: measured 33 to 340 a stage of 20^2 to 96^2 balls of silk
FOLDING = 2.2
SECOND_ORDER = 4.0  # times the work of implicit Euler: two stages of TR-BDF2, each solved thirty times finer


class _Work(NamedTuple):
    """Seconds that one thread of a CPU takes for one spring or element, fitted to cloth, nets, ropes and jelly: for its force,
    for its part of a product with the matrix, and for setting up that matrix once in a stage."""

    force: float
    product: float
    begin: float


WORK = {
    "springs": _Work(6e-9, 5e-9, 24e-9),
    "bending": _Work(8e-9, 7e-9, 32e-9),
    "membranes": _Work(18e-9, 16e-9, 72e-9),
    "bricks": _Work(110e-9, 300e-9, 5e-6),
    "solids": _Work(40e-9, 55e-9, 300e-9),
}
OTHERS = _Work(8e-9, 8e-9, 32e-9)
BALL, SEARCHING_BALL = _Work(3e-9, 14e-9, 0.0), 33e-9  # the second for each step of one that may meet others


class Demand(NamedTuple):
    """Wishes for a simulation. step [s]: given, or None; contact_step [s]: the longest that contacts bear; advised [s]: the
    longest that `check` advises for impacts; contacts: whether any are looked for; by_error: whether the error chooses the
    step; part: of Verlet's bound that its steps have."""

    step: float | None
    contact_step: float
    advised: float
    contacts: bool
    by_error: bool
    part: float


class Choice(NamedTuple):
    """A method, the step [s] that goes with it, or None for that which any simulation takes, and why, in words."""

    method: Method
    step: float | None
    reason: str


def choose(scene: Scene, demand: Demand, custom: Declared, unknown: bool = False) -> Choice:
    """Choose by the step that is given, or else by the work that Verlet and an implicit method have in a simulated second.
    custom: what user-defined forces declare; unknown: whether one declares nothing."""
    longest = stability(scene, VERLET, None, custom).dt_any_shape
    if unknown:
        return Choice(VERLET, None, "a force of your own does not declare how stiff it is")
    if np.isinf(longest):
        return Choice(VERLET, None, "nothing that is stiff limits its step")
    if demand.step is None and np.isfinite(scene.break_strain).any():
        return Choice(VERLET, None, "long steps do not resolve the pulls that tear springs")
    if demand.step is None:
        return _cheaper(scene, longest, demand, custom)
    if demand.step <= longest:
        return Choice(VERLET, None, f"the step of {demand.step:.4g} s is within its bound of {longest:.4g} s")
    return Choice(
        IMPLICIT_EULER, None, f"the step of {demand.step:.4g} s is beyond the bound of {VERLET}, {longest:.4g} s"
    )


def _cheaper(scene: Scene, longest: float, demand: Demand, custom: Declared) -> Choice:
    """The cheaper method; that of second order where the error matters. longest [s]: the bound of Verlet."""
    method = TR_BDF2 if demand.by_error else IMPLICIT_EULER
    work = _work(scene)
    meeting = SEARCHING_BALL * _loose(scene) if demand.contacts else 0.0
    h = min(LONGEST_STEP, demand.part * longest, demand.contact_step)
    explicit = (VERLET.passes(scene, h) * work.force + meeting) / h
    if explicit < CHEAP:
        return Choice(VERLET, None, "its own short steps are too little work to save any of it")
    strikes = strike_step(scene, method) if demand.contacts else np.inf
    longest_step = 0.9 * stability(scene, method, None, custom).dt_any_shape
    step = min(FRAME_STEP, demand.contact_step, demand.advised, strikes, longest_step)
    touching = demand.contacts and may_touch(scene)
    passes = passes_of_stage(scene, step, longest, touching)
    stages = SECOND_ORDER if demand.by_error else 1.0
    implicit = (stages * (work.begin + passes * work.product) + meeting) / step
    why = ", the longest that answer impacts of balls on springs and elements," if step == strikes else ""
    costs = (
        f"{method} by steps of {step:.2g} s{why} takes an estimated {implicit / explicit:.2g} of the work of {VERLET}"
    )
    needed = WORTH_TOUCHING if touching else WORTH
    if explicit < needed * implicit:
        unsure = " where contacts may cost more" if touching else ""
        return Choice(VERLET, None, f"{costs}; auto wants less than {1.0 / needed:.2g}{unsure}")
    return Choice(method, None if demand.by_error else step, costs)


def passes_of_stage(scene: Scene, h: float, longest: float, touching: bool) -> float:
    """Estimate of the passes over the forces in a stage of `implicit_euler`, in steps of h [s]. longest [s]: the bound of Verlet;
    touching: whether anything may touch."""
    folding = touching and (len(scene.bends) > 0 or len(scene.membranes) > 0)
    return FEWEST_PASSES + (FOLDING if folding else PASSES_PER_RADIAN) * min(2.0 * h / longest, RIGID)


def _loose(scene: Scene) -> int:
    """Number of balls that may meet each other."""
    loose = int(np.count_nonzero((scene.body == 0) & ~scene.pinned))
    return loose if loose > 1 else 0


def _work(scene: Scene) -> _Work:
    """Work [s] of one pass over a scene."""
    counts = [(BALL, int(np.count_nonzero(~scene.pinned))), (WORK["springs"], scene.n_springs)]
    counts += [(WORK.get(one.name, OTHERS), one.count(scene)) for one in ELEMENTS if one.acts(scene)]
    return _Work(
        sum(work.force * count for work, count in counts),
        sum(work.product * count for work, count in counts),
        sum(work.begin * count for work, count in counts),
    )
