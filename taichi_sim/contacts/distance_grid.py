"""Distances from a closed mesh, kept on a grid around it, and where that is too coarse the triangles themselves."""

from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.common.memory import available
from taichi_sim.contacts.triangle_tree import NO_TREE, TriangleTree, triangle_tree
from taichi_sim.device.backend import has_wide_numbers
from taichi_sim.device.engine import ti
from taichi_sim.geometry.graph import components
from taichi_sim.geometry.mesh import Surface
from taichi_sim.kernels.contacts import distance_grid as loops
from taichi_sim.kernels.contacts.colliders import CUT
from taichi_sim.kernels.contacts.triangle_tree import CORNERS, INSIDE, OUTWARD
from taichi_sim.scene.collider_forms import Meshed
from taichi_sim.scene.colliders import Collider
from taichi_sim.scene.scene import Scene

__all__ = ["DistanceGrid", "distance_grid", "distance_grids"]

MOST_CORNERS = 1 << 24
CORNER_BYTES = 32  # while a grid is made; what it keeps is less than half of that
BORDER = 2  # cells around what comes near the mesh
FEW_TRIANGLES = 8  # in the list of a cell: where there are more it is cut into eight
MOST_TRIANGLES = 32  # in that of a smallest cell: where there are more the tree is faster
ROOM = 128  # triangles at most of which the list of a smallest cell is made
LEVELS = 2  # of cells, each half as wide as those before
MOST_CUT = 1 << 16  # cells of a level, the most crowded ones: their lists take some 50 MB
LIST_BYTES = 100  # of a corner, while there are fewer than eighths
AT_ONCE = 1 << 13  # cells whose lists are made together
NEAR = 2.0  # cells: beyond, what lies between corners is as good as they are, but where two places are as near
INEXACT = 0.02  # of a cell, and of the smallest diameter: the largest error of what lies between corners
BETWEEN = 0.44  # of a cell: no place in one is farther from those that are looked at
EIGHTHS = np.array([[2 * (k >> axis & 1) - 1 for axis in range(3)] for k in range(8)])  # directions of their centres
ROW_SHIFT = 1e-5  # of a cell, see `winding`


class DistanceGrid(NamedTuple):
    """Distances from a mesh on a grid: value (nz, ny, nx) [m], negative inside, at low (3,) [m] + cell [m] x (i, j, k); exact
    (nz, ny, nx): -1 where values interpolate well in the cell that begins there, else its row in `cells` (c, 2). That has, with
    its number, the begin in `listed` of the triangles of the tree that may be closest there, in the order of their distances
    `away` [m] from its centre; with CUT the first row of its eighths, x before y before z; with 0 a triangle near it, and the
    tree is asked."""

    value: NDArray[np.float64]
    exact: NDArray[np.int32]
    cells: NDArray[np.int64]
    listed: NDArray[np.int32]
    away: NDArray[np.float64]
    low: NDArray[np.float64]
    cell: float
    tree: TriangleTree

    def cells_from(self, row: int, triangle: int, first: int) -> NDArray[np.int64]:
        """Cells (c, 2) where rows, triangles and lists of other grids, so many, come before these."""
        number = self.cells[:, 1]
        before = np.where(number > 0, first, np.where(number == 0, triangle, row))
        return np.stack([self.cells[:, 0] + before, number], axis=1)


def layout(collider: Collider, reach: float) -> tuple[float, NDArray[np.int64]]:
    """Cell [m] and corners (3,) along each axis of the grid of a mesh, with a margin for what comes within `reach` [m]; cells
    grow where there would be too many."""
    low, high = collider.vertices.min(axis=0), collider.vertices.max(axis=0)
    longest = float((high - low).max())
    cell = longest / collider.resolution
    margin = min(reach, 0.5 * longest)
    while True:
        border = margin + BORDER * cell
        size = np.ceil((high - low + 2 * border) / cell).astype(np.int64) + 1
        if size.prod() <= MOST_CORNERS:
            return cell, size
        cell *= 1.1


def memory_of(corners: int) -> int:
    """Bytes that a grid with so many corners takes while it is made, with the lists of its cells."""
    return CORNER_BYTES * corners + LIST_BYTES * min(corners, 8 * MOST_CUT)


