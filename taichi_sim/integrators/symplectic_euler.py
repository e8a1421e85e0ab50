"""Symplectic (semi-implicit) Euler: v += h a(x), then x += h v with the new velocity."""

from taichi_sim.analysis.methods import SYMPLECTIC_EULER
from taichi_sim.device.engine import ti
from taichi_sim.device.parts import STEP, Part
from taichi_sim.integrators.base import Integrator

__all__ = ["SymplecticEuler"]


@ti.data_oriented
class SymplecticEuler(Integrator):
    """Order 1, energy bounded for omega h < 2; spring damping explicit. The article's method."""

    method = SYMPLECTIC_EULER
    relaxes = True

    def parts(self) -> list[Part]:
        """Forces first, contacts on the new velocity, then move."""
        return [Part(self, "_sum_forces", STEP), *self.moving(), Part(self, "_relax", STEP)]

    @ti.func
    def _sum_forces(self, role: ti.template(), h, time):
        self.forces.total(self.ball, h, time)

    @ti.func
    def before_move(self, i, h):
        """The whole kick."""
        self.state.kick(i, self.forces.change(i, h))

    @ti.func
    def load(self, i, h):
        """All that forces changed."""
        return self.forces.change(i, h)
