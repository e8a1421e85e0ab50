"""Distances from a closed mesh, kept on a grid around it, and where that is too coarse the triangles themselves."""

from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.common.memory import available
from taichi_sim.contacts.triangle_tree import CORNERS, NO_TREE, TriangleTree, triangle_tree
from taichi_sim.device.backend import has_wide_numbers
from taichi_sim.device.engine import ti
from taichi_sim.geometry.graph import components
from taichi_sim.geometry.mesh import Surface
from taichi_sim.kernels.contacts import distance_grid as loops
from taichi_sim.scene.colliders import MESH, Collider
from taichi_sim.scene.scene import Scene

__all__ = ["DistanceGrid", "distance_grid", "distance_grids"]

MOST_CORNERS = 1 << 24
CORNER_BYTES = 32  # while a grid is made; what it keeps is less than half of that
BORDER = 2  # cells around what comes near the mesh
MOST_LEAVES = 32  # of a cell; where there are more the tree is faster
NEAR = 2.0  # cells: beyond, what lies between corners is as good as they are
INEXACT = 0.02  # of a cell, and of the smallest diameter: the largest error of what lies between corners
BETWEEN = 0.44  # of a cell: no place in one is farther from those that are looked at
ROW_SHIFT = 1e-5  # of a cell, see `winding`


class DistanceGrid(NamedTuple):
    """Distances from a mesh on a grid: value (nz, ny, nx) [m], negative inside, at low (3,) [m] + cell [m] x (i, j, k); exact
    (nz, ny, nx): -1 where values interpolate well in the cell that begins there, else its number; of cells (c + 1, 2) with
    numbers a triangle of the tree near it, and where those leaves of the tree begin among `leaves` that may hold the closest
    one: none where these are many."""

    value: NDArray[np.float64]
    exact: NDArray[np.int32]
    cells: NDArray[np.int64]
    leaves: NDArray[np.int32]
    low: NDArray[np.float64]
    cell: float
    tree: TriangleTree


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
        given(tree.triangles[:, :CORNERS].reshape(-1, 3) - origin),
        given(np.array([*(start - origin), *lengths])),
    )
    closest, best = given(np.full(shape, -1), np.int32), given(np.full(shape, np.inf))
    loops.seed(corner, closest, best, frame)
    reaches = [1 << k for k in reversed(range(int(size.max()).bit_length()))]
    for distance in [*reaches, 2, 1]:
        source = deepcopy(closest)  # `copy` of an engine's array would share and free its memory
        loops.spread(corner, source, closest, best, frame, distance)
    each_once = given((collider.vertices - origin)[collider.triangles].reshape(-1, 3))  # in a tree some are there twice
    windings = given(np.zeros(shape), np.int32)
    loops.winding(each_once, windings, frame)
    ti.sync()
    inside, far = _on_host(windings) != 0, np.sqrt(_on_host(best).astype(np.float64))
    value = np.where(inside, -far, far)
    closest = _on_host(closest)
    tree = _facing_out(collider, tree, closest, value, start, cell)
    near = given(np.full(shape, -1), np.int32)
    boxes, triangles = tree.boxes - np.tile(origin, 2), tree.triangles.copy()
    triangles[:, :CORNERS] -= np.tile(origin, 3)
    tables = given(boxes.ravel()), given(tree.links.ravel(), np.int32), given(triangles.ravel())
    grids = given(value), given(closest, np.int32)  # kept by name: a device may still read what is passed and forgotten
    loops.find_inexact(*grids, *tables, near, frame)
    ti.sync()
    near = _on_host(near)
    at = np.argwhere(near >= 0)
    exact = np.full(shape, -1, np.int32)
    exact[tuple(at.T)] = np.arange(len(at))
    near = near[near >= 0]
    given_cells = given(at[:, ::-1], np.int32), *tables, given(near, np.int32)
    begin, leaves = given(np.zeros(len(at) + 1), np.int32), given(np.zeros(1), np.int32)
    loops.list_leaves(*given_cells, begin, leaves, frame, MOST_LEAVES)
    ti.sync()
    first = np.concatenate([[0], np.cumsum(_on_host(begin)[:-1])])
    begin, leaves = given(first, np.int32), given(np.zeros(max(1, first[-1])), np.int32)
    loops.list_leaves(*given_cells, begin, leaves, frame, 0)
    ti.sync()
    cells = np.stack([np.append(near, 0), first], axis=1)
    return DistanceGrid(value, exact, cells, _on_host(leaves), start, cell, tree)


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
    at = tree.triangles[number].reshape(-1, 10, 3)
    above = np.sum((low + cell * np.stack([i, j, k], axis=1) - at[:, 0]) * at[:, 3], axis=1)
    wrong = np.bincount(part[number], np.sign(above) * np.sign(value[k, j, i]), minlength=part.max() + 1) < 0
    normals = np.where(wrong[part][:, None], -1.0, 1.0) * tree.triangles[:, CORNERS:]
    return tree._replace(triangles=np.concatenate([tree.triangles[:, :CORNERS], normals], axis=1))


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
    none = DistanceGrid(np.zeros((0, 0, 0)), integers, np.zeros((0, 2), np.int64), integers, np.zeros(3), 1.0, NO_TREE)
    if all(collider.kind != MESH for collider in scene.colliders):
        return [none] * len(scene.colliders)
    reach = 2.0 * float(np.max(scene.radius, initial=0.0))
    finest = 2.0 * float(np.min(scene.radius, initial=np.inf))
    need, free = 0, available()
    for k, collider in enumerate(scene.colliders):
        if collider.kind == MESH:
            need += CORNER_BYTES * int(layout(collider, reach)[1].prod())
            if need > free:
                says = (
                    f"is not allowed; the grids of the meshes so far need {need / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB"
                    " are free"
                )
                with scene.in_file():
                    raise SceneError(f"colliders[{k}].resolution", collider.resolution, says=says)
    return [distance_grid(c, reach, finest) if c.kind == MESH else none for c in scene.colliders]
