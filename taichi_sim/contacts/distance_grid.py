"""Distances from a closed mesh, kept on a grid around it."""

from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.common.memory import available
from taichi_sim.device.backend import has_wide_numbers
from taichi_sim.device.engine import ti
from taichi_sim.kernels.contacts import distance_grid as loops
from taichi_sim.scene.colliders import MESH, Collider
from taichi_sim.scene.scene import Scene

__all__ = ["DistanceGrid", "distance_grid", "distance_grids"]

MOST_CORNERS = 1 << 24
CORNER_BYTES = 24  # while a grid is made; what it keeps is half of that
BORDER = 2  # cells around what comes near the mesh
ROW_SHIFT = 1e-5  # of a cell, see `winding`


class DistanceGrid(NamedTuple):
    """value (nz, ny, nx) [m], negative inside, at low (3,) [m] + cell [m] x (i, j, k)."""

    value: NDArray[np.float64]
    low: NDArray[np.float64]
    cell: float


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


def distance_grid(collider: Collider, reach: float) -> DistanceGrid:
    """The grid of a mesh, see `layout`."""
    cell, size = layout(collider, reach)
    start = 0.5 * (collider.vertices.min(axis=0) + collider.vertices.max(axis=0)) - 0.5 * cell * (size - 1)
    shape = tuple(size[::-1])
    wide = has_wide_numbers()
    real = np.float64 if wide else np.float32
    origin = np.zeros(3) if wide else start  # single precision has digits to spare only near the grid
    corner: Any = np.ascontiguousarray((collider.vertices - origin)[collider.triangles].reshape(-1, 3), dtype=real)
    frame: Any = np.array([*(start - origin), cell, ROW_SHIFT], dtype=real)
    closest: Any = np.full(shape, -1, dtype=np.int32)
    best: Any = np.full(shape, np.inf, dtype=real)
    if not wide:  # external arrays are copied at each launch, and with Vulkan some come back with other numbers
        corner, frame, closest, best = (_on_device(array) for array in (corner, frame, closest, best))
    loops.seed(corner, closest, best, frame)
    reaches = [1 << k for k in reversed(range(int(size.max()).bit_length()))]
    for distance in [*reaches, 2, 1]:
        source = copy(closest)
        loops.spread(corner, source, closest, best, frame, distance)
    windings: Any = np.zeros(shape, dtype=np.int32)
    if not wide:
        windings = _on_device(windings)
    loops.winding(corner, windings, frame)
    ti.sync()
    if not wide:
        windings, best = windings.to_numpy(), best.to_numpy()
    return DistanceGrid(np.where(windings != 0, -1.0, 1.0) * np.sqrt(best.astype(np.float64)), start, cell)


def _on_device(array: NDArray[Any]) -> Any:
    """A Taichi array with the same numbers."""
    made = ti.ndarray(ti.i32 if array.dtype == np.int32 else ti.f32, array.shape)
    made.from_numpy(array)
    return made


def distance_grids(scene: Scene) -> list[DistanceGrid]:
    """One for each collider, empty for what is no mesh; to be made before the fields of a simulation are. Raises SceneError where
    they do not fit into memory together."""
    none = DistanceGrid(np.zeros((0, 0, 0)), np.zeros(3), 1.0)
    if all(collider.kind != MESH for collider in scene.colliders):
        return [none] * len(scene.colliders)
    reach = 2.0 * float(np.max(scene.radius, initial=0.0))
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
    return [distance_grid(c, reach) if c.kind == MESH else none for c in scene.colliders]
