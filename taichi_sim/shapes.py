"""Shapes: free functions that add balls, springs and triangles to a scene and return what they added.

    scene = ts.Scene(dim=3, gravity=(0, -9.81, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(32, 32), pinned=[0, 31 * 32], position=(0, 1, 0))

Every length is in m, every mass is that of the whole shape in kg, every stiffness in N/m, damping in N s/m along a
spring, angles in degrees. `position`, `rotation` and `scale` move the finished shape: scaled about its origin, turned
about the x, y and z axis in this order (2D: one angle), then shifted; scale changes no given mass. Balls of one shape
do not collide with each other unless `self_collision` is True; with `surface_collision` nothing goes through the triangles of a
cloth or a jelly, its own ones included. A wrong argument is a SceneError that names it; the
scene is then unchanged.

Defaults. A stiffness that is not given follows from the mass and the resolution so that the bound which holds for
every shape the springs can take, h^2 (S_i/m_i + S_j/m_j) < 4 for each spring (physics section 5), is met at h = 1 ms
with a factor 2 to spare, whatever the resolution: velocity Verlet is then stable at 1 ms. Finer shapes of the same
mass are therefore softer: held by one edge, a cloth of 1 m stretches by about 5 % at the top with 32 x 32 balls and
20 % with 64 x 64. For a firmer one give a stiffness and let `dt = "auto"` find the step. A damping that is not given
is a tenth of the critical damping of each spring's two balls. `pinned` takes what `Scene.add_balls` takes, counted
within the shape.
"""

from collections.abc import Sequence
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from taichi_sim import checks
from taichi_sim import mesh as meshes
from taichi_sim.errors import SceneError
from taichi_sim.scene import Scene
from taichi_sim.shape_parts import (
    Part,
    Shape,
    Springs,
    build,
    count,
    counts,
    lattice_pairs,
    moved,
    named,
    stable_stiffness,
)

__all__ = ["Shape", "cloth", "jelly", "pile", "rope", "wheel"]

Pins = bool | Sequence[int] | Sequence[bool] | NDArray

CLOTH_DENSITY = 0.2  # kg/m^2, a cotton sheet
ROPE_DENSITY = 0.1  # kg/m
JELLY_DENSITY = {2: 100.0, 3: 1000.0}  # kg/m^2 (a slab of 0.1 m) and kg/m^3: water
SHEAR_SHARE = 0.25  # of a cloth's stiffness, in its diagonals
BALL_RADIUS, SHELL_RADIUS = 0.45, 0.4  # of the spacing of a sheet, of the mean edge of a mesh
SURFACE_RADIUS = 0.25  # of either, where triangles collide, which need no balls that leave no gap
BENDING_SHARE = 0.05  # of a cloth's stiffness, between balls two apart or across an edge


