"""Velocity Verlet, with spring damping at predicted velocities, or, where it is strong, in exponential halves about the drift."""

from typing import Any

import taichi as ti

from taichi_sim.fields import Fields
from taichi_sim.integrators.base import Integrator
from taichi_sim.scene import Scene
from taichi_sim.stability import predicts_damping

__all__ = ["Verlet"]


@ti.data_oriented
class Verlet(Integrator):
    """Order 2. Undamped: K(h/2) A(h) K(h/2), K the kick, A the drift; stable for omega h < 2.

    Weak damping, see `stability.predicts_damping`, acts with all other forces at the velocities v + h a, a from the step before:
    one pass over the springs, order 2. Eliminating v, x(t+h) - 2 x + x(t-h) = h^2 a with the second backward difference of x as
    the velocity in a; on the circle of stability its damping is real at -1 alone, so it is stable just where
    h^2 lambda(K + 4 D / h) < 4 (masses left out).

    Strong damping: K(h/2) D(h/2) A(h) D(h/2) K(h/2), D the damping, stable for omega h < 2 at least, whatever the damping. D is
    exact for a lone spring and second order there; in a network it splits masses between the damped springs of a ball, which
    is formally first order with a small constant. Written in this order a step costs two passes over the springs, because
    the second D and K read the same old values.
    """

    name, order = "verlet", 2
    relaxes = True

    def fit(self, scene: Scene) -> None:
        """Choose how damping acts."""
        self.predicts = predicts_damping(scene)
        self.implicit_damping = not self.predicts

    def allocate(self, fields: Fields) -> None:
        """`pull` [m/s^2]: what acted at the end of the step before, where damping, or a force of one's own, is predicted."""
        self.predicts = self.predicts or (bool(self.forces.extra) and not self.forces.damped)
        if self.predicts:
            self.pull = fields.vectors(self.model.n, self.model.dim)

    def memory(self) -> list[Any]:
        """What acted at the end of the step before: at the velocities predicted there, not those it came to."""
        return [self.pull] if self.predicts else []

    @ti.func
    def prime(self, h, time):
        """The forces and the contacts at the present positions."""
        if ti.static(self.predicts):
            self.forces.total(self.ball, h, time)
            for i in range(self.model.n):
                self.pull[i] = self.forces.change(i, h) / h
        else:
            self.forces.elastic(self.ball, h, time)
        self.contacts.prime(self.ball)

    @ti.func
    def substep(self, h, time):
        """Half kick, contacts, drift, half kick, contacts."""
        if ti.static(self.predicts):
            self.predicted(h, time)
        else:
            self.split(h, time)
        self.contacts.solve(self.ball, 0.5 * h, 1, False)

    @ti.func
    def predicted(self, h, time):
        """With the whole kick of old forces, half of it before the drift; then half of what the new ones differ by."""
        if ti.static(self.contacts.active):
            for i in range(self.model.n):
                self.state.kick(i, 0.5 * h * self.pull[i])
            self.contacts.solve(self.ball, 0.5 * h, self.contacts.passes, True)
            self.contacts.separate(self.ball, h)
            for i in range(self.model.n):
                v, a = self.ball[i].v, self.pull[i]
                shift, drift = self.contacts.move(self.ball, i, v, a, h, 0.0 * v)
                self.state.shift(i, shift)
                self.ball[i].v = drift
            self.contacts.refresh(self.ball)
            for i in range(self.model.n):
                self.state.kick(i, 0.5 * h * self.pull[i])
        else:
            for i in range(self.model.n):
                change = h * self.pull[i]
                self.state.shift(i, h * (self.ball[i].v + 0.5 * change))
                self.state.kick(i, change)
        self.forces.total(self.ball, h, time + h)
        for i in range(self.model.n):
            a = self.forces.change(i, h) / h
            self.state.kick(i, 0.5 * h * (a - self.pull[i]))
            self.pull[i] = a

    @ti.func
    def split(self, h, time):
        """Damping by itself."""
        first_half = ti.static(self.contacts.active or self.forces.damped)  # the kick needs a loop of its own
        if ti.static(first_half):
            for i in range(self.model.n):
                self.state.kick(i, 0.5 * self.forces.change(i, h))
        if ti.static(self.forces.damped):
            self.forces.springs.damp(self.ball, self.forces.jump, 0.5 * h)
            for i in range(self.model.n):
                self.state.kick(i, self.model.inverse_mass[i] * self.forces.jump[i])
        self.contacts.solve(self.ball, 0.5 * h, self.contacts.passes, True)
        self.contacts.separate(self.ball, h)
        for i in range(self.model.n):
            if ti.static(not first_half):
                self.state.kick(i, 0.5 * self.forces.change(i, h))
            shift, drift = self.contacts.move(
                self.ball, i, self.ball[i].v, self.forces.change(i, h) / h, h, 0.0 * self.ball[i].v
            )
            self.state.shift(i, shift)
            self.ball[i].v = drift
        self.contacts.refresh(self.ball)
        self.forces.elastic_and_jump(self.ball, h, 0.5 * h, time + h)
        for i in range(self.model.n):
            dv = 0.5 * self.forces.change(i, h)
            if ti.static(self.forces.damped):
                dv += self.model.inverse_mass[i] * self.forces.jump[i]
            self.state.kick(i, dv)
