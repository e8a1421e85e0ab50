"""XPBD with small steps: each spring in turn, implicitly, once per substep."""

import numpy as np

from taichi_sim.analysis import methods
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.forces.gas import Gases
from taichi_sim.integrators.base import Integrator
from taichi_sim.integrators.implicit_gas import GasConstraints
from taichi_sim.kernels.springs import edge_blocks, law, padded_blocks, simd_batches
from taichi_sim.kernels.vectors import unit

__all__ = ["XPBD"]


@ti.data_oriented
class XPBD(Integrator):
    """Order 1, bounded at any step; one pass over the springs per substep (Macklin et al. 2019, "Small steps").

    Each spring asks where its ends would be after the step, and gives the impulse that would be right at the end of it if the
    spring were alone: J = h (k (d - l) + c u) / (1 + (h^2 k + h c) W), d and u predicted, W the sum of inverse masses. That is
    XPBD's projection, written for velocities: with v a variable, and not a difference of positions, small steps lose no digits.
    Springs see what those before them changed (Gauss-Seidel, in a fixed order: blocks, in small scenes SIMD batches, on a GPU and
    with accumulate="gather" colours, if no ball has more than 32 springs); where sums are atomic, and on a GPU without colours,
    all act on old values and every ball splits its mass between its springs. Order 1 with a large constant: stiff springs act
    softer than they are, unless steps are small.
    """

    method = methods.XPBD
    relaxes = True
    each_once = in_turn = True

    def allocate(self, fields: Fields) -> None:
        """`sum` [N s]: impulses of springs that act on old values. `start` [m/s]: velocities before forces changed them."""
        self.dim = self.model.dim
        self.springs = self.forces.springs
        self.active = self.springs is not None
        self.notes_load = self.contacts.plan.walls
        if self.notes_load:
            self.start = fields.vectors(self.model.n, self.dim)
        gases = self.forces.take(Gases) if self.active else None
        self.inflated = gases is not None
        if self.inflated:
            self.gas = GasConstraints(gases, self.model, fields)
        self.at_once = self.active and self.springs.order == "atomic"
        self.in_batches = self.active and self.springs.order == "batches"
        if self.at_once:
            self.sum = fields.vectors(self.model.n, self.dim)
            count = np.bincount(self.model.scene.pairs.ravel(), minlength=self.model.n)
            self.spring_count = fields.reals(count.astype(np.float64))  # springs of each ball

    @ti.func
    def _impulse(self, i, j, e, h, n, d, split: ti.template()):
        """Impulse on ball i of spring e to ball j, which will lie d metres away along n."""
        spring = self.springs.spring[e]
        wi, wj = self.model.inverse_mass[i], self.model.inverse_mass[j]
        if ti.static(split):
            wi *= self.spring_count[i]
            wj *= self.spring_count[j]
        closing = (self.ball[j].v - self.ball[i].v).dot(n)
        pull = law.tension(spring, 1.0, d, 1.0, closing, self.springs.damped)
        rate = h * spring.stiffness
        if ti.static(self.springs.damped):
            rate += spring.damping
        return h * pull / (1.0 + h * rate * (wi + wj)) * n

    @ti.func
    def _ahead(self, i, j, h):
        """From ball i to ball j after the step."""
        a, b = self.ball[i], self.ball[j]
        return (b.x - a.x) + h * (b.v - a.v)

    @ti.func
    def own(self, i):
        """No spring yet."""
        return ti.Vector.zero(float, self.dim)

    @ti.func
    def term(self, i, j, e, h):
        """What spring e gives its lower ball i, each ball's mass split between its springs."""
        n, d = unit(self._ahead(i, j, h), i, j)
        return self._impulse(i, j, e, h, n, d, True)

    @ti.func
    def change(self, i, j, e, h):
        """Apply spring e at both ends."""
        n, d = unit(self._ahead(i, j, h), i, j)
        self.take(i, j, self._impulse(i, j, e, h, n, d, False))

    @ti.func
    def give(self, i, j, e, h):
        """The impulse of spring e on ball i where its ends do not meet, without a branch; the square of their distance."""
        r = self._ahead(i, j, h)
        square = r.dot(r)
        inverse = ti.rsqrt(ti.max(square, padded_blocks.COINCIDENT))
        return self._impulse(i, j, e, h, r * inverse, square * inverse, False), square

    @ti.func
    def take(self, i, j, p):
        """Impulse p on ball i, -p on ball j."""
        self.state.kick(i, self.model.inverse_mass[i] * p)
        self.state.kick(j, -self.model.inverse_mass[j] * p)

    @ti.func
    def substep(self, h, time):
        """Other forces, springs, contacts on the new velocity, then move."""
        self.forces.external(self.ball, h, time)
        for i in range(self.model.n):
            if ti.static(self.notes_load):
                self.start[i] = self.ball[i].v
            self.state.kick(i, self.forces.external_change(i, h))
        if ti.static(self.inflated):
            self.gas.push(self.ball, self.state, h)
        if ti.static(self.active):
            self.forces.flex(1.0)
            self._kick_by_springs(h)
        self.contacts.advance(self.ball, self, h, h)
        self.contacts.relax(self.ball, 0.0)

    @ti.func
    def _kick_by_springs(self, h):
        """Each once: all at once, by batches or by blocks."""
        if ti.static(self.at_once):
            edge_blocks.sums(self, self.springs, h)
            for i in range(self.model.n):
                self.state.kick(i, self.model.inverse_mass[i] * self.sum[i])
        elif ti.static(self.in_batches):
            simd_batches.in_turn(self, self.springs, h)
        else:
            edge_blocks.in_turn(self, self.springs, h)

    @ti.func
    def load(self, i, h):
        """What springs and other forces changed."""
        change = ti.Vector.zero(float, self.dim)
        if ti.static(self.notes_load):
            change = self.contacts.velocity_before[i] - self.start[i]
        return change
