"""Scenes from scenes: a part, a mirror image, other units, a moving frame, many side by side in one."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.colliders import shape_of

__all__ = ["Change", "NoSuchSceneError", "changed", "components", "embedded", "merged", "part", "renumbered", "walls"]


class NoSuchSceneError(ValueError):
    """The scene cannot be changed in this way: a wall does not move, a turned box has no mirror image here."""


@dataclass(frozen=True)
class Change:
    """x -> length (turn x) + shift, t -> time t, m -> mass m, and all of it at `velocity` [m/s]; turn: signed permutation."""

    turn: Any = None  # (dim, dim)
    length: float = 1.0
    time: float = 1.0
    mass: float = 1.0
    shift: Any = 0.0
    velocity: Any = None  # (dim,)

    def place(self, x: Any) -> np.ndarray:
        """Points (..., dim) [m]."""
        return self.direction(x) * self.length + self.shift

    def speed(self, v: Any) -> np.ndarray:
        """Velocities (..., dim) [m/s]."""
        out = self.direction(v) * (self.length / self.time)
        return out if self.velocity is None else out + self.velocity

    def direction(self, d: Any) -> np.ndarray:
        """Vectors (..., dim) of no unit."""
        d = np.asarray(d, dtype=float)
        return d if self.turn is None else d @ np.asarray(self.turn).T

    @property
    def hand(self) -> float:
        """-1 for a mirror image."""
        return 1.0 if self.turn is None else float(np.sign(np.linalg.det(self.turn)))

    def turning(self, w: Any) -> Any:
        """Angular velocities, a number in 2D, (3,) in 3D, in any unit."""
        w = np.asarray(w, dtype=float)
        return (w if w.ndim == 0 else self.direction(w)) * (self.hand / self.time)

    @property
    def same_place(self) -> bool:
        """Whether directions and speeds stay as they are."""
        return self.turn is None and self.velocity is None and self.length == self.time == 1.0


@dataclass
class _Adding:
    """One scene on its way into another one."""

    target: ts.Scene
    scene: ts.Scene
    change: Change
    keep: np.ndarray
    group: str | None = None
    number: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))  # old index to new; -1: left out

    def material(self, index: int) -> str:
        """The name, in the target, of a material like that one."""
        m, to = self.scene.materials[index], self.target
        law = (m.restitution, m.friction, m.viscous_friction / self.change.time)
        for other in to.materials[1:]:
            if (other.restitution, other.friction, other.viscous_friction) == law:
                return other.name
        return to.add_material(f"m{len(to.materials)}", *law)

    def balls(self) -> None:
        scene, to, c = self.scene, self.target, self.change
        self.number = np.full(scene.n_balls, -1)
        new = to.add_balls(
            c.place(scene.position[self.keep]),
            radius=scene.radius[self.keep] * c.length,
            mass=scene.mass[self.keep] * c.mass,
            velocity=c.speed(scene.velocity[self.keep]),
            pinned=scene.pinned[self.keep],
        )
        self.number[self.keep] = new
        names = {k: self.material(int(k)) for k in np.unique(scene.material[self.keep])}
        # far apart, two scenes may share a number of bodies: no more is compiled than for one
        materials = [names[k] for k in scene.material[self.keep].tolist()]
        to.set_balls(new, material=materials, body=scene.body[self.keep])
        if self.group is not None:
            to.set_group(new, self.group)

    def whole(self, corners: np.ndarray) -> np.ndarray:
        """Which rows of ball numbers are all kept."""
        return (self.number[corners] >= 0).all(axis=1) if len(corners) else np.zeros(0, dtype=bool)

    def springs(self) -> None:
        scene, to, c = self.scene, self.target, self.change
        on = self.whole(scene.pairs)
        if on.any():
            to.add_springs(
                self.number[scene.pairs[on]],
                stiffness=scene.stiffness[on] * (c.mass / c.time**2),
                damping=scene.damping[on] * (c.mass / c.time),
                rest_length=scene.rest_length[on] * c.length,
                collides=scene.collides[on],
                break_strain=scene.break_strain[on],
            )

    def elements(self) -> None:
        scene, to, c, number = self.scene, self.target, self.change, self.number
        pressure = c.mass / (c.time**2 * c.length ** (scene.dim - 2))
        on = self.whole(scene.cells)
        if on.any():
            corners = number[scene.cells[on]]
            if c.hand < 0:
                corners = corners[:, [1, 0, *range(2, scene.dim + 1)]]
            volume = scene.rest_volume[on] * c.length**scene.dim
            moduli = {name: getattr(scene, name)[on] * pressure for name in ("bulk_modulus", "crush_modulus")}
            to.add_cells(corners, **moduli, rest_volume=volume, together=scene.cells_together[on])
        on = self.whole(scene.bends)
        if on.any():
            to.add_bending(
                number[scene.bends[on]],
                weights=scene.bend_weights[on],
                stiffness=scene.bend_stiffness[on] * (c.mass / c.time**2),
                damping=scene.bend_damping[on] * (c.mass / c.time),
                hinge=scene.bend_hinge[on],
            )
        on = self.whole(scene.triangles)
        if on.any():
            to.add_triangles(self._faces(scene.triangles[on]), collides=scene.solid[on])
        for gas in scene.gases:
            if self.whole(gas.triangles).all():
                to.add_gas(self._faces(gas.triangles), pressure=gas.pressure * pressure, outside=gas.outside * pressure)
        for pins in scene.moving_pins:
            if (number[pins.balls] >= 0).all():
                to.add_moving_pins(number[pins.balls], **self._led(dict(pins.given)))
        led = np.concatenate([np.zeros(0, dtype=int), *(pins.balls for pins in scene.moving_pins)])
        still = [k for k in np.flatnonzero(scene.pinned & (number >= 0)) if k not in led]
        if still and c.velocity is not None:
            to.add_moving_pins(number[still], velocity=c.velocity)
        if scene.wind is not None:
            wind = scene.wind
            if wind.gust and not c.same_place:
                raise NoSuchSceneError("gusts know where they are")
            if to.wind is None:
                to.add_wind(
                    c.speed(wind.velocity),
                    density=wind.density * c.mass / c.length**3,
                    drag=wind.drag,
                    skin_friction=wind.skin_friction,
                    gust=wind.gust,
                    gust_length=wind.gust_length * c.length,
                )

    def _faces(self, triangles: np.ndarray) -> np.ndarray:
        t = self.number[triangles]
        return t[:, ::-1] if self.change.hand < 0 else t

    def _led(self, given: dict[str, Any]) -> dict[str, Any]:
        """Arguments that move something."""
        c = self.change
        if given.get("path"):
            if c.velocity is not None:
                raise NoSuchSceneError("a path has no velocity of its own")
            keys = [
                key if isinstance(key, dict) else dict(zip(("time", "position", "rotation"), key))
                for key in given["path"]
            ]
            if any("rotation" in key for key in keys) and c.turn is not None:
                raise NoSuchSceneError("a path that turns")
            given["path"] = [{**key, "time": key["time"] * c.time} for key in keys]
            for key in given["path"]:
                if "position" in key:
                    key["position"] = (c.direction(key["position"]) * c.length).tolist()
        elif given.get("velocity") is not None or c.velocity is not None:
            given["velocity"] = c.speed(given.get("velocity") or np.zeros(self.scene.dim)).tolist()
        if given.get("rotation_rate") is not None:
            given["rotation_rate"] = np.asarray(c.turning(given["rotation_rate"])).tolist()
        if given.get("pivot") is not None:
            given["pivot"] = c.place(given["pivot"]).tolist()
        return given

    def solid(self) -> None:
        scene, to, c = self.scene, self.target, self.change
        if scene.walls and c.velocity is not None:
            raise NoSuchSceneError("walls do not move")
        shared = self.group is None
        for wall in scene.walls:
            normal = c.direction(wall.normal)
            offset = wall.offset * c.length + float(normal @ np.broadcast_to(c.shift, scene.dim))
            material = self.material(wall.material)
            old = [w for w in to.walls if np.array_equal(w.normal, normal) and w.offset == offset]
            if not (shared and any(to.materials[w.material].name == material for w in old)):
                to.add_wall(normal, offset, material, collides_with=None if shared else self.group)
        for collider in scene.colliders:
            given = self._led(dict(collider.given))
            if given.get("rotation") is not None and c.turn is not None:
                raise NoSuchSceneError("a collider that is turned already")
            for key in ("center", "start", "end"):
                if key in given:
                    given[key] = c.place(given[key])
            for key in ("radius", "hollow"):
                if key in given:
                    given[key] = given[key] * c.length
            if "size" in given:
                given["size"] = np.abs(c.direction(given["size"])) * c.length
            if given["shape"] == "mesh":
                given["mesh"] = (c.direction(collider.vertices) * c.length, collider.triangles)
                given["position"] = c.place(given.get("position") or np.zeros(3))
            given["material"] = self.material(collider.material)
            to.add_collider(shape_of(given))

    def all(self) -> None:
        self.balls()
        self.springs()
        self.elements()
        self.solid()


def _blank(scene: ts.Scene, gravity: Any = None) -> ts.Scene:
    out = ts.Scene(scene.dim, scene.gravity if gravity is None else gravity)
    out.settings, out.output = dict(scene.settings), dict(scene.output)
    return out


def changed(scene: ts.Scene, change: Change) -> ts.Scene:
    """The same scene mirrored, turned, in other units, elsewhere, or in motion. Raises NoSuchSceneError."""
    out = _blank(scene, change.direction(scene.gravity) * (change.length / change.time**2))
    _Adding(out, scene, change, np.arange(scene.n_balls)).all()
    return out


def part(scene: ts.Scene, keep: Any) -> ts.Scene:
    """The scene with the balls `keep` alone, and what joins them."""
    out = _blank(scene)
    _Adding(out, scene, Change(), np.asarray(keep, dtype=int)).all()
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
        _Adding(out, scene, Change(shift=by), np.arange(scene.n_balls), group).all()
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
    if scene.dim != 2 or len(scene.cells) or scene.colliders or scene.moving_pins:
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
    """The balls of each thing that hangs together by springs, cells, bending, triangles or gas."""
    label = np.arange(scene.n_balls)
    rows = [scene.pairs, scene.cells, scene.bends, scene.triangles, *(gas.triangles for gas in scene.gases)]
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
