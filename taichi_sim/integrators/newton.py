"""StageSolver: an implicit stage on springs by Newton's method and conjugate gradients, with no matrix."""

import numpy as np
import taichi as ti

from taichi_sim.fields import Fields
from taichi_sim.forces.springs import Springs
from taichi_sim.integrators.components import FreeBodies
from taichi_sim.kernels import half, lanes
from taichi_sim.kernels import implicit as parts
from taichi_sim.kernels.springs import GRAIN
from taichi_sim.model import Model, phase_type

__all__ = ["Launched", "StageSolver"]

MOST_ROUNDS = 100  # of Newton's method
MOST_TURNS = 2000  # of conjugate gradients in a round
MOST_TRIES = 8  # halvings of a change that went too far
ROUNDING = 1e3  # of the potential, in units of the machine's
FINEST = 8.0  # the same, of a solution
FORCING = 0.1  # part of the residual that a round leaves: more would be lost to what is not linear
LOCAL = 0.05  # part of the local error that a solution may add
SHRINKING = 0.5  # squared changes of two rounds; they do not in mere rounding
CERTAIN = 4.0  # times the square of what rounding leaves of a residual
MISSED = 10.0  # tolerances; a stage that leaves more counts as not solved


def control(self, s, stage):
    """A stage, from the guess that base.v holds. The one text of two programs: compiled for one thread, where every loop runs
    inside a kernel, and in Python, where each line launches a kernel whose loops run in parallel."""
    self.begin(stage)
    self.evaluate(s, 0.0)
    while self.unsolved():
        self.aim(stage)
        while self.searching():
            self.turn()
        self.evaluate(s, 1.0)
        back = 0.5
        while self.worse():
            self.evaluate(s, -back)
            back = 0.5 * back
    self.end(stage)


@ti.data_oriented
class Product:
    """sum = A p."""

    def __init__(self, solver: "StageSolver", fields: Fields) -> None:
        self.solver, self.dim = solver, solver.dim
        self.p = fields.vectors(solver.n, self.dim)
        self.sum = fields.vectors(solver.n, self.dim)

    @ti.func
    def own(self, i):
        """The mass part; a pinned ball has none, and its p is 0."""
        w = self.solver.model.inverse_mass[i]
        return self.p[i] / ti.select(w > 0.0, w, 1.0)

    @ti.func
    def term(self, i, j, e, s):
        """Block of spring e times p."""
        row = self.solver.row[e]
        r = self.p[i] - self.p[j]
        return row.g.dot(r) * row.g + row.b * r


