"""Symplectic (semi-implicit) Euler: v += h a(x), then x += h v with the new velocity."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.base import Integrator

__all__ = ["SymplecticEuler"]


@ti.data_oriented
class SymplecticEuler(Integrator):
    """Order 1, energy bounded for omega h < 2; spring damping explicit. The article's method."""

    name, order = "symplectic_euler", 1
    relaxes = True

    @ti.func
    def substep(self, h, time):
        """Forces first, contacts on the new velocity, then move."""
        self.forces.total(self.ball, h, time)
        self.contacts.advance(self.ball, self, h, h)
        self.contacts.relax(self.ball, 0.0)

    @ti.func
    def before_move(self, i, h):
        """The whole kick."""
        self.state.kick(i, self.forces.change(i, h))

    @ti.func
    def load(self, i, h):
        """All that forces changed."""
        return self.forces.change(i, h)
