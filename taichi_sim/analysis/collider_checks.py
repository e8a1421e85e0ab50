"""Walls and colliders that cannot do what their scene says: an error or a warning before anything runs. Imports no Taichi."""

import numpy as np

from taichi_sim.analysis.diagnostics import collider_depth
from taichi_sim.common.errors import SceneError
from taichi_sim.common.warn import warn
from taichi_sim.scene.collision_groups import meet
from taichi_sim.scene.objects import ball_in_words, balls_in_words
from taichi_sim.scene.scene import Scene

__all__ = ["check_colliders"]

FASTEST = 4.0  # radii of the smallest ball in a step: what pushes faster throws balls about


def check_colliders(scene: Scene, h: float) -> None:
    """Raise SceneError where a collider starts around the centres of balls, and where pins tear a surface that collides across
    the whole scene in h seconds; warn where a collider moves too far in them, and where a wall starts around balls: it puts them
    out at once."""
    with scene.in_file():
        _refuse_leaps(scene, h)
        _check_each(scene, h)


def _refuse_leaps(scene: Scene, h: float) -> None:
    """Refuse steps on whose way every triangle would be near every other: lists of all pairs, and nothing that they could
    mend. Raises SceneError."""
    surfaces = scene.triangles[scene.solid]
    if not len(surfaces):
        return
    wide = float(np.linalg.norm(np.ptp(scene.position, axis=0))) + 2.0 * float(scene.radius.max())
    for k, pins in enumerate(scene.moving_pins):
        led = np.isin(surfaces, pins.balls)
        if not (led.any(axis=1) & ~led.all(axis=1)).any():  # no triangle, or as a whole
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            arm = float(np.linalg.norm(scene.position[pins.balls] - pins.motion.at(0.0)[0][0], axis=1).max())
            way = pins.motion.fastest(arm)[0] * h
            if len(pins.motion.times) > 1:
                way = min(way, float(np.linalg.norm(np.ptp(pins.motion.positions, axis=0))) + 2.0 * arm)
        if not way <= wide:
            says = (
                f"leads some balls of a surface that collides {way:.3g} m in one step of {h:.3g} s, farther than the scene is"
                f" wide, {wide:.3g} m; give more time, or a smaller dt"
            )
            raise SceneError(f"moving_pins[{k}]", says=says)


def _check_each(scene: Scene, h: float) -> None:
    free = ~scene.pinned
    _warn_of_walls(scene)
    for k, collider in enumerate(scene.colliders):
        depth = collider_depth(scene, collider, scene.position, 0.0)
        inside = np.flatnonzero((depth > scene.radius) & meet(scene.group, scene.mask, collider.group, collider.mask))
        if len(inside):
            what = f"{collider.name} {collider.label!r}" if collider.label else collider.name
            raise SceneError(
                f"colliders[{k}]",
                says=f"the {what} starts around {balls_in_words(scene.objects, inside.tolist())}, up to"
                f" {depth[inside].max():.4g} m deep;"
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
            warn(
                f"{collider.in_words(k)}{where}: moves at up to {speed:.4g} m/s, {speed * h / smallest:.3g} radii"
                f" of the smallest ball in one step of {h:.4g} s: it jumps rather than pushes; take more time, or a smaller dt"
            )


def _warn_of_walls(scene: Scene) -> None:
    for k, wall in enumerate(scene.walls):
        depth = wall.offset - scene.position @ wall.normal
        depth[scene.pinned | ~meet(scene.group, scene.mask, wall.group, wall.mask)] = -np.inf
        inside = np.flatnonzero(depth > 0.0)
        if len(inside):
            deepest = int(np.argmax(depth))
            others = f" and {len(inside) - 1} more" if len(inside) > 1 else ""
            one = ball_in_words(scene.objects, deepest)
            warn(
                f"walls[{k}]: {one}{others} start{'' if others else 's'} with the centre in the solid, up to"
                f" {depth[deepest]:.4g} m deep: the wall puts them out at once, which adds what energy that takes"
            )
