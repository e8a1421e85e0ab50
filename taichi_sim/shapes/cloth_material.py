"""Cloth as a material: springs, masses and bending of a sheet that is the same at every resolution. Imports no Taichi.

A sheet has a mass per area [kg/m^2], a stretch stiffness [N/m] (force per width and strain, C11, its width kept), a shear
stiffness C44 [N/m] and a bending rigidity [N m]; see physics.md, "Elastic bodies".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.geometry.mesh import Surface, hinges, unique_edges
from taichi_sim.scene.membranes import flattened
from taichi_sim.shapes.base import Bends, bends_along
from taichi_sim.shapes.mesh_bending import corners_of, cotangent, is_thin, mesh_bends, warp_directions

__all__ = [
    "Fabric",
    "Parts",
    "Weave",
    "along_warp",
    "diagonals",
    "evened",
    "folding_limit",
    "of_mesh",
    "of_sheet",
    "of_triangles",
    "require_sheet",
    "tension_shares",
    "turned",
]

ASKEW = 1e-9  # sine of twice the angle between warp and rows, up to which the warp lies along them


class Fabric(NamedTuple):
    """Material of a sheet."""

    mass_per_area: float  # kg/m^2
    stretch: float  # N/m
    shear: float  # N/m
    rigidity: float  # N m, along the warp
    weft_rigidity: float  # N m
    warp_angle: float = 0.0  # rad, from x toward z


class Weave(NamedTuple):
    """Stiffness of a sheet of triangles, see Scene.add_membranes [N/m]."""

    warp: float
    weft: float
    shear: float
    coupling: float


class Parts(NamedTuple):
    """A sheet of fabric in pieces."""

    mass: NDArray  # (n,) kg of each ball
    springs: list[tuple[NDArray, NDArray]]  # pairs (m, 2) and stiffness (m,) [N/m]
    bends: Bends


def of_sheet(number: tuple[int, int], spacing: NDArray, fabric: Fabric) -> Parts:
    """A grid of balls. Raises SceneError for a shear stiffness that it cannot have."""
    return Parts(
        _sheet_masses(number, spacing, fabric),
        _sheet_springs(number, spacing, fabric),
        _sheet_bends(number, spacing, fabric),
    )


def of_mesh(surface: Surface, fabric: Fabric) -> Parts:
    """A triangle mesh; its shear stiffness is a third of the stretch stiffness. Raises SceneError for triangles without area."""
    area = _areas(surface)
    third = np.repeat(area / 3, 3)
    mass = fabric.mass_per_area * np.bincount(surface.triangles.ravel(), third, minlength=len(surface.vertices))
    bends, across, strength = _mesh_bends(surface, fabric)  # a spring across is never stiffer than the sheet
    springs = [_mesh_springs(surface, area, fabric), (across, np.minimum(strength, fabric.stretch))]
    return Parts(mass, springs, bends)


def of_triangles(surface: Surface, grid: tuple[tuple[int, int], NDArray] | None, fabric: Fabric) -> Parts:
    """A mesh, or a grid of so many balls with its spacing, without the springs whose place triangles take: only those across the
    folded edges of a mesh are left."""
    if grid is None:
        parts = of_mesh(surface, fabric)
        return parts._replace(springs=parts.springs[1:])
    askew = fabric.rigidity != fabric.weft_rigidity and abs(np.sin(2.0 * fabric.warp_angle)) > ASKEW
    bends = _mesh_bends(surface, fabric)[0] if askew else _sheet_bends(*grid, fabric)
    return Parts(_sheet_masses(*grid, fabric), [], bends)


def _mesh_bends(surface: Surface, fabric: Fabric) -> tuple[Bends, NDArray, NDArray]:
    return mesh_bends(surface, fabric.rigidity, fabric.weft_rigidity, fabric.warp_angle)


def along_warp(surface: Surface, angle: float) -> NDArray[np.float64]:
    """Corners (t, 3, 2) [m] of triangles in their planes, u along a warp that lies `angle` [rad] from x toward z."""
    x = surface.vertices[surface.triangles]
    return flattened(x, warp_directions(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), angle))


def folding_limit(rest: NDArray, fabric: Fabric) -> NDArray[np.float64]:
    """Compression (t,) [N/m] at which triangles with corners (t, 3, 2) [m] at rest give way: Euler's load, pi^2 B / L^2, of a
    strip as long as a square of twice their area is wide, by the smaller bending rigidity B."""
    twice = np.abs(np.linalg.det(rest[:, 1:] - rest[:, :1]))
    return np.asarray(np.pi**2 * min(fabric.rigidity, fabric.weft_rigidity) / twice)


def _borders(number: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Parts of a spacing that each line of balls along x and along z has beside it: 1, or 1/2 at the ends."""
    parts = []
    for n in number:
        part = np.ones(n)
        part[0] = part[-1] = 0.5
        parts.append(part)
    return parts[0], parts[1]


