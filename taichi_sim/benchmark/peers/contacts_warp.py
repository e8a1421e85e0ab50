# mypy: ignore-errors
# (kernels are Warp's language; its stubs type neither wp.tid() nor arrays of vectors)
"""One iteration of ball contacts in NVIDIA Warp: its hash grid is built, then every ball gathers from its neighbours."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.cases import Balls
from taichi_sim.benchmark.peers.warp_start import on_cpu, wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _count(grid: wp.uint64, x: wp.array(dtype=wp.vec3), diameter: wp.float32, count_out: wp.array(dtype=wp.float32)):
    i = wp.hash_grid_point_id(grid, wp.tid())  # in the order of the cells: neighbours in space are near in memory
    here = x[i]
    touching = wp.float32(0.0)
    for j in wp.hash_grid_query(grid, here, diameter):
        r = x[j] - here
        if j != i and wp.dot(r, r) < diameter * diameter:
            touching += 1.0
    count_out[i] = touching


@wp.kernel
def _impulses(
    grid: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    count: wp.array(dtype=wp.float32),
    diameter: wp.float32,
    restitution: wp.float32,
    v_out: wp.array(dtype=wp.vec3),
):
    i = wp.hash_grid_point_id(grid, wp.tid())
    here = x[i]
    velocity = v[i]
    dv = wp.vec3(0.0, 0.0, 0.0)
    for j in wp.hash_grid_query(grid, here, diameter):
        r = x[j] - here
        d2 = wp.dot(r, r)
        if j != i and d2 < diameter * diameter and d2 > 0.0:
            n = r / wp.sqrt(d2)
            u = wp.dot(n, v[j] - velocity)
            if u < 0.0:
                dv += (1.0 + restitution) * u / (count[i] + count[j]) * n
    v_out[i] = velocity + dv


class ContactsWarp:
    """Contact iterations on balls that stay where they are: unit masses, from old velocities, applied at the end.

    split "count" divides by the contacts of both balls (section 6 of the physics notes), "none" is the plain sum.
    """

    def __init__(self, pack: Balls, *, split: str) -> None:
        n = len(pack.position)
        side = int(np.clip(2 ** np.ceil(np.log2(max(n, 8) ** (1 / 3))), 8, 256))
        self._split, self._e, self._diameter = split, pack.restitution, 2 * pack.radius
        self._grid = wp.HashGrid(side, side, side, device="cpu")
        self._x, self._v, self._next = map(on_cpu, (pack.position, pack.velocity, pack.velocity))
        self._first = wp.clone(self._v)
        self._count = wp.full(n, 1.0, dtype=wp.float32, device="cpu")

    def reset(self) -> None:
        """Back to the start; positions never change."""
        wp.copy(self._v, self._first)

    def step(self, steps: int) -> None:
        """`steps` times: build the grid, one iteration."""
        n, grid = len(self._x), self._grid
        for _ in range(steps):
            grid.build(self._x, self._diameter)
            shared: list[Any] = [self._x, self._diameter]
            if self._split == "count":
                wp.launch(_count, n, inputs=[grid.id, *shared], outputs=[self._count], device="cpu")
            inputs: list[Any] = [grid.id, self._x, self._v, self._count, self._diameter, self._e]
            wp.launch(_impulses, n, inputs=inputs, outputs=[self._next], device="cpu")
            self._v, self._next = self._next, self._v
        wp.synchronize_device("cpu")

    def result(self) -> tuple[NDArray, NDArray]:
        return self._x.numpy().copy(), self._v.numpy().copy()
