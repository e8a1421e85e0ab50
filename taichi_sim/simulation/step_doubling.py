"""SecondSolution: a second solution of the same scene, with other steps, stored beside the first, to measure the error by."""

import numpy as np

from taichi_sim.contacts.base import ContactRule
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.state import WORLD_RADIUS, State
from taichi_sim.integrators.base import Integrator
from taichi_sim.kernels.reductions import each_part, member, members, parts_of
from taichi_sim.simulation.moments import KEPT, Moments

__all__ = ["AHEAD", "BEGUN", "COARSE", "FINE", "NEXT", "START", "SecondSolution"]

# moments: the solution kept, the second solution, where both were when they began, and both one step on
FINE, COARSE, START, BEGUN, NEXT, AHEAD = range(KEPT, KEPT + 6)


@ti.data_oriented
class SecondSolution(Moments):
    """Moments of both solutions. The second one one step on counts once the step is accepted.

    What contacts hold belongs to one solution: a pair that has met in one of them has not yet in the other.
    """

    def __init__(
        self, state: State, integrator: Integrator, contacts: ContactRule, fields: Fields, serial: bool
    ) -> None:
        super().__init__(state, integrator, contacts, fields, serial, 1 + AHEAD)
        self.parts = parts_of(self.n)
        self.row = np.zeros(self.parts, dtype=np.float64 if fields.real == ti.f64 else np.float32)
        # the second solution, to be compared
        self.seen = self.whole["seen"] = fields.table({"x": ti.types.vector(state.dim, fields.real)}, self.n)

    @ti.kernel
    def _show(self):
        ti.loop_config(serialize=self.serial)
        for i in range(self.n):
            self.seen[i].x = self.state.ball[i].x

    def show(self) -> None:
        """The second solution is where the balls are now."""
        self._show()

    @ti.func
    def _part(self, c, row: ti.template()):
        largest = 0.0 * self.seen[0].x[0]
        for k in range(members(c, self.parts, self.n)):
            i = member(c, k, self.parts)
            square = (self.state.ball[i].x - self.seen[i].x).norm_sqr()
            if not square < WORLD_RADIUS:  # nan, too
                square = WORLD_RADIUS
            largest = ti.max(largest, square)
        row[c] = largest

    @ti.kernel
    def _compare(self, row: ti.types.ndarray()):
        if ti.static(self.serial):
            ti.loop_config(serialize=True)
            for c in range(self.parts):
                self._part(c, row)
        else:
            each_part(self.parts, self._part, (row,))

    def apart(self) -> float:
        """Largest distance [m] of a ball from where the second solution was shown; infinite where either is nowhere."""
        self._compare(self.row)
        square = float(self.row.max())
        return float(np.sqrt(square)) if square < WORLD_RADIUS else np.inf
