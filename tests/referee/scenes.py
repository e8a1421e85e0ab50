"""Scenes from scenes: a part, a mirror image, other units, a moving frame, many side by side in one."""

from dataclasses import replace
from typing import Any

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.elements import ELEMENTS

from .adding import Adding, Change, NoSuchSceneError

__all__ = ["Change", "NoSuchSceneError", "changed", "components", "embedded", "merged", "part", "renumbered", "walls"]


def _blank(scene: ts.Scene, gravity: Any = None) -> ts.Scene:
    out = ts.Scene(scene.dim, scene.gravity if gravity is None else gravity)
    out.settings, out.output = dict(scene.settings), dict(scene.output)
    return out


def changed(scene: ts.Scene, change: Change) -> ts.Scene:
    """The same scene mirrored, turned, in other units, elsewhere, or in motion. Raises NoSuchSceneError."""
    out = _blank(scene, change.direction(scene.gravity) * (change.length / change.time**2))
    Adding(out, scene, change, np.arange(scene.n_balls)).all()
    return out


def part(scene: ts.Scene, keep: Any) -> ts.Scene:
    """The scene with the balls `keep` alone, and what joins them."""
    out = _blank(scene)
    Adding(out, scene, Change(), np.asarray(keep, dtype=int)).all()
    return out


def renumbered(scene: ts.Scene, order: Any) -> ts.Scene:
    """The scene with its balls in another order: the k-th is what was the order[k]-th."""
    return part(scene, order)


def merged(scenes: list[ts.Scene], shifts: list[float]) -> ts.Scene:
    """All of them in one, the k-th moved along x by shifts[k]. Walls that differ collide with their own balls only."""
    alike = {walls(scene, shift) for scene, shift in zip(scenes, shifts)}
    out = _blank(scenes[0])
    for k, (scene, shift) in enumerate(zip(scenes, shifts)):
        by = np.zeros(scene.dim)
        by[0] = shift
        group = None if len(alike) == 1 else f"g{k}"
        Adding(out, scene, Change(shift=by), np.arange(scene.n_balls), group).all()
    return out


def walls(scene: ts.Scene, shift: float) -> tuple:
    """Walls with their laws, moved along x by `shift`: what two scenes must share to do without groups."""
    rows = []
    for wall in scene.walls:
        m = scene.materials[wall.material]
        law = (m.restitution, m.friction, m.viscous_friction)
        rows.append((wall.normal, wall.offset + wall.normal[0] * shift, law))
    return tuple(rows)


def embedded(scene: ts.Scene) -> ts.Scene:
    """A 2D scene in 3D, at z = 0. Raises NoSuchSceneError where it is another one there: discs turn otherwise than balls."""
    if scene.dim != 2 or scene.has_elements() or scene.colliders or scene.moving_pins:
        raise NoSuchSceneError("needs balls, springs and walls in 2D")
    if any(m.friction or m.viscous_friction for m in scene.materials):
        raise NoSuchSceneError("discs turn otherwise than balls")
    flat = lambda a: np.concatenate([a, np.zeros((len(a), 1))], axis=1)  # noqa: E731
    out = ts.Scene(3, np.append(scene.gravity, 0.0))
    out.materials = [replace(m) for m in scene.materials]
    new = out.add_balls(
        flat(scene.position),
        radius=scene.radius,
        mass=scene.mass,
        velocity=flat(scene.velocity),
        pinned=scene.pinned,
    )
    out.set_balls(new, material=[scene.materials[k].name for k in scene.material], body=scene.body)
    if scene.n_springs:
        columns = {k: getattr(scene, k) for k in ("stiffness", "damping", "rest_length", "collides", "break_strain")}
        out.add_springs(scene.pairs, **columns)
    for wall in scene.walls:
        out.add_wall((*wall.normal, 0.0), wall.offset, scene.materials[wall.material].name)
    return out


def components(scene: ts.Scene) -> list[np.ndarray]:
    """The balls of each thing that hangs together by springs, elements or triangles."""
    label = np.arange(scene.n_balls)
    rows = [scene.pairs, scene.triangles, *(element.corners(scene) for element in ELEMENTS)]
    edges = np.concatenate(
        [np.stack([r[:, 0], r[:, k]], axis=1) for r in rows for k in range(1, r.shape[1]) if len(r)]
        or [np.zeros((0, 2), dtype=int)]
    )
    while True:
        before = label.copy()
        np.minimum.at(label, edges[:, 0], label[edges[:, 1]])
        np.minimum.at(label, edges[:, 1], label[edges[:, 0]])
        label = label[label]
        if np.array_equal(label, before):
            return [np.flatnonzero(label == k) for k in np.unique(label)]