def cloth(
    scene: Scene,
    size: Sequence[float] | None = None,
    resolution: Sequence[int] | None = None,
    mesh: "str | PathLike[str] | meshes.Surface | None" = None,
    *,
    mass: float | None = None,
    stiffness: float | None = None,
    bending_stiffness: float | None = None,
    damping: float | None = None,
    radius: float | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: Sequence[float] | None = None,
    scale: float = 1.0,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
    surface_collision: bool = False,
) -> Shape:
    """A sheet of cloth, or a shell from a surface mesh, in 3D.

    The sheet lies in the x-z plane from the origin toward +x and +z; ball (i, j) along x and z has index
    i * resolution[1] + j. It has springs to the next balls, along the diagonals (a quarter as stiff) and between
    balls two apart (bending). A mesh keeps its coordinates: vertices are balls, edges springs, and bending springs
    join the two vertices that face each other across an edge.

    Args:
        size: (x, z) m, (1, 1) by default; resolution: balls along x and z, at least 2, (32, 32) by default.
        mesh: an OBJ, PLY or STL file, or a `taichi_sim.mesh.Surface`, in place of size and resolution.
        mass: kg, shared out equally; 0.2 kg per m^2 of the sheet by default.
        stiffness: N/m; bending_stiffness: N/m, a twentieth of it by default.
        radius: of each ball [m]; 0.45 of the smaller spacing, or 0.4 of the mean edge of a mesh; with surface_collision 0.25.
        surface_collision: nothing goes through its triangles, itself and other such surfaces included, see Scene.add_triangles.
    """
    if scene.dim != 3:
        raise SceneError("cloth: a cloth needs a scene with dim = 3; in 2D use rope or jelly")
    if mesh is None:
        points, triangles, kinds, spacing, area = _sheet(size, resolution)
        share = BALL_RADIUS
    elif size is not None or resolution is not None:
        raise SceneError("cloth.mesh: takes the place of size and resolution; give one or the other")
    else:
        points, triangles, kinds, spacing, area = _shell(mesh)
        share = SHELL_RADIUS
    points = moved("cloth", points, position, rotation, scale)
    spacing, area = spacing * scale, area * scale**2
    total = _or_default("cloth.mass", mass, CLOTH_DENSITY * area)
    strength = _stiffness("cloth", stiffness, stable_stiffness(kinds, len(points), total))
    if bending_stiffness is not None:
        bending = checks.number("cloth.bending_stiffness", bending_stiffness, low=0)
        kinds[-1] = Springs(kinds[-1].pairs, 0.0, bending)
    solid = _flag("cloth.surface_collision", surface_collision)
    ball_radius = _or_default("cloth.radius", radius, (SURFACE_RADIUS if solid else share) * spacing)
    part = Part(total, ball_radius, pinned, material, colour, self_collision, solid)
    return build(scene, "cloth", points, kinds, triangles, part, strength, _damping("cloth", damping))


def jelly(
    scene: Scene,
    size: Sequence[float] | None = None,
    resolution: Sequence[int] | None = None,
    *,
    mass: float | None = None,
    stiffness: float | None = None,
    damping: float | None = None,
    radius: float | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: float | Sequence[float] | None = None,
    scale: float = 1.0,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
    surface_collision: bool = False,
) -> Shape:
    """A block of jelly from the origin toward the positive axes: a box lattice in 3D, a rectangle in 2D.

    Springs run along the edges and the diagonals of faces and cells, their stiffness in the ratio that makes the
    lattice elastic alike in all directions (see `_lattice`). In 3D the surface has triangles. Ball (i, j, k) has
    index (i * resolution[1] + j) * resolution[2] + k.

    Args:
        size: m per axis, 0.4 by default; resolution: balls per axis, at least 2, 8 by default.
        mass: kg, shared out equally; as heavy as water by default (in 2D a slab of 0.1 m).
        stiffness: of an edge [N/m]. By default such that waves run at sqrt(40 g height), which wobbles like jelly,
        and never
            above what is stable at 1 ms.
        radius: of each ball [m]; 0.45 of the smallest spacing by default, 0.25 with surface_collision.
        surface_collision: in 3D, nothing goes through the surface, see Scene.add_triangles.
    """
    dim = scene.dim
    lengths = _lengths("jelly.size", (0.4,) * dim if size is None else size, dim)
    number = counts("jelly.resolution", (8,) * dim if resolution is None else resolution, dim, 2)
    spacing = lengths / (np.array(number) - 1)
    points = np.stack(np.meshgrid(*map(np.arange, number), indexing="ij"), axis=-1).reshape(-1, dim) * spacing
    points = moved("jelly", points, position, rotation, scale)
    total = _or_default("jelly.mass", mass, JELLY_DENSITY[dim] * float(np.prod(lengths * scale)))
    kinds, along = _lattice(number)
    cell = float(np.prod(spacing * scale)) ** (2 / dim)  # m^2
    soft = 40 * 10.0 * float(lengths[1]) * scale * total / len(points) / (along * cell)  # c^2 = along k a^2 / m
    strength = _stiffness("jelly", stiffness, min(soft, stable_stiffness(kinds, len(points), total)))
    solid = _flag("jelly.surface_collision", surface_collision)
    if solid and dim == 2:
        raise SceneError("jelly.surface_collision: needs a scene with dim = 3")
    share = SURFACE_RADIUS if solid else BALL_RADIUS
    ball_radius = _or_default("jelly.radius", radius, share * float(spacing.min()) * scale)
    part = Part(total, ball_radius, pinned, material, colour, self_collision, solid)
    triangles = _box_surface(number) if dim == 3 else np.zeros((0, 3), dtype=np.int64)
    return build(scene, "jelly", points, kinds, triangles, part, strength, _damping("jelly", damping))


