"""The method that `auto` takes for a scene: Verlet, or a method that solves for what would make its steps short. No Taichi."""

from typing import NamedTuple

import numpy as np

from taichi_sim.analysis.element_rates import Declared
from taichi_sim.analysis.methods import IMPLICIT_EULER, TR_BDF2, VERLET, Method
from taichi_sim.analysis.stability import stability
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.scene import Scene

__all__ = ["FRAME_STEP", "Choice", "Demand", "choose"]

FRAME_STEP = 1.0 / 120.0  # s, of an implicit method for pictures: half a frame of 60 a second
LONGEST_STEP = 1e-3  # s, of Verlet
CHEAP = 1e6  # springs and elements a simulated second that nobody waits for: some 10 to 50 ms
WORTH = 1.2  # times cheaper than Verlet, from which an implicit method is worth the motion that it damps

# Cost of an implicit stage, in passes of an explicit method over all forces, fitted to cloth, nets, ropes and jelly on a CPU. Its
# own passes grow with the step times the frequency of the fastest motion; bodies that hardly deform need no more than RIGID.
FEWEST_PASSES, PASSES_PER_RADIAN, RIGID = 6.0, 0.4, 150.0
PASS_COST = 1.3  # of its passes: each multiplies by a matrix and has sums to join
BEGINNING = {"bricks": 30.0, "solids": 10.0}  # passes that a matrix takes to set up, by elements
OTHERS_BEGIN = 4.0
SECOND_ORDER = 4.0  # times the cost of implicit Euler: two stages of TR-BDF2, each solved thirty times finer


class Demand(NamedTuple):
    """Wishes for a simulation. step [s]: given, or None; contact_step [s]: the longest that contacts bear; by_error: whether the
    error chooses the step; part: of Verlet's bound that its steps have."""

    step: float | None
    contact_step: float
    by_error: bool
    part: float


class Choice(NamedTuple):
    """A method, the step [s] that goes with it, or None for that which any simulation takes, and why, in words."""

    method: Method
    step: float | None
    reason: str


def choose(scene: Scene, demand: Demand, custom: Declared, unknown: bool = False) -> Choice:
    """Choose by the step that is given, or else by the passes over springs and elements that Verlet and an implicit method need
    in a simulated second. custom: what user-defined forces declare; unknown: whether one declares nothing."""
    longest = stability(scene, VERLET, None, custom).dt_any_shape
    if unknown:
        return Choice(VERLET, None, "a force of your own does not declare how stiff it is")
    if np.isinf(longest):
        return Choice(VERLET, None, "nothing that is stiff limits its step")
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
    h = min(LONGEST_STEP, demand.part * longest, demand.contact_step)
    explicit = VERLET.passes(scene, h) / h
    step = min(FRAME_STEP, demand.contact_step, 0.9 * stability(scene, method, None, custom).dt_any_shape)
    implicit = (SECOND_ORDER if demand.by_error else 1.0) * _stage_cost(scene, 2.0 * step / longest) / step
    acting = {one.name: one.count(scene) for one in ELEMENTS if one.acts(scene)}
    if explicit * (scene.n_springs + sum(acting.values())) < CHEAP:
        return Choice(VERLET, None, f"its {explicit:.3g} passes over the forces in a simulated second cost little here")
    costs = (
        f"{VERLET} takes {explicit:.3g} passes over the forces in a simulated second, {method} in steps of {step:.4g} s about as"
        f" much time as {implicit:.3g}"
    )
    if explicit < WORTH * implicit:
        return Choice(VERLET, None, costs)
    return Choice(method, None if demand.by_error else step, costs)


def _stage_cost(scene: Scene, angle: float) -> float:
    """Cost of a stage, in passes of an explicit method; angle: the step times the frequency of the fastest motion [rad]."""
    passes = FEWEST_PASSES + min(PASSES_PER_RADIAN * angle, RIGID)
    begins = [BEGINNING.get(one.name, OTHERS_BEGIN) for one in ELEMENTS if one.acts(scene)]
    return max([OTHERS_BEGIN, *begins]) + PASS_COST * passes
