"""Scene: what exists, as NumPy arrays. It knows no solver and imports no Taichi."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import asdict, replace
from functools import partial
from importlib import import_module
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, did_you_mean
from taichi_sim.common.spelling import takes_color
from taichi_sim.scene.colliders import Collider, build
from taichi_sim.scene.collision_groups import EVERY, Groups, bits_of
from taichi_sim.scene.columns import Column, Names, sealed, tables_of
from taichi_sim.scene.elements import Elements
from taichi_sim.scene.embedded_surfaces import EmbeddedSurface, build_surface
from taichi_sim.scene.materials import Material, Wall, max_restitution, used_materials
from taichi_sim.scene.motors import Motorised
from taichi_sim.scene.moving_pins import PinMethods
from taichi_sim.scene.objects import Objects
from taichi_sim.scene.parts import LISTS, PARTS
from taichi_sim.scene.pins import Pins, chosen
from taichi_sim.scene.presets import PRESETS, Preset
from taichi_sim.scene.probes import Probed
from taichi_sim.scene.read_only import read_only, refuse
from taichi_sim.scene.summary import as_html, in_words, parts_of
from taichi_sim.scene.toml_writer import save_scene

__all__ = ["Material", "Scene", "Wall", "max_restitution", "used_materials"]


MOST_BODY = 2**31 - 1
UNIT = 4e-16  # how far from 1 rounding leaves the length of a unit vector


class Scene(Elements, PinMethods, Motorised, Probed, Objects):
    """A world of balls, springs, walls, colliders and triangles in 2 or 3 dimensions, SI units.

    Args:
        dim: 2 or 3.
        gravity: acceleration (dim,) [m/s^2]; none by default. In 3D the y axis points up.

    Arrays that it hands out are read-only: `add_` methods add rows, `set_` methods change them, and both check what they get.
    Raises SceneError for anything that is not allowed, naming the field and the index; the scene is then unchanged.
    """

    materials: list[Material]
    walls: list[Wall]
    colliders: list[Collider]
    embedded_surfaces: list[EmbeddedSurface]

    def __init__(self, dim: int = 2, gravity: ArrayLike | None = None) -> None:
        if isinstance(dim, bool) or dim not in (2, 3):
            raise SceneError("dim", dim, "2 or 3")
        self.dim = int(dim)
        dim = self.dim
        self.gravity = np.zeros(dim) if gravity is None else gravity
        for name in LISTS:
            setattr(self, name, [])
        self.materials.append(Material("default"))
        self._material_names = Names()
        self.groups = Groups()
        self._settings: dict[str, Any] = {}
        self._output: dict[str, Any] = {}
        self.locate: Callable[[SceneError], SceneError] | None = None  # where in its file an error's path stands
        self.tables = tables_of(type(self), dim)  # of the balls, springs, triangles, cells and bending elements
        self._bodies = 0
        self._begin_pins()
        self._begin_motors()
        self._begin_probes()
        self._begin_objects()

    # What there is -------------------------------------------------------------------------------------------------

    @property
    def gravity(self) -> NDArray[np.float64]:
        """(dim,) m/s^2"""
        return self._gravity

    @gravity.setter
    def gravity(self, gravity: ArrayLike) -> None:
        self._may_change("gravity")
        self._gravity = sealed(validation.vector("gravity", gravity, self.dim))

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of Simulation, from the scene file's [simulation]."""
        return self._settings

    @settings.setter
    def settings(self, settings: dict[str, Any]) -> None:
        self._may_change("settings")
        self._settings = settings

    @property
    def output(self) -> dict[str, Any]:
        """fps, duration, size, ..., from the scene file's [output]."""
        return self._output

    @output.setter
    def output(self, output: dict[str, Any]) -> None:
        self._may_change("output")
        self._output = output

    @property
    def n_balls(self) -> int:
        """Number of balls."""
        return self.tables["balls"].rows

    @property
    def n_springs(self) -> int:
        """Number of springs, sticks included."""
        return self.tables["springs"].rows

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
    pairs = Column("springs", "pairs", "(m, 2) the balls of each spring", (2,), np.int32)
    stiffness = Column("springs", "stiffness", "(m,) N/m")
    damping = Column("springs", "damping", "(m,) N s/m")
    rest_length = Column("springs", "rest_length", "(m,) m")
    collides = Column("springs", "collides", "(m,) bool; True: a stick that balls bounce off", dtype=bool)
    break_strain = Column("springs", "break_strain", "(m,) strain at which it tears; inf: never")
    triangles = Column("triangles", "triangles", "(t, 3) balls, counter-clockwise from outside", (3,), np.int32)
    solid = Column("triangles", "collides", "(t,) bool; True: triangles that nothing goes through", dtype=bool)

    # What can be added ---------------------------------------------------------------------------------------------

    @takes_color
    def add_material(
        self,
        name: str,
        restitution: float = 0.0,
        friction: float = 0.0,
        viscous_friction: float = 0.0,
        colour: Sequence[float] | None = None,
    ) -> str:
        """Add a material and return its name. Of two that meet, the larger restitution counts and the geometric mean of
        frictions.

        Args:
            name: what balls, walls and colliders call it by.
            restitution: part of the speed of an impact that comes back, 0..1 [1].
            friction: coefficient of Coulomb friction, >= 0 [1].
            viscous_friction: rate at which sliding in contact slows down, >= 0 [1/s].
            colour: sRGB in 0..1 [1] of what is made of it and has none of its own.
        """
        name = validation.name("materials.name", name)
        if name != "default" and self._material_names.number(self.materials, name) is not None:
            raise SceneError("materials.name", name, says="exists already")
        new = Material(
            name,
            validation.number("materials.restitution", restitution, low=0, high=1),
            validation.number("materials.friction", friction, low=0),
            validation.number("materials.viscous_friction", viscous_friction, low=0),
            None if colour is None else _colour("materials.colour", colour),
        )
        if name == "default":
            self.materials[0] = new
        else:
            self.materials.append(new)
        return name

    @takes_color
    def add_balls(
        self,
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
        v = np.zeros_like(x) if rest else validation.vectors("balls.velocity", velocity, n, self.dim)
        v[held] = 0.0
        columns = {
            "position": x,
            "velocity": v,
            "mass": validation.per_item("balls.mass", mass, n, positive=True),
            "radius": validation.per_item("balls.radius", radius, n, positive=True),
            "pinned": held,
            "body": np.full(n, body, dtype=np.int32),
            "colour": np.tile(np.full(3, np.nan) if colour is None else _colour("balls.colour", colour), (n, 1)),
        }
        for name, bits in zip(("group", "mask"), self._groups("balls", group, collides_with)):
            columns[name] = np.full(n, bits, dtype=np.int32)
        columns["material"] = np.full(n, self._material("balls.material", material), dtype=np.int32)
        self._bodies = max(self._bodies, body)
        return self.tables["balls"].append(n, **columns)

    def _add_ball_columns(
        self,
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
        columns: dict[str, NDArray] = {
            "position": validation.vectors("balls.position", position, n, self.dim),
            "velocity": validation.vectors("balls.velocity", velocity, n, self.dim),
            "mass": validation.per_item("balls.mass", mass, n, positive=True),
            "radius": validation.per_item("balls.radius", radius, n, positive=True),
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

    def add_springs(
        self,
        pairs: ArrayLike,
        *,
        stiffness: ArrayLike,
        damping: ArrayLike = 0.0,
        rest_length: ArrayLike | None = None,
        collides: bool | Sequence[bool] | NDArray = False,
        break_strain: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Add m springs and return their indices, shape (m,).

        Args:
            pairs: (m, 2) ball indices, or one pair.
            stiffness: one or one per spring, >= 0 [N/m]; damping: along the spring, one or one per spring, >= 0 [N s/m].
            rest_length: one or one per spring, >= 0 [m]; None: the present distance.
            collides: True makes it a stick that balls bounce off; one or one per spring.
            break_strain: (length - rest_length) / rest_length at which it tears for good, > 0 [1]; None or inf: never.
        """
        ij = validation.indices("springs.pairs", validation.many(pairs, 1), self.n_balls, width=2)
        m = len(ij)
        itself = ij[:, 0] == ij[:, 1]
        if itself.any():
            k = int(np.argmax(itself))
            raise SceneError(f"springs.pairs[{k}]", ij[k], says="joins a ball to itself; give two different balls")
        if rest_length is None:
            x = self.position
            rest = np.linalg.norm(x[ij[:, 1]] - x[ij[:, 0]], axis=1)
        else:
            rest = validation.per_item("springs.rest_length", rest_length, m, low=0)
        columns = {
            "pairs": ij,
            "stiffness": validation.per_item("springs.stiffness", stiffness, m, low=0),
            "damping": validation.per_item("springs.damping", damping, m, low=0),
            "rest_length": rest,
            "collides": validation.flags("springs.collides", collides, m),
            "break_strain": validation.strains("springs.break_strain", break_strain, m),
        }
        self._may_tear(columns["collides"], columns["break_strain"], rest)
        return self.tables["springs"].append(m, **columns)

    def add_wall(
        self,
        normal: ArrayLike,
        offset: float = 0.0,
        material: str = "default",
        group: str | Sequence[str] = "default",
        collides_with: str | Sequence[str] | None = None,
    ) -> None:
        """Add a wall, solid where normal . x < offset.

        Args:
            normal: (dim,) away from the solid side; its length does not matter [1]. offset: of the wall along it [m].
            material: name of a material added before, or of a preset.
            group: name or names of the collision groups that it is in.
            collides_with: names of the groups that it collides with; None: all.
        """
        n = validation.direction("walls.normal", normal, self.dim)
        if abs(float(np.linalg.norm(n)) - 1.0) >= UNIT:  # else a saved scene would not come back bit for bit
            n = n / float(np.max(np.abs(n)))  # so that squares of huge or tiny numbers stay finite
            n = n / float(np.linalg.norm(n))
        distance = validation.number("walls.offset", offset)
        bits = self._groups("walls", group, collides_with)
        self.walls.append(Wall(tuple(n.tolist()), distance, self._material("walls.material", material), *bits))

    def add_collider(self, shape: Any) -> int:
        """Add a solid body of infinite mass, a Sphere, Box, Capsule, Mesh or a ColliderShape of your own, and return its number.

        It stands where it is or moves along its path and pushes balls; pinned balls ignore it.
        """
        where = f"colliders[{len(self.colliders)}]"
        collider = build(shape, self.dim, where, 0)
        self._require_new_label(where, collider.label)
        group, mask = self._groups(where, shape.group, shape.collides_with)
        material = self._material(f"{where}.material", shape.material)
        motion = sealed(collider.motion)
        self.colliders.append(sealed(replace(collider, group=group, mask=mask, material=material, motion=motion)))
        return len(self.colliders) - 1

    def set_collider_name(self, number: int, name: str) -> None:
        """Call a collider by a name, as the argument `name` of its shape does: colliders of letters for instance."""
        where = f"colliders[{number}]"
        self._require_new_label(where, name)
        one = self.colliders[number]
        self.colliders[number] = sealed(replace(one, label=name, given={**one.given, "name": name}))

    def _require_new_label(self, where: str, label: str) -> None:
        if label:
            validation.name(f"{where}.name", label)
        if label and any(one.label == label for one in self.colliders):
            raise SceneError(f"{where}.name", label, says="exists already; every collider needs its own name")

    def add_triangles(self, triangles: ArrayLike, collides: bool | Sequence[bool] | NDArray = False) -> None:
        """Add triangles: what the renderer draws as a surface.

        Args:
            triangles: (t, 3) balls, counter-clockwise seen from outside.
            collides: True, in 3D, makes a surface, as thick as its balls, that no ball and no other such triangle goes through;
                one or one per triangle.
        """
        t = validation.indices("triangles.triangles", triangles, self.n_balls, width=3)
        solid = validation.flags("triangles.collides", collides, len(t))
        if solid.any() and self.dim != 3:
            raise SceneError("triangles.collides", says="needs a scene with dim = 3; in 2D use springs that collide")
        for k in np.flatnonzero(solid & np.any(t == np.roll(t, 1, axis=1), axis=1)):
            says = "may not collide; it must be three different balls"
            raise SceneError(f"triangles.triangles[{k}]", t[k], says=says)
        self.tables["triangles"].append(len(t), triangles=t, collides=solid)

    @takes_color
    def add_embedded_surface(
        self,
        corners: ArrayLike,
        weights: ArrayLike,
        triangles: ArrayLike,
        *,
        covers: ArrayLike | None = None,
        colour: Sequence[float] | None = None,
        uv: ArrayLike | None = None,
    ) -> int:
        """Add a surface that pictures show in place of balls, their springs and triangles, and return its number.

        Args:
            corners: (s, k) balls that each of its s vertices follows; weights: (s, k) their shares [1], 1 in sum for each vertex.
            triangles: (t, 3) vertices of the surface, counter-clockwise seen from outside.
            covers: (b,) further balls that it is shown in place of. colour: sRGB in 0..1 [1]; None: that of the balls.
            uv: (t, 3, 2) places of the corners of its triangles on a texture, v upward [1]; None: there are none.
        """
        where = f"embedded_surfaces[{len(self.embedded_surfaces)}]"
        tint = None if colour is None else _colour(f"{where}.colour", colour)
        self.embedded_surfaces.append(build_surface(where, self.n_balls, corners, weights, triangles, covers, tint, uv))
        return len(self.embedded_surfaces) - 1

    def new_body(self) -> int:
        """A fresh number for `add_balls(body=...)`: balls that share it do not collide with each other."""
        self._bodies = validation.whole("balls.body", self._bodies + 1, 0, MOST_BODY)
        return self._bodies

    # What can be changed -------------------------------------------------------------------------------------------

    def set_balls(
        self,
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
        index = _rows("balls", balls, self.n_balls)
        k = len(index)
        new: dict[str, NDArray] = {}
        if position is not None:
            new["position"] = validation.vectors("balls.position", position, k, self.dim)
        if mass is not None:
            new["mass"] = validation.per_item("balls.mass", mass, k, positive=True)
        if radius is not None:
            new["radius"] = validation.per_item("balls.radius", radius, k, positive=True)
        if material is not None:
            names = [material] * k if isinstance(material, str) else list(material)
            if len(names) != k:
                raise SceneError("balls.material", says=f"gives {len(names)} names; it must be one, or {k} of them")
            new["material"] = np.array([self._material("balls.material", name) for name in names], dtype=np.int32)
        if body is not None:
            bodies = validation.per_item("balls.body", body, k, low=0, high=2**31 - 1)
            for at in np.flatnonzero(bodies != np.round(bodies)):
                raise SceneError(f"balls.body[{at}]", bodies[at], "a whole number")
            new["body"] = bodies.astype(np.int32)
        x = self.position[index]
        held = self.pinned[index] if pinned is None else chosen("balls.pinned", pinned, new.get("position", x))
        for pins in self.moving_pins:
            loose = index[~held & np.isin(index, pins.balls)]
            if len(loose):
                raise SceneError("balls.pinned", says=f"ball {loose[0]} is led along a path; it stays pinned")
        if pinned is not None or velocity is not None:
            v = (
                self.velocity[index]
                if velocity is None
                else validation.vectors("balls.velocity", velocity, k, self.dim)
            )
            v[held] = 0.0
            new |= {"pinned": held, "velocity": v}
        self.tables["balls"].replace(index, **new)

    def set_springs(
        self,
        springs: Any = slice(None),
        *,
        stiffness: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        rest_length: ArrayLike | None = None,
        break_strain: ArrayLike | None = None,
    ) -> None:
        """Change springs that were added before; what is left None stays.

        Args:
            springs: indices (k,), a bool for each spring of the scene, or a slice; all by default.
            stiffness, damping, rest_length, break_strain: as for `add_springs`, of these k springs.
        """
        index = _rows("springs", springs, self.n_springs)
        k = len(index)
        new: dict[str, NDArray] = {}
        for name, given in (("stiffness", stiffness), ("damping", damping), ("rest_length", rest_length)):
            if given is not None:
                new[name] = validation.per_item(f"springs.{name}", given, k, low=0)
        if break_strain is not None:
            new["break_strain"] = validation.strains("springs.break_strain", break_strain, k)
        self._may_tear(
            self.collides[index],
            new.get("break_strain", self.break_strain[index]),
            new.get("rest_length", self.rest_length[index]),
        )
        self.tables["springs"].replace(index, **new)

    def set_group(
        self, balls: ArrayLike, group: str | Sequence[str], collides_with: str | Sequence[str] | None = None
    ) -> None:
        """Put balls (k,) that were added before, a shape's for instance, into other collision groups."""
        index = validation.indices("balls", np.atleast_1d(validation.as_array(balls)), self.n_balls)
        group_bits, mask_bits = self._groups("balls", group, collides_with)
        self.tables["balls"].replace(index, group=group_bits, mask=mask_bits)

    def has_groups(self) -> bool:
        """True if any collision group matters. Raises SceneError where something collides with a group that nobody is in."""
        groups = {*bits_of(self.group), *(wall.group for wall in self.walls), *(c.group for c in self.colliders)}
        masks = [("balls", bits) for bits in bits_of(self.mask)]
        masks += [(f"walls[{k}]", wall.mask) for k, wall in enumerate(self.walls)]
        masks += [(f"colliders[{k}]", collider.mask) for k, collider in enumerate(self.colliders)]
        with self.in_file():
            self.groups.check(groups, masks)
        return any(bits != EVERY for _, bits in masks)

    @contextmanager
    def all_or_nothing(self) -> Iterator[None]:
        """Take back what the block adds to this scene where it raises: for shapes, which add several things."""
        self._may_change("anything")
        tables = [(table, table.rows) for table in self.tables.values()]
        lists: list[Any] = [self.groups.names, *(getattr(self, name) for name in LISTS)]
        lengths, bodies = [len(one) for one in lists], self._bodies
        try:
            yield
        except BaseException:
            for table, rows in tables:
                table.cut(rows)
            for one, length in zip(lists, lengths):
                del one[length:]
            self._bodies = bodies
            raise

    @contextmanager
    def in_file(self, given: Collection[str] = ()) -> Iterator[None]:
        """Let an error in the block name its line in the scene's file, if it came from one. given: settings that did not."""
        try:
            yield
        except SceneError as error:
            name = error.path[0] if error.path else None
            if self.locate is None or error.file is not None or name in given:
                raise
            if name in self.settings:
                error.path = ("simulation", *error.path)
            self.locate(error)
            if error.line is None:  # it was added later
                error.file = None
            raise

    def frozen(self) -> Scene:
        """A copy that stays as it is: what is done to this scene does not reach it, and its own `add_` and `set_` methods raise
        SceneError. What a Simulation holds. Costs no memory for balls and springs, which both share."""
        if isinstance(self.walls, tuple):
            return self
        held = copy(self)
        held.tables = {name: table.copy() for name, table in self.tables.items()}
        for name in LISTS:
            setattr(held, name, tuple(getattr(self, name)))
        held.groups, held._material_names = Groups(self.groups.names), Names()
        held._settings, held._output = (read_only(name, getattr(self, name)) for name in ("settings", "output"))
        for name in dir(self):
            if name.startswith(("add_", "set_", "new_")):
                setattr(held, name, partial(refuse, name))
        return held

    def grown_since(self, held: Scene) -> str:
        """Words for the kinds of things that this scene has more of than `held`, a frozen copy of it; "" where nothing was
        added."""
        return ", ".join(part.words for part in PARTS if part.is_simulated and part.count(self) > part.count(held))

    def _may_change(self, name: str) -> None:
        if isinstance(getattr(self, "walls", None), tuple):
            refuse(name)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the scene as TOML; large arrays go to an .npz beside it. Raises SceneError without a ball, and for what
        `output` may not hold."""
        save_scene(
            self, path, import_module("taichi_sim.files.source").checked_output(self)
        )  # by name: an outer room's

    def __repr__(self) -> str:
        return f"<{in_words(self)}>"

    def _repr_html_(self) -> str:
        gravity = {"gravity": f"({', '.join(f'{a:g}' for a in self.gravity)}) m/s^2"} if self.gravity.any() else {}
        return as_html(f"Scene in {self.dim}D", parts_of(self) | gravity)

    # Checks --------------------------------------------------------------------------------------------------------

    def _material(self, where: str, name: str) -> int:
        index = self._material_names.number(self.materials, name) if isinstance(name, str) else None
        if index is None:
            index = next((k for k, material in enumerate(self.materials) if material.name == name), None)
        if index is not None:
            return index
        if isinstance(name, str) and name in PRESETS:
            return self._material(where, self.add_material(**asdict(PRESETS[name].material(name))))
        known = [material.name for material in self.materials]
        close = did_you_mean(name, [*known, *PRESETS], "") if isinstance(name, str) else ""
        there = f"there are {', '.join(map(repr, known))}, and those of `taichi-sim materials`"
        hint = close if close.startswith("did") else there
        raise SceneError(where, name, says=f"is not a material of this scene; {hint}")

    def preset(self, material: str) -> Preset | None:
        """Preset for cloth and bodies of a material; None where no preset has that name, or the scene has its own material
        of it."""
        known = PRESETS.get(material) if isinstance(material, str) else None
        number = None if known is None else self._material_names.number(self.materials, material)
        if known is None or (number is not None and self.materials[number] != known.material(material)):
            return None
        return known

    def _groups(
        self, where: str, group: str | Sequence[str], collides_with: str | Sequence[str] | None
    ) -> tuple[int, int]:
        with self.all_or_nothing():  # names are new groups
            member = self.groups.bits(f"{where}.group", group if group is not None else [])
            if member == 0:
                raise SceneError(f"{where}.group", group, "a name, or a list of names")
            return member, self.groups.bits(f"{where}.collides_with", collides_with)

    @staticmethod
    def _may_tear(collides: NDArray[np.bool_], strain: NDArray[np.float64], rest_length: NDArray[np.float64]) -> None:
        """Raise SceneError for the first spring (k,) that cannot tear at its strain."""
        both = collides & np.isfinite(strain)
        if both.any():
            k = int(np.argmax(both))
            raise SceneError(f"springs.break_strain[{k}]", says="a stick, which collides, cannot tear")
        validation.strained(strain, rest_length)


def _rows(where: str, rows: Any, n: int) -> NDArray[np.int64]:
    """Indices (k,) of rows named by indices, by a bool each or by a slice."""
    if isinstance(rows, slice):
        return np.arange(n)[rows]
    array = np.atleast_1d(validation.as_array(rows))
    if array.dtype == np.bool_:
        return np.flatnonzero(validation.flags(where, array, n))
    return validation.indices(where, array, n, what=where.removesuffix("s")).astype(np.int64)


def _colour(where: str, value: Sequence[float]) -> tuple[float, float, float]:
    rgb = validation.per_item(where, value, 3, low=0, high=1)
    return (float(rgb[0]), float(rgb[1]), float(rgb[2]))