def rope(
    scene: Scene,
    start: Sequence[float],
    end: Sequence[float],
    n: int = 32,
    *,
    mass: float | None = None,
    stiffness: float | None = None,
    bending_stiffness: float = 0.0,
    damping: float | None = None,
    radius: float | None = None,
    pinned: Pins = False,
    material: str = "default",
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
) -> Shape:
    """A rope of n balls from start to end [m], in 2D or 3D; ball 0 lies at the start.

    Args:
        mass: kg, shared out equally; 0.1 kg per m by default.
        stiffness: N/m of each piece; bending_stiffness: N/m between balls two apart, none by default.
        radius: of each ball [m]; 0.45 of their distance by default.
    """
    a = checks.vectors("rope.start", start, 1, scene.dim)[0]
    b = checks.vectors("rope.end", end, 1, scene.dim)[0]
    number = (count("rope.n", n, 2),)
    length = float(np.linalg.norm(b - a))
    if length == 0:
        raise SceneError(f"rope.end: {list(end)!r} is not allowed; it must differ from start")
    points = a + np.linspace(0.0, 1.0, number[0])[:, None] * (b - a)
    bend = checks.number("rope.bending_stiffness", bending_stiffness, low=0)
    kinds = [Springs(lattice_pairs(number, (1,)), 1.0)]
    total = _or_default("rope.mass", mass, ROPE_DENSITY * length)
    strength = _stiffness("rope", stiffness, stable_stiffness(kinds, len(points), total))
    if bend > 0:
        kinds.append(Springs(lattice_pairs(number, (2,)), 0.0, bend))
    part = Part(
        total,
        _or_default("rope.radius", radius, 0.45 * length / (number[0] - 1)),
        pinned,
        material,
        colour,
        self_collision,
    )
    return build(scene, "rope", points, kinds, np.zeros((0, 3)), part, strength, _damping("rope", damping))


def wheel(
    scene: Scene,
    centre: Sequence[float],
    radius: float,
    spokes: int = 12,
    *,
    mass: float = 1.0,
    stiffness: float | None = None,
    damping: float | None = None,
    ball_radius: float | None = None,
    pinned: Pins = False,
    material: str = "default",
    rotation: float | Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
) -> Shape:
    """A wheel in the x-y plane: a hub (ball 0) at the centre and one rim ball at the end of each spoke.

    Args:
        centre: (dim,) m; radius: from the hub to the rim balls' centres [m]; spokes: at least 3.
        mass: kg, shared out equally over the hub and the rim.
        pinned: [0] holds the hub, about which the wheel then turns.
        ball_radius: of each ball [m]; 0.3 of the distance along the rim by default.
    """
    reach = checks.number("wheel.radius", radius, positive=True)
    number = count("wheel.spokes", spokes, 3)
    middle = checks.vectors("wheel.centre", centre, 1, scene.dim)[0]
    angle = 2 * np.pi * np.arange(number) / number
    points = np.zeros((number + 1, scene.dim))
    points[1:, 0], points[1:, 1] = reach * np.cos(angle), reach * np.sin(angle)
    points = moved("wheel", points, middle, rotation, 1.0)
    rim = 1 + np.arange(number)
    spoke_pairs = np.stack([np.zeros(number, dtype=np.int64), rim], axis=1)
    kinds = [Springs(spoke_pairs, 1.0), Springs(np.stack([rim, np.roll(rim, -1)], axis=1), 1.0)]
    total = _or_default("wheel.mass", mass, 1.0)
    strength = _stiffness("wheel", stiffness, stable_stiffness(kinds, len(points), total))
    side = 2 * reach * float(np.sin(np.pi / number))
    part = Part(
        total,
        _or_default("wheel.ball_radius", ball_radius, 0.3 * side),
        pinned,
        material,
        colour,
        self_collision,
    )
    return build(scene, "wheel", points, kinds, np.zeros((0, 3)), part, strength, _damping("wheel", damping))


