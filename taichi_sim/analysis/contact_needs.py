"""What the contacts of a scene need: whether there may be any, whether a solve may gain energy, what is too slow to bounce."""

import numpy as np

from taichi_sim.scene.scene import Scene, max_restitution

__all__ = ["may_collide", "may_gain", "slowest_bounce"]

MOST_BOUNCE = 0.5  # above that, passes over many contacts could add energy


def slowest_bounce(scene: Scene, h: float) -> float:
    """The approach speed below which nothing bounces [m/s]: twice what gravity adds in a substep of h seconds; without gravity
    everything does."""
    return 2.0 * float(np.linalg.norm(scene.gravity)) * h


def may_gain(scene: Scene, rule: str, warm: bool, rows: bool) -> bool:
    """Whether a contact solve could add energy: not where little bounces, nor with split masses from nothing, nor where pairs
    in turn bounce one by one; they do without rows, contacts of more than two balls."""
    return max_restitution(scene) > MOST_BOUNCE and (rows if rule == "gauss_seidel" else rule == "jacobi" and warm)


def may_collide(scene: Scene) -> bool:
    """Whether any two balls may touch: not both pinned, not of one body, not joined by a spring."""
    n = scene.n_balls
    total = n * (n - 1) // 2
    held = int(scene.pinned.sum())
    bodies = np.bincount(scene.body[scene.body > 0]).astype(np.int64)
    both = np.bincount(scene.body[(scene.body > 0) & scene.pinned]).astype(np.int64)  # pinned and of one body: once
    total -= held * (held - 1) // 2 + int(np.sum(bodies * (bodies - 1) // 2) - np.sum(both * (both - 1) // 2))
    pairs = np.unique(np.sort(scene.pairs, axis=1), axis=0)
    i, j = pairs[:, 0], pairs[:, 1]
    apart = (scene.body[i] == 0) | (scene.body[i] != scene.body[j])
    total -= int(np.sum(apart & ~(scene.pinned[i] & scene.pinned[j])))
    return total > 0