def distance_grid(collider: Collider, reach: float, finest: float) -> DistanceGrid:
    """The grid of a mesh, see `layout`. finest [m]: diameter of the smallest ball."""
    cell, size = layout(collider, reach)
    start = 0.5 * (collider.vertices.min(axis=0) + collider.vertices.max(axis=0)) - 0.5 * cell * (size - 1)
    shape = tuple(size[::-1])
    wide = has_wide_numbers()
    real = np.float64 if wide else np.float32
    origin = np.zeros(3) if wide else start  # single precision has digits to spare only near the grid
    tree = triangle_tree(Surface(collider.vertices, collider.triangles))
    lengths = [cell, ROW_SHIFT, NEAR * cell, INEXACT * min(cell, finest), reach + BETWEEN * cell]

    def given(array: NDArray[Any], kind: Any = real) -> Any:
        array = np.ascontiguousarray(array, dtype=kind)
        # external arrays are copied at each launch, and with Vulkan some come back with other numbers
        return array if wide else _on_device(array)

    corner, frame = (
        given(tree.triangles[:, CORNERS:].reshape(-1, 3) - origin),
        given(np.array([*(start - origin), *lengths])),
    )
    closest, best = given(np.full(shape, -1), np.int32), given(np.full(shape, np.inf))
    loops.seed(corner, closest, best, frame)
    reaches = [1 << k for k in reversed(range(int(size.max()).bit_length()))]
    for distance in [*reaches, 2, 1]:
        source = deepcopy(closest)  # `copy` of an engine's array would share and free its memory
        loops.spread(corner, source, closest, best, frame, distance)
    windings = given(np.zeros(shape), np.int32)
    loops.winding(corner, windings, frame)
    ti.sync()
    inside, far = _on_host(windings) != 0, np.sqrt(_on_host(best).astype(np.float64))
    value = np.where(inside, -far, far)
    closest = _on_host(closest)
    tree = _facing_out(collider, tree, closest, value, start, cell)
    near = given(np.full(shape, -1), np.int32)
    boxes, triangles = tree.boxes - np.tile(origin, 2), tree.triangles.copy()
    triangles[:, CORNERS:] -= np.tile(origin, 3)
    tables = given(boxes.ravel()), given(tree.links.ravel(), np.int32), given(triangles.ravel())
    grids = given(value), given(closest, np.int32)  # kept by name: a device may still read what is passed and forgotten
    loops.find_inexact(*grids, *tables, near, frame)
    ti.sync()
    near = _on_host(near)
    at = np.argwhere(near >= 0)
    exact = -1 - closest
    exact[tuple(at.T)] = np.arange(len(at))
    near = near[near >= 0]
    centre = start - origin + cell * (at[:, ::-1] + 0.5)
    return DistanceGrid(value, exact, *_cells(centre, near, tables, frame, cell, given), start, cell, tree)


def _cells(
    centre: NDArray, near: NDArray, tables: tuple, frame: Any, width: float, given: Any
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
    """Cells, lists and their distances, see DistanceGrid, of cells with these centres (c, 3) and width [m]. near: a triangle near
    each."""
    rows, lists, distances = [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int32)], [np.zeros(0)]
    begin, total = 0, len(near)  # of lists, of rows
    for level in range(LEVELS):
        part, few = 0.5**level, FEW_TRIANGLES
        number, listed, away = _lists(
            centre, near, tables, frame, part, MOST_TRIANGLES if level + 1 < LEVELS else ROOM, given
        )
        if len(number) > MOST_CUT:
            few = max(few, int(np.partition(number, -MOST_CUT - 1)[-MOST_CUT - 1]))
        cut = (number > few) & (level + 1 < LEVELS)
        length = np.where(number > MOST_TRIANGLES, 0, number)
        kept = np.repeat(~cut, length)
        lists.append(listed[kept])
        distances.append(away[kept])
        length[cut] = 0
        first = np.where(length > 0, begin + np.cumsum(length) - length, near)
        first[cut] = total + 8 * np.arange(cut.sum())
        rows.append(np.stack([first, np.where(cut, CUT, length)], axis=1))
        begin, total = begin + int(length.sum()), total + 8 * int(cut.sum())
        centre = (centre[cut][:, None] + 0.25 * part * width * EIGHTHS).reshape(-1, 3)
        near = np.repeat(near[cut], 8)
    return np.concatenate(rows), np.concatenate(lists), np.concatenate(distances)