def pile(
    scene: Scene,
    resolution: Sequence[int],
    radius: float,
    *,
    spacing: float | None = None,
    jitter: float = 0.05,
    seed: int = 0,
    mass: float = 1.0,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: float | Sequence[float] | None = None,
    colour: Sequence[float] | None = None,
) -> Shape:
    """A heap of loose balls on a lattice from the origin toward the positive axes. They collide with each other.

    Args:
        resolution: balls per axis; radius: of each [m]; mass: of each [kg].
        spacing: between centres [m]; 2.2 radii by default.
        jitter: the balls are moved at random by up to this fraction of a radius per axis, so that no column stands by
            luck; the same seed gives the same heap.
    """
    dim = scene.dim
    number = counts("pile.resolution", resolution, dim, 1)
    size = checks.number("pile.radius", radius, positive=True)
    step = _or_default("pile.spacing", spacing, 2.2 * size)
    shake = checks.number("pile.jitter", jitter, low=0, high=1) * size
    points = np.stack(np.meshgrid(*map(np.arange, number), indexing="ij"), axis=-1).reshape(-1, dim) * step
    points = points + np.random.default_rng(count("pile.seed", seed, 0)).uniform(-shake, shake, points.shape)
    points = moved("pile", points, position, rotation, 1.0)
    total = _or_default("pile.mass", mass, 1.0) * len(points)
    part = Part(total, size, pinned, material, colour, self_collision=True)
    return build(scene, "pile", points, [], np.zeros((0, 3)), part, 0.0, None)


# Arguments ---------------------------------------------------------------------------------------------------------


def _or_default(where: str, value: float | None, default: float) -> float:
    return default if value is None else checks.number(where, value, positive=True)


def _stiffness(shape: str, value: float | None, default: float) -> float:
    return default if value is None else checks.number(f"{shape}.stiffness", value, low=0)


def _damping(shape: str, value: float | None) -> float | None:
    return None if value is None else checks.number(f"{shape}.damping", value, low=0)


def _flag(where: str, value: bool) -> bool:
    return bool(checks.flags(where, value, 1)[0])


def _lengths(where: str, value: Sequence[float], n: int) -> NDArray[np.float64]:
    if np.shape(value) != (n,):
        raise SceneError(f"{where}: {value!r} is not allowed; it must be {n} lengths")
    return checks.per_item(where, value, n, positive=True)


# Lattices ----------------------------------------------------------------------------------------------------------


def _sheet(size: Sequence[float] | None, resolution: Sequence[int] | None) -> tuple:
    """Points, triangles, springs, spacing and area of a flat sheet."""
    lengths = _lengths("cloth.size", (1.0, 1.0) if size is None else size, 2)
    number = counts("cloth.resolution", (32, 32) if resolution is None else resolution, 2, 2)
    i, j = np.meshgrid(*map(np.arange, number), indexing="ij")
    spacing = lengths / (np.array(number) - 1)
    points = np.stack([i * spacing[0], np.zeros(i.shape), j * spacing[1]], axis=-1).reshape(-1, 3)
    index = np.arange(i.size).reshape(number)
    here, right, up, across = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    corners = [here, up, right], [right, up, across]  # seen from +y
    triangles = np.concatenate([np.stack([c.ravel() for c in three], axis=1) for three in corners])
    kinds = [
        Springs(lattice_pairs(number, (1, 0), (0, 1)), 1.0),
        Springs(lattice_pairs(number, (1, 1), (1, -1)), SHEAR_SHARE),
        Springs(lattice_pairs(number, (2, 0), (0, 2)), BENDING_SHARE),
    ]
    return points, triangles, kinds, float(spacing.min()), float(lengths.prod())


