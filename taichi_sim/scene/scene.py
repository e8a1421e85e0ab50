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
from taichi_sim.scene.balls import BallMethods
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
from taichi_sim.scene.presets import PRESETS, Preset
from taichi_sim.scene.probes import Probed
from taichi_sim.scene.read_only import read_only, refuse
from taichi_sim.scene.springs import SpringMethods
from taichi_sim.scene.summary import as_html, in_words, parts_of
from taichi_sim.scene.toml_writer import save_scene

__all__ = ["Material", "Scene", "Wall", "max_restitution", "used_materials"]

UNIT = 4e-16  # how far from 1 rounding leaves the length of a unit vector


class Scene(BallMethods, SpringMethods, Elements, PinMethods, Motorised, Probed, Objects):
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
        """Acceleration of all balls, (dim,) [m/s^2]."""
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
            None if colour is None else validation.colour("materials.colour", colour),
        )
        if name == "default":
            self.materials[0] = new
        else:
            self.materials.append(new)
        return name

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
        flat = np.any(t == np.roll(t, 1, axis=1), axis=1)
        says = "may not collide; it must be three different balls"
        validation.require("triangles.triangles", t, ~(solid & flat), says=says)
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
        tint = None if colour is None else validation.colour(f"{where}.colour", colour)
        self.embedded_surfaces.append(build_surface(where, self.n_balls, corners, weights, triangles, covers, tint, uv))
        return len(self.embedded_surfaces) - 1

    # What can be changed -------------------------------------------------------------------------------------------

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
