# mypy: ignore-errors
# (kernels are Warp's language; its stubs type neither wp.tid() nor arrays of vectors)
"""The cloth step in NVIDIA Warp: the same gather over each ball's springs. On the CPU Warp runs on one thread."""

from typing import Any

from numpy.typing import NDArray

from taichi_sim.benchmark.cases import Cloth, HalfSprings
from taichi_sim.benchmark.peers.warp_start import on_cpu, wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _step(
    start: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    stiffness: wp.array(dtype=wp.float32),
    rest_length: wp.array(dtype=wp.float32),
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    h: wp.float32,
    gravity: wp.vec3,
    x_out: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    here = x[i]
    a = gravity
    for s in range(start[i], start[i + 1]):
        r = x[neighbour[s]] - here
        inverse = 1.0 / wp.sqrt(wp.max(wp.dot(r, r), 1.0e-30))
        a += stiffness[s] * (1.0 - rest_length[s] * inverse) * r
    u = v[i] + h * a
    v[i] = u
    x_out[i] = here + h * u


class ClothWarp:
    """A cloth stepped by Warp in f32. Balls have no masses here: all are 1 kg."""

    def __init__(self, cloth: Cloth, half: HalfSprings) -> None:
        self._dt, self._gravity = cloth.dt, wp.vec3(*cloth.gravity)
        self._springs = [wp.array(column, device="cpu") for column in half]
        self._x, self._next, self._v = map(on_cpu, (cloth.position, cloth.position, cloth.velocity))
        self._first = (wp.clone(self._x), wp.clone(self._v))

    def reset(self) -> None:
        wp.copy(self._x, self._first[0])
        wp.copy(self._v, self._first[1])

    def step(self, steps: int) -> None:
        for _ in range(steps):
            inputs: list[Any] = [*self._springs, self._x, self._v, self._dt, self._gravity]
            wp.launch(_step, dim=len(self._x), inputs=inputs, outputs=[self._next], device="cpu")
            self._x, self._next = self._next, self._x
        wp.synchronize_device("cpu")

    def result(self) -> tuple[NDArray, NDArray]:
        return self._x.numpy().copy(), self._v.numpy().copy()
