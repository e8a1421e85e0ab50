"""Coarse meshes: ropes and sheets that are bent sharply from piece to piece, and bodies with few cells across. No Taichi.

A bend by an angle phi at a ball stands for an arc of phi. Its element has the curvature 2 sin(phi / 2) in place of phi, so that
it stores phi^2 / 12 too little, and the arc is phi^2 / 24 longer than its chords. A fold that runs along a limp rope of n pieces
is late by about 150 / n^2 of the time of a fine rope (measured, from 20 to 80 pieces): each piece that turns around it takes
energy.

Solids take the strains of a ball from all elements around it. Across a slender bar with few of them these are those of its
middle. Bars with one layer of boxes, six tetrahedra each, are 1.2, 2.2 and 2.9 times as stiff in bending as they should be at
Poisson's ratios of 1/4, .49 and .4999. With two layers they are within 11 % up to .49 and 1.45 times as stiff at .4999. With
four they are within 4 % (measured). Boxes of springs, m across, are c / m + d / m^2 too stiff (measured on bars): springs at the
surface, which has boxes on one side of it alone, are whole.
"""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.quantities import at_most, percent
from taichi_sim.geometry.mesh import Surface
from taichi_sim.scene.objects import SceneObject, owner
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes.jelly_material import boxes_in, skin_of_boxes

