"""XPBD with small steps: each spring in turn, implicitly, there and back; elements are solved for in between."""

import numpy as np

from taichi_sim.analysis import methods
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.parts import STEP, Part
from taichi_sim.forces.gases import Gases
from taichi_sim.integrators.implicit_base import Implicit
from taichi_sim.integrators.implicit_gas import GasConstraints
from taichi_sim.kernels.springs import edge_blocks, law, padded_blocks, simd_batches
from taichi_sim.kernels.vectors import unit
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.scene import Scene

__all__ = ["XPBD"]


@ti.data_oriented
class XPBD(Implicit):
    """Order 1, stable at any step; two passes over the springs per substep (Macklin et al. 2019, "Small steps").

    Each spring predicts where its ends will be after the step, and gives the impulse that would be right then if the spring were
    alone: J = h (k (d - l) + c u) / (1 + (h^2 k + h c) W), d and u predicted, W the sum of inverse masses. That is XPBD's
    projection, written for velocities: with v a variable, and not a difference of positions, small steps lose no digits. Springs
    see what those before them changed (Gauss-Seidel, in a fixed order: blocks, in small scenes SIMD batches, on a GPU and with
    accumulate="gather" colours, if no ball has more than 32 springs).

    Two rules make it stable (docs/physics.md). Each substep takes the springs in order and then in the reverse order, each time
    with half of k and c: one pass alone is not symmetric, and gains energy in a wide cloth. A spring that will be shorter than
    its rest length pushes along its direction at the start of the step: along the predicted one, ends that pass each other gain
    energy.

    Where sums are atomic, and on a GPU without colours, all springs act once on old values, which is symmetric, and every ball
    splits its mass between its springs. Order 1 with a large constant: stiff springs act softer than they are, unless steps are
    small.

    Elements, and gas beside them, are solved for together between there and back, by a stage of implicit Euler from the
    velocities that springs led to: after both passes the step would not be symmetric. Without springs that is implicit Euler.
    """

    method = methods.XPBD
    relaxes = takes_gas = in_turn = True
    takes_springs = False
    tolerance = 3e-2

    def refines(self, scene: Scene) -> bool:
        """True where there are elements to solve for: springs read places alone."""
        return any(one.is_implicit and one.acts(scene) for one in ELEMENTS)

    def allocate(self, fields: Fields) -> None:
        """`sum` [N s]: impulses of springs that act on old values. `start` [m/s]: velocities before forces changed them."""
        self.dim = self.model.dim
        self.springs = self.forces.springs
        self.active = self.springs is not None
        self.stages = int(any(one.implicit for one in self.forces.elements))
        self.hosted = self.solves = self.stages > 0
        if self.solves:
            super().allocate(fields)
        self.part_at_once = (
            0.5 if self.solves else 1.0
        )  # of springs that act on old values, before elements and after them
        self.notes_load = self.contacts.plan.walls
        if self.notes_load:
            self.start = fields.vectors(self.model.n, self.dim)
        gases = self.forces.of_kind(Gases) if self.active and not self.solves else None
        self.inflated = gases is not None
        if self.inflated:
            self.forces.take([gases])
            self.gas = GasConstraints(gases, self.model, fields)
        self.at_once = self.active and self.springs.order == "atomic"
        self.in_batches = self.active and self.springs.order == "batches"
        if self.at_once:
            self.sum, self.type = fields.vectors(self.model.n, self.dim), fields.real
            count = np.bincount(self.model.scene.pairs.ravel(), minlength=self.model.n)
            self.spring_count = fields.reals(count.astype(np.float64))  # springs of each ball

    @ti.func
    def _impulse(self, i, j, e, h, n, d, part: ti.template(), split: ti.template()):
        """Impulse along n on ball i of a part of spring e to ball j, which will lie d metres away."""
        spring = self.springs.spring[e]
        wi, wj = self.model.inverse_mass[i], self.model.inverse_mass[j]
        if ti.static(split):
            wi *= self.spring_count[i]
            wj *= self.spring_count[j]
        closing = (self.ball[j].v - self.ball[i].v).dot(n)
        pull = law.tension(spring, part, d, 1.0, closing, self.springs.damped)
        rate = part * h * spring.stiffness
        if ti.static(self.springs.damped):
            rate += part * spring.damping
        return h * pull / (1.0 + h * rate * (wi + wj)) * n

    @ti.func
    def _direction(self, i, j, e, h):
        """Unit vector of spring e from ball i to ball j, and its length after the step: the vector of the start of the step where
        the spring will be compressed."""
        a, b = self.ball[i], self.ball[j]
        n, d = unit((b.x - a.x) + h * (b.v - a.v), i, j)
        if d < self.springs.spring[e].rest_length:
            n, _ = unit(b.x - a.x, i, j)
        return n, d

    @ti.func
    def own(self, i):
        """No spring yet."""
        return ti.Vector.zero(float, self.dim)

    @ti.func
    def term(self, i, j, e, h):
        """Impulse of spring e on its lower ball i, each ball's mass split between its springs."""
        n, d = self._direction(i, j, e, h)
        return self._impulse(i, j, e, h, n, d, self.part_at_once, True)

    @ti.func
    def change(self, i, j, e, h):
        """Apply half of spring e at both ends."""
        n, d = self._direction(i, j, e, h)
        self.take(i, j, self._impulse(i, j, e, h, n, d, 0.5, False))

    @ti.func
    def give(self, i, j, e, h):
        """The impulse of half of spring e on ball i where its ends do not meet, without a branch, and the square of the smaller
        of their distances before and after the step."""
        a, b = self.ball[i], self.ball[j]
        start = b.x - a.x
        r = start + h * (b.v - a.v)
        square, before = r.dot(r), start.dot(start)
        inverse = ti.rsqrt(ti.max(square, padded_blocks.COINCIDENT))
        inverse_before = ti.rsqrt(ti.max(before, padded_blocks.COINCIDENT))
        d = square * inverse
        n = ti.select(d < self.springs.spring[e].rest_length, start * inverse_before, r * inverse)
        return self._impulse(i, j, e, h, n, d, 0.5, False), ti.min(square, before)

    @ti.func
    def take(self, i, j, p):
        """Impulse p on ball i, -p on ball j."""
        self.state.kick(i, self.model.inverse_mass[i] * p)
        self.state.kick(j, -self.model.inverse_mass[j] * p)

    def finishing(self) -> list[Part]:
        """Other forces and springs, where no elements did them in a stage; contacts on the new velocity, then move."""
        springs = [Part(self, "_kick_by_springs", STEP)] if self.active else []
        kicks = [] if self.solves else [Part(self, "_kick_by_others", STEP), *springs]
        return [*kicks, *self.moving(), Part(self, "_relax", STEP)]

    @ti.func
    def begin(self, stage, h, time):
        """Other forces, and springs there: elements start from where these lead. What energy the stage may give is judged by the
        velocities before both: by those after them, a body that only bears its load could gain."""
        for i in range(self.model.n):
            self.begin_at(i, ti.Vector.zero(float, self.dim))
            self.solver.base[i].v = self.ball[i].v
        self._kick_by_others(STEP, h, time)
        if ti.static(self.active):
            self.forces.flex(1.0)
            self._one_way(h, False)
        for i in range(self.model.n):
            self.solver.kick[i] = self.forces.external_change(i, h)
            self.solver.q[i] = self.ball[i].v

    @ti.func
    def end(self, stage, h):
        """The velocities of the stage, and springs back."""
        for i in range(self.model.n):
            self.state.kick(i, self.solver.base[i].v - self.ball[i].v)
        if ti.static(self.active):
            self._one_way(h, True)

    @ti.func
    def _kick_by_others(self, role: ti.template(), h, time):
        self.forces.external(self.ball, h, time)
        self.contacts.note_velocities()
        for i in range(self.model.n):
            if ti.static(self.notes_load):
                self.start[i] = self.ball[i].v
            self.state.kick(i, self.forces.external_change(i, h))
        if ti.static(self.inflated):
            self.gas.push(self.ball, self.state, h)

    @ti.func
    def _kick_by_springs(self, role: ti.template(), h, time):
        """All at once, or there and back by batches, colours or blocks."""
        self.forces.flex(1.0)
        if ti.static(self.at_once):
            self._all_at_once(h)
        elif ti.static(self.in_batches):
            simd_batches.there_and_back(self, self.springs, h)
        else:
            edge_blocks.there_and_back(self, self.springs, h)

    @ti.func
    def _one_way(self, h, reverse: ti.template()):
        """There, or back; or half of all springs at once."""
        if ti.static(self.at_once):
            self._all_at_once(h)
        elif ti.static(self.in_batches):
            count = ti.static(self.springs.batches)
            begin = ti.static(count if reverse else 0)
            simd_batches.some_batches(self, self.springs, h, begin, ti.static(begin + count))
        else:
            edge_blocks.one_way(self, self.springs, h, reverse)

    @ti.func
    def _all_at_once(self, h):
        edge_blocks.sums(self, self.springs, h)
        for i in range(self.model.n):
            self.state.kick(i, self.model.inverse_mass[i] * self.sum[i])

    @ti.func
    def load(self, i, h):
        """Velocity [m/s] that springs and other forces changed of ball i in this step."""
        change = ti.Vector.zero(float, self.dim)
        if ti.static(self.notes_load):
            change = self.contacts.velocity_before[i] - self.start[i]
        return change