def _sheet_masses(number: tuple[int, int], spacing: NDArray, fabric: Fabric) -> NDArray[np.float64]:
    """Mass (n,) [kg] of each ball of a grid: that of the area around it."""
    return fabric.mass_per_area * float(np.prod(spacing)) * np.outer(*_borders(number)).ravel()


def _sheet_springs(number: tuple[int, int], spacing: NDArray, fabric: Fabric) -> list[tuple[NDArray, NDArray]]:
    """Pairs (m, 2) and stiffness (m,) [N/m] of the sides and the diagonals of a grid.

    The diagonals of rectangles a x b, L long, one of each, with k, give C12 = C44 = k a b / L^2 and C11 = C44 (a/b)^2 along a;
    the sides give k a / b more. Sides at the border count half. Raises SceneError for a shear stiffness that leaves nothing for
    the sides.
    """
    index = np.arange(number[0] * number[1]).reshape(number)
    a, b = spacing
    sides = []
    for axis, along, across in ((0, a, b), (1, b, a)):
        k = across / along * (fabric.stretch - fabric.shear * (along / across) ** 2)
        if k < 0:
            most = f"{fabric.stretch * (across / along) ** 2:.4g}"
            allowed = f"at most {most}, the stretch stiffness times the square of the ratio of the sides of a mesh of the grid"
            raise SceneError("cloth.shear_stiffness", fabric.shear, allowed)
        part = _borders(number)[1 - axis]
        grid = index if axis == 0 else index.T
        pairs = np.stack([grid[:-1].ravel(), grid[1:].ravel()], axis=1)
        sides.append((pairs, k * np.broadcast_to(part, grid[1:].shape).ravel()))
    return [*sides, (diagonals(index), fabric.shear * (a * a + b * b) / (a * b) * evened(number))]


def turned(number: Sequence[int]) -> NDArray[np.bool_]:
    """Mask of the squares of a grid of so many balls that are cut from the first corner to the last; the others are cut the other
    way. In turns, as chequers are coloured: cut all alike a sheet would shear where it is pulled, and cut both ways it could not
    fold."""
    return np.asarray(np.add.outer(*(np.arange(n - 1) for n in number)) % 2 == 0)


def evened(number: Sequence[int]) -> NDArray[np.float64]:
    """Stiffness (m,) of the diagonals of a grid of so many balls, in parts of their mean: both kinds are as stiff together, also
    where an odd number of squares has one more of one kind. Else the sheet would shear where it is stretched."""
    turn = turned(number).ravel()
    one, other = (max(1, int(np.count_nonzero(kind))) for kind in (turn, ~turn))
    return np.where(turn, turn.size / (2.0 * one), turn.size / (2.0 * other)) if turn.size > 1 else np.ones(1)


def diagonals(index: NDArray) -> NDArray[np.int64]:
    """Balls (m, 2) at the ends of the cuts of all squares of a grid of balls."""
    turn = turned(index.shape)
    ends = (np.where(turn, index[:-1, :-1], index[:-1, 1:]), np.where(turn, index[1:, 1:], index[1:, :-1]))
    return np.stack([end.ravel() for end in ends], axis=1)