@ti.data_oriented
class StageSolver:
    """Solves m (q - v) + s F(p + s v, v) = 0 for the velocities v, see kernels.implicit.

    Fields: `base` (n) with x the places p [m] and v [m/s]: the guess, then the solution; `q` (n) [m/s]; `first` (n): the guess.
    `stages`: how many there are in a step; each starts along its change in the step before. Without springs v is q.
    tolerance: of the residual, in units of the impulses of the springs, both divided by the block diagonal of the matrix; less
    where the error of the method, of the given order, is less.
    """

    def __init__(
        self, model: Model, springs: Springs | None, fields: Fields, stages: int, order: int, tolerance: float
    ) -> None:
        self.model, self.springs, self.order, self.tolerance = model, springs, order, tolerance
        self.n, self.dim, self.real = model.n, model.dim, fields.real
        self.base = fields.table(phase_type(self.dim, fields.real), self.n)
        self.q, self.first = (fields.vectors(self.n, self.dim) for _ in range(2))
        self.number = fields.doubles(parts.SIZE)
        self.wide = self.number.dtype
        if springs is None:
            return
        self.atomic = springs.order == "atomic"
        self.sum, self.dv = (fields.vectors(self.n, self.dim) for _ in range(2))
        self.last = fields.vectors(self.n * stages, self.dim)
        self.block = fields.matrices(self.n, self.dim)  # of the diagonal, then its inverse
        vector = ti.types.vector(self.dim, fields.real)
        self.row = fields.table({"g": vector, "b": fields.real}, springs.padded)
        self.product = Product(self, fields)
        self.bodies = FreeBodies(model, fields)
        self.parts = -(-self.n // parts.PART)
        self.one, self.two, self.three, self.four = (fields.doubles(self.parts) for _ in range(4))
        self.five = fields.doubles(self.parts)
        self.potential = fields.reals(self.n)
        eps = 2.0**-52 if fields.real == ti.f64 else 2.0**-23
        self.rounding, self.least = ROUNDING * eps, max(tolerance**2, FINEST * eps)
        scene = model.scene
        stiff = np.bincount(scene.pairs.ravel(), np.repeat(scene.stiffness**2, 2), self.n)
        self.rough = fields.reals(eps * np.sqrt(stiff))  # N/m: what rounding of a place makes of the forces on a ball

    # Residual and matrix -------------------------------------------------------------------------------------------

    @ti.func
    def own(self, i):
        """m (q - v), and the mass part of the block; pinned balls keep still."""
        w = self.model.inverse_mass[i]
        m = ti.select(w > 0.0, 1.0 / ti.select(w > 0.0, w, 1.0), 0.0)
        self.block[i] = m * ti.Matrix.identity(float, self.dim)
        change = self.q[i] - self.base[i].v
        self.potential[i] = 0.5 * m * change.dot(change)
        return m * change

    @ti.func
    def term(self, i, j, e, s):
        """Impulse of spring e on ball i; notes its block of the matrix."""
        a, b = self.base[i], self.base[j]
        a.x += s * a.v
        b.x += s * b.v
        f, g, across, potential = parts.linearise(a, b, i, j, self.springs.spring[e], s, self.springs.damped)
        self.row[e].g = g
        self.row[e].b = across
        block = g.outer_product(g) + across * ti.Matrix.identity(float, self.dim)
        if ti.static(self.atomic):
            self.block[i] += block
            self.block[j] += block
            self.potential[i] += potential
        else:
            self.block[i] = self.block[i] + block
            self.block[j] = self.block[j] + block
            self.potential[i] = self.potential[i] + potential
        return f

    @ti.func
    def evaluate(self, s, step):
        """Add `step` of the change to the velocities; residual, matrix, their size and the potential there."""
        for i in range(self.n):
            self.base[i].v = self.base[i].v + step * self.dv[i]
        half.sums(self, self.springs, s)
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                rr, ff, phi = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                kinetic, noise = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                for i in range(c * parts.PART, ti.min((c + 1) * parts.PART, self.n)):
                    phi += ti.cast(self.potential[i], self.wide)
                    w = self.model.inverse_mass[i]
                    inverse = ti.Matrix.zero(float, self.dim, self.dim)
                    if w > 0.0:
                        inverse = self.block[i].inverse()
                        own = self.q[i] - self.base[i].v
                        f = self.sum[i] - own / w
                        rr += ti.cast(self.sum[i].dot(inverse @ self.sum[i]), self.wide)
                        ff += ti.cast(f.dot(inverse @ f), self.wide)
                        kinetic += ti.cast(own.dot(own) / w, self.wide)
                        blur = s * self.rough[i] * ti.abs(self.base[i].x).max()
                        noise += ti.cast(blur * blur * inverse.trace(), self.wide)
                    self.block[i] = inverse
                self.one[c] = rr
                self.two[c] = ff
                self.three[c] = phi
                self.four[c] = kinetic
                self.five[c] = noise
        ti.loop_config(serialize=True)
        for _ in range(1):
            rr, ff = self._total()
            self.number[parts.RESIDUAL] = rr
            self.number[parts.FORCE] = ff
            phi, kinetic, noise = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
            for c in range(self.parts):
                phi += self.three[c]
                kinetic += self.four[c]
                noise += self.five[c]
            self.number[parts.NOISE] = CERTAIN * noise
            self.number[parts.POTENTIAL] = phi
            self.number[parts.SCALE] = ti.max(self.number[parts.SCALE], ti.max(ff, kinetic))
            self.number[parts.PASSES] += 1.0

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
        """Nothing is changed yet."""
        for i in range(self.n):
            self.first[i] = self.base[i].v
            self.dv[i] = ti.Vector.zero(float, self.dim)
        self.number[parts.ROUNDS] = 0.0
        self.number[parts.SCALE] = 0.0
        self.number[parts.TARGET] = 0.0
        self.number[parts.MOVED] = 1e300

    @ti.func
    def unsolved(self):
        """Whether another round is due: not where the residual is small, nor where the last change was, nor where the residual
        may be rounding and changes do not shrink any more."""
        target, turns = self.number[parts.TARGET], self.number[parts.TURNS] < MOST_TURNS
        large = self.number[parts.RESIDUAL] > target and self.number[parts.MOVED] > target and turns
        if self.number[parts.RESIDUAL] < self.number[parts.NOISE] and self.number[parts.ROUNDS] > 1.0:
            large = large and self.number[parts.MOVED] < SHRINKING * self.number[parts.EARLIER]
        return ti.cast(large and self.number[parts.ROUNDS] < MOST_ROUNDS, ti.i32)

    @ti.func
    def aim(self, stage):
        """Start the conjugate gradients of a round: the first along the change of the step before."""
        opening = self.number[parts.ROUNDS] == 0.0
        for i in range(self.n):
            self.dv[i] = ti.Vector.zero(float, self.dim)
            self.product.p[i] = self.last[stage * self.n + i] if opening else self.block[i] @ self.sum[i]
        self.number[parts.BEFORE] = self.number[parts.POTENTIAL]
        self.number[parts.LEFT] = self.number[parts.RESIDUAL]
        self.number[parts.EARLIER] = self.number[parts.MOVED]
        self.number[parts.MOVED] = 0.0
        self.number[parts.RZ] = self.number[parts.RESIDUAL]
        self.number[parts.ROUNDS] += 1.0
        self.number[parts.TURNS] = 0.0
        self.number[parts.TRIES] = 0.0
        self.number[parts.RESTART] = ti.select(opening, 1.0, 0.0)

    @ti.func
    def searching(self):
        """Whether another turn is due: by what the last one gained, which sees the slow modes that the residual hides."""
        goal = ti.max(FORCING**2 * self.number[parts.MOVED], 0.1 * self.number[parts.TARGET])
        turns = self.number[parts.TURNS]
        more = (self.number[parts.GAIN] > goal or turns < 2.0) and self.number[parts.RZ] > 0.0 and turns < MOST_TURNS
        return ti.cast(more, ti.i32)

    @ti.func
    def turn(self):
        """The best change along p; the next p conjugate to it."""
        if ti.static(self.springs.order == "lanes"):
            lanes.sums(self.product, self.springs, 0.0)
        else:
            half.sums(self.product, self.springs, 0.0)
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                pr, py = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                for i in range(c * parts.PART, ti.min((c + 1) * parts.PART, self.n)):
                    if self.model.inverse_mass[i] > 0.0:
                        p = self.product.p[i]
                        pr += ti.cast(p.dot(self.sum[i]), self.wide)
                        py += ti.cast(p.dot(self.product.sum[i]), self.wide)
                self.one[c] = pr
                self.two[c] = py
        ti.loop_config(serialize=True)
        for _ in range(1):
            pr, py = self._total()
            step = ti.select(py > 0.0, pr / ti.select(py > 0.0, py, 1.0), 0.0)
            self.number[parts.STEP] = step
            self.number[parts.GAIN] = step * pr  # dv A dv grows by that
            self.number[parts.MOVED] += step * pr
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                step = ti.cast(self.number[parts.STEP], float)
                rz = ti.cast(0.0, self.wide)
                for i in range(c * parts.PART, ti.min((c + 1) * parts.PART, self.n)):
                    self.dv[i] = self.dv[i] + step * self.product.p[i]
                    r = self.sum[i] - step * self.product.sum[i]
                    z = self.block[i] @ r
                    self.sum[i] = r
                    self.product.sum[i] = z
                    rz += ti.cast(r.dot(z), self.wide)
                self.one[c] = rz
                self.two[c] = 0.0
        ti.loop_config(serialize=True)
        for _ in range(1):
            rz, _zero = self._total()
            before = self.number[parts.RZ]
            fresh = self.number[parts.RESTART] > 0.0 or before <= 0.0
            self.number[parts.STEP] = ti.select(fresh, 0.0, rz / ti.select(fresh, 1.0, before))
            if self.number[parts.RESTART] > 0.0:
                self._set_target(rz)
            self.number[parts.RESTART] = 0.0
            self.number[parts.RZ] = rz
            self.number[parts.TURNS] += 1.0
            self.number[parts.PASSES] += 1.0
        for i in range(self.n):
            self.product.p[i] = self.product.sum[i] + ti.cast(self.number[parts.STEP], float) * self.product.p[i]

    @ti.func
    def _set_target(self, rz):
        """How small the residual has to become, once it is known how far the change of the step before fits this one.

        What is left then is the acceleration's change, of order h, so that this part of its `order`-th power is a part of the
        local error of the method; where a step does not resolve the motion, the tolerance it is.
        """
        ff = self.number[parts.FORCE]
        if ff > 0.0:
            part, tolerance = LOCAL * (rz / ff) ** (0.5 * self.order), ti.cast(self.tolerance, self.wide)
            self.number[parts.TARGET] = self.number[parts.SCALE] * ti.max(self.least, ti.min(part, tolerance)) ** 2

    @ti.func
    def worse(self):
        """Whether the change went too far, and half of it is worth a try: it raised the potential, and the residual too. One of
        them alone may rise: the potential by damping, whose direction turns, the residual where a stiff body turns."""
        self.number[parts.TRIES] += 1.0
        before = self.number[parts.BEFORE]
        larger = self.number[parts.POTENTIAL] > before + self.rounding * ti.abs(before)
        larger = larger and self.number[parts.RESIDUAL] > self.number[parts.LEFT]
        return ti.cast(larger and self.number[parts.TRIES] <= MOST_TRIES, ti.i32)

    @ti.func
    def end(self, stage):
        """Give free bodies the momentum that the residual lacks; note the change of this stage, and how well it was solved."""
        self.bodies.share(self.base, self.sum)
        for i in range(self.n):
            self.last[stage * self.n + i] = self.base[i].v - self.first[i]
        self.number[parts.SOLVED] += 1.0
        left, scale = ti.min(self.number[parts.RESIDUAL], self.number[parts.MOVED]), self.number[parts.SCALE]
        if scale > 0.0:
            left = ti.sqrt(left / scale)
            self.number[parts.WORST] = ti.max(self.number[parts.WORST], left)
            if left > MISSED * self.tolerance:
                self.number[parts.MISSES] += 1.0

    solve = ti.func(control)


@ti.data_oriented
class Launched:
    """The same from the host: each part a kernel of its own."""

    solve = control

    def __init__(self, solver: StageSolver) -> None:
        self.solver = solver

    @ti.kernel
    def begin(self, stage: int):
        """See StageSolver."""
        self.solver.begin(stage)

    @ti.kernel
    def evaluate(self, s: float, step: float):
        """See StageSolver."""
        self.solver.evaluate(s, step)

    @ti.kernel
    def unsolved(self) -> int:
        """See StageSolver."""
        return self.solver.unsolved()

    @ti.kernel
    def aim(self, stage: int):
        """See StageSolver."""
        self.solver.aim(stage)

    @ti.kernel
    def searching(self) -> int:
        """See StageSolver."""
        return self.solver.searching()

    @ti.kernel
    def turn(self):
        """See StageSolver."""
        self.solver.turn()

    @ti.kernel
    def worse(self) -> int:
        """See StageSolver."""
        return self.solver.worse()

    @ti.kernel
    def end(self, stage: int):
        """See StageSolver."""
        self.solver.end(stage)
