"""Velocity Verlet, with spring damping in exponential halves on either side of the drift."""

import taichi as ti

from taichi_sim.integrators.base import Integrator

__all__ = ["Verlet"]


@ti.data_oriented
class Verlet(Integrator):
    """Order 2, symmetric: K(h/2) D(h/2) A(h) D(h/2) K(h/2), K the kick, D the damping, A the drift.

    Stable for omega h < 2 undamped, and at least that far for any damping. D is exact for a lone spring and second order
    there; in a network it splits masses between the damped springs of a ball, which is formally first order with a small
    constant. Written in this order a damped step costs two passes over the springs, because the second D and K read the same
    old values; an undamped one costs one.
    """

    name, order = "verlet", 2
    relaxes = True
    implicit_damping = True

    @ti.func
    def prime(self, h, time):
        """The impulse h F and the contacts at the present positions."""
        self.forces.elastic(self.ball, h, time)
        self.contacts.prime(self.ball)

    @ti.func
    def substep(self, h, time):
        """Half kick, contacts, drift, half kick, contacts."""
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
        self.contacts.solve(self.ball, 0.5 * h, 1, False)
