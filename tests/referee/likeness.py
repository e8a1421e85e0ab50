"""Relations between scenes that say the same in other words: a wall and a box, a stick and a capsule, cloth that is pinned and
a mesh, a solid that moves and the same from its own frame."""

from collections.abc import Callable
from typing import Any

import numpy as np

import taichi_sim as ts

from .agreement import apart
from .observe import Case, Record
from .relations import Relation
from .scenes import Change, changed, part

__all__ = ["LIKENESSES", "block", "slab"]

THIN = 2.0**-30  # m, of a capsule that is as good as a line
RIDE = np.array([0.75, -0.5, 0.25])  # m/s
SIDE = 32.0  # m, of what stands for a wall


def block(size: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a box about the origin."""
    corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * np.asarray(size) / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def slab(x: np.ndarray, triangles: np.ndarray, up: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The solid between a sheet of triangles moved by `up` and the same moved by `down` [m]."""
    n = len(x)
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    known = {(int(a), int(b)) for a, b in sides}
    rim = np.array([(a, b) for a, b in known if (b, a) not in known])
    a, b = rim.T
    walls = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    return np.concatenate([x + up, x + down]), np.concatenate([triangles, triangles[:, ::-1] + n, walls])


# A wall, a box, a mesh ------------------------------------------------------------------------------------------------


def _solids(scene: ts.Scene) -> list[ts.Scene]:
    """The scene with its one level wall as a Box and, in 3D, as a mesh; none where there is no such wall."""
    dim = scene.dim
    if len(scene.walls) != 1 or scene.walls[0].normal != tuple(np.eye(dim)[1]) or scene.colliders:
        return []
    wall = scene.walls[0]
    centre, size = np.array([0.0, wall.offset - 1.0, 0.0])[:dim], np.array([SIDE, 2.0, SIDE])[:dim]
    out = []
    for shape in ("box", "mesh")[: dim - 1]:
        other = changed(scene, Change())
        other.walls.clear()
        name = _name(other, scene.materials[wall.material])
        if shape == "box":
            other.add_collider(ts.Box(centre, size, material=name))
        else:
            other.add_collider(ts.Mesh(block(size), position=centre, material=name, resolution=32))
        out.append(other)
    return out


def _name(scene: ts.Scene, law: Any) -> str:
    """The material that is like that of another scene; added where there is none."""
    numbers = (law.restitution, law.friction, law.viscous_friction)
    for m in scene.materials:
        if (m.restitution, m.friction, m.viscous_friction) == numbers:
            return m.name
    return scene.add_material(f"m{len(scene.materials)}", *numbers)


def _grounds(case: Case) -> list[Case] | None:
    solids = _solids(case.scene)
    return [case, *map(case.of, solids)] if solids else None


def _riding(case: Case) -> list[Case] | None:
    """The same as solids that move, with all that is on them."""
    if any(m.viscous_friction for m in case.scene.materials):
        return None
    solids = [changed(s, Change(velocity=RIDE[: s.dim])) for s in _solids(case.scene)]
    return [case, *map(case.of, solids)] if solids else None


def _all_apart(case: Case, records: list[Record]) -> float:
    return max(apart(records[0], other) for other in records[1:])


def _all_along(case: Case, records: list[Record]) -> float:
    """Seen from the solid that moves."""
    by = records[0].time[:, None, None] * RIDE[: case.scene.dim]
    return max(apart(records[0], other, other.x - by) for other in records[1:])


def _crowds_apart(case: Case, records: list[Record]) -> float:
    """Of the whole: where its centre of mass is, in parts of its motion, and its energy, in parts of what it could lose."""
    m = case.scene.mass / case.scene.mass.sum()
    centre = [np.einsum("n,sni->si", m, r.x) for r in records]
    energy = [r.energy(case.scene) for r in records]
    far = max(float(np.linalg.norm(centre[0] - centre[0][0], axis=1).max()), 1e-300)
    lost = max(float(np.ptp(energy[0])), 0.5 * float(m @ (records[0].v[0] ** 2).sum(axis=1)) * case.scene.mass.sum())
    where = max(float(np.linalg.norm(c - centre[0], axis=1).max()) / far for c in centre[1:])
    return max(where, max(float(np.abs(e - energy[0]).max()) / lost for e in energy[1:]))


# A stick and a capsule, pinned cloth and a mesh -----------------------------------------------------------------------


def _instead(case: Case, build: Callable[[ts.Scene, ts.Scene], None]) -> list[Case]:
    """The case and the same without its pinned balls; what stands in their place is built from the first scene."""
    other = part(case.scene, np.flatnonzero(~case.scene.pinned))
    build(case.scene, other)
    return [case, case.of(other)]


def _capsules(case: Case) -> list[Case] | None:
    """Sticks between two pinned balls, that may move on together, as capsules that are hardly thick."""
    scene = case.scene
    if not scene.collides.any() or not scene.pinned[scene.pairs].all():
        return None

    def build(scene: ts.Scene, other: ts.Scene) -> None:
        speed = {int(b): pins.given.get("velocity") for pins in scene.moving_pins for b in pins.balls}
        for a, b in scene.pairs[scene.collides]:
            name = _name(other, scene.materials[scene.material[a]])
            ends = scene.position[a], scene.position[b]
            other.add_collider(ts.Capsule(*ends, THIN, material=name, velocity=speed.get(int(a))))

    return _instead(case, build)


def _meshes(case: Case) -> list[Case] | None:
    """A flat sheet of pinned triangles as the upper face of a thick solid."""
    scene = case.scene
    if not scene.solid.any() or not scene.pinned[scene.triangles].all():
        return None

    def build(scene: ts.Scene, other: ts.Scene) -> None:
        sheet = np.unique(scene.triangles)
        triangles, x = np.searchsorted(sheet, scene.triangles), scene.position[sheet]
        a, b, c = x[triangles[0]]
        up = np.cross(b - a, c - a)
        up /= np.linalg.norm(up)
        whole = slab(x, triangles, scene.radius[sheet[0]] * up, -0.5 * up)
        name = _name(other, scene.materials[scene.material[sheet[0]]])
        other.add_collider(ts.Mesh(whole, material=name, resolution=32))

    return _instead(case, build)


def _loose_apart(case: Case, records: list[Record]) -> float:
    """What is loose, against the same where pinned balls have become something else; in parts of its motion."""
    loose = records[0].x[:, ~case.scene.pinned]
    moved = max(float(np.linalg.norm(loose - loose[0], axis=2).max(initial=0.0)), 1e-300)
    return float(np.linalg.norm(records[1].x - loose, axis=2).max(initial=0.0)) / moved


LIKENESSES = {
    relation.name: relation
    for relation in (
        Relation("wall_is_box_is_mesh", 1e-8, _all_apart, _grounds),
        Relation("wall_is_a_solid_that_moves", 1e-8, _all_along, _riding),
        Relation("crowd_on_wall_box_mesh", 0.01, _crowds_apart, _grounds),
        Relation("stick_is_a_thin_capsule", 0.02, _loose_apart, _capsules),
        Relation("pinned_cloth_is_a_mesh", 0.02, _loose_apart, _meshes),
    )
}
