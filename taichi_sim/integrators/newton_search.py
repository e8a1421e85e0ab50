"""Conjugate gradients for a change of the velocities of an implicit stage, of each body with its own steps."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_decisions import Verdicts
from taichi_sim.integrators.newton_numbers import READY, SEARCHING
from taichi_sim.kernels.springs import edge_blocks, padded_blocks

__all__ = ["Search"]


@ti.data_oriented
class Search(Verdicts):
    """The part of a StageSolver that searches."""

    @ti.func
    def start_search(self):
        """Start the conjugate gradients of an iteration."""
        if ti.static(self.levels.active):
            self.levels.solve(self.sum)
        self.bodies.each_part(self._aim, ())
        self._join_conditioned()
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == READY:
                if ti.static(self.deflates):
                    self.deflation.aim(b)
                self._count_iteration(b)
                self.next_search(b)
        self.bodies.each_part(self._set_out, ())

    @ti.func
    def deflate(self):
        """Have the next searches of heavy bodies leave no momentum."""
        self.deflation.find()

    @ti.func
    def multiply(self):
        """product.sum = A product.p."""
        self._sum_springs(self.product, 0.0)
        if ti.static(self.inflated):
            self.gas.multiply(self.product.p, self.product.sum)
        if ti.static(self.has_elements):
            self.elements.multiply(self.product.p, self.product.sum)

    @ti.func
    def _sum_springs(self, total: ti.template(), s):
        """total.sum (n) = own terms and those of springs."""
        if ti.static(self.has_springs):
            edge_blocks.sums(total, self.springs, s)
        else:
            for i in range(self.n):
                total.sum[i] = total.own(i)

    @ti.func
    def _aim(self, c):
        """Part c of the first change, and of its preconditioned residual."""
        if self.number[self.bodies.part[c].body].phase == READY:
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                self.dv[i] = ti.Vector.zero(float, self.dim)
                if ti.static(self.deflates):
                    self.dv[i] = self.deflation.way(i)
            self._precondition(c)

    @ti.func
    def _precondition(self, c):
        """Preconditioned residual of part c, and the product of both."""
        rz, reach = ti.cast(0.0, self.wide), ti.Vector.zero(self.wide, self.dim)
        for k in range(self.bodies.part[c].count):
            i = self.bodies.ball(c, k)
            z = self._conditioned(i)
            self.product.sum[i] = padded_blocks.pad(z, self.dim)
            rz += ti.cast(self.sum[i].dot(z), self.wide)
            if ti.static(self.deflates):
                if self.deflation.acts(self.bodies.part[c].body):
                    reach += self.deflation.reach(i, z)
        self.part[c].residual = rz
        if ti.static(self.deflates):
            self.deflation.part[c].sum = reach

    @ti.func
    def _join_conditioned(self):
        self.bodies.join((self.part.residual,))
        if ti.static(self.deflates):
            self.bodies.join((self.deflation.part.sum,))

    @ti.func
    def _conditioned(self, i):
        """Preconditioned residual at ball i, in the directions that it is free to take."""
        z = self.inverse_block[i] @ self.sum[i]
        if ti.static(self.levels.active):
            z += self.levels.shift(i)
        if ti.static(self.holds):
            z = self.held.along(i, z)
        return z

    @ti.func
    def _count_iteration(self, b):
        """The numbers with which an iteration starts."""
        self.number[b].residual_before = self.number[b].residual
        self.number[b].moved_before = self.number[b].moved
        self.number[b].moved = 0.0
        if ti.static(self.deflates):
            self.number[b].moved = self.number[b].shifted
            self.number[b].shifted = 0.0
        self.number[b].rz = self.bodies.total(self.part.residual, b)
        self.number[b].iterations += 1.0
        self.number[b].searches = 0.0
        self.number[b].tries = 0.0

    @ti.func
    def search(self):
        """The best change along p; the next p conjugate to it."""
        self.multiply()
        self.bodies.each_part(self._project, ())
        self.bodies.join((self.part.descent, self.part.curvature))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == SEARCHING:
                self._choose_step(b)
        self.bodies.each_part(self._descend, ())
        if ti.static(self.levels.active):
            self.levels.solve(self.sum)
            self.bodies.each_part(self._condition, ())
        self._join_conditioned()
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == SEARCHING:
                if ti.static(self.deflates):
                    self.deflation.aim(b)
                self._count_search(b)
                self.next_search(b)
        self.bodies.each_part(self._turn, ())

    @ti.func
    def _choose_step(self, b):
        """The step along p that is best for body b."""
        descent, curvature = self.bodies.total(self.part.descent, b), self.bodies.total(self.part.curvature, b)
        step = ti.select(curvature > 0.0, descent / ti.select(curvature > 0.0, curvature, 1.0), 0.0)
        if ti.static(self.inflated):
            # a direction of negative curvature ends the search; the first one still leads down
            if curvature < 0.0 and self.number[b].searches == 0.0:
                step = -descent / curvature
            self.number[b].saddle = ti.select(curvature > 0.0, 0.0, 1.0)
        self.number[b].step = step
        self.add_gain(b, step * descent)  # dv A dv grows by that
        self.number[b].moved += step * descent

    @ti.func
    def _count_search(self, b):
        """The numbers after a step along p."""
        rz, before = self.bodies.total(self.part.residual, b), self.number[b].rz
        if ti.static(self.inflated):
            rz = ti.select(self.number[b].saddle > 0.0, 0.0 * rz, rz)
        self.number[b].step = ti.select(before > 0.0, rz / ti.select(before > 0.0, before, 1.0), 0.0)
        self.number[b].rz = rz
        self.number[b].searches += 1.0
        self.number[b].passes += 1.0

    @ti.func
    def _project(self, c):
        """Part c of p . r and p . A p."""
        if self.number[self.bodies.part[c].body].phase == SEARCHING:
            descent = curvature = ti.cast(0.0, self.wide)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                if self.model.inverse_mass[i] > 0.0:
                    p = self.product.p[i]
                    descent += ti.cast(padded_blocks.dot(p, self.sum[i], self.dim), self.wide)
                    curvature += ti.cast(padded_blocks.dot(p, self.product.sum[i], self.dim), self.wide)
            self.part[c].descent = descent
            self.part[c].curvature = curvature

    @ti.func
    def _descend(self, c):
        """Step along part c of p, and its residual."""
        b = self.bodies.part[c].body
        if self.number[b].phase == SEARCHING:
            step = ti.cast(self.number[b].step, float)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                self.dv[i] = self.dv[i] + step * padded_blocks.cut(self.product.p[i], self.dim)
                r = self.sum[i] - step * padded_blocks.cut(self.product.sum[i], self.dim)
                if ti.static(self.holds):
                    r = self.held.along(i, r)
                self.sum[i] = r
        if ti.static(not self.levels.active):
            self._condition(c)

    @ti.func
    def _condition(self, c):
        if self.number[self.bodies.part[c].body].phase == SEARCHING:
            self._precondition(c)

    @ti.func
    def _set_out(self, c):
        """Part c of the first p. Others may be amid a search, where launches run ahead."""
        b = self.bodies.part[c].body
        if self.number[b].phase == SEARCHING and self.number[b].searches == 0.0:
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                self.product.p[i] = self._conjugate(i)

    @ti.func
    def _turn(self, c):
        """Part c of the next p."""
        b = self.bodies.part[c].body
        if self.number[b].phase == SEARCHING:
            step = ti.cast(self.number[b].step, float)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                self.product.p[i] = self._conjugate(i) + step * self.product.p[i]

    @ti.func
    def _conjugate(self, i):
        """Preconditioned residual of ball i, without what deflation has found."""
        z = self.product.sum[i]
        if ti.static(self.deflates):
            if self.deflation.acts(self.bodies.of(i)):
                z -= padded_blocks.pad(self.deflation.way(i), self.dim)
        return z
