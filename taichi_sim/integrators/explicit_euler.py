"""Explicit Euler: x += h v, v += h a, both from old values."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.base import Integrator

__all__ = ["ExplicitEuler"]


@ti.data_oriented
class ExplicitEuler(Integrator):
    """Order 1. Gains energy on every undamped spring whatever the step; here for study."""

    name, order = "explicit_euler", 1

    @ti.func
    def substep(self, h, time):
        """Move with the old velocity, then change it by the old forces."""
        self.forces.total(self.ball, h, time)
        self.contacts.move(self.ball, self, h)
        self.contacts.solve(self.ball, h, self.contacts.iterations, True)

    @ti.func
    def load(self, i, h):
        """All that forces change."""
        return self.forces.change(i, h)

    @ti.func
    def after_move(self, i, h):
        """The whole kick."""
        self.state.kick(i, self.forces.change(i, h))
