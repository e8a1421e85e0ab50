# mypy: ignore-errors
# (what numba compiles has no types of its own)
"""Verlet and symplectic Euler in numba: one loop over the springs, with fast math, on one thread, in double precision."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.peers import PeerMissingError
from taichi_sim.scene.scene import Scene

try:
    from numba import njit
except ImportError:
    raise PeerMissingError("numba is not installed (pip install numba)") from None


@njit(fastmath=True)
def _force(x, v, one, other, stiffness, damping, rest_length, gravity, mass, force):
    for b in range(len(x)):
        for a in range(3):
            force[b, a] = mass[b] * gravity[a]
    for e in range(len(one)):
        i, j = one[e], other[e]
        rx, ry, rz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        d = np.sqrt(rx * rx + ry * ry + rz * rz)
        u = ((v[j, 0] - v[i, 0]) * rx + (v[j, 1] - v[i, 1]) * ry + (v[j, 2] - v[i, 2]) * rz) / d
        pull = (stiffness[e] * (d - rest_length[e]) + damping[e] * u) / d
        force[i, 0] += pull * rx
        force[i, 1] += pull * ry
        force[i, 2] += pull * rz
        force[j, 0] -= pull * rx
        force[j, 1] -= pull * ry
        force[j, 2] -= pull * rz


@njit(fastmath=True)
def _verlet(x, v, w, springs, gravity, mass, force, h, steps):
    _force(x, v, *springs, gravity, mass, force)
    for _ in range(steps):
        for b in range(len(x)):
            for a in range(3):
                v[b, a] += 0.5 * h * w[b] * force[b, a]
                x[b, a] += h * v[b, a]
        _force(x, v, *springs, gravity, mass, force)
        for b in range(len(x)):
            for a in range(3):
                v[b, a] += 0.5 * h * w[b] * force[b, a]


@njit(fastmath=True)
def _symplectic_euler(x, v, w, springs, gravity, mass, force, h, steps):
    for _ in range(steps):
        _force(x, v, *springs, gravity, mass, force)
        for b in range(len(x)):
            for a in range(3):
                v[b, a] += h * w[b] * force[b, a]
                x[b, a] += h * v[b, a]


class StiffNumba:
    """A scene's springs in steps of `h` [s]."""

    def __init__(self, scene: Scene, h: float, *, verlet: bool) -> None:
        self._scene, self._h = scene, h
        self._step = _verlet if verlet else _symplectic_euler
        self._w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
        columns = (scene.pairs[:, 0], scene.pairs[:, 1], scene.stiffness, scene.damping, scene.rest_length)
        self._springs = tuple(np.ascontiguousarray(column) for column in columns)
        self._force = np.zeros_like(scene.position)

    def reset(self) -> None:
        self._x, self._v = self._scene.position.copy(), self._scene.velocity.copy()

    def step(self, steps: int) -> None:
        scene = self._scene
        self._step(self._x, self._v, self._w, self._springs, scene.gravity, scene.mass, self._force, self._h, steps)

    def result(self) -> tuple[NDArray, NDArray]:
        return self._x, self._v
