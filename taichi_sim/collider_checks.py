"""Colliders that cannot do what their scene says: an error or a warning before anything runs. Imports no Taichi."""

import warnings

import numpy as np

from taichi_sim.diagnostics import collider_depth
from taichi_sim.errors import SceneError
from taichi_sim.groups import meet
from taichi_sim.scene import Scene

__all__ = ["check_colliders"]

FASTEST = 4.0  # radii of the smallest ball in a step: what pushes faster throws balls about


def check_colliders(scene: Scene, h: float) -> None:
    """Raise SceneError where a collider starts around the centres of balls; warn where one moves too far in h seconds."""
    free = ~scene.pinned
    for k, collider in enumerate(scene.colliders):
        depth = collider_depth(scene, collider, scene.position, 0.0)
        inside = np.flatnonzero((depth > scene.radius) & meet(scene.group, scene.mask, collider.group, collider.mask))
        if len(inside):
            more = f" and {len(inside) - 3} more" if len(inside) > 3 else ""
            names = ", ".join(str(i) for i in inside[:3])
            plural = "s" if len(inside) > 1 else ""
            raise SceneError(
                f"colliders[{k}] ({collider.name}): starts around ball{plural} {names}{more},"
                f" up to {depth[inside].max():.4g} m deep; move it or the balls, or pin them"
            )
        if not collider.motion.moves or not free.any():
            continue
        speed, keyframe = collider.motion.fastest(collider.extent)
        smallest = float(scene.radius[free].min())
        if speed * h > FASTEST * smallest:
            where = f", path[{keyframe}]" if len(collider.motion.times) > 1 else ""
            warnings.warn(
                f"colliders[{k}] ({collider.name}){where}: moves at up to {speed:.4g} m/s, {speed * h / smallest:.3g} radii"
                f" of the smallest ball in one step of {h:.4g} s: it jumps rather than pushes; take more time, or a smaller dt",
                stacklevel=4,
            )
