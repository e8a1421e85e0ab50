"""Explicit Euler: x += h v, v += h a, both from old values."""

from taichi_sim.analysis.methods import EXPLICIT_EULER
from taichi_sim.device.engine import ti
from taichi_sim.device.parts import STEP, Part
from taichi_sim.integrators.base import Integrator

__all__ = ["ExplicitEuler"]


@ti.data_oriented
class ExplicitEuler(Integrator):
    """Order 1. Gains energy on every undamped spring whatever the step; here for study."""

    method = EXPLICIT_EULER

    def parts(self) -> list[Part]:
        """Move with the old velocity, then change it by the old forces."""
        move = [Part(self, "_displace", STEP), *self.contacts.finding()]
        return [Part(self, "_sum_forces", STEP), *move, Part(self, "_solve_contacts", STEP)]

    @ti.func
    def _sum_forces(self, role: ti.template(), h, time):
        self.forces.total(self.ball, h, time)

    @ti.func
    def _solve_contacts(self, role: ti.template(), h, time):
        self.contacts.solve(self.ball, h, self.contacts.iterations, True)

    @ti.func
    def load(self, i, h):
        """All that forces change."""
        return self.forces.change(i, h)

    @ti.func
    def after_move(self, i, h):
        """The whole kick."""
        self.state.kick(i, self.forces.change(i, h))
