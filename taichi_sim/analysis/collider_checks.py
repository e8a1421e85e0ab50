"""Walls and colliders that cannot do what their scene says: an error or a warning before anything runs. Imports no Taichi."""

import warnings

import numpy as np

from taichi_sim.analysis.diagnostics import collider_depth
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.collision_groups import meet
from taichi_sim.scene.scene import Scene

__all__ = ["check_colliders"]

FASTEST = 4.0  # radii of the smallest ball in a step: what pushes faster throws balls about


def check_colliders(scene: Scene, h: float) -> None:
    """Raise SceneError where a collider starts around the centres of balls; warn where one moves too far in h seconds, and where
    a wall does so: it puts balls out at once."""
    free = ~scene.pinned
    _warn_of_walls(scene)
    for k, collider in enumerate(scene.colliders):
        depth = collider_depth(scene, collider, scene.position, 0.0)
        inside = np.flatnonzero((depth > scene.radius) & meet(scene.group, scene.mask, collider.group, collider.mask))
        if len(inside):
            more = f" and {len(inside) - 3} more" if len(inside) > 3 else ""
            names = ", ".join(str(i) for i in inside[:3])
            plural = "s" if len(inside) > 1 else ""
            raise SceneError(
                f"colliders[{k}]",
                says=f"the {collider.name} starts around ball{plural} {names}{more}, up to {depth[inside].max():.4g} m deep;"
                " move it or the balls, or pin them",
            )
        if not collider.motion.moves or not free.any():
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            speed, keyframe = collider.motion.fastest(collider.extent)
        if not np.isfinite(speed * h):
            raise SceneError(f"colliders[{k}]", says=f"the {collider.name} moves faster than any number says")
        smallest = float(scene.radius[free].min())
        if speed * h > FASTEST * smallest:
            where = f", path[{keyframe}]" if len(collider.motion.times) > 1 else ""
            warnings.warn(
                f"colliders[{k}] ({collider.name}){where}: moves at up to {speed:.4g} m/s, {speed * h / smallest:.3g} radii"
                f" of the smallest ball in one step of {h:.4g} s: it jumps rather than pushes; take more time, or a smaller dt",
                stacklevel=4,
            )


def _warn_of_walls(scene: Scene) -> None:
    for k, wall in enumerate(scene.walls):
        depth = wall.offset - scene.position @ wall.normal
        depth[scene.pinned | ~meet(scene.group, scene.mask, wall.group, wall.mask)] = -np.inf
        inside = np.flatnonzero(depth > 0.0)
        if len(inside):
            deepest = int(np.argmax(depth))
            others = f" and {len(inside) - 1} more" if len(inside) > 1 else ""
            warnings.warn(
                f"walls[{k}]: ball {deepest}{others} start{'' if others else 's'} with the centre in the solid, up to"
                f" {depth[deepest]:.4g} m deep: the wall puts them out at once, which adds what energy that takes",
                stacklevel=5,
            )
