"""Symplectic (semi-implicit) Euler: v += h a(x), then x += h v with the new velocity."""

from taichi_sim.analysis.methods import SYMPLECTIC_EULER
from taichi_sim.device.engine import ti
from taichi_sim.integrators.base import Integrator

__all__ = ["SymplecticEuler"]


@ti.data_oriented
class SymplecticEuler(Integrator):
    """Order 1, energy bounded for omega h < 2; spring damping explicit. The article's method."""

    method = SYMPLECTIC_EULER
    relaxes = True

    @ti.func
    def substep(self, h, time):
        """Forces first, contacts on the new velocity, then move."""
        self.forces.total(self.ball, h, time)
        if ti.static(self.contacts.active):
            for i in range(self.model.n):
                self.state.kick(i, self.forces.change(i, h))
            self.contacts.solve(self.ball, h, self.contacts.iterations, True)
            self.contacts.separate(self.ball, h)
        for i in range(self.model.n):
            if ti.static(not self.contacts.active):
                self.state.kick(i, self.forces.change(i, h))
            v = self.ball[i].v
            shift, drift = self.contacts.move(self.ball, i, v, 0.0 * v, h, self.forces.change(i, h))
            self.state.shift(i, shift)
            self.ball[i].v = drift
        self.contacts.refresh(self.ball)
        self.contacts.relax(self.ball, 0.0)
