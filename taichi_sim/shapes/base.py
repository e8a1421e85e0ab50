"""Parts of the shapes: checked sizes, lattices, placing, a stiffness that is stable, and the handle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, about, following
from taichi_sim.common.memory import available
from taichi_sim.scene.pins import Pins, chosen
from taichi_sim.scene.presets import SLAB
from taichi_sim.scene.scene import Scene

__all__ = [
    "Bends",
    "Cells",
    "Part",
    "Pins",
    "Shape",
    "Springs",
    "affordable",
    "at_least_0",
    "bends_along",
    "build",
    "counts",
    "exclusive",
    "given_of",
    "lattice_pairs",
    "lengths",
    "moved",
    "or_default",
    "stable_stiffness",
    "surface_part",
    "with_preset",
]

SURFACE_PART = (
    5 / 9
)  # of the usual radius, 0.45 of a spacing: triangles that collide need no balls without gaps between
SAFE_STEP = 1e-3  # s, the step at which every default stiffness is stable
SAFE_MARGIN = 2.0  # how far below the bound the defaults stay, as a factor in stiffness
# at most, while built and made to run
BALL_BYTES, SPRING_BYTES, CELL_BYTES, BEND_BYTES, BRICK_BYTES, SOLID_BYTES = 800, 130, 250, 400, 600, 2000
LITTLE = 100_000  # bytes that there always are
NOTHING_SAID: Mapping[str, Sequence[str]] = {}
DAMPING_RATIO = 0.1  # of critical, for the pair of balls at each spring


def _none(*shape: int) -> NDArray[np.int32]:
    return np.zeros(shape, dtype=np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Balls, springs and all else that a shape added to the scene, as indices into it.

    A user-defined shape is a function that returns a Shape:

    def bar(scene, start, end, stiffness=100.0):
        balls = scene.add_balls([start, end], radius=0.1)
        return ts.shapes.Shape(balls, scene.add_springs([balls], stiffness=stiffness))

    bar(scene, (0.0, 2.0), (1.0, 2.0))
    """

    balls: NDArray[np.int32]  # (n,)
    springs: NDArray[np.int32] = field(default_factory=lambda: _none(0))  # (m,)
    triangles: NDArray[np.int32] = field(default_factory=lambda: _none(0, 3))  # (t, 3), counter-clockwise from outside
    cells: NDArray[np.int32] = field(default_factory=lambda: _none(0))  # (c,)
    bricks: NDArray[np.int32] = field(default_factory=lambda: _none(0))  # (b,)
    solids: NDArray[np.int32] = field(default_factory=lambda: _none(0))  # (e,)

    @classmethod
    def of(cls, parts: Sequence[Shape]) -> Shape:
        """All parts as one."""
        return cls(*(np.concatenate([getattr(one, each.name) for one in parts]) for each in fields(cls)))


@dataclass(frozen=True, slots=True)
class Springs:
    """Springs of one kind within a shape: pairs (m, 2) of its balls, and their stiffness relative to the shape's."""

    pairs: NDArray
    weight: float | NDArray  # one or one per spring
    stiffness: float | NDArray | None = None  # N/m, one or one per spring; in place of weight times the shape's


class Bends(NamedTuple):
    """Bending elements within a shape, as `Scene.add_bending` takes them."""

    corners: NDArray[np.int64]  # (b, 4) of its balls
    weights: NDArray[np.float64]  # (b, 4)
    stiffness: NDArray[np.float64]  # (b,) N/m
    hinge: bool | NDArray[np.bool_] = True  # one or (b,)

    def plus(self, other: Bends) -> Bends:
        """Both, one behind the other."""
        hinge = [np.broadcast_to(one.hinge, len(one.corners)) for one in (self, other)]
        pairs = zip(self[:3], other[:3])
        corners, weights, stiffness = (np.concatenate(pair) for pair in pairs)
        return Bends(corners, weights, stiffness, np.concatenate(hinge))

    def times(self, factor: float) -> Bends:
        """Return bends that are so many times as stiff."""
        return self._replace(stiffness=factor * self.stiffness)


