"""StageSolver: an implicit stage on springs by Newton's method and conjugate gradients, with no matrix."""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model, incidence, phase_type
from taichi_sim.forces.springs import Springs
from taichi_sim.integrators.coarse_preconditioner import Patches
from taichi_sim.integrators.free_bodies import FreeBodies
from taichi_sim.integrators.newton_control import control
from taichi_sim.integrators.newton_decisions import MISSED, MOST_TRIES, Verdicts
from taichi_sim.integrators.newton_operators import Product, Residual
from taichi_sim.integrators.stage_gas import StageGas
from taichi_sim.integrators.stage_work import StageWork
from taichi_sim.kernels.springs import edge_blocks, padded_blocks
from taichi_sim.kernels.springs import newton_terms as parts
from taichi_sim.kernels.springs.law import GRAIN, PART

__all__ = ["StageSolver"]

ROUNDING = 1e3  # of the potential, in units of the machine's
FINEST = 8.0  # the same, of a solution
CERTAIN = 4.0  # times the square of what rounding leaves of a residual


@ti.data_oriented
class StageSolver(Verdicts):
    """Solves m (q - v) + s F(p + s v, v) = 0 for the velocities v, see kernels.implicit.

    Fields: `base` (n) with x the places p [m] and v [m/s]: the start, then the solution; `q` (n) [m/s]; `first` (n): the start.
    Without springs v is q. gases: those that act in the stage, or None.
    method: an Implicit; each of its `stages` starts with its change in the step before. `tolerance`: of the residual, in units of
    the impulses of the springs, both divided by the block diagonal of the matrix; less where the error of the method, of the
    given order, is less.
    """

    def __init__(self, model: Model, springs: Springs | None, gases: Any, fields: Fields, method: Any) -> None:
        self.model, self.springs = model, springs
        self.order, self.tolerance, stages = method.method.order, method.tolerance, method.stages
        self.n, self.dim = model.n, model.dim
        self.base = fields.table(phase_type(self.dim, fields.real), self.n)
        self.q, self.first = (fields.vectors(self.n, self.dim) for _ in range(2))
        self.number = fields.doubles(parts.SIZE)
        self.wide = self.number.dtype
        if springs is None:
            return
        scene, wide = model.scene, padded_blocks.width(self.dim)
        vector = ti.types.vector(wide, fields.real)
        self.sum, self.dv = (fields.vectors(self.n, self.dim) for _ in range(2))
        self.last = fields.vectors(self.n * stages, self.dim)
        self.ahead = fields.table({"x": vector, "v": vector}, self.n)  # where the stage ends, in rows
        self.row = fields.table({"r": vector, "along": fields.real, "across": fields.real}, springs.padded)
        self.product = Product(self, fields)
        self.residual = Residual(self)
        self.block = fields.matrices(self.n, self.dim)  # inverse of the diagonal's
        start, _, spring = incidence(scene.pairs[springs.number], self.n)
        self.start, self.own_spring = fields.integers(start), fields.integers(spring)
        self.patches = Patches(model, springs, self.row, fields)
        self.bodies = FreeBodies(model, fields)
        self.gas = None if gases is None else StageGas(gases, fields)
        self.inflated = gases is not None
        self.parts = -(-self.n // PART)
        self.one, self.two, self.three, self.four = (fields.doubles(self.parts) for _ in range(4))
        self.five = fields.doubles(self.parts)
        eps = 2.0**-52 if fields.real == ti.f64 else 2.0**-23
        self.rounding, self.finest = ROUNDING * eps, FINEST * eps
        self.work = StageWork(model, fields, self.rounding, MISSED * self.tolerance)
        self.least = max(self.tolerance**2, self.finest)
        stiff = np.bincount(scene.pairs.ravel(), np.repeat(scene.stiffness**2, 2), self.n)
        self.rough = fields.reals(eps * np.sqrt(stiff))  # N/m: what rounding of a place makes of the forces on a ball

    # Residual and matrix -------------------------------------------------------------------------------------------

    @ti.func
    def _move(self, s, step):
        """Add `step` of the change to the velocities; the residual there."""
        for i in range(self.n):
            v = self.base[i].v + step * self.dv[i]
            self.base[i].v = v
            self.ahead[i].x = padded_blocks.pad(self.base[i].x + s * v, self.dim)
            self.ahead[i].v = padded_blocks.pad(v, self.dim)
        edge_blocks.sums(self.residual, self.springs, s)
        if ti.static(self.inflated):
            self.gas.push(self.base, self.product.sum, s)

    @ti.func
    def linearise(self, s, step):
        """Add `step` of the change to the velocities; residual, matrix with its blocks and patches, and their size there."""
        self._move(s, step)
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                rr, ff = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                kinetic, noise = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                load = ti.cast(0.0, self.wide)
                for i in range(c * PART, ti.min((c + 1) * PART, self.n)):
                    r = padded_blocks.cut(self.product.sum[i], self.dim)
                    self.sum[i] = r
                    w = self.model.inverse_mass[i]
                    inverse = ti.Matrix.zero(float, self.dim, self.dim)
                    if w > 0.0:
                        inverse = self._inverse(i, w)
                        own, whole = self.q[i] - self.base[i].v, self.q[i] - self.first[i]
                        f = r - own / w
                        rr += ti.cast(r.dot(inverse @ r), self.wide)
                        ff += ti.cast(f.dot(inverse @ f), self.wide)
                        kinetic += ti.cast(ti.max(own.dot(own), whole.dot(whole)) / w, self.wide)
                        load += ti.cast(whole.dot(whole) / w, self.wide)
                        blur = s * self.rough[i] * ti.abs(self.base[i].x).max()
                        noise += ti.cast(blur * blur * inverse.trace(), self.wide)
                    self.block[i] = inverse
                self.one[c] = rr
                self.two[c] = ff
                self.three[c] = kinetic
                self.four[c] = noise
                self.five[c] = load
        ti.loop_config(serialize=True)
        for _ in range(1):
            rr, ff = self._total()
            kinetic, noise = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
            load = ti.cast(0.0, self.wide)
            for c in range(self.parts):
                kinetic += self.three[c]
                noise += self.four[c]
                load += self.five[c]
            self.number[parts.LOAD] = load
            self.number[parts.RESIDUAL] = rr
            self.number[parts.FORCE] = ff
            self.number[parts.SCALE] = ti.max(ff, kinetic)
            self.number[parts.NOISE] = CERTAIN * noise
            self.number[parts.PASSES] += 1.0
        self.work.find(self.base, self.sum, self.first, self.bodies, self.number)
        if ti.static(self.patches.active):
            self.patches.factor()

    @ti.func
    def _inverse(self, i, w):
        """Of the diagonal's block for ball i of inverse mass w; in double precision, or stiff springs in a line would make it
        indefinite."""
        across = 1.0 / ti.cast(w, self.wide)
        along = ti.Matrix.zero(self.wide, self.dim, self.dim)
        for k in range(self.start[i], self.start[i + 1]):
            row = self.row[self.own_spring[k]]
            across += ti.cast(row.across, self.wide)
            for a in ti.static(range(self.dim)):
                for b in ti.static(range(self.dim)):
                    product = ti.cast(row.r[a], self.wide) * ti.cast(row.r[b], self.wide)
                    along[a, b] += ti.cast(row.along, self.wide) * product
        if ti.static(self.inflated):
            g = ti.cast(self.gas.gradient(i), self.wide)
            along += g.outer_product(g)
        inverse = (along + across * ti.Matrix.identity(self.wide, self.dim)).inverse()
        return ti.cast(inverse, float)

    @ti.func
    def evaluate(self, s, step):
        """The same with blocks and patches as they were: they condition well enough, and the residual keeps its measure."""
        self._move(s, step)
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                rr = ti.cast(0.0, self.wide)
                for i in range(c * PART, ti.min((c + 1) * PART, self.n)):
                    r = padded_blocks.cut(self.product.sum[i], self.dim)
                    self.sum[i] = r
                    rr += ti.cast(r.dot(self.block[i] @ r), self.wide)
                self.one[c] = rr
                self.two[c] = 0.0
        ti.loop_config(serialize=True)
        for _ in range(1):
            rr, _zero = self._total()
            self.number[parts.RESIDUAL] = rr
            self.number[parts.PASSES] += 1.0
        self.work.find(self.base, self.sum, self.first, self.bodies, self.number)

    @ti.func
    def _total(self):
        rr, ff = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
        for c in range(self.parts):
            rr += self.one[c]
            ff += self.two[c]
        return rr, ff

    # Newton's rounds -----------------------------------------------------------------------------------------------

    @ti.func
    def begin(self, stage):
        """The change of the step before is the first guess of this one."""
        for i in range(self.n):
            self.first[i] = self.base[i].v
            self.dv[i] = self.last[stage * self.n + i]
        self.bodies.find_means(self.base, self.q)
        self.number[parts.ROUNDS] = 0.0
        self.number[parts.TRIES] = 0.0
        self.number[parts.MOVED] = 1e300

    @ti.func
    def compare(self, s, part):
        """The potential at the velocities and before `part` of the change was added."""
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                now, before = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                for i in range(c * PART, ti.min((c + 1) * PART, self.n)):
                    now += ti.cast(self._potential(i, s, 0.0), self.wide)
                    before += ti.cast(self._potential(i, s, part), self.wide)
                self.one[c] = now
                self.two[c] = before
        if ti.static(self.inflated):
            self.gas.compare(self.base, self.dv, s, part)
        ti.loop_config(serialize=True)
        for _ in range(1):
            now, before = self._total()
            if ti.static(self.inflated):
                now += self.gas.energy[0]
                before += self.gas.energy[1]
            raised = now > before + self.rounding * ti.abs(before)
            self.number[parts.RAISED] = ti.select(raised, 1.0, 0.0)
            self.number[parts.TRIES] = ti.select(raised, self.number[parts.TRIES] + 1.0, MOST_TRIES)
            self.number[parts.PASSES] += 2.0

    @ti.func
    def _potential(self, i, s, part):
        """Of ball i and the springs that list it first, with `part` of the change taken back."""
        v = self.base[i].v - part * self.dv[i]
        x = self.base[i].x + s * v
        w = self.model.inverse_mass[i]
        m = ti.select(w > 0.0, 1.0 / ti.select(w > 0.0, w, 1.0), 0.0)
        phi = 0.5 * m * (self.q[i] - v).norm_sqr()
        for e in range(self.springs.start[i], self.springs.start[i + 1]):
            spring = self.springs.spring[e]
            u = self.base[spring.other].v - part * self.dv[spring.other]
            phi += parts.potential(self.base[spring.other].x + s * u - x, u - v, spring, s, self.springs.damped)
        return phi

    @ti.func
    def aim(self):
        """Start the conjugate gradients of a round."""
        if ti.static(self.patches.active):
            self.patches.solve(self.sum)
        for i in range(self.n):
            self.dv[i] = ti.Vector.zero(float, self.dim)
            p = self.block[i] @ self.sum[i]
            if ti.static(self.patches.active):
                p += self.patches.shift(i)
            self.product.p[i] = padded_blocks.pad(p, self.dim)
        self.number[parts.LEFT] = self.number[parts.RESIDUAL]
        self.number[parts.EARLIER] = self.number[parts.MOVED]
        self.number[parts.MOVED] = 0.0
        ti.loop_config(serialize=True)
        for _ in range(1):
            rz = self.number[parts.RESIDUAL]
            if ti.static(self.patches.active):
                rz += self.patches.product()
            self.number[parts.RZ] = rz
        self.number[parts.ROUNDS] += 1.0
        self.number[parts.TURNS] = 0.0
        self.number[parts.TRIES] = 0.0

    @ti.func
    def turn(self):
        """The best change along p; the next p conjugate to it."""
        edge_blocks.sums(self.product, self.springs, 0.0)
        if ti.static(self.inflated):
            self.gas.multiply(self.product.p, self.product.sum)
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                pr, py = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                for i in range(c * PART, ti.min((c + 1) * PART, self.n)):
                    if self.model.inverse_mass[i] > 0.0:
                        p = self.product.p[i]
                        pr += ti.cast(padded_blocks.dot(p, self.sum[i], self.dim), self.wide)
                        py += ti.cast(padded_blocks.dot(p, self.product.sum[i], self.dim), self.wide)
                self.one[c] = pr
                self.two[c] = py
        ti.loop_config(serialize=True)
        for _ in range(1):
            pr, py = self._total()
            step = ti.select(py > 0.0, pr / ti.select(py > 0.0, py, 1.0), 0.0)
            if ti.static(
                self.inflated
            ):  # a direction of negative curvature ends the search; the first one still leads down
                if py < 0.0 and self.number[parts.TURNS] == 0.0:
                    step = -pr / py
                self.number[parts.SADDLE] = ti.select(py > 0.0, 0.0, 1.0)
            self.number[parts.STEP] = step
            self.number[parts.GAIN] = step * pr  # dv A dv grows by that
            self.number[parts.MOVED] += step * pr
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                step = ti.cast(self.number[parts.STEP], float)
                rz = ti.cast(0.0, self.wide)
                for i in range(c * PART, ti.min((c + 1) * PART, self.n)):
                    self.dv[i] = self.dv[i] + step * padded_blocks.cut(self.product.p[i], self.dim)
                    r = self.sum[i] - step * padded_blocks.cut(self.product.sum[i], self.dim)
                    z = self.block[i] @ r
                    self.sum[i] = r
                    self.product.sum[i] = padded_blocks.pad(z, self.dim)
                    rz += ti.cast(r.dot(z), self.wide)
                self.one[c] = rz
                self.two[c] = 0.0
        if ti.static(self.patches.active):
            self.patches.solve(self.sum)
        ti.loop_config(serialize=True)
        for _ in range(1):
            rz, _zero = self._total()
            if ti.static(self.patches.active):
                rz += self.patches.product()
            if ti.static(self.inflated):
                rz = ti.select(self.number[parts.SADDLE] > 0.0, 0.0 * rz, rz)
            before = self.number[parts.RZ]
            self.number[parts.STEP] = ti.select(before > 0.0, rz / ti.select(before > 0.0, before, 1.0), 0.0)
            self.number[parts.RZ] = rz
            self.number[parts.TURNS] += 1.0
            self.number[parts.PASSES] += 1.0
        for i in range(self.n):
            z = self.product.sum[i]
            if ti.static(self.patches.active):
                z += padded_blocks.pad(self.patches.shift(i), self.dim)
            self.product.p[i] = z + ti.cast(self.number[parts.STEP], float) * self.product.p[i]

    @ti.func
    def end(self, stage):
        """Give free bodies the momentum that they should have; note the change of this stage, and how well it was solved."""
        self.bodies.share(self.base, self.q)
        for i in range(self.n):
            self.last[stage * self.n + i] = self.base[i].v - self.first[i]
        self.judge()

    solve = ti.func(control)
