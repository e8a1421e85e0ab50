"""Balls: the points of mass that all else holds on to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.spelling import takes_color
from taichi_sim.scene.columns import Column
from taichi_sim.scene.pins import Pins, chosen

__all__ = ["BallMethods"]

MOST_BODY = 2**31 - 1


class BallMethods:
    """The part of a Scene that holds balls."""

    position = Column("balls", "position", "(n, dim) m", ("dim",))
    velocity = Column("balls", "velocity", "(n, dim) m/s; 0 for pinned balls", ("dim",))
    mass = Column("balls", "mass", "(n,) kg")
    radius = Column("balls", "radius", "(n,) m")
    pinned = Column("balls", "pinned", "(n,) bool", dtype=bool)
    material = Column("balls", "material", "(n,) index into materials", dtype=np.int32)
    body = Column("balls", "body", "(n,) balls of one body > 0 do not collide; 0: no body", dtype=np.int32)
    group = Column("balls", "group", "(n,) bits of the groups each is in, see groups.names", dtype=np.int32)
    mask = Column("balls", "mask", "(n,) bits of the groups each collides with; -1: all", dtype=np.int32)
    colour = Column("balls", "colour", "(n, 3) sRGB in 0..1; nan: the renderer chooses", (3,))

    @property
    def n_balls(self: Any) -> int:
        """Number of balls."""
        return self.tables["balls"].rows  # type: ignore[no-any-return]

    @takes_color
    def add_balls(
        self: Any,
        position: ArrayLike,
        *,
        radius: ArrayLike,
        velocity: ArrayLike = 0.0,
        mass: ArrayLike = 1.0,
        material: str = "default",
        pinned: Pins = False,
        colour: Sequence[float] | None = None,
        body: int = 0,
        group: str | Sequence[str] = "default",
        collides_with: str | Sequence[str] | None = None,
    ) -> NDArray[np.int32]:
        """Add n balls and return their indices, shape (n,).

        Args:
            position: (n, dim) [m], or one vector (dim,) for one ball.
            radius: one or one per ball, > 0 [m]; mass: one or one per ball, > 0 [kg].
            velocity: one vector or one per ball [m/s].
            material: name of a material added before, or of a preset (`taichi-sim materials`).
            pinned: a bool, a bool per ball, or integer positions within this call. Or "border", "corners", "left", "right",
                "bottom", "top", in 3D "front", "back", of the box around these balls. Or a ts.Box, ts.Sphere or ts.Capsule (in a
                file a table of its keys) for all with their centre in it. Or a list of such. A pinned ball never moves.
            colour: sRGB in 0..1 [1] for all of them; chosen by the renderer otherwise.
            body: balls of the same body > 0 (see new_body) do not collide with each other.
            group: name or names of the collision groups that they are in, 32 different ones in a scene at most.
            collides_with: names of the groups that they collide with; None: all, []: none. Two things collide where each is
                in a group that the other collides with. A stick is in the groups of its first ball.
        """
        x = validation.vectors("balls.position", validation.many(position, 1), None, self.dim)
        n = len(x)
        body = validation.whole("balls.body", body, 0, MOST_BODY)
        held = chosen("balls.pinned", pinned, x)
        rest = isinstance(velocity, (int, float)) and velocity == 0
        columns = self._ball_columns(n, mass=mass, radius=radius, **({} if rest else {"velocity": velocity}))
        v = columns.setdefault("velocity", np.zeros_like(x))
        v[held] = 0.0
        tint = np.full(3, np.nan) if colour is None else validation.colour("balls.colour", colour)
        columns |= {"position": x, "pinned": held, "colour": np.tile(tint, (n, 1))}
        group_bits, mask_bits = self._groups("balls", group, collides_with)
        numbers = {"body": body, "group": group_bits, "mask": mask_bits}
        numbers["material"] = self._material("balls.material", material)
        columns |= {name: np.full(n, number, dtype=np.int32) for name, number in numbers.items()}
        self._bodies = max(self._bodies, body)
        return self.tables["balls"].append(n, **columns)  # type: ignore[no-any-return]

    def _ball_columns(self: Any, n: int, **values: ArrayLike) -> dict[str, NDArray]:
        """Columns of n balls by name, of vectors and positive numbers. Raises SceneError."""
        found: dict[str, NDArray] = {}
        for name, value in values.items():
            if name in ("position", "velocity"):
                found[name] = validation.vectors(f"balls.{name}", value, n, self.dim)
            else:
                found[name] = validation.per_item(f"balls.{name}", value, n, positive=True)
        return found

    def _add_ball_columns(
        self: Any,
        position: NDArray,
        velocity: NDArray,
        mass: NDArray,
        radius: NDArray,
        pinned: NDArray,
        material: NDArray,
        body: NDArray,
        group: NDArray,
        mask: NDArray,
        colour: NDArray,
    ) -> None:
        """Add balls from all columns of their table; materials and groups are there already."""
        n = len(validation.vectors("balls.position", position, None, self.dim))
        columns = self._ball_columns(n, position=position, velocity=velocity, mass=mass, radius=radius)
        columns |= {
            "pinned": validation.flags("balls.pinned", pinned, n),
            "material": validation.indices("balls.material", material, len(self.materials), what="material"),
            "body": validation.indices("balls.body", body, MOST_BODY + 1, what="body"),
            "group": validation.bits("balls.group", group),
            "mask": validation.bits("balls.mask", mask),
            "colour": validation.colours("balls.colour", colour),
        }
        for name, column in columns.items():
            if len(column) != n:
                says = f"shape {column.shape} does not fit; it must have as many rows as balls.position, {n}"
                raise SceneError(f"balls.{name}", says=says)
        loose = ~columns["pinned"][:, None]
        validation.require("balls.velocity", columns["velocity"], loose | (columns["velocity"] == 0), "0, it is pinned")
        self.groups.check_bits("balls", columns["group"], columns["mask"])
        self.tables["balls"].append(n, **columns)
        self._bodies = max(self._bodies, int(columns["body"].max(initial=0)))

    def new_body(self: Any) -> int:
        """A fresh number for `add_balls(body=...)`: balls that share it do not collide with each other."""
        self._bodies = validation.whole("balls.body", self._bodies + 1, 0, MOST_BODY)
        return self._bodies

    def set_balls(
        self: Any,
        balls: Any = slice(None),
        *,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        mass: ArrayLike | None = None,
        radius: ArrayLike | None = None,
        pinned: Pins | None = None,
        material: str | Sequence[str] | None = None,
        body: int | ArrayLike | None = None,
    ) -> None:
        """Change balls that were added before; what is left None stays.

        Args:
            balls: indices (k,), a bool for each ball of the scene, or a slice; all by default.
            position, velocity, mass, radius, pinned, material, body: as for `add_balls`, of these k balls; material and body:
                one, or one per ball. Pinned balls keep velocity 0. Rest lengths of springs stay as they are.
        """
        index = validation.rows("balls", balls, self.n_balls)
        k = len(index)
        given = validation.given(position=position, velocity=velocity, mass=mass, radius=radius)
        new = self._ball_columns(k, **given)
        if material is not None:
            names = [material] * k if isinstance(material, str) else list(material)
            if len(names) != k:
                raise SceneError("balls.material", says=f"gives {len(names)} names; it must be one, or {k} of them")
            new["material"] = np.array([self._material("balls.material", name) for name in names], dtype=np.int32)
        if body is not None:
            bodies = validation.per_item("balls.body", body, k, low=0, high=MOST_BODY)
            validation.require("balls.body", bodies, bodies == np.round(bodies), "a whole number")
            new["body"] = bodies.astype(np.int32)
        x = self.position[index]
        held = self.pinned[index] if pinned is None else chosen("balls.pinned", pinned, new.get("position", x))
        for pins in self.moving_pins:
            loose = index[~held & np.isin(index, pins.balls)]
            if len(loose):
                raise SceneError("balls.pinned", says=f"ball {loose[0]} is led along a path; it stays pinned")
        if pinned is not None or velocity is not None:
            v = new.get("velocity", self.velocity[index])
            v[held] = 0.0
            new |= {"pinned": held, "velocity": v}
        self.tables["balls"].replace(index, **new)

    def set_group(
        self: Any, balls: ArrayLike, group: str | Sequence[str], collides_with: str | Sequence[str] | None = None
    ) -> None:
        """Put balls (k,) that were added before, a shape's for instance, into other collision groups."""
        index = validation.indices("balls", np.atleast_1d(validation.as_array(balls)), self.n_balls)
        group_bits, mask_bits = self._groups("balls", group, collides_with)
        self.tables["balls"].replace(index, group=group_bits, mask=mask_bits)
