"""Integrators as a user writes them."""

import taichi_sim as ts
from taichi_sim.device.engine import ti


@ti.data_oriented
class Silent(ts.Integrator):
    """Symplectic Euler without contacts, of which nothing is said."""

    method = ts.Method("silent", order=1)

    @ti.func
    def substep(self, h, time):
        self.forces.total(self.ball, h, time)
        for i in range(self.model.n):
            self.state.kick(i, self.forces.change(i, h))
            self.state.shift(i, h * self.ball[i].v)


@ti.data_oriented
class Declared(Silent):
    """Symplectic Euler without contacts, and its limit."""

    method = ts.Method("declared", order=1, symplectic=True, limit=ts.StabilityLimit(undamped=2.0, damped=2.0))


@ti.data_oriented
class Advancing(Silent):
    """Symplectic Euler with contacts."""

    method = ts.Method("advancing", order=1)

    @ti.func
    def substep(self, h, time):
        self.forces.total(self.ball, h, time)
        self.contacts.advance(self.ball, self, h, h)

    @ti.func
    def before_move(self, i, h):
        self.state.kick(i, self.forces.change(i, h))
