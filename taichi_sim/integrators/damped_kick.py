"""DampedKick: forces and strong spring damping together over half a step, at the same places."""

from typing import Any

import numpy as np

from taichi_sim.analysis.damping import MOST_STAGES, lone, softened, stages
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields, fill
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.forces.sum import TotalForce
from taichi_sim.kernels.vectors import unit
from taichi_sim.scene.scene import Scene

__all__ = ["DampedKick"]


@ti.data_oriented
class DampedKick:
    """v(tau) of dv/dt = W (F - D v) from present velocities, for tau = h / 2, see taichi_sim.analysis.damping.

    A half begins with `start`, goes through stages 2 to `count`, and ends with `lone_springs`. Velocities are in ball.v, for the
    next pass over the springs; what they were is in `began`, so that the whole change is added at once, with the digits that
    single precision keeps apart.
    """

    def __init__(self, model: Model, state: State, forces: TotalForce, contacts: Any, fields: Fields) -> None:
        scene = model.scene
        self.model, self.state, self.forces, self.ball = model, state, forces, state.ball
        self.contacts = contacts
        alone = lone(scene)
        self.network = bool(np.any((scene.damping > 0) & ~alone))  # has damped springs that share balls
        self.n = model.n if self.network else 0
        self.began, self.slope = fields.vectors(self.n, model.dim), fields.vectors(self.n, model.dim)  # m/s; m/s a half
        self.change = fields.vectors(2 * self.n, model.dim)  # m/s, after this stage and the one before
        self.brake = fields.vectors(self.n, model.dim)  # m/s^2, by damping when the half after the drift began
        self.weights = fields.reals(np.zeros((2 * MOST_STAGES if self.network else 1, 4)))
        self.count = fields.integers(2)  # stages before the drift, and after it
        self.alone = np.flatnonzero(alone)
        self.m = len(self.alone)
        real = fields.real
        one, other = scene.pairs[self.alone].T if self.m else np.zeros((2, 0), dtype=np.int32)
        columns = {"one": ti.i32, "other": ti.i32, "lost": real, "late": real}
        zero = np.zeros(self.m)
        self.lone = fields.table(columns, self.m, {"one": one, "other": other, "lost": zero, "late": zero})
        self.counts = (1, 1)

    def fit(self, h: float) -> None:
        """Coefficients for steps of h seconds."""
        tau, scene = 0.5 * h, self.model.scene
        if self.network:
            both = stages(scene, tau)
            weights = np.zeros((2 * MOST_STAGES, 4))
            weights[: len(both.before)] = both.before
            weights[MOST_STAGES : MOST_STAGES + len(both.after)] = both.after
            fill(self.weights, weights)
            self.counts = (len(both.before), len(both.after))
            fill(self.count, np.array(self.counts))
        if self.m:
            w = self.model.inverse_mass_array[scene.pairs[self.alone]].sum(axis=1)
            z = tau * scene.damping[self.alone] * w
            lost = -np.expm1(-z)  # of the relative speed
            late = np.where(z > 1e-4, 1.0 - lost / np.where(z > 1e-4, z, 1.0), 0.5 * z - z * z / 6.0)
            fill(self.lone.lost, lost)
            fill(self.lone.late, late)

    @staticmethod
    def damping(scene: Scene, h: float) -> Any:
        """Spring damping (m,) [N s/m] that the stages work with."""
        return softened(scene, 0.5 * h)

    @ti.func
    def start(self, half: ti.template(), h, pull: ti.template(), delayed: ti.template()):
        """The first stage; where there is only one, all of the half. half: 0 before the drift, 1 after it. delayed:
        what is not damping is h `pull`, else in the forces. Damping at present velocities is in forces.damping_impulse."""
        stages = self.count[half]
        weight = self.weights[half * MOST_STAGES]
        for i in range(self.model.n):
            v = self.ball[i].v
            brake = self.model.inverse_mass[i] * self.forces.damping_impulse[i]
            slope = self._free(i, half, h, pull, delayed) + brake
            y = weight[2] * slope
            if ti.static(half == 0):
                y += weight[3] * (brake - 0.5 * h * self.brake[i])
            else:
                self.brake[i] = brake / (0.5 * h)
            if stages == 1:
                self.state.kick(i, y)
            else:
                self.began[i] = v
                self.slope[i] = slope
                self.change[i] = y
                self.change[self.n + i] = ti.Vector.zero(float, self.model.dim)
                self.ball[i].v = v + y

    @ti.func
    def prime(self, h):
        """Begin as if a half after a drift had changed nothing. Damping at present velocities is in forces.damping_impulse."""
        for i in range(self.model.n):
            self.brake[i] = self.model.inverse_mass[i] * self.forces.damping_impulse[i] / (0.5 * h)

    @ti.func
    def stage(self, half: ti.template(), j, h, pull: ti.template(), delayed: ti.template()):
        """Stage j, from 1 on counted, of the second and later ones; after the last the velocities are those of the end."""
        self.forces.springs.damp(self.ball, self.forces.damping_impulse, 0.5 * h)
        weight = self.weights[half * MOST_STAGES + j]
        last = j + 1 == self.count[half]
        now, old = (j + 1) % 2 * self.n, j % 2 * self.n
        for i in range(self.model.n):
            slope = self._free(i, half, h, pull, delayed) + self.model.inverse_mass[i] * self.forces.damping_impulse[i]
            y = (
                weight[0] * self.change[now + i]
                + weight[1] * self.change[old + i]
                + weight[2] * slope
                + weight[3] * self.slope[i]
            )
            self.change[old + i] = y
            if last:
                self.ball[i].v = self.began[i]
                self.state.kick(i, y)
            else:
                self.ball[i].v = self.began[i] + y

    @ti.func
    def undamped(self, half: ti.template(), h, pull: ti.template(), delayed: ti.template()):
        """All of a half in which no springs that share balls are damped."""
        for i in range(self.model.n):
            self.state.kick(i, self._free(i, half, h, pull, delayed))

    @ti.func
    def lone_springs(self, half: ti.template(), h, pull: ti.template(), delayed: ti.template()):
        """Take away what damping takes from the kick that both balls of a lone spring have had, a of their relative velocity u:
        u(tau) = exp(-z) u + (1 - exp(-z)) / z a is (1 - exp(-z)) u + (1 - (1 - exp(-z)) / z) a less than u + a."""
        for e in range(self.m):
            spring = self.lone[e]
            i, j = spring.one, spring.other
            n, _ = unit(self.ball[j].x - self.ball[i].x, i, j)
            a = (self._free(j, half, h, pull, delayed) - self._free(i, half, h, pull, delayed)).dot(n)
            u = (self.ball[j].v - self.ball[i].v).dot(n) - a
            wi, wj = self.model.inverse_mass[i], self.model.inverse_mass[j]
            loss = (spring.lost * u + spring.late * a) / (wi + wj) * n
            if wi > 0.0:
                self.state.kick(i, wi * loss)
            if wj > 0.0:
                self.state.kick(j, -wj * loss)

    @ti.func
    def _free(self, i, half: ti.template(), h, pull: ti.template(), delayed: ti.template()):
        """Velocity change of ball i over half a step without damping."""
        if ti.static(delayed):
            return 0.5 * h * pull[i]
        elif ti.static(half == 1):
            return self.contacts.second_half(i, 0.5 * self.forces.change(i, h))
        else:
            return 0.5 * self.forces.change(i, h)
