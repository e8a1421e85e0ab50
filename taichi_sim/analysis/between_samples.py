"""Extremes between samples: how often a run is to be read, and how far a quantity may go beyond the largest or least value that
was read."""

from collections.abc import Sequence
from math import ceil, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import stability

__all__ = ["beyond", "steps_between"]

PART = 0.25  # of the change from an extreme to a neighbour: 1/8 of a parabola, 0.21 of a wave of four samples
PER_PERIOD = 64  # readings in one of the fastest motion of springs: an extreme goes a thousandth beyond them
WORK = 1 << 27  # balls and elements read in a run
ALONE, EACH = 2048, 64  # what a reading by itself is worth of these, and a number


def beyond(values: Sequence[float] | NDArray[np.float64], at: int, ends: bool = False) -> float:
    """Bound of how far a quantity goes beyond its extreme sample number `at`, in its unit. values: (n,) at even times, those that
    are nan left out.

    A curve with at least four samples in its fastest period keeps to it; jumps need not. ends: where the motion may end at once
    between samples, as a pull that tears a spring, it may have gone on as far as before. At the first and the last sample the
    parabola through it and its two neighbours tells: a motion that starts there from rest goes no further.
    """
    known = np.flatnonzero(~np.isnan(values))
    found, at = np.asarray(values, dtype=np.float64)[known], int(np.searchsorted(known, at))
    changes = np.abs(np.diff(found))
    if 0 < at < len(changes):
        beside = changes[at - 1 : at + 1]
        return float(max(PART * beside.max(), beside.min() * ends))
    if len(changes) < 2:
        return 0.0
    first, second = (changes if at == 0 else changes[::-1])[:2]
    return PART * float((second - 3.0 * first) ** 2 / (second - first)) if second > 3.0 * first else 0.0


def steps_between(simulation: Any, duration: float, numbers: int) -> int:
    """Steps from one reading of so many numbers to the next in a run of `duration` [s]: 1 where contacts or anything else may act
    all at once. Springs alone move smoothly, which fewer show; and no run reads more than its WORK."""
    scene, parts, steps = simulation.scene, simulation.parts, max(1, round(duration / simulation.dt))
    if not numbers or not scene.n_balls:
        return steps
    size = scene.n_balls + scene.n_springs + len(scene.membranes) + scene.n_volumes()
    affordable = ceil(steps * (ALONE + EACH * numbers + size) / WORK)
    if parts.contacts.active or parts.driven or parts.tearing is not None or simulation.has_custom_parts:
        return affordable
    fastest = pi * stability(scene, named("verlet")).dt_any_shape  # s, its period
    return max(affordable, int(min(steps, fastest / PER_PERIOD / simulation.dt)))
