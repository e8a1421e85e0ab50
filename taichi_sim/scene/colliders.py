"""Colliders: solid bodies of infinite mass that balls bounce off, still or moving along a given path. Imports no Taichi.

scene.add_collider(ts.Sphere((0, 0), 1.0, hollow=0.1, angular_velocity=2.0))   # a turning drum
scene.add_collider(ts.Box((0, -1), (4, 0.2), rotation=20))                     # an incline
scene.add_collider(ts.Box((0, 0), (1, 1), path=[(0.0, (0, 0)), (1.0, (2, 0))]))  # a piston
"""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, dataclass, field, fields
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.geometry.mesh import Surface, by_hand, holes, mesh_distance, read_surface, volume
from taichi_sim.scene.collision_groups import EVERY, ONLY
from taichi_sim.scene.keyframes import Motion, keyframe, turn_matrix

__all__ = ["BOX", "MESH", "ROUND", "SHAPES", "Box", "Capsule", "Collider", "Mesh", "Sphere", "build", "shape_of"]

Floats = NDArray[np.float64]
ROUND, BOX, MESH, CUSTOM = "round", "box", "mesh", "custom"
FLAT = 1e-9  # of the cube around a mesh: what encloses less is a sheet
MOST_CELLS = 512  # of a mesh's grid along its longest side


