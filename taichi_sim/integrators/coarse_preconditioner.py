"""Aggregates: the coarse part of the preconditioner of conjugate gradients.

A block of the diagonal sees a ball and its neighbours, so what moves many balls together takes as many iterations as there are
balls across. Aggregates of neighbouring balls that move as wholes see just that: z = D^-1 r + P (P^T A P)^-1 P^T r, P from the
movement of aggregates to that of balls. Their matrix is small and solved directly; springs within an aggregate drop out of it.
Elements that do not tell what joins their corners enter by a bound for it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import on_device as on_gpu
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.springs import Springs
from taichi_sim.kernels.loops import list_entry
from taichi_sim.kernels.reductions import each_part

__all__ = ["Aggregates", "bisected"]

FEWEST_BALLS = 32  # free ones, for which aggregates pay
FACTOR_COST = 8.0  # cube of the number of aggregates over that of balls: factors then cost about an iteration


def bisected(x: NDArray[np.float64], parts: int) -> NDArray[np.int64]:
    """A part, of `parts`, a power of two, for each of the points x (n, dim): boxes halved across their longest side."""
    part, n = np.zeros(len(x), dtype=np.int64), len(x)
    for _ in range(parts.bit_length() - 1):
        count = np.bincount(part)
        first = np.cumsum(count) - count
        grouped = np.argsort(part, kind="stable")
        side = np.maximum.reduceat(x[grouped], first) - np.minimum.reduceat(x[grouped], first)
        along = x[np.arange(n), side.argmax(axis=1)[part]]
        rank = np.empty(n, dtype=np.int64)
        rank[np.lexsort((along, part))] = np.arange(n)
        part = 2 * part + (rank - first[part] >= (count[part] + 1) // 2)
    return part


@ti.data_oriented
class Aggregates:
    """Aggregates of a scene's free balls. `spring_block`: of each spring, see kernels.springs.newton_terms. elements: a
    StageElements, or None."""

    def __init__(
        self, model: Model, springs: Springs | None, spring_block: ti.StructField, elements: Any, fields: Fields
    ) -> None:
        scene, self.elements, self.has_elements = model.scene, elements, elements is not None
        self.spring_block, self.dim = spring_block, model.dim
        free = np.flatnonzero(~scene.pinned)
        # one thread of a GPU is slow
        on_device = on_gpu() if springs is None else springs.order in ("atomic", "ends")
        pay = len(free) >= FEWEST_BALLS
        self.active, self.missing = pay and not on_device, pay and on_device
        if not self.active:
            return
        self.count = 1 << int(np.log2(np.cbrt(FACTOR_COST * len(free))))
        own = bisected(scene.position[free], self.count)
        aggregate = np.full(model.n, -1)
        aggregate[free] = own
        self.aggregate = fields.integers(aggregate)
        self.member = fields.integers(free[np.argsort(own, kind="stable")])
        mass = np.bincount(own, scene.mass[free], self.count)
        self.mass, self.least = fields.reals(mass), fields.reals(mass.min(keepdims=True))
        self.begin = fields.integers(np.append(0, np.cumsum(np.bincount(own, minlength=self.count))))
        ends = aggregate[scene.pairs if springs is None else scene.pairs[springs.number]]
        slots = np.flatnonzero(ends[:, 0] != ends[:, 1])
        here, there = ends[slots].ravel(), ends[slots][:, ::-1].ravel()
        order = np.lexsort((np.repeat(slots, 2), there, here))
        order = order[here[order] >= 0]
        self.link = fields.table(
            {"spring": ti.i32, "other": ti.i32},
            len(order),
            {"spring": np.repeat(slots, 2)[order], "other": there[order]},
        )
        self.first = fields.integers(np.append(0, np.cumsum(np.bincount(here[order], minlength=self.count))))
        self.size = self.count * self.dim
        self.matrix = fields.doubles(self.size**2)  # its lower factor, rows one after another
        self.load, self.answer = fields.doubles(self.size), fields.doubles(self.size)
        self.wide = fields.wide

    @ti.func
    def factor(self):
        """The matrix of the springs as they are, and its Cholesky factor."""
        size = ti.static(self.size)
        each_part(self.count, self._assemble, ())
        ti.loop_config(serialize=True)
        for j in range(size):
            for i in range(j, size):
                total = self.matrix[i * size + j]
                for q in range(j):
                    total -= self.matrix[i * size + q] * self.matrix[j * size + q]
                if i == j:
                    # what is added to the masses is positive semidefinite: less than the least is rounding
                    self.matrix[j * size + j] = ti.sqrt(ti.max(total, self.least[0]))
                else:
                    self.matrix[i * size + j] = total / self.matrix[j * size + j]

    @ti.func
    def _assemble(self, c):
        """The rows of aggregate c."""
        size, dim = ti.static(self.size, self.dim)
        for e in range(c * dim * size, (c + 1) * dim * size):
            self.matrix[e] = 0.0
        own = ti.cast(self.mass[c], self.wide) * ti.Matrix.identity(self.wide, dim)
        if ti.static(self.has_elements):
            for one in ti.static(self.elements.elements):
                for e in range(self.begin[c], self.begin[c + 1]):
                    own += self._assemble_element(one, c, self.member[e])
        for e in range(self.first[c], self.first[c + 1]):
            link = self.link[e]
            block = self.spring_block[link.spring]
            for a in ti.static(range(dim)):
                for b in ti.static(range(dim)):
                    value = ti.cast(block.r[a], self.wide) * ti.cast(block.r[b], self.wide)
                    value *= ti.cast(block.along, self.wide)
                    if ti.static(a == b):
                        value += ti.cast(block.across, self.wide)
                    own[a, b] += value
                    if link.other >= 0:
                        at = (c * dim + a) * size + link.other * dim + b
                        self.matrix[at] = self.matrix[at] - value
        for a in ti.static(range(dim)):
            for b in ti.static(range(dim)):
                self.matrix[(c * dim + a) * size + c * dim + b] = own[a, b]

    @ti.func
    def _assemble_element(self, one: ti.template(), c, i):
        """Add what the elements of a kind at ball i of aggregate c join to others; returns what they add to its own block."""
        size, dim = ti.static(self.size, self.dim)
        s = self.elements.step[0]
        own = ti.Matrix.zero(self.wide, dim, dim)
        for k in range(one.start[i + 1] - one.start[i]):
            e = list_entry(one, i, k)
            row = one.row[e]
            for t in ti.static(range(len(one.corner_names))):
                d = self.aggregate[getattr(row, one.corner_names[t])]
                if d != c and one.is_whole(e):
                    if ti.static(one.couples):
                        block = ti.cast(one.corner_coupling(self.elements.there, i, row, t, s), self.wide)
                        own -= block
                        if d >= 0:
                            for a, b in ti.static(ti.ndrange(dim, dim)):
                                at = (c * dim + a) * size + d * dim + b
                                self.matrix[at] = self.matrix[at] + block[a, b]
                    else:
                        own += ti.cast(one.corner_block(self.elements.there, i, row, s), self.wide) * float(
                            len(one.corner_names)
                        )
        return own

    @ti.func
    def solve(self, residual: ti.template()):
        """Solve the coarse system of the aggregates for a residual (n); its scalar product with the solution is `product`."""
        size = ti.static(self.size)
        each_part(self.count, self._restrict, (residual,))
        ti.loop_config(serialize=True)
        for i in range(size):
            total = self.load[i]
            for q in range(i):
                total -= self.matrix[i * size + q] * self.answer[q]
            self.answer[i] = total / self.matrix[i * size + i]
        ti.loop_config(serialize=True)
        for k in range(size):
            i = size - 1 - k
            total = self.answer[i]
            for q in range(i + 1, size):
                total -= self.matrix[q * size + i] * self.answer[q]
            self.answer[i] = total / self.matrix[i * size + i]

    @ti.func
    def _restrict(self, c, residual: ti.template()):
        dim = ti.static(self.dim)
        total = ti.Vector.zero(float, dim)
        for e in range(self.begin[c], self.begin[c + 1]):
            total += residual[self.member[e]]
        for a in ti.static(range(dim)):
            self.load[c * dim + a] = ti.cast(total[a], self.wide)

    @ti.func
    def product(self):
        """Scalar product of the last residual with the solution of the aggregates."""
        total = ti.cast(0.0, self.wide)
        for k in range(self.size):
            total += self.load[k] * self.answer[k]
        return total

    @ti.func
    def shift(self, i):
        """Solution of the last coarse system for the aggregate of ball i; 0 without one."""
        v = ti.Vector.zero(float, self.dim)
        c = self.aggregate[i]
        if c >= 0:
            for a in ti.static(range(self.dim)):
                v[a] = ti.cast(self.answer[c * self.dim + a], float)
        return v
