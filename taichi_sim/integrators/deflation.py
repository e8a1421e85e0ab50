"""Deflation: conjugate gradients that leave a body no momentum which it lacks.

How a body moves as a whole is its softest motion where surfaces hold some of its balls, so that conjugate gradients find it last.
A sheet that folds over a sphere took most of its iterations for that alone. With the columns of T, by which all balls go along an
axis as far as surfaces leave them free, a search starts from r - A T G^-1 T^T r, G = T^T A T, and each of its directions p loses
T G^-1 (A T)^T p. Then T^T r, the momentum that is left, stays 0 (Nicolaides, 1987; Saad, Yeung, Erhel and Guyomarc'h, 2000).
"""

from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.springs import padded_blocks

__all__ = ["Deflation"]

LEAST_PART = 64.0  # of the trace of G, in units of the machine's rounding, that is added to its diagonal


@ti.data_oriented
class Deflation:
    """Deflation of the free bodies of a StageSolver, of those whose searches are `heavy`.

    Fields: `carried` (n) [kg]: A T of each ball. `own` (bodies): G^-1, 0 of those that are not deflated, and the `way`, the
    multiple of T that is due. `part`: sums over parts of bodies.
    """

    def __init__(self, solver: Any, fields: Fields) -> None:
        self.solver, self.bodies, self.dim, self.wide = solver, solver.bodies, solver.dim, fields.wide
        square, line = ti.types.matrix(self.dim, self.dim, fields.wide), ti.types.vector(self.dim, fields.wide)
        self.carried = fields.matrices(solver.n, self.dim)
        self.part = solver.bodies.columns({"gram": square, "sum": line})
        self.own = fields.table({"inverse": square, "way": line}, solver.bodies.count)
        # where all balls are held along the same normal, G is 0 along it but for rounding
        self.least = LEAST_PART * (2.0**-52 if fields.real == ti.f64 else 2.0**-23)

    @ti.func
    def forget(self, b):
        """Deflate body b no more."""
        self.own[b].inverse = ti.Matrix.zero(self.wide, self.dim, self.dim)
        self.own[b].way = ti.Vector.zero(self.wide, self.dim)

    @ti.func
    def acts(self, b):
        """True if body b is deflated: only then are its sums worth their time."""
        return self.own[b].inverse[0, 0] > 0.0

    @ti.func
    def find(self):
        """Find A T and G of heavy bodies, and take out of their residuals what T reaches. Others may be amid a search."""
        for axis in ti.static(range(self.dim)):
            for i in range(self.solver.n):
                if self.solver.heavy(self.bodies.of(i)):
                    column = self._along(i, ti.Vector.unit(self.dim, axis, float))
                    self.solver.product.p[i] = padded_blocks.pad(column, self.dim)
            self.solver.multiply()
            for i in range(self.solver.n):
                if self.solver.heavy(self.bodies.of(i)):
                    r = self._along(i, padded_blocks.cut(self.solver.product.sum[i], self.dim))
                    for a in ti.static(range(self.dim)):
                        self.carried[i][a, axis] = r[a]
        self.bodies.each_part(self._sum, ())
        self.bodies.join((self.part.gram, self.part.sum))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.solver.heavy(b):
                gram, left = self.bodies.total(self.part.gram, b), self.bodies.total(self.part.sum, b)
                gram += self.least * gram.trace() * ti.Matrix.identity(self.wide, self.dim)
                self.own[b].inverse = gram.inverse()
                self.own[b].way = self.own[b].inverse @ left
                self.solver.number[b].shifted = self.own[b].way.dot(left)
                self.solver.number[b].passes += ti.static(float(self.dim))
        for i in range(self.solver.n):
            b = self.bodies.of(i)
            if self.solver.heavy(b):
                self.solver.sum[i] = self.solver.sum[i] - self.carried[i] @ ti.cast(self.own[b].way, float)

    @ti.func
    def _sum(self, c):
        """Part c of G, and of what is left of its body's momentum."""
        if self.solver.heavy(self.bodies.part[c].body):
            gram, left = ti.Matrix.zero(self.wide, self.dim, self.dim), ti.Vector.zero(self.wide, self.dim)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                if self.solver.model.inverse_mass[i] > 0.0:
                    gram += ti.cast(self.carried[i], self.wide)
                    left += ti.cast(self.solver.sum[i], self.wide)
            self.part[c].gram, self.part[c].sum = gram, left

    @ti.func
    def _along(self, i, u):
        """The part of the vector u that ball i is free to take."""
        free = ti.Vector.zero(float, self.dim)
        if self.solver.model.inverse_mass[i] > 0.0:
            free = self.solver.held.along(i, u)
        return free

    @ti.func
    def reach(self, i, z):
        """The part of (A T)^T z that ball i has."""
        return ti.cast(self.carried[i].transpose() @ z, self.wide)

    @ti.func
    def aim(self, b):
        """The way of body b, from the joined sums of `reach`."""
        self.own[b].way = self.own[b].inverse @ self.bodies.total(self.part.sum, b)

    @ti.func
    def way(self, i):
        """The way of ball i, by that of its body [m/s]."""
        return self._along(i, ti.cast(self.own[self.bodies.of(i)].way, float))
