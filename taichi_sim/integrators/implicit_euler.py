"""Implicit (backward) Euler: x += h v, v += h a(x, v), both from new values."""

from taichi_sim.analysis.methods import IMPLICIT_EULER
from taichi_sim.device.engine import ti
from taichi_sim.device.parts import STEP, Part
from taichi_sim.integrators.implicit_base import Implicit

__all__ = ["ImplicitEuler"]


@ti.data_oriented
class ImplicitEuler(Implicit):
    """Order 1, bounded at any step; its own damping takes the energy of everything faster than a step."""

    method = IMPLICIT_EULER
    relaxes = True
    takes_gas = True
    tolerance = 3e-2

    @ti.func
    def begin(self, stage, h, time):
        """Begin from the present places; gravity, the user's forces and all elements but gas act on old values."""
        self.forces.external(self.ball, h, time)
        self.forces.flex(1.0)
        for i in range(self.model.n):
            self.begin_at(i, ti.Vector.zero(float, self.model.dim))
            self.solver.base[i].v = self.ball[i].v
            self.solver.kick[i] = self.forces.external_change(i, h)
            self.solver.q[i] = self.ball[i].v + self.solver.kick[i]

    @ti.func
    def end(self, stage, h):
        """End the stage: there is nothing to keep. Probes learn what it left out."""
        self.solver.tell_probes(1.0)

    def finishing(self) -> list[Part]:
        """Contacts on the new velocity, then move."""
        return [*self.moving(), Part(self, "_relax", STEP)]

    @ti.func
    def before_move(self, i, h):
        """Kick ball i to the velocity that the stage came to."""
        self.state.kick(i, self.solver.base[i].v - self.ball[i].v)

    @ti.func
    def load(self, i, h):
        """All that the stage changed."""
        return self.solver.base[i].v - self.solver.first[i]
