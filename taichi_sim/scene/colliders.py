"""Colliders: solid bodies of infinite mass that balls bounce off, still or moving along a given path. Imports no Taichi.

scene.add_collider(ts.Sphere((0, 0), 1.0, hollow=0.1, rotation_rate=90.0))     # a turning drum
scene.add_collider(ts.Box((0, -1), (4, 0.2), rotation=20))                     # an incline
scene.add_collider(ts.Box((0, 0), (1, 1), path=[(0.0, (0, 0)), (1.0, (2, 0))]))  # a piston, pushed by 2 m

A user-defined shape is a subclass of `ColliderShape`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, unknown_key
from taichi_sim.common.plain import plain
from taichi_sim.scene.collider_forms import Floats, Form, Meshed
from taichi_sim.scene.collider_shapes import SHAPES
from taichi_sim.scene.collision_groups import EVERY, ONLY
from taichi_sim.scene.mesh_colliders import ColliderShape
from taichi_sim.scene.motion import Motion, plain_path

__all__ = ["Collider", "build", "shape_of"]

NAMES = ", ".join(f"ts.{kind.__name__}" for kind in SHAPES.values())


@dataclass(frozen=True, slots=True, eq=False)
class Collider:
    """A collider of a scene, checked. Its local frame has the origin at its centre; `motion` says where that is.

    form: what half (dim,) [m] and radius [m] mean. Where it is Meshed: vertices (v, dim) [m] and triangles (t, 3), in 2D those
    that fill it. hollow > 0 [m]: what is given is the room inside a shell that thick. given: the arguments as plain lists and
    numbers; with the vertices and triangles of a mesh they build the same collider again, unless it is of a shape of the
    user's own.
    """

    name: str
    form: type[Form]
    half: Floats
    radius: float
    hollow: float
    material: int
    motion: Motion
    colour: tuple[float, float, float] | None
    resolution: int
    vertices: Floats
    triangles: NDArray[np.int32]
    given: dict[str, Any] = field(repr=False)
    group: int = ONLY  # bits, see Scene.groups
    mask: int = EVERY  # bits of the groups that it collides with
    shape: ColliderShape | None = None  # of the user's own
    label: str = ""  # the name that it was given

    def in_words(self, number: int) -> str:
        """`colliders[2] (bowl)`: its number in the scene, and the name that it was given, or what it is."""
        return f"colliders[{number}] ({self.label or self.name})"

    @property
    def is_meshed(self) -> bool:
        """True if its surface is known as triangles."""
        return issubclass(self.form, Meshed)

    @property
    def extent(self) -> float:
        """Distance [m] from the centre within which all of it lies."""
        if self.is_meshed:
            return float(np.linalg.norm(self.vertices, axis=1).max())
        return float(np.linalg.norm(self.half)) + self.radius + self.hollow

    def distance(self, x: Floats, time: float) -> Floats:
        """Signed distances (n,) [m] of points x (n, dim) from its surface at `time` [s], negative inside; plain and slow. That
        of a shape of the user's own as it is drawn."""
        centre, turn = self.motion.at(time)
        d = self.form.distances(self, (x - centre[0]) @ turn[0])
        return d if self.hollow == 0.0 else np.maximum(-d, d - self.hollow)

    def surface(self, around: int) -> tuple[Floats, NDArray[np.int32]]:
        """Vertices (v, 3) [m] and triangles (t, 3) in 3D. A vertex belongs to one smooth part of the surface, unless it is
        meshed. around: faces of what is round about its axis, a multiple of 4."""
        return self.form.triangulated(self, around)

    def filled(self, around: int) -> tuple[Floats, NDArray[np.int32]]:
        """Vertices (v, 2) [m] and triangles (t, 3) that fill it in 2D. around: as above."""
        return self.form.filled(self, around)

    def saved(self, where: str) -> Collider:
        """The collider that a file holds in its place. Raises SceneError where a file cannot hold it."""
        if self.shape is None:
            return self
        instead = self.shape.saved_as()
        if not isinstance(instead, tuple(SHAPES.values())):
            raise SceneError(
                where,
                says=f"a file cannot hold {self.name}, a shape of your own; let its saved_as() return the shape that is to"
                f" be saved in its place, one of {NAMES}",
            )
        return replace(build(instead, len(self.half), where, self.material), group=self.group, mask=self.mask)


def build(shape: Any, dim: int, where: str, material: int) -> Collider:
    """A collider from a shape, every argument checked. Raises SceneError that names `where`, the argument and the value."""
    name = next((name for name, kind in SHAPES.items() if type(shape) is kind), None)
    if isinstance(shape, ColliderShape):
        name = type(shape).__name__
    if isinstance(shape, type):
        raise SceneError(where, says=f"{shape.__name__} is a class; give an object, {shape.__name__}(...)")
    if name is None:
        raise SceneError(where, shape, f"one of {NAMES}, or a ts.ColliderShape")
    given = {f.name: getattr(shape, f.name) for f in fields(shape)}
    form = shape._checked(dim, where)
    if form.form is Meshed:
        given |= {"scale": 1.0, "up": None}  # as its vertices are
    motion = Motion.of(where, dim, form.centre, given)
    if form.turn is not None:
        motion = replace(motion, rotations=motion.rotations @ form.turn)
    colour = None
    if shape.colour is not None:
        colour = tuple(validation.per_item(f"{where}.colour", shape.colour, 3, low=0, high=1).tolist())
    if shape.name is not None and (not isinstance(shape.name, str) or not shape.name):
        raise SceneError(f"{where}.name", shape.name, "a text")
    if len(motion.times) > 1:
        given["path"] = plain_path(shape.path)
    given = {key: value for key, value in given.items() if key != "mesh" and not _left_out(shape, key, value)}
    own = plain({"shape": name} | given)
    collider = Collider(
        name,
        form.form,
        form.half,
        form.radius,
        form.hollow,
        material,
        motion,
        colour,
        form.resolution,
        form.surface.vertices,
        form.surface.triangles,
        own,
    )
    return replace(collider, label=shape.name or "", shape=shape if isinstance(shape, ColliderShape) else None)


def _left_out(shape: Any, key: str, value: Any) -> bool:
    """True if an argument has its default."""
    default = next(f.default for f in fields(shape) if f.name == key)
    return value is default or (isinstance(value, (int, float, str, tuple)) and value == default)


def shape_of(given: Mapping[str, Any]) -> Any:
    """The shape that `Collider.given`, or a table of a scene file, describes. Raises SceneError for keys that it has not."""
    arguments = dict(given)
    name = arguments.pop("shape", None)
    validation.one_of("colliders.shape", name, SHAPES)
    kind = SHAPES[name]
    if "vertices" in arguments or "triangles" in arguments:
        arguments["mesh"] = (arguments.pop("vertices", ()), arguments.pop("triangles", ()))
    known = {f.name: f for f in fields(kind)}
    for key in arguments:
        if key not in known:
            raise unknown_key(("colliders", key), known, f"a key of a {name}")
    for key, entry in known.items():
        if entry.default is MISSING and key not in arguments:
            raise SceneError(("colliders", key), says=f"is missing; a {name} needs it")
    return kind(**arguments)