class Cells(NamedTuple):
    """Cells within a shape, as `Scene.add_cells` takes them."""

    corners: NDArray[np.int64]  # (c, dim + 1) of its balls
    bulk_modulus: NDArray[np.float64]  # (c,) Pa, in 2D N/m
    crush_modulus: NDArray[np.float64]  # (c,) the same
    rest_volume: NDArray[np.float64]  # (c,) m^dim
    together: NDArray[np.int64] | None = None  # (c,)


class Bricks(NamedTuple):
    """Bricks within a shape, as `Scene.add_bricks` takes them."""

    corners: NDArray[np.int64]  # (b, 2^dim) of its balls
    young_modulus: float
    poisson_ratio: float
    viscosity: float
    rest_size: NDArray[np.float64]  # (dim,) m


class Solids(NamedTuple):
    """Tetrahedra, in 2D triangles, within a shape, as `Scene.add_solids` takes them."""

    corners: NDArray[np.int64]  # (e, dim + 1) of its balls
    young_modulus: float
    poisson_ratio: float
    viscosity: float


@dataclass(frozen=True, slots=True)
class Part:
    """Arguments of every shape: properties of its balls, and where it is put. radius is that of all, or (n,) of each [m];
    words: masks (n,) of balls by words for `pinned` that its triangles and extents do not tell."""

    mass: float | NDArray  # kg, of all of them together, or (n,) of each
    radius: float | NDArray
    pinned: Any
    material: str
    colour: Sequence[float] | None
    self_collision: bool
    surface_collision: bool = False
    velocity: Any = None
    position: Any = None
    rotation: Any = None
    scale: float = 1.0
    words: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)


def surface_part(shape: str, surface_collision: Any) -> float:
    """Default ball radius of a shape with `surface_collision`, as a part of that without [1]; 1 where it is False. Raises
    SceneError where it is no truth value."""
    return SURFACE_PART if validation.flags(f"{shape}.surface_collision", surface_collision, 1)[0] else 1.0


def counts(where: str, value: Any, n: int, low: int) -> tuple[int, ...]:
    """n whole numbers of at least `low`. Raises SceneError."""
    array = validation.as_array(value)
    if array.dtype.kind not in "iu" or array.shape != (n,) or (array < low).any():
        raise SceneError(where, value, f"{n} whole numbers of at least {low}")
    return tuple(int(k) for k in array)


def given_of(**arguments: Any) -> list[str]:
    """Names of those arguments that are not None, and of a scale that is not 1."""
    return [name for name, value in arguments.items() if value is not None and not (name == "scale" and value == 1)]


def or_default(where: str, value: float | None, default: float) -> float:
    """A positive number, or what it is where none is given. Raises SceneError."""
    return default if value is None else validation.number(where, value, positive=True)


def at_least_0(where: str, value: float | None, default: Any = None) -> Any:
    """A number of 0 or more, or what it is where none is given. Raises SceneError."""
    return default if value is None else validation.number(where, value, low=0)


def lengths(where: str, value: Sequence[float], n: int) -> NDArray[np.float64]:
    """n positive lengths. Raises SceneError."""
    if validation.as_array(value).shape != (n,):
        raise SceneError(where, value, f"{n} lengths")
    return validation.per_item(where, value, n, positive=True)


def exclusive(shape: str, one: dict[str, Any], other: dict[str, Any]) -> None:
    """Raise SceneError where an argument of each is given: they say the same in two ways."""
    first, second = ([name for name, value in group.items() if value is not None] for group in (one, other))
    if first and second:
        raise SceneError(f"{shape}.{first[0]}", says=f"does not go with {second[0]}; give one or the other")


def with_preset(
    scene: Scene, material: str, given: dict[str, float | None], but: Sequence[str] = ()
) -> dict[str, float | None]:
    """The arguments, with what is not given taken from the preset that the material names, if it does; but: those it leaves.

    In 2D a body stands for a slab: its density and modulus are those of the solid times the thickness.
    """
    preset = scene.preset(material)
    if preset is None:
        return given
    known = {name: getattr(preset, name) for name in given if name not in but}
    if scene.dim == 2:
        known |= {name: known[name] and SLAB * known[name] for name in ("density", "young_modulus") if name in known}
    return {name: known.get(name) if value is None else value for name, value in given.items()}


