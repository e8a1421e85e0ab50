"""StageSolver: an implicit stage on springs and elements by Newton's method and conjugate gradients, with no matrix."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model, incidence, phase_type
from taichi_sim.forces.springs import Springs
from taichi_sim.integrators.coarse_preconditioner import Aggregates
from taichi_sim.integrators.free_bodies import FreeBodies, StageWork
from taichi_sim.integrators.implicit_elements import StageElements
from taichi_sim.integrators.implicit_gas import StageGas
from taichi_sim.integrators.newton_decisions import (
    DOUBTFUL,
    FOUND,
    MISSED_TOLERANCES,
    MOST_TRIES,
    NUMBERS,
    READY,
    SEARCHING,
    SLOW_MODES_PART,
    Verdicts,
    solve_stage,
)
from taichi_sim.integrators.newton_operators import Product, Residual
from taichi_sim.kernels import reductions
from taichi_sim.kernels.reductions import each_part, groups_of, join, member, members, parts_of, total
from taichi_sim.kernels.springs import edge_blocks, newton_terms, padded_blocks

__all__ = ["StageSolver"]

POTENTIAL_ROUNDING = 1e3  # in units of the machine's
FINEST_SOLUTION = 8.0  # the same
CERTAIN_NOISE = 4.0  # times the square of what rounding leaves of a residual
SUMS = ("residual", "force", "kinetic", "noise", "load", "potential", "potential_before", "descent", "curvature")


@ti.data_oriented
class StageSolver(Verdicts):
    """Solves m (q - v) + s F(p + s v, v) = 0 for the velocities v, see kernels.springs.newton_terms.

    Fields: `base` (n) with x the places p [m] and v [m/s]: the start, then the solution; `q` (n) [m/s]; `first` (n): the start.
    Without springs and elements v is q. gases, elements: those that act in the stage; elements give their derivatives.
    method: an Implicit; each of its `stages` starts with its change in the step before. `tolerance`: of the residual, in units of
    the impulses of the springs, both divided by the block diagonal of the matrix; less where the error of the method, of the
    given order, is less.
    """

    solve = ti.func(solve_stage)

    def __init__(self, model: Model, springs: Springs | None, gases: Any, elements: Sequence[Any],
                 fields: Fields, method: Any) -> None:  # fmt: skip
        self.model, self.springs = model, springs
        self.order, self.tolerance, stages = method.method.order, method.tolerance, method.stages
        self.n, self.dim = model.n, model.dim
        self.base = fields.table(phase_type(self.dim, fields.real), self.n)
        self.q, self.first = (fields.vectors(self.n, self.dim) for _ in range(2))
        self.wide, self.gated = fields.wide, reductions.on_device()
        self.number = fields.table(dict.fromkeys(NUMBERS, self.wide), 1)
        self.active = springs is not None or len(elements) > 0
        if not self.active:
            return
        self.has_springs, self.has_elements = springs is not None, len(elements) > 0
        self.elements = StageElements(elements, self.n, self.dim, fields) if elements else None
        ties = self.elements.ties if self.elements is not None else np.zeros((0, 2), dtype=np.int64)
        scene, width = model.scene, padded_blocks.width(self.dim)
        self.sum, self.dv = (fields.vectors(self.n, self.dim) for _ in range(2))
        self.last = fields.vectors(self.n * stages, self.dim)
        self.ahead = fields.table(phase_type(width, fields.real), self.n)  # where the stage ends, padded
        vector = ti.types.vector(width, fields.real)
        block = {"r": vector, "along": fields.real, "across": fields.real}
        self.spring_block = fields.table(block, 0 if springs is None else springs.entries)
        self.product = Product(self, fields)
        self.residual = Residual(self)
        self.inverse_block = fields.matrices(self.n, self.dim)  # of the diagonal
        pairs = scene.pairs if springs is None else scene.pairs[springs.number]
        start, _, spring = incidence(pairs, self.n)
        self.start, self.own_spring = fields.integers(start), fields.integers(spring)
        self.aggregates = Aggregates(model, springs, self.spring_block, self.elements, fields)
        self.slow = self.aggregates.missing
        self.asked = self.tolerance * (SLOW_MODES_PART if self.slow else 1.0)
        self.bodies = FreeBodies(model, ties, fields)
        self.gas = None if gases is None else StageGas(gases, fields)
        self.inflated = gases is not None
        self.parts = parts_of(self.n)
        self.part = fields.table(dict.fromkeys(SUMS, self.wide), self.parts + groups_of(self.parts))
        eps = 2.0**-52 if fields.real == ti.f64 else 2.0**-23
        self.rounding, self.finest = POTENTIAL_ROUNDING * eps, FINEST_SOLUTION * eps
        self.work = StageWork(model, ties, fields, self.rounding, MISSED_TOLERANCES * self.tolerance)
        self.least = max(self.tolerance**2, self.finest)
        self.eps = eps
        stiff = np.bincount(scene.pairs.ravel(), np.repeat(scene.stiffness**2, 2), self.n)
        self.rough = fields.reals(eps * np.sqrt(stiff))  # N/m: what rounding of a place makes of the forces on a ball

    @ti.func
    def mass(self, i):
        """Mass of ball i [kg]; 0 where it is pinned."""
        w = self.model.inverse_mass[i]
        return ti.select(w > 0.0, 1.0 / ti.select(w > 0.0, w, 1.0), 0.0)

    @ti.func
    def _sum(self, column: ti.template()):
        """Sum of a column over all parts, joined before."""
        return total(column, self.parts)

    # Residual and matrix

    @ti.func
    def _move(self, s, step, gated: ti.template()):
        """Add `step` of the change to the velocities; the residual there. gated: only where the change is found."""
        for i in range(self.n):
            v = self.base[i].v
            if not gated or self.in_phase(FOUND):
                v += step * self.dv[i]
                self.base[i].v = v
            self.ahead[i].x = padded_blocks.pad(self.base[i].x + s * v, self.dim)
            self.ahead[i].v = padded_blocks.pad(v, self.dim)
        self._sum_springs(self.residual, s)
        if ti.static(self.inflated):
            self.gas.push(self.base, self.product.sum, s)
        if ti.static(self.has_elements):
            self.elements.push(self.base, self.product.sum, s)

    @ti.func
    def _sum_springs(self, total: ti.template(), s):
        """total.sum (n) = own terms and those of springs."""
        if ti.static(self.has_springs):
            edge_blocks.sums(total, self.springs, s)
        else:
            for i in range(self.n):
                total.sum[i] = total.own(i)

    @ti.func
    def linearise(self, s, step):
        """Add `step` of the change to the velocities; residual, matrix with its blocks and aggregates, and their size there."""
        self._move(s, step, False)
        each_part(self.parts, self._measure, (s,))
        join((self.part.residual, self.part.force, self.part.kinetic, self.part.noise, self.part.load), self.parts)
        ti.loop_config(serialize=True)
        for _ in range(1):
            force = self._sum(self.part.force)
            self.number[0].residual = self._sum(self.part.residual)
            self.number[0].force = force
            self.number[0].scale = ti.max(force, self._sum(self.part.kinetic))
            self.number[0].noise = CERTAIN_NOISE * self._sum(self.part.noise)
            self.number[0].load = self._sum(self.part.load)
            self.number[0].passes += 1.0
        self.work.find(self.base, self.sum, self.first, self.bodies, self.number)
        if ti.static(self.aggregates.active):
            self.aggregates.factor()

    @ti.func
    def judge_guess(self, s, step):
        """Check a guess that is in doubt: add `step` of it, -1, if that lowers the potential; then go on from there."""
        self.compare(s, 1.0)
        withdrawn = 0.0 * step
        if self.in_phase(DOUBTFUL):
            if self.raised() == 1:
                withdrawn = step
        self.linearise(s, withdrawn)
        if self.in_phase(DOUBTFUL):
            self.accept_guess()

    @ti.func
    def _measure(self, c, s):
        """Part c of the residual and of the inverse blocks, and what they sum up to."""
        residual = force = kinetic = noise = load = ti.cast(0.0, self.wide)
        for k in range(members(c, self.parts, self.n)):
            i = member(c, k, self.parts)
            r = padded_blocks.cut(self.product.sum[i], self.dim)
            self.sum[i] = r
            w = self.model.inverse_mass[i]
            inverse = ti.Matrix.zero(float, self.dim, self.dim)
            if w > 0.0:
                block = ti.Matrix.zero(float, self.dim, self.dim)
                if ti.static(self.has_elements):
                    block = self.elements.block(i)
                inverse = self._inverse(i, w, block)
                own, whole = self.q[i] - self.base[i].v, self.q[i] - self.first[i]
                f = r - own / w
                residual += ti.cast(r.dot(inverse @ r), self.wide)
                force += ti.cast(f.dot(inverse @ f), self.wide)
                kinetic += ti.cast(ti.max(own.dot(own), whole.dot(whole)) / w, self.wide)
                load += ti.cast(whole.dot(whole) / w, self.wide)
                blur = (s * self.rough[i] + self.eps * block.trace() / s) * ti.abs(self.base[i].x).max()
                noise += ti.cast(blur * blur * inverse.trace(), self.wide)
            self.inverse_block[i] = inverse
        self.part[c].residual = residual
        self.part[c].force = force
        self.part[c].kinetic = kinetic
        self.part[c].noise = noise
        self.part[c].load = load

    @ti.func
    def _inverse(self, i, w, of_elements):
        """Inverse of the diagonal's block for ball i of inverse mass w, with what elements have of it; in double precision, or
        stiff springs in a line would make it indefinite."""
        across = 1.0 / ti.cast(w, self.wide)
        along = ti.cast(of_elements, self.wide)
        for k in range(self.start[i], self.start[i + 1]):
            block = self.spring_block[self.own_spring[k]]
            across += ti.cast(block.across, self.wide)
            for a in ti.static(range(self.dim)):
                for b in ti.static(range(self.dim)):
                    product = ti.cast(block.r[a], self.wide) * ti.cast(block.r[b], self.wide)
                    along[a, b] += ti.cast(block.along, self.wide) * product
        if ti.static(self.inflated):
            g = ti.cast(self.gas.gradient(i), self.wide)
            along += g.outer_product(g)
        inverse = (along + across * ti.Matrix.identity(self.wide, self.dim)).inverse()
        return ti.cast(inverse, float)

    @ti.func
    def evaluate(self, s, step):
        """Add `step` of the change to the velocities and recompute the residual only. Blocks and aggregates stay as they were:
        they condition well enough, and the residual keeps its measure."""
        self._move(s, step, ti.static(self.gated))
        each_part(self.parts, self._measure_residual, ())
        join((self.part.residual,), self.parts)
        ti.loop_config(serialize=True)
        for _ in range(1):
            if self.in_phase(FOUND):
                self.number[0].residual = self._sum(self.part.residual)
                self.number[0].passes += 1.0
        self.work.find(self.base, self.sum, self.first, self.bodies, self.number)

    @ti.func
    def take_back(self, s, step):
        """Add `step` of the change, a negative part, if the change raised the potential, and evaluate that."""
        self.evaluate(s, ti.select(self.raised() == 1, step, 0.0 * step))

    @ti.func
    def _measure_residual(self, c):
        residual = ti.cast(0.0, self.wide)
        for k in range(members(c, self.parts, self.n)):
            i = member(c, k, self.parts)
            r = padded_blocks.cut(self.product.sum[i], self.dim)
            if self.in_phase(FOUND):
                self.sum[i] = r
            residual += ti.cast(r.dot(self.inverse_block[i] @ r), self.wide)
        self.part[c].residual = residual

    @ti.func
    def compare(self, s, part):
        """The potential at the velocities and before `part` of the change was added."""
        if ti.static(self.has_elements):
            self.elements.take_back(self.base, self.dv, s, part)
        each_part(self.parts, self._sum_potentials, (s, part))
        join((self.part.potential, self.part.potential_before), self.parts)
        if ti.static(self.inflated):
            self.gas.compare(self.base, self.dv, s, part)
        ti.loop_config(serialize=True)
        for _ in range(1):
            now, before = self._sum(self.part.potential), self._sum(self.part.potential_before)
            if ti.static(self.inflated):
                now += self.gas.energy[0]
                before += self.gas.energy[1]
            raised = now > before + self.rounding * ti.abs(before)
            self.number[0].raised = ti.select(raised, 1.0, 0.0)
            self.number[0].tries = ti.select(raised, self.number[0].tries + 1.0, MOST_TRIES)
            self.number[0].passes += 2.0

    @ti.func
    def _sum_potentials(self, c, s, part):
        now = before = ti.cast(0.0, self.wide)
        for k in range(members(c, self.parts, self.n)):
            i = member(c, k, self.parts)
            now += ti.cast(self._potential(i, s, 0.0), self.wide)
            before += ti.cast(self._potential(i, s, part), self.wide)
            if ti.static(self.has_elements):
                now += self.elements.potential(self.elements.there, i, s)
                before += self.elements.potential(self.elements.back, i, s)
        self.part[c].potential = now
        self.part[c].potential_before = before

    @ti.func
    def _potential(self, i, s, part):
        """Potential of ball i and the springs that list it first, with `part` of the change taken back."""
        v = self.base[i].v - part * self.dv[i]
        x = self.base[i].x + s * v
        phi = 0.5 * self.mass(i) * (self.q[i] - v).norm_sqr()
        if ti.static(self.has_springs):
            for e in range(self.springs.start[i], self.springs.start[i + 1]):
                spring = self.springs.spring[e]
                u = self.base[spring.other].v - part * self.dv[spring.other]
                r = self.base[spring.other].x + s * u - x
                phi += newton_terms.potential(r, u - v, spring, s, self.springs.damped)
        return phi

    # Newton's iterations

    @ti.func
    def begin(self, stage):
        """The change of the step before is the first guess of this one."""
        for i in range(self.n):
            self.first[i] = self.base[i].v
            self.dv[i] = self.last[stage * self.n + i]
        self.bodies.find_means(self.base, self.q)
        self.number[0].iterations = 0.0
        self.number[0].tries = 0.0
        self.number[0].moved = 1e300

    @ti.func
    def start_search(self):
        """Start the conjugate gradients of an iteration."""
        if ti.static(self.aggregates.active):
            self.aggregates.solve(self.sum)
        for i in range(self.n):
            if self.in_phase(READY):
                self.dv[i] = ti.Vector.zero(float, self.dim)
                p = self.inverse_block[i] @ self.sum[i]
                if ti.static(self.aggregates.active):
                    p += self.aggregates.shift(i)
                self.product.p[i] = padded_blocks.pad(p, self.dim)
        ti.loop_config(serialize=True)
        for _ in range(1):
            if self.in_phase(READY):
                self._count_iteration()
                if ti.static(self.gated):
                    self.next_search()

    @ti.func
    def _count_iteration(self):
        """The numbers with which an iteration starts."""
        rz = self.number[0].residual
        self.number[0].residual_before = rz
        self.number[0].moved_before = self.number[0].moved
        self.number[0].moved = 0.0
        if ti.static(self.aggregates.active):
            rz += self.aggregates.product()
        self.number[0].rz = rz
        self.number[0].iterations += 1.0
        self.number[0].searches = 0.0
        self.number[0].tries = 0.0

    @ti.func
    def search(self):
        """The best change along p; the next p conjugate to it."""
        self._sum_springs(self.product, 0.0)
        if ti.static(self.inflated):
            self.gas.multiply(self.product.p, self.product.sum)
        if ti.static(self.has_elements):
            self.elements.multiply(self.product.p, self.product.sum)
        each_part(self.parts, self._project, ())
        join((self.part.descent, self.part.curvature), self.parts)
        ti.loop_config(serialize=True)
        for _ in range(1):
            descent, curvature = self._sum(self.part.descent), self._sum(self.part.curvature)
            step = ti.select(curvature > 0.0, descent / ti.select(curvature > 0.0, curvature, 1.0), 0.0)
            if ti.static(self.inflated):
                # a direction of negative curvature ends the search; the first one still leads down
                if curvature < 0.0 and self.number[0].searches == 0.0:
                    step = -descent / curvature
                self.number[0].saddle = ti.select(curvature > 0.0, 0.0, 1.0)
            if self.in_phase(SEARCHING):
                self.number[0].step = step
                self.add_gain(step * descent)  # dv A dv grows by that
                self.number[0].moved += step * descent
        each_part(self.parts, self._descend, ())
        join((self.part.residual,), self.parts)
        if ti.static(self.aggregates.active):
            self.aggregates.solve(self.sum)
        ti.loop_config(serialize=True)
        for _ in range(1):
            if self.in_phase(SEARCHING):
                self._count_search()
                if ti.static(self.gated):
                    self.next_search()
        for i in range(self.n):
            if self.in_phase(SEARCHING):
                z = self.product.sum[i]
                if ti.static(self.aggregates.active):
                    z += padded_blocks.pad(self.aggregates.shift(i), self.dim)
                self.product.p[i] = z + ti.cast(self.number[0].step, float) * self.product.p[i]

    @ti.func
    def _count_search(self):
        """The numbers after a step along p."""
        rz, before = self._sum(self.part.residual), self.number[0].rz
        if ti.static(self.aggregates.active):
            rz += self.aggregates.product()
        if ti.static(self.inflated):
            rz = ti.select(self.number[0].saddle > 0.0, 0.0 * rz, rz)
        self.number[0].step = ti.select(before > 0.0, rz / ti.select(before > 0.0, before, 1.0), 0.0)
        self.number[0].rz = rz
        self.number[0].searches += 1.0
        self.number[0].passes += 1.0

    @ti.func
    def _project(self, c):
        """Part c of p . r and p . A p."""
        descent = curvature = ti.cast(0.0, self.wide)
        for k in range(members(c, self.parts, self.n)):
            i = member(c, k, self.parts)
            if self.model.inverse_mass[i] > 0.0:
                p = self.product.p[i]
                descent += ti.cast(padded_blocks.dot(p, self.sum[i], self.dim), self.wide)
                curvature += ti.cast(padded_blocks.dot(p, self.product.sum[i], self.dim), self.wide)
        self.part[c].descent = descent
        self.part[c].curvature = curvature

    @ti.func
    def _descend(self, c):
        """Step along part c of p; its residual r, what the blocks make of that, and their product."""
        step = ti.cast(self.number[0].step, float)
        rz = ti.cast(0.0, self.wide)
        for k in range(members(c, self.parts, self.n)):
            i = member(c, k, self.parts)
            if self.in_phase(SEARCHING):
                self.dv[i] = self.dv[i] + step * padded_blocks.cut(self.product.p[i], self.dim)
                r = self.sum[i] - step * padded_blocks.cut(self.product.sum[i], self.dim)
                z = self.inverse_block[i] @ r
                self.sum[i] = r
                self.product.sum[i] = padded_blocks.pad(z, self.dim)
                rz += ti.cast(r.dot(z), self.wide)
        self.part[c].residual = rz

    @ti.func
    def end(self, stage):
        """Give free bodies the momentum that they should have; note the change of this stage, and how well it was solved."""
        self.bodies.share(self.base, self.q)
        for i in range(self.n):
            self.last[stage * self.n + i] = self.base[i].v - self.first[i]
        self.judge()
