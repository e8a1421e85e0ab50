"""Pointer: a hand that drags a ball, and what hangs on it, to where a mouse points."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields, fill
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.geometry.graph import components
from taichi_sim.scene.scene import Scene

__all__ = ["MOST_RATE_STEP", "POINTER_RATE", "Pointer"]

POINTER_RATE = 50.0  # 1/s; a dragged ball is within a twentieth of its way after 0.1 s
MOST_RATE_STEP = (
    0.06  # rate times step: h^2 rate^2 + 8 h rate adds 0.5 to the 4 that velocity Verlet with predicted damping allows
)
DRAGGED_PART = (
    1 / 16
)  # of the mass that hangs together: by so much of it a cloth is dragged; its weight then draws it 16 g / rate^2 down


@ti.data_oriented
class Pointer:
    """A damped spring, critically damped, from a ball to a target that the host moves between steps.

        pointer = Pointer()
        with Simulation(scene, forces=[pointer]) as sim:
            pointer.grab(3, target=(0.5, 1.0))
            sim.run(0.1)
            pointer.move((0.6, 1.0))
            sim.run(0.1)
            pointer.release()

    A ball j that is dragged feels f_j = -m_j s (s (x_j - g_j) + 2 v_j) [N], so that its distance d to g_j would be
    (1 + s t) exp(-s t) d(0) alone and from rest, whatever its mass. Of balls that springs join, the nearest ones with a
    sixteenth of the mass of all are dragged together, each at its place beside the first. Pinned balls cannot be dragged.

    Args: rate s [1/s]. It acts explicitly with at most 0.06 / h, which no method minds in steps h of nine tenths of its bound.
    """

    def __init__(self, rate: float = POINTER_RATE) -> None:
        self.rate = validation.number("rate", rate, positive=True)
        self.ball: int | None = None  # which is dragged
        self._target: NDArray[np.float64] | None = None
        self._fields: Fields | None = None
        self._scene: Scene | None = None
        self._labels: NDArray[np.int64] | None = None

    def allocate(self, model: Model, state: State, fields: Fields) -> None:
        """Declare its fields; called for each simulation, and again where one is made anew inside."""
        if model.scene is not self._scene:
            self.ball, self._labels = None, None
            self._balls, self._places = np.zeros(0, dtype=np.int32), np.zeros((0, model.dim))
        self._scene, self._state, self._fields = model.scene, state, fields
        self._count = fields.integers(np.array([len(self._balls)]))
        self._dragged = fields.integers(_filled(self._balls, model.n))
        self._place = fields.reals(_filled(self._places, model.n))  # m, beside the target
        self._goal = fields.reals(np.zeros((1, model.dim)) if self.ball is None else np.array([self._target]))
        self._speed = fields.reals(np.array([self.rate]))

    def stiffness_rate(self, scene: Scene) -> float:
        """0: it fits itself to any step."""
        return 0.0

    def grab(self, ball: int, target: "ArrayLike") -> None:
        """Hold a ball, and nothing else, at a target (dim,) [m]. Raises SceneError for a pinned one."""
        scene = self._there()
        index = int(validation.indices("ball", [ball], scene.n_balls)[0])
        if scene.pinned[index]:
            raise SceneError("ball", index, says="is pinned; only balls that move can be dragged")
        goal = validation.vector("target", target, scene.dim)
        x = self._state.position
        self.ball, self._balls = index, self._around(index, x)
        self._places = x[self._balls] - x[index]
        fill(self._dragged, _filled(self._balls, scene.n_balls))
        fill(self._place, _filled(self._places, scene.n_balls))
        self._speed[0] = self.rate
        self._set_target(goal)
        self._count[0] = len(self._balls)

    def move(self, target: "ArrayLike") -> None:
        """Put the target (dim,) [m] elsewhere; does nothing where no ball is dragged."""
        goal = validation.vector("target", target, self._there().dim)
        if self.ball is not None:
            self._set_target(goal)

    def release(self) -> None:
        """Release the ball that is dragged."""
        self._there()
        self.ball, self._balls, self._places = None, self._balls[:0], self._places[:0]
        self._count[0] = 0

    @property
    def ready(self) -> bool:
        """True if it belongs to a simulation that is open."""
        return self._fields is not None and self._fields.built

    @property
    def target(self) -> NDArray[np.float64] | None:
        """Place (dim,) [m] that the ball is drawn to, or None."""
        return None if self.ball is None else self._target

    def _there(self) -> Scene:
        if self._scene is None or not self.ready:
            raise RuntimeError("pointer: belongs to no open simulation; give it as forces=[pointer]")
        return self._scene

    def _set_target(self, goal: NDArray[np.float64]) -> None:
        self._target = goal
        self._goal[0] = ti.Vector(goal.tolist(), dt=self._goal.dtype)

    def _around(self, ball: int, x: NDArray[np.float64]) -> NDArray[np.int32]:
        """The ball and the nearest of those that hang on it, with DRAGGED_PART of their mass together."""
        scene = self._there()
        if self._labels is None:
            self._labels = components(scene.n_balls, scene.pairs)
        own = np.flatnonzero((self._labels == self._labels[ball]) & ~scene.pinned)
        order = own[np.argsort(np.linalg.norm(x[own] - x[ball], axis=1), kind="stable")]
        mass = np.cumsum(scene.mass[order])
        return order[: 1 + int(np.searchsorted(mass, DRAGGED_PART * mass[-1]))].astype(np.int32)

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        """impulse += h f of the balls that are dragged."""
        for k in range(self._count[0]):
            i = self._dragged[k]
            rate = ti.min(self._speed[0], MOST_RATE_STEP / h)
            away = ball[i].x - self._place[k] - self._goal[0]
            impulse[i] += -h * rate / model.inverse_mass[i] * (rate * away + 2.0 * ball[i].v)


def _filled(values: NDArray, n: int) -> NDArray:
    """The values and zeros after them, n in all."""
    return np.concatenate([values, np.zeros((n - len(values), *values.shape[1:]), dtype=values.dtype)])