__all__ = ["bent_findings", "beyond_bricks", "few_across", "in_common", "objects_of", "ropes"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

SMOOTH = 0.35  # rad, at which a bend stores a hundredth too little
FOLD = 1.0  # rad: a limp rope that turns more is folded
FOLDED = 150.0  # times 1 / n^2: part of its time by which a fold of n pieces is late
RIGHT = 0.01  # part of a time that is right
ONE, TWO = 0.03, 0.2  # part of the balls inside a body: at most so many with one layer of boxes across, with two
LOCKS = 0.49  # Poisson's ratio in three dimensions, above which two layers are too stiff
BOXES = {2: (2.0, 0.46), 3: (2.1, 0.7)}  # c and d
TOO_FAR = 1 / 16  # of the size of a mesh, a default brick: beyond its bricks, from which it is reported
FINER = 0.95  # of a spacing that is too long: the next to try
MOST_TRIED = 1e6  # boxes around a mesh that is filled to try a spacing


class _Bend(NamedTuple):
    """The sharpest bend of a rope or sheet: its angle [rad], the length [m] of a piece there, the ball, and whether an element
    resists it."""

    angle: float
    piece: float
    ball: int
    resists: bool


def bent_findings(scene: Scene) -> Iterator[tuple[str, str]]:
    """Sentence and cure for each rope and sheet that is bent sharply at the start."""
    for one in ropes(scene):
        found = _of_rope(scene, one.balls)
        if found.angle > SMOOTH:
            yield _rope_in_words(one.name, found, len(one.balls) - 1)
    for name, found in _of_sheets(scene).items():
        if found.angle > SMOOTH:
            wanted = found.piece * SMOOTH / found.angle
            yield _bent(name, found), f"take balls {wanted:.2g} m apart there for 1 %"


def beyond_bricks(scene: Scene) -> Iterator[tuple[str, str]]:
    """Sentence and cure for each mesh that is drawn farther out than the bricks that move it reach."""
    of = objects_of(scene)
    place = {row.tobytes(): k for k, row in enumerate(scene.bricks)} if scene.embedded_surfaces else {}
    for surface in scene.embedded_surfaces:
        brick = np.array([place.get(row.tobytes(), -1) for row in surface.corners])
        if (brick < 0).any():
            continue
        reach = _reach(surface.weights, scene.brick_size[brick])
        corner = scene.position[surface.corners[0]]
        axes = corner[[1 << k for k in reversed(range(scene.dim))]] - corner[0]
        vertices = np.einsum("sk,ski->si", surface.weights, scene.position[surface.corners])
        mesh = Surface(vertices @ (axes / np.linalg.norm(axes, axis=1, keepdims=True)).T, surface.triangles)
        right = TOO_FAR * float(np.ptp(mesh.vertices, axis=0).max())
        if reach > right:
            name = scene.objects[of[surface.corners[0, 0]]].name
            cure = _filling_spacing(mesh, float(scene.brick_size[brick].max()), reach, right)
            says = f"the mesh of {name} reaches up to {reach:.2g} m beyond its bricks, which alone collide"
            yield says, f'{cure} or fill = "tetrahedra"'


def _reach(weights: Floats, size: float | Floats) -> float:
    """Largest distance [m] of vertices from the bricks that move them. weights: (v, 2^dim), of corners; size [m]: of bricks."""
    bit = np.array(list(itertools.product((0.0, 1.0), repeat=int(weights.shape[1]).bit_length() - 1)))
    along = weights @ bit  # of a brick, in parts of its sides
    return float(np.linalg.norm((along - np.clip(along, 0.0, 1.0)) * size, axis=1).max())


def _filling_spacing(mesh: Surface, spacing: float, reach: float, right: float) -> str:
    """Advice on the spacing [m] of bricks that a mesh reaches at most `right` [m] beyond, tried on the mesh; it may take so many
    boxes that it is not tried. reach [m]: beyond bricks of the present spacing."""
    while True:
        spacing = float(at_most(spacing * min(FINER, right / reach)))
        if not np.prod(np.maximum(1.0, np.ptp(mesh.vertices, axis=0) / spacing)) <= MOST_TRIED:
            return f"try a spacing below {spacing:g}"
        low, filled = boxes_in(mesh, spacing)
        if filled.any():
            reach = _reach(skin_of_boxes(filled, (mesh.vertices - low) / spacing)[1], spacing)
            if reach <= right:
                return f"take spacing = {spacing:g}"


def ropes(scene: Scene) -> list[SceneObject]:
    """Objects of three balls or more that springs join one behind the other and in no other way, whatever they are called."""
    if not scene.n_springs:
        return []
    of = objects_of(scene)
    low, high = np.sort(scene.pairs, axis=1).astype(np.int64).T
    number = np.bincount(1 + np.where(of[low] == of[high], of[low], -1), minlength=len(scene.objects) + 1)[1:]
    in_row = number == [len(one.balls) - 1 for one in scene.objects]
    joined = set((low * scene.n_balls + high).tolist()) if in_row.any() else set()
    found = []
    for one, springs in zip(scene.objects, in_row):
        if springs and len(one.balls) > 2:
            steps = np.sort(np.stack([one.balls[:-1], one.balls[1:]], axis=1).astype(np.int64), axis=1)
            if joined.issuperset((steps @ [scene.n_balls, 1]).tolist()):
                found.append(one)
    return found


def objects_of(scene: Scene) -> NDArray[np.int64]:
    """Number of the object that each ball (n,) belongs to, or -1."""
    of = np.full(scene.n_balls, -1)
    for k, one in enumerate(scene.objects):
        of[one.balls] = k
    return of


def in_common(of: NDArray[np.int64]) -> NDArray[np.int64]:
    """Object (e,) that all balls of an element have in common, or -1; of: that of each ball (e, k)."""
    return np.where((of == of[:, :1]).all(axis=1), of[:, 0], -1)


def _of_rope(scene: Scene, balls: Ints) -> _Bend:
    x = scene.position[balls]
    sides = np.diff(x, axis=0)
    angle = _angles(sides[:-1], sides[1:])
    worst = int(np.argmax(angle))
    piece = float(np.linalg.norm(sides[worst : worst + 2], axis=1).mean())
    bent = scene.bends[scene.bend_stiffness > 0.0]
    return _Bend(float(angle[worst]), piece, worst + 1, bool((bent[:, 0] == balls[worst + 1]).any()))


def _rope_in_words(name: str, found: _Bend, pieces: int) -> tuple[str, str]:
    finer = math.ceil(pieces * found.angle / SMOOTH)
    if found.resists:
        return _bent(name, found), f"take {finer} pieces for 1 %"
    where = f"{name} turns by {found.angle:.2g} rad at its ball {found.ball}, and nothing resists that"
    if found.angle <= FOLD:
        return (
            f"{where}: its arc there is {percent(found.angle**2 / 24.0)} longer than its pieces",
            f"take {finer} pieces",
        )
    late = FOLDED / pieces**2
    says = f"{where}: it is folded as sharply as its {pieces} pieces allow"
    says += f"; a fold that runs along it is about {percent(late)} late"
    return says, f"take {math.ceil(math.sqrt(FOLDED / RIGHT))} pieces for 1 %" if late > RIGHT else ""


def _bent(name: str, found: _Bend) -> str:
    radius = found.piece / found.angle
    return (
        f"{name} is bent by {found.angle:.2g} rad from one piece to the next at its ball {found.ball}, to a radius of"
        f" {radius:.2g} m or {1.0 / found.angle:.2g} pieces: it stores {percent(found.angle**2 / 12.0)} too little energy there"
    )


def _of_sheets(scene: Scene) -> dict[str, _Bend]:
    """The sharpest bend of each surface with triangles, by its name."""
    acts = (scene.bend_stiffness > 0.0) & scene.bend_hinge
    acts &= np.isin(scene.bends[:, 0], scene.triangles)
    corners = scene.bends[acts]
    if not len(corners):
        return {}
    x = scene.position[corners]
    one, other = x[:, 0] - x[:, 2], x[:, 3] - x[:, 1]
    row = corners[:, 0] == corners[:, 1]
    along = x[:, 1] - x[:, 0]
    if scene.dim == 3:
        first, second = np.cross(along, x[:, 2] - x[:, 0]), np.cross(x[:, 3] - x[:, 0], along)
        one, other = np.where(row[:, None], one, first), np.where(row[:, None], other, second)
    angle = _angles(one, other)
    found: dict[str, _Bend] = {}
    for k in np.argsort(-angle)[: max(1, np.count_nonzero(angle > SMOOTH))]:
        ball = int(corners[k, 0])
        body = owner(scene.objects, ball)
        name = body.name if body else "the surface"
        number = ball if body is None else int(np.flatnonzero(body.balls == ball)[0])
        piece = 0.5 * float(np.linalg.norm(x[k, 3] - x[k, 2]) / max(1e-300, math.cos(0.5 * angle[k])))
        found.setdefault(name, _Bend(float(angle[k]), piece, number, True))
    return found


def _angles(one: Floats, other: Floats) -> Floats:
    """Angles (k,) [rad] between directions (k, dim)."""
    size = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
    cosine = np.divide(np.einsum("ki,ki->k", one, other), size, out=np.ones_like(size), where=size > 0.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def few_across(scene: Scene) -> Iterator[tuple[str, str]]:
    """Sentence and cure for each body of solids, or of boxes of springs, with so few of them across that it bends too little."""
    of = objects_of(scene)
    bodies = in_common(of[scene.solids])
    for k in np.unique(bodies[bodies >= 0]):
        yield from _solids_in_words(scene, scene.objects[k].name, np.flatnonzero(bodies == k))
    if not len(scene.cells) or not scene.n_springs:
        return
    acting = np.where(scene.stiffness > 0.0, in_common(of[scene.pairs]), -1)
    bodies, springs_of = in_common(of[scene.cells]), np.argsort(acting, kind="stable")
    first = np.searchsorted(acting[springs_of], np.arange(len(scene.objects) + 1))
    for k in np.unique(bodies[bodies >= 0]):
        one, cells, springs = scene.objects[k], bodies == k, springs_of[first[k] : first[k + 1]]
        if len(springs) and not scene.bulk_modulus[cells].any():
            yield _boxes_in_words(scene, one, springs)


def _solids_in_words(scene: Scene, name: str, solids: NDArray[np.int64]) -> Iterator[tuple[str, str]]:
    """Sentence and cure for a body of solids with few of them across: few of its balls lie inside it."""
    corners = scene.solids[solids]
    faces, number = _faces(corners)
    balls = len(np.unique(corners))
    inside = 1.0 - len(np.unique(faces[number == 1])) / balls
    locks = float(scene.solid_ratio[solids].max()) > (LOCKS if scene.dim == 3 else LOCKS / (1.0 - LOCKS))
    if inside > (TWO if locks else ONE):
        return
    if inside <= ONE:
        where, much = f"{percent(1.0 - inside)} of the balls of {name} are at its surface", "1.2 to 2.9 times"
    else:
        where, much = (
            f"{percent(inside)} of the balls of {name} lie inside it, and its material keeps its volume",
            "up to 1.5 times",
        )
    kind = "triangles" if scene.dim == 2 else "tetrahedra"
    yield (
        f"{where}: slender parts with so few {kind} across are {much} as stiff in bending as they should be",
        "take half the spacing, or a jelly of boxes, which bend as they should",
    )


def _boxes_in_words(scene: Scene, one: SceneObject, springs: NDArray[np.int64]) -> tuple[str, str]:
    """Sentence and cure for a block of boxes of springs, by the number of boxes where that is least."""
    ends = scene.position[scene.pairs[springs]]
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    _, first = np.unique(np.round(along / length[:, None], 3), axis=0, return_index=True)  # of each direction
    reach = np.ptp(scene.position[one.balls] @ (along[first] / length[first, None]).T, axis=0)
    across = max(1, round(float((reach / length[first]).min())))
    c, d = BOXES[scene.dim]
    return (
        f"{one.name} is made of boxes of springs, {across} across: it is about {_too_stiff(c / across + d / across**2)} in"
        " bending",
        "give it a young_modulus, which makes bricks that bend as they should",
    )


def _too_stiff(more: float) -> str:
    """Words on the part by which a stiffness is too large."""
    return f"{percent(more)} too stiff" if more < 1.0 else f"{1.0 + more:.2g} times as stiff as it should be"


def _faces(cells: Ints) -> tuple[Ints, NDArray[np.int64]]:
    """The faces (f, dim) of cells, and how many cells have each."""
    width = cells.shape[1]
    faces = np.concatenate([cells[:, list(some)] for some in itertools.combinations(range(width), width - 1)])
    found, number = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    return found, number