def _lists(
    centre: NDArray, near: NDArray, tables: tuple, frame: Any, part: float, room: int, given: Any
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Numbers of triangles, see loops.list_triangles, of which a row has this room, and, one cell after the other, those of
    cells with MOST_TRIANGLES or less, and their distances [m]. Puts the closest ones into `near`."""
    number, lists, distances = np.zeros(len(near), np.int32), [np.zeros(0, np.int32)], [np.zeros(0)]
    for k in range(0, len(near), AT_ONCE):
        some = slice(k, k + AT_ONCE)
        rows = np.zeros((len(near[some]), room))
        listed, away, places = given(rows, np.int32), given(rows.copy()), given(centre[some])
        closest, found = given(near[some], np.int32), given(number[some], np.int32)
        loops.list_triangles(places, *tables, closest, found, listed, away, frame, part)
        ti.sync()
        near[some], number[some] = _on_host(closest), _on_host(found)
        fits = (number[some] <= MOST_TRIANGLES)[:, None]
        kept = fits & (np.arange(room) < number[some][:, None])
        lists.append(_on_host(listed)[kept])
        distances.append(_on_host(away)[kept].astype(np.float64))
    return number, np.concatenate(lists), np.concatenate(distances)


def _facing_out(
    collider: Collider, tree: TriangleTree, closest: NDArray, value: NDArray, low: NDArray, cell: float
) -> TriangleTree:
    """The tree with the normals of each connected part of the mesh as the corners next to it tell: a part that faces inward is
    solid, too, unless it is the inside of another one."""
    part = components(len(collider.vertices), np.concatenate([collider.triangles[:, :2], collider.triangles[:, 1:]]))
    part = part[collider.triangles[tree.order, 0]]
    if np.all(part == part[0]):
        return tree
    k, j, i = np.nonzero(np.abs(value) < cell)
    number = closest[k, j, i]
    at = tree.triangles[number]
    above = np.sum(
        (low + cell * np.stack([i, j, k], axis=1) - at[:, CORNERS : CORNERS + 3]) * at[:, 3 * INSIDE : OUTWARD], axis=1
    )
    wrong = np.bincount(part[number], np.sign(above) * np.sign(value[k, j, i]), minlength=part.max() + 1) < 0
    normals = np.where(wrong[part][:, None], -1.0, 1.0) * tree.triangles[:, :OUTWARD]
    return tree._replace(triangles=np.concatenate([normals, tree.triangles[:, OUTWARD:]], axis=1))


def _on_host(array: Any) -> NDArray[Any]:
    return array if isinstance(array, np.ndarray) else array.to_numpy()


def _on_device(array: NDArray[Any]) -> Any:
    """Taichi array with the same numbers."""
    made = ti.ndarray(ti.i32 if array.dtype == np.int32 else ti.f32, array.shape)
    made.from_numpy(array)
    return made


def distance_grids(scene: Scene) -> list[DistanceGrid]:
    """One for each collider, empty for what is no mesh; to be made before the fields of a simulation are. Raises SceneError where
    they do not fit into memory together."""
    integers = np.zeros(0, np.int32)
    cells = np.zeros((0, 2), np.int64), integers, np.zeros(0)
    none = DistanceGrid(np.zeros((0, 0, 0)), integers, *cells, np.zeros(3), 1.0, NO_TREE)
    if all(collider.form is not Meshed for collider in scene.colliders):
        return [none] * len(scene.colliders)
    reach = 2.0 * float(np.max(scene.radius, initial=0.0))
    finest = 2.0 * float(np.min(scene.radius, initial=np.inf))
    need, free = 0, available()
    for k, collider in enumerate(scene.colliders):
        if collider.form is Meshed:
            need += memory_of(int(layout(collider, reach)[1].prod()))
            if need > free:
                says = (
                    f"is not allowed; the grids of the meshes so far need {need / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB"
                    " are free"
                )
                with scene.in_file():
                    raise SceneError(f"colliders[{k}].resolution", collider.resolution, says=says)
    return [distance_grid(c, reach, finest) if c.form is Meshed else none for c in scene.colliders]