@dataclass(frozen=True, slots=True, eq=False)
class Collider:
    """A collider of a scene, checked. Its local frame has the origin at its centre; `motion` says where that is.

    kind ROUND: all points within `radius` [m] of the stretch from -half[0] to half[0] of the local x axis; BOX: |x| <= half
    (dim,) [m]; MESH: vertices (v, 3) [m] and triangles (t, 3). hollow > 0 [m]: what is given is the room inside a shell that
    thick. given: the arguments as plain lists and numbers, which build the same collider again.
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

    @property
    def extent(self) -> float:
        """Distance [m] from the centre within which all of it lies."""
        if self.kind == MESH:
            return float(np.linalg.norm(self.vertices, axis=1).max())
        return float(np.linalg.norm(self.half)) + self.radius + self.hollow

    def distance(self, x: Floats, time: float) -> Floats:
        """Signed distances (n,) [m] of points x (n, dim) from its surface at `time` [s], negative inside; plain and slow."""
        centre, turn = self.motion.at(time)
        p = (x - centre[0]) @ turn[0]
        if self.kind == MESH:
            return mesh_distance(Surface(self.vertices, self.triangles), p)
        if self.kind == BOX:
            q = np.abs(p) - self.half
            d = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)
        else:
            d = np.linalg.norm(p - np.clip(p, -self.half, self.half), axis=1) - self.radius
        return d if self.hollow == 0.0 else np.maximum(-d, d - self.hollow)


@dataclass(frozen=True)
class _Placed:
    """What every collider takes.

    Args:
        material: name of a material added before. colour: sRGB in 0..1. group, collides_with: as for balls.
        rotation: about its centre at the start: degrees (one number in 2D, three about x, y and z in 3D), or a matrix.
        velocity: (dim,) m/s. angular_velocity: 1/s, counter-clockwise in 2D, (3,) in 3D, about `pivot` (dim,) [m], which
            moves along and is the centre if left out.
        path: in place of these, keyframes {time [s], position (dim,) [m], rotation} or (time, position[, rotation]); what is
            left out of one is the shape's own. Between keyframes it moves with constant velocities, in 3D the shorter way
            around. repeat: start again at the end, for ever.
    """

    _: KW_ONLY
    material: str = "default"
    rotation: Any = None
    velocity: Any = None
    angular_velocity: Any = None
    pivot: Any = None
    path: Any = ()
    repeat: bool = False
    colour: Any = None
    group: Any = "default"
    collides_with: Any = None


@dataclass(frozen=True)
class Sphere(_Placed):
    """A solid sphere, in 2D a disc; hollow [m] > 0: a shell that thick around the radius [m], balls inside stay inside."""

    center: ArrayLike
    radius: float
    hollow: float = 0.0


@dataclass(frozen=True)
class Box(_Placed):
    """A solid box of the full size (dim,) [m] about its center (dim,) [m]; hollow [m] > 0: the room inside a shell that thick."""

    center: ArrayLike
    size: ArrayLike
    hollow: float = 0.0


@dataclass(frozen=True)
class Capsule(_Placed):
    """All points within radius [m] of the line from start (dim,) [m] to end; hollow [m] > 0: a shell around that."""

    start: ArrayLike
    end: ArrayLike
    radius: float
    hollow: float = 0.0


@dataclass(frozen=True)
class Mesh(_Placed):
    """A closed triangle mesh in 3D, solid inside.

    mesh: an OBJ, PLY or STL file, or (vertices (v, 3) [m], triangles (t, 3)). position (3,) [m]: where its origin goes; scale:
    its size. resolution: cells along the longest side of the grid on which distances are kept: edges are round to about a cell.
    """

    mesh: str | PathLike[str] | tuple[Any, Any]
    position: Any = None
    scale: float = 1.0
    resolution: int = 64


SHAPES: dict[str, type[_Placed]] = {"sphere": Sphere, "box": Box, "capsule": Capsule, "mesh": Mesh}


def build(shape: Any, dim: int, where: str, material: int) -> Collider:
    """A collider from a shape, every argument checked. Raises SceneError that names `where`, the argument and the value."""
    name = next((name for name, kind in SHAPES.items() if type(shape) is kind), None)
    if name is None:
        raise SceneError(f"{where}: {shape!r} is not allowed; it must be one of ts.Sphere, ts.Box, ts.Capsule, ts.Mesh")
    given = {f.name: getattr(shape, f.name) for f in fields(shape)}
    half, radius, hollow, resolution = np.zeros(dim), 0.0, 0.0, 0
    surface = Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    turn = None
    if isinstance(shape, Mesh):
        kind, centre = MESH, np.zeros(3)
        surface, resolution = _surface(shape, dim, where), _resolution(shape.resolution, where)
        if shape.position is not None:
            centre = validation.vector(f"{where}.position", shape.position, 3)
        given["mesh"] = surface  # scaled already
        given["scale"] = 1.0
    else:
        hollow = validation.number(f"{where}.hollow", given["hollow"], low=0)
    if isinstance(shape, (Sphere, Capsule)):
        kind, radius = ROUND, validation.number(f"{where}.radius", shape.radius, positive=True)
    if isinstance(shape, (Sphere, Box)):
        centre = validation.vector(f"{where}.center", shape.center, dim)
    if isinstance(shape, Box):
        kind, half = BOX, 0.5 * validation.vector(f"{where}.size", shape.size, dim)
        if not np.all(half > 0):
            axis = int(np.argmin(half > 0))
            raise SceneError(f"{where}.size[{axis}]: {2 * half[axis]:g} is not allowed; it must be greater than 0")
    if isinstance(shape, Capsule):
        start, end = (validation.vector(f"{where}.{key}", given[key], dim) for key in ("start", "end"))
        centre, length = 0.5 * (start + end), float(np.linalg.norm(end - start))
        if length == 0.0:
            raise SceneError(
                f"{where}.end: {end.tolist()} is not allowed; it must differ from start (or take a Sphere)"
            )
        half[0], turn = 0.5 * length, _onto((end - start) / length)
    motion = Motion.of(where, dim, centre, given)
    if turn is not None:
        motion = _turned(motion, turn)
    colour = None
    if shape.colour is not None:
        colour = tuple(validation.per_item(f"{where}.colour", shape.colour, 3, low=0, high=1).tolist())
    if len(motion.times) > 1:
        given["path"] = [keyframe("", key) for key in shape.path]
    plain = {"shape": name} | {key: _plain(value) for key, value in given.items() if not _left_out(shape, key, value)}
    parts = (surface.vertices, surface.triangles)
    return Collider(name, kind, half, radius, hollow, material, motion, colour, resolution, *parts, plain)


def _turned(motion: Motion, turn: Floats) -> Motion:
    """The motion of a shape whose local frame is turned before: a capsule lies along its local x axis."""
    return Motion(
        motion.times,
        motion.positions,
        motion.rotations @ turn,
        motion.turns,
        motion.velocity,
        motion.pivot,
        motion.repeat,
    )


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
        raise SceneError(f"{where}: a mesh needs a scene in 3D")
    scale = validation.number(f"{where}.scale", shape.scale, positive=True)
    if isinstance(shape.mesh, (str, PathLike)):
        name = repr(str(shape.mesh))
        try:
            surface = read_surface(shape.mesh)
        except SceneError as problem:
            raise SceneError(f"{where}.{problem}") from None
    else:
        surface = by_hand(f"{where}.mesh", shape.mesh)
        name = "the mesh"
    open_edges = holes(surface.triangles)
    if len(open_edges) or not len(surface.triangles):
        at = ""
        if len(open_edges):
            at = f"; the first lies at {(surface.vertices[open_edges[0]].mean(axis=0)).round(6).tolist()}"
        raise SceneError(
            f"{where}.mesh: {name} is not closed: {len(open_edges)} edges do not lie between exactly two triangles that"
            f" face the same way{at}; a collider needs an inside"
        )
    inside = volume(surface)
    if abs(inside) <= FLAT * float(np.max(np.ptp(surface.vertices, axis=0))) ** 3:
        raise SceneError(f"{where}.mesh: {name} is flat: it encloses {inside:.2g} m^3; a collider needs an inside")
    triangles = surface.triangles[:, ::-1] if inside < 0.0 else surface.triangles
    return Surface(surface.vertices * scale, np.ascontiguousarray(triangles))


def _resolution(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 4 <= value <= MOST_CELLS:
        raise SceneError(
            f"{where}.resolution: {value!r} is not allowed; it must be a whole number from 4 to {MOST_CELLS}"
        )
    return int(value)


def _left_out(shape: Any, key: str, value: Any) -> bool:
    """Whether an argument has its default."""
    default = next(f.default for f in fields(shape) if f.name == key)
    return value is default or (isinstance(value, (int, float, str, tuple)) and value == default)


def _plain(value: Any) -> Any:
    """Lists, numbers and texts; a mesh stays a pair of arrays."""
    if isinstance(value, Surface):
        return value
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, Sequence) and not isinstance(value, str) else value


def shape_of(given: Mapping[str, Any]) -> Any:
    """The shape that `Collider.given`, or a table of a scene file, describes. Raises SceneError for keys that it has not."""
    arguments = dict(given)
    name = arguments.pop("shape")
    kind = SHAPES[name]
    if "vertices" in arguments or "triangles" in arguments:
        arguments["mesh"] = (arguments.pop("vertices", ()), arguments.pop("triangles", ()))
    known = {f.name: f for f in fields(kind)}
    for key in arguments:
        if key not in known:
            raise SceneError(f"{key}: is not a key of a {name}; it has {', '.join(known)}")
    for key, entry in known.items():
        if entry.default is MISSING and key not in arguments:
            raise SceneError(f"{key}: is missing; a {name} needs it")
    return kind(**arguments)