def _sheet_bends(number: tuple[int, int], spacing: NDArray, fabric: Fabric) -> Bends:
    """A plate with Poisson's ratio 0, whose warp lies along x or z: energy (B_x w_xx^2 + B_z w_zz^2 + (B_x + B_z) w_xz^2) / 2 per
    area, with the rigidities along x and z.

    Each three balls in a row have the second difference, each four of a mesh the twist; a row at the border counts half.
    """
    index = np.arange(number[0] * number[1]).reshape(number)
    a, b = spacing
    beside_x, beside_z = _borders(number)
    one, other = fabric.rigidity, fabric.weft_rigidity
    if abs(np.sin(fabric.warp_angle)) > 0.5:
        one, other = other, one
    along_x = bends_along(index, one * b / a**3 * beside_z)
    along_z = bends_along(index.T, other * a / b**3 * beside_x)
    four = np.stack([index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]], axis=-1).reshape(-1, 4)
    weights = np.tile([1.0, -1.0, -1.0, 1.0], (len(four), 1))
    twist = Bends(four, weights, np.full(len(four), (one + other) / (a * b)), hinge=False)
    return along_x.plus(along_z).plus(twist)


def require_sheet(surface: Surface) -> None:
    """Raises SceneError where all triangles of a mesh are without area, or one has a corner twice; and for vertices without a
    triangle."""
    t = surface.triangles
    thin, twice = is_thin(*corners_of(surface)), (t == np.roll(t, 1, axis=1)).any(axis=1)
    _refuse_thin(np.flatnonzero(thin if thin.all() else twice))
    unused = np.setdiff1d(np.arange(len(surface.vertices)), t)
    if len(unused):
        raise SceneError("cloth.mesh", says=f"vertex {unused[0]} (from 0) belongs to no triangle; take it out")


def _areas(surface: Surface) -> NDArray[np.float64]:
    a, b, c = corners_of(surface)
    _refuse_thin(np.flatnonzero(is_thin(a, b, c)))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _refuse_thin(thin: NDArray) -> None:
    if len(thin):
        names = ", ".join(str(t) for t in thin[:3]) + (f" and {len(thin) - 3} more" if len(thin) > 3 else "")
        says = f"triangles {names} (from 0) have no area; take them out, or merge their corners"
        raise SceneError("cloth.mesh", says=says)


def _mesh_springs(surface: Surface, area: NDArray, fabric: Fabric) -> tuple[NDArray, NDArray]:
    """The edges (m, 2) and k = Y A / L^2 [N/m], A the area of the triangles at each (Van Gelder 1998).

    Where edges point everywhere alike Poisson's ratio is 1/3 and Y = 8/9 of the stretch stiffness.
    """
    edges = unique_edges(surface.triangles)
    sides = np.sort(np.concatenate([surface.triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1).astype(np.int64)
    n = len(surface.vertices)
    keys = edges.astype(np.int64) @ np.array([n, 1])
    around = np.bincount(np.searchsorted(keys, sides @ np.array([n, 1])), np.tile(area, 3), minlength=len(edges))
    square = np.sum((surface.vertices[edges[:, 1]] - surface.vertices[edges[:, 0]]) ** 2, axis=1)
    return edges, 8 / 9 * fabric.stretch * around / square


def tension_shares(surface: Surface) -> NDArray[np.float64]:
    """Tension along each edge (m,) of a closed mesh where that in the sheet is 1 N/m, over the edge's length.

    Half the sum of the cotangents of the angles that face it, which makes the forces those of a soap film.
    """
    edge, opposite = hinges(surface.triangles)
    x0, x1 = surface.vertices[edge[:, 0]], surface.vertices[edge[:, 1]]
    facing = (surface.vertices[opposite[:, k]] for k in range(2))
    return 0.5 * np.sum([cotangent(at, x0, x1) for at in facing], axis=0)
