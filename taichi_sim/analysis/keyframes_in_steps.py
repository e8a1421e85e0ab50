"""Keyframes of colliders that lie inside a step: what rests on one leaves it at an end of that step. Imports no Taichi."""

from collections.abc import Iterator

import numpy as np

from taichi_sim.common.quantities import measured
from taichi_sim.scene.colliders import Collider
from taichi_sim.scene.scene import Scene

__all__ = ["inside_steps"]

AT_AN_END = 1e-6  # of a step: a keyframe as near to its end


def inside_steps(scene: Scene, h: float, end: float) -> Iterator[str]:
    """Words on the keyframe inside a step of h [s], up to the time `end` [s], at which a collider changes its velocity most."""
    found = [(p * h, t, k) for k, one in enumerate(scene.colliders) for t, p in _changes(one, end) if _is_inside(t, h)]
    if not found or not scene.n_balls:
        return
    aside, time, k = max(found)
    yield (
        f"keyframes inside a step (collider {k} at {time:.4g} s: what rests on it may be {measured(aside, unit='m')} aside;"
        " choose steps that end there)"
    )


def _is_inside(time: float, h: float) -> bool:
    return abs(time / h - round(time / h)) > AT_AN_END


def _changes(collider: Collider, end: float) -> Iterator[tuple[float, float]]:
    """Times [s] up to `end` of keyframes, and by how much the velocity of the collider changes there [m/s]. Later rounds of
    a path that repeats are left out."""
    motion = collider.motion
    if len(motion.times) < 2:
        return
    velocity = np.diff(motion.positions, axis=0) / np.diff(motion.times)[:, None]
    still = np.zeros((1, velocity.shape[1]))
    before, after = (velocity[-1:], velocity[:1]) if motion.repeat else (still, still)
    change = np.linalg.norm(np.diff(np.concatenate([before, velocity, after]), axis=0), axis=1)
    for time, much in zip(motion.times, change):
        if 0.0 < time < end and much > 0.0:
            yield float(time), float(much)