def affordable(
    where: str,
    value: Any,
    balls: float,
    springs: float,
    cells: float = 0.0,
    bends: float = 0.0,
    bricks: float = 0.0,
    solids: float = 0.0,
) -> None:
    """Raise SceneError where building and running a shape of so many parts needs more memory than there is."""
    balls, springs = float(balls), float(springs)
    need = balls * BALL_BYTES + springs * SPRING_BYTES + cells * CELL_BYTES + bends * BEND_BYTES
    need += bricks * BRICK_BYTES + solids * SOLID_BYTES
    if need < LITTLE:
        return
    free = available()
    if need > free:
        raise SceneError(
            where,
            value,
            says=f"is not allowed; {balls:.3g} balls and {springs:.3g} springs need about {need / 1e9:.3g} GB of memory, and"
            f" {free / 1e9:.3g} GB are free; make it coarser",
        )


def lattice_pairs(resolution: tuple[int, ...], *offsets: tuple[int, ...]) -> NDArray[np.int64]:
    """All pairs of points of a lattice that lie one of the offsets apart, (m, 2); the last axis counts fastest."""
    index = np.arange(int(np.prod(resolution))).reshape(resolution)
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for offset in offsets:
        here = index[tuple(slice(max(0, -o), max(0, n - max(0, o))) for o, n in zip(offset, resolution))]
        there = index[tuple(slice(max(0, o), max(0, n - max(0, -o))) for o, n in zip(offset, resolution))]
        if here.shape == there.shape:
            pairs.append(np.stack([here.ravel(), there.ravel()], axis=1))
    return np.concatenate(pairs)


def bends_along(index: NDArray, stiffness: float | NDArray) -> Bends:
    """Bending elements of each three neighbours along the first axis of an array of balls; stiffness [N/m]: one, or one per ball
    of a line across, whose force is that on the middle ball for each metre by which it lies off, times 4."""
    first, middle, last = index[:-2], index[1:-1], index[2:]
    corners = np.stack([middle, middle, first, last], axis=-1).reshape(-1, 4)
    return Bends(
        corners, np.tile([-1.0, -1.0, 1.0, 1.0], (len(corners), 1)), np.broadcast_to(stiffness, middle.shape).ravel()
    )


def moved(shape: str, points: NDArray, position: Any, rotation: Any, scale: Any) -> NDArray[np.float64]:
    """Points (n, dim), scaled, then turned about the x, the y and the z axis in this order, then shifted.

    rotation is in degrees, about the shape's own origin: three numbers in 3D, one in 2D.
    """
    dim = points.shape[1]
    factor = validation.number(f"{shape}.scale", scale, positive=True)
    shift = np.zeros(dim) if position is None else validation.vectors(f"{shape}.position", position, 1, dim)[0]
    return points * factor @ _turn(f"{shape}.rotation", rotation, dim).T + shift


def _turn(where: str, rotation: Any, dim: int) -> NDArray[np.float64]:
    turn = np.eye(dim)
    if rotation is None:
        return turn
    angles = (
        [validation.number(where, rotation)]
        if dim == 2
        else validation.vectors(where, rotation, 1, 3)[0].tolist()  # degrees
    )
    for axis, angle in enumerate(angles):
        first, second = (0, 1) if dim == 2 else ((axis + 1) % 3, (axis + 2) % 3)
        cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        one = np.eye(dim)
        one[first, first] = one[second, second] = cosine
        one[first, second], one[second, first] = -sine, sine
        turn = one @ turn
    return turn


