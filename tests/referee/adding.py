"""One scene added to another: mirrored, turned, in other units, elsewhere, in motion."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.colliders import shape_of

__all__ = ["Adding", "Change", "NoSuchSceneError"]


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

    def pressure(self, dim: int) -> float:
        """Of a modulus or pressure: force per area, in 2D per length."""
        return self.mass / (self.time**2 * self.length ** (dim - 2))

    @property
    def same_place(self) -> bool:
        """True if directions and speeds stay as they are."""
        return self.turn is None and self.velocity is None and self.length == self.time == 1.0


@dataclass
class Adding:
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
        """Mask of the rows of ball numbers that are all kept."""
        return (self.number[corners] >= 0).all(axis=1) if len(corners) else np.zeros(0, dtype=bool)

    def springs(self) -> None:
        scene, to, c = self.scene, self.target, self.change
        on = self.whole(scene.pairs)
        if on.any():
            added = to.add_springs(
                self.number[scene.pairs[on]],
                stiffness=scene.stiffness[on] * (c.mass / c.time**2),
                damping=scene.damping[on] * (c.mass / c.time),
                rest_length=scene.rest_length[on] * c.length,
                collides=scene.collides[on],
                break_strain=scene.break_strain[on],
            )
            number = np.full(scene.n_springs, -1)
            number[on] = added
            self.motors(number)

    def motors(self, number: np.ndarray) -> None:
        """Motors of springs; number: old index to new, -1 where one is left out."""
        for motor in self.scene.motors:
            kept = number[motor.springs] >= 0
            if kept.any():
                given = dict(motor.given)
                if "path" in given:
                    given["path"] = [{**key, "time": key["time"] * self.change.time} for key in given["path"]]
                else:
                    given |= {"frequency": motor.frequency / self.change.time, "phase": motor.phase[kept]}
                self.target.add_motor(number[motor.springs[kept]], **given)

    def elements(self) -> None:
        self.sheets()
        self.volumes()
        scene, to, c, number = self.scene, self.target, self.change, self.number
        for gas in scene.gases:
            if self.whole(gas.triangles).all():
                held = {"pressure": gas.pressure * c.pressure(3), "outside": gas.outside * c.pressure(3)}
                to.add_gas(self._faces(gas.triangles), **held, volume=gas.volume * c.length**3)
        for pins in scene.moving_pins:
            if (number[pins.balls] >= 0).all():
                to.add_moving_pins(number[pins.balls], **self._led(dict(pins.given)))
        led = np.concatenate([np.zeros(0, dtype=int), *(pins.balls for pins in scene.moving_pins)])
        still = [k for k in np.flatnonzero(scene.pinned & (number >= 0)) if k not in led]
        if still and c.velocity is not None:
            to.add_moving_pins(number[still], velocity=c.velocity)
        if scene.wind is not None:
            self.wind()

    def sheets(self) -> None:
        """Membranes, bending and triangles."""
        scene, to, c, number = self.scene, self.target, self.change, self.number
        stiffness = c.mass / c.time**2
        on = self.whole(scene.membranes)
        if on.any():
            names = ("warp", "weft", "shear", "coupling")
            threads = {name: getattr(scene, f"membrane_{name}")[on] * stiffness for name in names}
            loss, rest = scene.membrane_damping[on] * c.time, scene.membrane_rest[on] * c.length
            to.add_membranes(number[scene.membranes[on]], **threads, damping=loss, rest=rest)
        on = self.whole(scene.bends)
        if on.any():
            to.add_bending(
                number[scene.bends[on]],
                weights=scene.bend_weights[on],
                stiffness=scene.bend_stiffness[on] * stiffness,
                damping=scene.bend_damping[on] * (c.mass / c.time),
                hinge=scene.bend_hinge[on],
            )
        on = self.whole(scene.triangles)
        if on.any():
            to.add_triangles(self._faces(scene.triangles[on]), collides=scene.solid[on])

    def volumes(self) -> None:
        """Cells, bricks and solids. In a mirror image two corners change places, so that none is inside out."""
        scene, to, c, number = self.scene, self.target, self.change, self.number
        dim, mirrored = scene.dim, c.hand < 0
        pressure = c.pressure(dim)
        swapped = [1, 0, *range(2, dim + 1)] if mirrored else list(range(dim + 1))
        on = self.whole(scene.cells)
        if on.any():
            moduli = {name: getattr(scene, name)[on] * pressure for name in ("bulk_modulus", "crush_modulus")}
            volume = scene.rest_volume[on] * c.length**dim
            together = scene.cells_together[on]
            to.add_cells(number[scene.cells[on]][:, swapped], **moduli, rest_volume=volume, together=together)
        on = self.whole(scene.bricks)
        if on.any():
            order = np.arange(2**dim) ^ int(mirrored)
            to.add_bricks(
                number[scene.bricks[on]][:, order],
                young_modulus=scene.brick_modulus[on] * pressure,
                poisson_ratio=scene.brick_ratio[on],
                viscosity=scene.brick_viscosity[on] * pressure * c.time,
                rest_size=scene.brick_size[on] * c.length,
            )
        on = self.whole(scene.solids)
        if on.any():
            to.add_solids(
                number[scene.solids[on]][:, swapped],
                young_modulus=scene.solid_modulus[on] * pressure,
                poisson_ratio=scene.solid_ratio[on],
                viscosity=scene.solid_viscosity[on] * pressure * c.time,
                rest=c.direction(scene.solid_rest[on])[:, swapped] * c.length,
            )

    def wind(self) -> None:
        wind, to, c = self.scene.wind, self.target, self.change
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
