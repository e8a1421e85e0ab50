"""Explicit Euler: x += h v, v += h a, both from old values."""

from taichi_sim.analysis.methods import EXPLICIT_EULER
from taichi_sim.device.engine import ti
from taichi_sim.integrators.base import Integrator

__all__ = ["ExplicitEuler"]


@ti.data_oriented
class ExplicitEuler(Integrator):
    """Order 1. Gains energy on every undamped spring whatever the step; here for study."""

    method = EXPLICIT_EULER

    @ti.func
    def substep(self, h, time):
        """Move with the old velocity, then change it by the old forces."""
        self.forces.total(self.ball, h, time)
        self.contacts.separate(self.ball, h)
        for i in range(self.model.n):
            dv = self.forces.change(i, h)
            v = self.ball[i].v
            shift, drift = self.contacts.move(self.ball, i, v, 0.0 * v, h, dv)
            self.state.shift(i, shift)
            self.state.kick(i, (drift - v) + dv)
        self.contacts.refresh(self.ball)
        self.contacts.solve(self.ball, h, self.contacts.iterations, True)