def stable_stiffness(kinds: Sequence[Springs], n: int, mass: float, bends: Bends | None = None) -> float:
    """The stiffness k [N/m] of weight 1 that is stable at SAFE_STEP with a margin, for n balls of total mass [kg]; bends: with
    stiffness in parts of k.

    The bound that holds for every shape (physics section 5) is h^2 max (S_i / m_i + S_j / m_j) < 4 over the springs,
    S_i the sum of the stiffness at ball i. With S_i = k R_i and all masses mass / n, k = 4 mass / (margin n h^2
    max(R_i + R_j)). Bending adds the largest of its rows, twice where one side of an element is held.
    """
    ends = np.concatenate([kind.pairs for kind in kinds])
    if not len(ends):
        return 1.0
    weight: NDArray = np.concatenate([np.broadcast_to(kind.weight, len(kind.pairs)) for kind in kinds])
    row = np.bincount(ends.ravel(), np.repeat(weight, 2), minlength=n)
    most = float(row[ends].sum(axis=1).max())
    if bends is not None and len(bends.corners):
        size = np.abs(bends.weights)
        each = bends.stiffness[:, None] * size * size.sum(axis=1, keepdims=True)
        most += 2 * float(np.bincount(bends.corners.ravel(), each.ravel()).max())
    return 4 * mass / (SAFE_MARGIN * n * SAFE_STEP**2 * most)


def build(
    scene: Scene,
    shape: str,
    points: NDArray,
    kinds: Sequence[Springs],
    triangles: NDArray,
    part: Part,
    stiffness: float,
    damping: float | NDArray | None,
    *,
    stretched: NDArray | None = None,
    bends: Bends | None = None,
    cells: Cells | None = None,
    bricks: Bricks | None = None,
    solids: Solids | None = None,
    break_strain: float | None = None,
    uv: NDArray | None = None,
    made_of: Mapping[str, Sequence[str]] = NOTHING_SAID,
) -> Shape:
    """Add one shape to the scene: points (n, dim) m, before they are moved; triangles (t, 3) and springs' pairs index its balls.

    stretched: strain (m,) of the springs at the start. uv: (n, 2), places on a sheet in 0..1, or (t, 3, 2) of the corners of its
    triangles. made_of: arguments of the shape that columns of tables follow from, see `errors.following`.
    """
    n, own = len(points), points
    points = moved(shape, own, part.position, part.rotation, part.scale)
    each = part.mass if isinstance(part.mass, np.ndarray) else part.mass / n
    strength = np.concatenate(
        [
            np.broadcast_to(kind.weight * stiffness if kind.stiffness is None else kind.stiffness, (len(kind.pairs),))
            for kind in kinds
        ]
        or [np.zeros(0)]
    )
    pairs = np.concatenate([kind.pairs for kind in kinds] or [np.zeros((0, 2), dtype=np.int64)])
    if isinstance(each, np.ndarray):
        reduced: Any = each[pairs[:, 0]] * each[pairs[:, 1]] / (each[pairs[:, 0]] + each[pairs[:, 1]])
    else:
        reduced = each / 2
    rest = None
    if stretched is not None:
        rest = np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1) / (1 + stretched)
    critical = 2 * np.sqrt(strength * reduced)
    corners = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    pinned = chosen(f"{shape}.pinned", part.pinned, points, own, corners, part.words)
    with scene.all_or_nothing(), about(shape), following(made_of):
        balls = scene.add_balls(
            points,
            radius=part.radius,
            mass=each,
            material=part.material,
            pinned=pinned,
            velocity=0.0 if part.velocity is None else part.velocity,
            colour=part.colour,
            body=0 if part.self_collision else scene.new_body(),
        )
        scene.new_object(shape, balls, uv)
        springs = scene.add_springs(
            balls[pairs].reshape(-1, 2),
            stiffness=strength,
            damping=DAMPING_RATIO * critical if damping is None else damping,
            rest_length=rest,
            break_strain=break_strain,
        )
        faces = balls[corners].astype(np.int32)
        scene.add_triangles(faces, collides=part.surface_collision)
        if bends is not None and bends.stiffness.any():
            scene.add_bending(balls[bends.corners], weights=bends.weights, stiffness=bends.stiffness, hinge=bends.hinge)
        filled = {}
        kinds_of = (("cells", cells), ("bricks", bricks), ("solids", solids))
        for name, some in kinds_of:
            if some is not None and len(some.corners):
                more = some._asdict()
                add = getattr(scene, f"add_{name}")
                filled[name] = add(balls[more.pop("corners")], **more)
        return Shape(balls, springs, faces, **filled)