def _shell(mesh: "str | PathLike[str] | meshes.Surface") -> tuple:
    """The same from a surface mesh."""
    if isinstance(mesh, meshes.Surface):
        surface = mesh
    elif isinstance(mesh, (str, PathLike)):
        with named("cloth.mesh"):
            surface = meshes.read_surface(mesh)
    else:
        raise SceneError(f"cloth.mesh: {mesh!r} is not allowed; it must be the name of an OBJ, PLY or STL file")
    edges, hinges = meshes.unique_edges(surface.triangles), meshes.hinge_pairs(surface.triangles)
    joined = np.isin(_key(hinges), _key(edges))  # in a tetrahedron the facing vertices share an edge
    kinds = [Springs(edges, 1.0), Springs(hinges[~joined], BENDING_SHARE)]
    x = surface.vertices
    mean_edge = float(np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1).mean())
    return x, surface.triangles, kinds, mean_edge, meshes.surface_area(surface)


def _key(pairs: NDArray) -> NDArray[np.int64]:
    return pairs[:, 0].astype(np.int64) << 32 | pairs[:, 1]


def _lattice(number: tuple[int, ...]) -> tuple[list[Springs], float]:
    """The springs of a square or cubic lattice that is elastic alike in all directions, and its C11 a^(dim-2) / k.

    With k1 on the edges, k2 on the face diagonals and k3 on the cell diagonals, summing k L^2 n n n n over the
    springs of a cell gives C11 = k1 + 2 k2 + 4/3 k3 and C12 = C44 = k2 + 4/3 k3 (times 1/a) in 3D, C11 = k1 + k2 and
    C12 = k2 in 2D. Isotropy, C11 = C12 + 2 C44, then asks for k1 = k2 + 8/3 k3, or k1 = 2 k2 in 2D.
    """
    if len(number) == 2:
        edges, diagonals = lattice_pairs(number, (1, 0), (0, 1)), lattice_pairs(number, (1, 1), (1, -1))
        return [Springs(edges, 1.0), Springs(diagonals, 0.5)], 1.5
    faces = lattice_pairs(number, (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1))
    cells = lattice_pairs(number, (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))
    edges = lattice_pairs(number, (1, 0, 0), (0, 1, 0), (0, 0, 1))
    return [Springs(edges, 1.0), Springs(faces, 0.6), Springs(cells, 0.15)], 2.4


def _box_surface(number: tuple[int, ...]) -> NDArray[np.int64]:
    """The triangles (t, 3) on the six faces of a box lattice, counter-clockwise from outside."""
    index = np.arange(int(np.prod(number))).reshape(number)
    triangles = []
    for axis in range(3):
        # with the axes (axis, axis + 1, axis + 2) in cyclic order, the far side's outward normal is first x second
        layers = np.moveaxis(index, (axis, (axis + 1) % 3, (axis + 2) % 3), (0, 1, 2))
        for side, outward in ((layers[-1], True), (layers[0], False)):
            a, b, c, d = side[:-1, :-1], side[1:, :-1], side[1:, 1:], side[:-1, 1:]
            for three in ((a, b, c), (a, c, d)):
                order = three if outward else three[::-1]
                triangles.append(np.stack([corner.ravel() for corner in order], axis=1))
    return np.concatenate(triangles)
