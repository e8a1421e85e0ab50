"""The classical fourth-order Runge-Kutta method."""

from taichi_sim.analysis import methods
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import phase_type
from taichi_sim.device.parts import STEP, Part
from taichi_sim.integrators.base import Integrator

__all__ = ["RK4"]


@ti.data_oriented
class RK4(Integrator):
    """Order 4, four force passes per step, spring damping explicit; loses a little energy for omega h < 2.828."""

    method = methods.RK4
    relaxes = True
    late_part = 1.0
    friction_part = 0.5

    def allocate(self, fields: Fields) -> None:
        """`stage`: where forces are asked next; `sum` (as x and v): the weighted change over the step."""
        phase = phase_type(self.model.dim, fields.real)
        self.stage = fields.table(phase, self.model.n)
        self.sum = fields.table(phase, self.model.n)

    @ti.func
    def _stage(self, at: ti.template(), h, time, weight: ti.template(), ahead: ti.template()):
        """One stage: slope at `at`, summed with `weight`; then the next place, `ahead` h along it from the start."""
        self.forces.total(at, h, time)
        for i in range(self.model.n):
            dx = h * at[i].v
            dv = self.forces.change(i, h)
            if ti.static(weight == 1.0 and ahead == 0.5):
                self.sum[i].x = dx / 6.0
                self.sum[i].v = dv / 6.0
            else:
                self.sum[i].x = self.sum[i].x + weight * dx / 6.0  # a bare += would be atomic
                self.sum[i].v = self.sum[i].v + weight * dv / 6.0
            self.stage[i].x = self.ball[i].x + ahead * dx
            self.stage[i].v = self.ball[i].v + ahead * dv

    def parts(self) -> list[Part]:
        """Four stages; then, as in Verlet, one part of the kick, contacts, the move, the rest of the kick, contacts."""
        first = [Part(self, "_half_of_stages", STEP), Part(self, "_other_half", STEP)]
        return [*first, *self.moving(), Part(self, "_kick_by_rest", STEP), Part(self, "_hold", STEP)]

    @ti.func
    def _half_of_stages(self, role: ti.template(), h, time):
        self._stage(self.ball, h, time, 1.0, 0.5)
        self.forces.flex(0.5)
        self._stage(self.stage, h, time + 0.5 * h, 2.0, 0.5)

    @ti.func
    def _other_half(self, role: ti.template(), h, time):
        self._stage(self.stage, h, time + 0.5 * h, 2.0, 1.0)
        self.forces.flex(1.0)
        self._stage(self.stage, h, time + h, 1.0, 0.0)

    @ti.func
    def _kick_by_rest(self, role: ti.template(), h, time):
        for i in range(self.model.n):
            self.state.kick(i, self.stage[i].v)

    @ti.func
    def before_move(self, i, h):
        """Kick ball i to the mean velocity of the step, with which it moves; the rest of the kick is kept for later."""
        kick = self.sum[i].x / h - self.ball[i].v
        self.stage[i].v = self.sum[i].v - kick
        self.state.kick(i, kick)

    @ti.func
    def acceleration(self, i, h):
        """The mean of the step."""
        return self.sum[i].v / h
