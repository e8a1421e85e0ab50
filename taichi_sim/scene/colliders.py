"""Colliders: solid bodies of infinite mass that balls bounce off, still or moving along a given path. Imports no Taichi.

scene.add_collider(ts.Sphere((0, 0), 1.0, hollow=0.1, rotation_rate=90.0))     # a turning drum
scene.add_collider(ts.Box((0, -1), (4, 0.2), rotation=20))                     # an incline
scene.add_collider(ts.Box((0, 0), (1, 1), path=[(0.0, (0, 0)), (1.0, (2, 0))]))  # a piston, pushed by 2 m

A user-defined shape is a subclass of `ColliderShape`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, dataclass, field, fields, replace
from os import PathLike
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, unknown_key
from taichi_sim.common.plain import plain
from taichi_sim.common.quantities import counted
from taichi_sim.common.spelling import takes_centre, takes_color
from taichi_sim.geometry.mesh import Surface, given_surface, holes, volume
from taichi_sim.scene.collider_forms import BOX, CUSTOM, FORMS, MESH, ROUND
from taichi_sim.scene.collision_groups import EVERY, ONLY
from taichi_sim.scene.motion import Keyframe, Motion, plain_path, turn_matrix

__all__ = [
    "SHAPES",
    "Box",
    "Capsule",
    "Collider",
    "ColliderShape",
    "Mesh",
    "Sphere",
    "build",
    "shape_of",
]

Floats = NDArray[np.float64]
FLATTEST = 1e-9  # of the cube around a mesh: what encloses less is a sheet
MOST_CELLS = 512  # of a mesh's grid along its longest side


@dataclass(frozen=True, slots=True, eq=False)
class Collider:
    """A collider of a scene, checked. Its local frame has the origin at its centre; `motion` says where that is.

    kind ROUND: all points within `radius` [m] of the stretch from -half[0] to half[0] of the local x axis; BOX: |x| <= half
    (dim,) [m]; MESH: vertices (v, 3) [m] and triangles (t, 3); CUSTOM: what the distance function of `shape` says, drawn as
    vertices (v, dim) [m] and triangles (t, 3), in 2D those that fill it. hollow > 0 [m]: what is given is the room inside a shell
    that thick. given: the arguments as plain lists and numbers; with the vertices and triangles of a MESH they build the same
    collider again, unless it is CUSTOM.
    """

    name: str
    kind: str
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
    shape: ColliderShape | None = None  # of a CUSTOM one
    label: str = ""  # the name that it was given

    def in_words(self, number: int) -> str:
        """`colliders[2] (bowl)`: its number in the scene, and the name that it was given, or what it is."""
        return f"colliders[{number}] ({self.label or self.name})"

    @property
    def is_meshed(self) -> bool:
        """True if its surface is known as triangles."""
        return self.kind in (MESH, CUSTOM)

    @property
    def extent(self) -> float:
        """Distance [m] from the centre within which all of it lies."""
        if self.is_meshed:
            return float(np.linalg.norm(self.vertices, axis=1).max())
        return float(np.linalg.norm(self.half)) + self.radius + self.hollow

    def distance(self, x: Floats, time: float) -> Floats:
        """Signed distances (n,) [m] of points x (n, dim) from its surface at `time` [s], negative inside; plain and slow. That
        of a CUSTOM one as it is drawn."""
        centre, turn = self.motion.at(time)
        d = FORMS[self.kind].distances(self, (x - centre[0]) @ turn[0])
        return d if self.hollow == 0.0 else np.maximum(-d, d - self.hollow)

    def surface(self, around: int) -> tuple[Floats, NDArray[np.int32]]:
        """Vertices (v, 3) [m] and triangles (t, 3) in 3D. A vertex belongs to one smooth part of the surface, unless it is
        meshed. around: faces of what is round about its axis, a multiple of 4."""
        return FORMS[self.kind].triangulated(self, around)

    def filled(self, around: int) -> tuple[Floats, NDArray[np.int32]]:
        """Vertices (v, 2) [m] and triangles (t, 3) that fill it in 2D. around: as above."""
        return FORMS[self.kind].filled(self, around)

    def saved(self, where: str) -> Collider:
        """The collider that a file holds in its place. Raises SceneError where a file cannot hold it."""
        if self.shape is None:
            return self
        instead = self.shape.saved_as()
        if not isinstance(instead, tuple(SHAPES.values())):
            raise SceneError(
                where,
                says=f"a file cannot hold {self.name}, a shape of your own; let its saved_as() return the ts.Sphere, ts.Box,"
                " ts.Capsule or ts.Mesh that is to be saved in its place",
            )
        return replace(build(instead, len(self.half), where, self.material), group=self.group, mask=self.mask)


class _Checked(NamedTuple):
    """Properties that follow from the arguments of a shape, see Collider."""

    kind: str
    centre: Floats
    half: Floats
    radius: float = 0.0
    hollow: float = 0.0
    turn: Floats | None = None  # of its local frame, before its motion
    surface: Surface = Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    resolution: int = 0


@dataclass(frozen=True)
class _Placed:
    """Arguments of every collider.

    Args:
        material: name of a material added before, or of a preset. colour: sRGB in 0..1 [1]; grey otherwise.
        group: name or names of the collision groups that it is in. collides_with: names of the groups that it collides with;
            None: all. name: what files for other programs call it.
        rotation: about its centre at the start [degrees]: one number in 2D, three about x, y and z in 3D; or a matrix.
        velocity: (dim,) for ever [m/s].
        rotation_rate: about `pivot`, for ever [degrees per second], counter-clockwise in 2D, (3,) in 3D.
        pivot: (dim,) that it turns about, which moves along [m]; its centre if left out.
        path: in place of these, keyframes {time, position, rotation} or (time, position[, rotation]): by how far it has moved
            from where it starts, and turned about its centre. The first is 0. Between keyframes it moves with constant
            velocities, in 3D turning the shorter way around, and it stays where the last one leaves it, unless the path repeats.
        repeat: whether the path starts again at its end, for ever.
    """

    def __init_subclass__(cls) -> None:
        """Shapes say what they all take, too, for `help`."""
        if cls.__module__ == __name__ and cls.__doc__ is not None:
            common = (_Placed.__doc__ or "").partition("Args:\n")[2].rstrip()
            cls.__doc__ = f"{cls.__doc__.rstrip()}\n\n    Args of every shape, by name:\n{common}\n"

    def __new__(cls, *_: Any, **given: Any) -> _Placed:
        if "angular_velocity" in given:
            raise unknown_key(("colliders", "angular_velocity"), ("rotation_rate",))
        return object.__new__(cls)

    _: KW_ONLY
    material: str = "default"
    rotation: ArrayLike | None = None
    velocity: ArrayLike | None = None
    rotation_rate: ArrayLike | None = None
    pivot: ArrayLike | None = None
    path: Sequence[Keyframe | Sequence[Any]] = ()
    repeat: bool = False
    colour: Sequence[float] | None = None
    group: str | Sequence[str] = "default"
    collides_with: str | Sequence[str] | None = None
    name: str | None = None

    def _checked(self, dim: int, where: str) -> _Checked:
        """Its own arguments, checked. Raises SceneError."""
        raise NotImplementedError

    def _number(self, where: str, key: str, **bounds: Any) -> float:
        return validation.number(f"{where}.{key}", getattr(self, key), **bounds)

    def _vector(self, where: str, key: str, dim: int) -> Floats:
        return validation.vector(f"{where}.{key}", getattr(self, key), dim)


@dataclass(frozen=True)
class Sphere(_Placed):
    """A solid sphere, in 2D a disc.

    Args:
        center: (dim,) of the sphere [m]; radius: of the sphere [m].
        hollow: thickness of a shell around the radius, inside which balls stay [m]; 0: it is solid.
    """

    center: ArrayLike
    radius: float
    hollow: float = 0.0

    def _checked(self, dim: int, where: str) -> _Checked:
        hollow, radius = self._number(where, "hollow", low=0), self._number(where, "radius", positive=True)
        return _Checked(ROUND, self._vector(where, "center", dim), np.zeros(dim), radius, hollow)


@dataclass(frozen=True)
class Box(_Placed):
    """A solid box.

    Args:
        center: (dim,) of the box [m]; size: (dim,) from side to side [m].
        hollow: thickness of a shell around it, whose inside is of the given size [m]; 0: it is solid.
    """

    center: ArrayLike
    size: ArrayLike
    hollow: float = 0.0

    def _checked(self, dim: int, where: str) -> _Checked:
        hollow, centre = self._number(where, "hollow", low=0), self._vector(where, "center", dim)
        size = validation.per_item(f"{where}.size", self._vector(where, "size", dim), dim, positive=True)
        return _Checked(BOX, centre, 0.5 * size, hollow=hollow)


@dataclass(frozen=True)
class Capsule(_Placed):
    """All points within a radius of a line.

    Args:
        start, end: (dim,) of the line [m]; radius: around it [m].
        hollow: thickness of a shell around it, inside which balls stay [m]; 0: it is solid.
    """

    start: ArrayLike
    end: ArrayLike
    radius: float
    hollow: float = 0.0

    def _checked(self, dim: int, where: str) -> _Checked:
        hollow, radius = self._number(where, "hollow", low=0), self._number(where, "radius", positive=True)
        start, end = self._vector(where, "start", dim), self._vector(where, "end", dim)
        length = float(np.linalg.norm(end - start))
        if length == 0.0:
            raise SceneError(f"{where}.end", end, "another point than start (or take a Sphere)")
        half = np.zeros(dim)
        half[0] = 0.5 * length
        return _Checked(ROUND, 0.5 * (start + end), half, radius, hollow, _onto((end - start) / length))


@dataclass(frozen=True)
class Mesh(_Placed):
    """A closed triangle mesh in 3D, solid inside.

    Args:
        mesh: an OBJ, PLY, STL or GLB file, or (vertices (v, 3) [m], triangles (t, 3)).
        position: (3,) where its origin goes [m]; scale: its size in relation to the file's [1].
        up: axis of the mesh that points up, "y" or "z"; y by default, with a warning for STL and PLY files, which do not tell.
        resolution: cells along the longest side of the grid on which distances are kept. Where the grid is too coarse, at edges
            and thin walls, distances are taken from the triangles.
    """

    mesh: str | PathLike[str] | tuple[Any, Any]
    position: Any = None
    scale: float = 1.0
    resolution: int = 64
    up: Literal["y", "z"] | None = None

    def _checked(self, dim: int, where: str) -> _Checked:
        surface = _surface(self, dim, where)
        resolution = validation.whole(f"{where}.resolution", self.resolution, 4, MOST_CELLS)
        centre = np.zeros(3) if self.position is None else self._vector(where, "position", 3)
        return _Checked(MESH, centre, np.zeros(dim), surface=surface, resolution=resolution)


@dataclass(frozen=True)
class ColliderShape(_Placed):
    """Base of user-defined collider shapes.

    center (dim,) [m]: where the origin of its own frame is. It has

    `distance(p)`: a Taichi function, the signed distance [m] of the point p (dim,) [m] of its own frame from its surface,
    negative inside; true within a ball's radius, and nowhere more than that, for balls on their way are led by it.
    `surface()`: vertices (v, dim) [m] and triangles (t, 3), to draw it and to see that no ball starts inside: in 3D its closed
    surface, in 2D triangles that fill it. They reach as far as the shape does.

    A cone, upright, with its center in the middle of its base:

        @ti.data_oriented
        class Cone(ts.ColliderShape):
            def __init__(self, center, radius, height, **placed):
                super().__init__(center, **placed)
                self.radius, self.height = radius, height

            @ti.func
            def distance(self, p):
                r, h, out = self.radius, self.height, ti.sqrt(p[0] ** 2 + p[2] ** 2)
                up = ti.math.clamp(((r - out) * r + p[1] * h) / (r * r + h * h), 0.0, 1.0)  # nearest on its side, from the rim
                side, base = ti.Vector([out - r * (1.0 - up), p[1] - h * up]), ti.Vector([ti.max(out - r, 0.0), p[1]])
                inside = p[1] > 0.0 and (out - r) * h + p[1] * r < 0.0
                return ti.select(inside, -1.0, 1.0) * ti.min(side.norm(), base.norm())

            def surface(self):
                k, angle = np.arange(48), np.linspace(0, 2 * np.pi, 48, endpoint=False)
                rim = self.radius * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
                base, side = ([k, np.roll(k, -1), 48 + 0 * k], [np.roll(k, -1), k, 49 + 0 * k])
                vertices = np.concatenate([rim, [[0, 0, 0], [0, self.height, 0]]])
                return vertices, np.concatenate([np.stack(base, axis=1), np.stack(side, axis=1)])

        scene.add_collider(Cone((0, 0, 0), radius=1.0, height=0.5))

    A file holds what `saved_as` returns.
    """

    center: ArrayLike

    def surface(self) -> tuple[ArrayLike, ArrayLike]:
        """Vertices (v, dim) [m] and triangles (t, 3) in its own frame."""
        raise NotImplementedError

    def saved_as(self) -> Any:
        """The Sphere, Box, Capsule or Mesh that a file holds in its place; None: it cannot be saved."""
        return None

    def _checked(self, dim: int, where: str) -> _Checked:
        surface = _drawn(self, dim, where)
        return _Checked(CUSTOM, self._vector(where, "center", dim), np.zeros(dim), surface=surface)


SHAPES: dict[str, type[_Placed]] = {"sphere": Sphere, "box": Box, "capsule": Capsule, "mesh": Mesh}
for _kind in (*SHAPES.values(), ColliderShape):
    _kind.__init__ = takes_color(takes_centre(_kind.__init__))  # type: ignore[misc]


def build(shape: Any, dim: int, where: str, material: int) -> Collider:
    """A collider from a shape, every argument checked. Raises SceneError that names `where`, the argument and the value."""
    name = next((name for name, kind in SHAPES.items() if type(shape) is kind), None)
    if isinstance(shape, ColliderShape):
        name = type(shape).__name__
    if isinstance(shape, type):
        raise SceneError(where, says=f"{shape.__name__} is a class; give an object, {shape.__name__}(...)")
    if name is None:
        raise SceneError(where, shape, "one of ts.Sphere, ts.Box, ts.Capsule, ts.Mesh, or a ts.ColliderShape")
    given = {f.name: getattr(shape, f.name) for f in fields(shape)}
    form = shape._checked(dim, where)
    if form.kind == MESH:
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
        form.kind,
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
    return replace(collider, label=shape.name or "", shape=shape if form.kind == CUSTOM else None)


def _onto(axis: Floats) -> Floats:
    """A rotation (dim, dim) that takes the x axis to a unit vector."""
    if len(axis) == 2:
        return np.array([[axis[0], -axis[1]], [axis[1], axis[0]]])
    across = np.cross([1.0, 0.0, 0.0], axis)
    sine = float(np.linalg.norm(across))
    if sine < 1e-12:
        return np.eye(3) if axis[0] > 0 else np.diag([-1.0, -1.0, 1.0])
    return turn_matrix((across / sine * np.arctan2(sine, axis[0]))[None])[0]


def _surface(shape: Mesh, dim: int, where: str) -> Surface:
    """The triangles of a mesh collider, scaled, closed and facing outward."""
    if dim != 3:
        raise SceneError(where, says="a mesh needs a scene in 3D")
    scale = validation.number(f"{where}.scale", shape.scale, positive=True)
    name = repr(str(shape.mesh)) if isinstance(shape.mesh, (str, PathLike)) else "the mesh"
    surface = given_surface(where, shape.mesh, shape.up)
    surface = _closed(surface, f"{where}.mesh", name)
    return Surface(surface.vertices * scale, surface.triangles)


def _closed(surface: Surface, where: str, name: str) -> Surface:
    """A surface that encloses something, facing outward."""
    open_edges = holes(surface.triangles)
    if len(open_edges) or not len(surface.triangles):
        at = ""
        if len(open_edges):
            at = f"; the first lies at {(surface.vertices[open_edges[0]].mean(axis=0)).round(6).tolist()}"
        edges = counted(len(open_edges), "edge does", "edges do")
        raise SceneError(
            where,
            says=f"{name} is not closed: {edges} not lie between exactly two triangles that"
            f" face the same way{at}; a collider needs an inside",
        )
    inside = volume(surface)
    if abs(inside) <= FLATTEST * float(np.max(np.ptp(surface.vertices, axis=0))) ** 3:
        raise SceneError(where, says=f"{name} is flat: it encloses {inside:.2g} m^3; a collider needs an inside")
    triangles = surface.triangles[:, ::-1] if inside < 0.0 else surface.triangles
    return Surface(surface.vertices, np.ascontiguousarray(triangles))


def _drawn(shape: ColliderShape, dim: int, where: str) -> Surface:
    """Surface that the renderer shows of a shape of the user's own. Checks it, and its distance function; raises SceneError."""
    name = type(shape).__name__
    validation.taichi_function(where, shape, "distance", "p")
    if type(shape).surface is ColliderShape.surface:
        raise SceneError(where, says=f"{name} needs a function surface(self) that returns (vertices, triangles)")
    where, drawn = f"{where}.surface()", shape.surface()
    if not isinstance(drawn, (tuple, list)) or len(drawn) != 2:
        raise SceneError(where, drawn, "a pair (vertices, triangles)")
    vertices, triangles = drawn
    points = validation.vectors(f"{where}.vertices", vertices, None, dim)
    corners = validation.indices(f"{where}.triangles", triangles, len(points), 3, "vertex")
    if dim == 3:
        return _closed(Surface(points, corners), where, "what it draws")
    if not len(corners):
        raise SceneError(where, says="there are no triangles; they fill the shape")
    return Surface(points, corners)


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
