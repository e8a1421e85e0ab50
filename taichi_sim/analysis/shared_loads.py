"""Shared loads: what a probe of force on a wall or collider means where balls at rest hold each other by friction. No Taichi."""

import numpy as np

from taichi_sim.scene.probes import bodies_of
from taichi_sim.scene.scene import Scene

__all__ = ["CURE", "SENTENCE", "are_read"]

SENTENCE = (
    "that balls at rest put on a wall or collider depends on how they came to rest, because friction at rest can be anything up"
    " to its bound: of 200 discs between two walls, floors carry 0.84 to 1.2 of the weight, with steps of 1 to 0.1 ms alike"
)
CURE = "let the floor sink by a radius before you read the force, or take the mean over several starts"


def are_read(scene: Scene) -> bool:
    """True if a force or impulse is asked of one of several surfaces that loose balls with friction may lie on."""
    loose = scene.loose()
    rough = any(scene.materials[k].friction > 0.0 for k in np.unique(scene.material[loose]))
    several = len(scene.walls) + len(scene.colliders) > 1 and np.count_nonzero(loose) > 2
    return bool(bodies_of(scene) and several and rough and np.any(scene.gravity != 0.0))
