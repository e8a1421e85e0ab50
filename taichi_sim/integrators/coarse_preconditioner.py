"""Aggregates: the coarse part of the preconditioner of conjugate gradients.

A block of the diagonal sees a ball and its neighbours, so what moves many balls together takes as many iterations as there are
balls across. Aggregates of neighbouring balls that move as wholes see just that: z = D^-1 r + P (P^T A P)^-1 P^T r, P from the
movement of aggregates to that of balls. Their matrix is small and solved directly; springs within an aggregate drop out of it.
No aggregate has balls of two bodies, so that the matrix is one for each body.
Elements that do not tell what joins their corners enter by a bound for it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.springs import Springs
from taichi_sim.integrators.bodies import Bodies
from taichi_sim.kernels import reductions
from taichi_sim.kernels.loops import list_entry
from taichi_sim.kernels.reductions import each_part

__all__ = ["Aggregates", "bisected"]

FEWEST_BALLS = 32  # free ones of a body, for which aggregates pay
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
    """Aggregates of the free balls of a scene's bodies. `spring_block`: of each spring, see kernels.springs.newton_terms.
    elements: a StageElements, or None."""

    def __init__(self, model: Model, springs: Springs | None, bodies: Bodies, spring_block: ti.StructField, elements: Any,
                 fields: Fields) -> None:  # fmt: skip
        scene, self.elements, self.has_elements = model.scene, elements, elements is not None
        self.spring_block, self.dim = spring_block, model.dim
        free = np.flatnonzero(~scene.pinned)
        balls = np.bincount(bodies.body[free], minlength=bodies.count)
        large = np.flatnonzero(bodies.joined & (balls >= FEWEST_BALLS))
        # one thread of a GPU is slow
        on_device = reductions.on_device() if springs is None else springs.order in ("atomic", "ends")
        self.active, self.missing = len(large) > 0 and not on_device, len(large) > 0 and on_device
        if not self.active:
            return
        counts = 1 << np.log2(np.cbrt(FACTOR_COST * balls[large])).astype(int)
        firsts = np.cumsum(counts) - counts
        self.count, self.blocks = int(counts.sum()), len(large)
        aggregate = np.full(model.n, -1)
        grouped = np.split(free[np.argsort(bodies.body[free], kind="stable")], np.cumsum(balls)[:-1])
        for k, first, count in zip(large, firsts, counts):
            aggregate[grouped[k]] = first + bisected(scene.position[grouped[k]], int(count))
        free = np.flatnonzero(aggregate >= 0)
        own = aggregate[free]
        self.aggregate = fields.integers(aggregate)
        self.member = fields.integers(free[np.argsort(own, kind="stable")])
        mass = np.bincount(own, scene.mass[free], self.count)
        self.mass, self.least = fields.reals(mass), fields.reals(np.minimum.reduceat(mass, firsts))
        self.begin = fields.integers(np.append(0, np.cumsum(np.bincount(own, minlength=self.count))))
        block_of_body = np.full(bodies.count, -1)
        block_of_body[large] = np.arange(self.blocks)
        self.block_of_body, self.body = fields.integers(block_of_body), fields.integers(large)
        self.block_of = fields.integers(np.repeat(np.arange(self.blocks), counts))
        # of each body with aggregates: the first of them, unknowns, and where its matrix begins
        sizes = counts * self.dim
        block = {"first": firsts, "size": sizes, "at": np.cumsum(sizes**2) - sizes**2}
        self.block = fields.table(dict.fromkeys(block, ti.i32), self.blocks, block)
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
        self.matrix = fields.doubles(int(np.sum(sizes**2)))  # lower factors, rows one after another
        self.load, self.answer = (fields.doubles(self.count * self.dim) for _ in range(2))
        self.wide = fields.wide

    @ti.func
    def factor(self, solver: ti.template()):
        """The matrix of the springs as they are, and its Cholesky factor, of each body of which solver.begins(body) is true."""
        each_part(self.count, self._assemble, (solver,))
        ti.loop_config(serialize=ti.static(self.blocks == 1))
        for b in range(self.blocks):
            if solver.begins(self.body[b]):
                self._factor(b)

    @ti.func
    def _factor(self, b):
        """Factor the matrix of body b."""
        size, at = self.block[b].size, self.block[b].at
        for j in range(size):
            for i in range(j, size):
                total = self.matrix[at + i * size + j]
                for q in range(j):
                    total -= self.matrix[at + i * size + q] * self.matrix[at + j * size + q]
                if i == j:
                    # what is added to the masses is positive semidefinite: less than the least is rounding
                    self.matrix[at + j * size + j] = ti.sqrt(ti.max(total, self.least[b]))
                else:
                    self.matrix[at + i * size + j] = total / self.matrix[at + j * size + j]

    @ti.func
    def _assemble(self, c, solver: ti.template()):
        """The rows of aggregate c, where they are due."""
        if solver.begins(self.body[self.block_of[c]]):
            self._assemble_rows(c)

    @ti.func
    def _assemble_rows(self, c):
        """The rows of aggregate c."""
        dim = ti.static(self.dim)
        block = self.block[self.block_of[c]]
        size, row = block.size, block.at + (c - block.first) * dim * block.size
        for e in range(row, row + dim * size):
            self.matrix[e] = 0.0
        own = ti.cast(self.mass[c], self.wide) * ti.Matrix.identity(self.wide, dim)
        if ti.static(self.has_elements):
            for one in ti.static(self.elements.elements):
                for e in range(self.begin[c], self.begin[c + 1]):
                    own += self._assemble_element(one, c, self.member[e], row)
        for e in range(self.first[c], self.first[c + 1]):
            link = self.link[e]
            spring = self.spring_block[link.spring]
            for a in ti.static(range(dim)):
                for b in ti.static(range(dim)):
                    value = ti.cast(spring.r[a], self.wide) * ti.cast(spring.r[b], self.wide)
                    value *= ti.cast(spring.along, self.wide)
                    if ti.static(a == b):
                        value += ti.cast(spring.across, self.wide)
                    own[a, b] += value
                    if link.other >= 0:
                        at = row + a * size + (link.other - block.first) * dim + b
                        self.matrix[at] = self.matrix[at] - value
        for a in ti.static(range(dim)):
            for b in ti.static(range(dim)):
                self.matrix[row + a * size + (c - block.first) * dim + b] = own[a, b]

    @ti.func
    def _assemble_element(self, one: ti.template(), c, i, row):
        """Add to the rows of aggregate c, which begin at `row`, what the elements of a kind join its ball i to; returns what they
        add to its own block."""
        dim = ti.static(self.dim)
        s, block = self.elements.step[0], self.block[self.block_of[c]]
        own = ti.Matrix.zero(self.wide, dim, dim)
        for k in range(one.start[i + 1] - one.start[i]):
            e = list_entry(one, i, k)
            corner, crosses = one.row[e], 0
            for t, other in ti.static(enumerate(one.others)):
                d = self.aggregate[other[e]]
                if d != c and one.is_whole(e):
                    if ti.static(one.couples):
                        joint = ti.cast(one.corner_coupling(self.elements.there, i, corner, t, s), self.wide)
                        own -= joint
                        if d >= 0:
                            for a, b in ti.static(ti.ndrange(dim, dim)):
                                at = row + a * block.size + (d - block.first) * dim + b
                                self.matrix[at] = self.matrix[at] + joint[a, b]
                    crosses = 1
            if ti.static(not one.couples):
                if crosses == 1:  # x^T K x is at most the sum of the blocks of the diagonal, times their number
                    bound = ti.static(1.0 + len(one.others)) * one.corner_block(self.elements.there, i, corner, s)
                    own += ti.cast(bound, self.wide)
        return own

    @ti.func
    def solve(self, residual: ti.template()):
        """Solve the coarse systems of all bodies for a residual (n); see `product`."""
        each_part(self.count, self._restrict, (residual,))
        ti.loop_config(serialize=ti.static(self.blocks == 1))
        for b in range(self.blocks):
            self._substitute(b)

    @ti.func
    def _substitute(self, b):
        """Solve the coarse system of body b, whose matrix is factored."""
        size, at, first = self.block[b].size, self.block[b].at, self.block[b].first * self.dim
        for i in range(size):
            total = self.load[first + i]
            for q in range(i):
                total -= self.matrix[at + i * size + q] * self.answer[first + q]
            self.answer[first + i] = total / self.matrix[at + i * size + i]
        for k in range(size):
            i = size - 1 - k
            total = self.answer[first + i]
            for q in range(i + 1, size):
                total -= self.matrix[at + q * size + i] * self.answer[first + q]
            self.answer[first + i] = total / self.matrix[at + i * size + i]

    @ti.func
    def _restrict(self, c, residual: ti.template()):
        dim = ti.static(self.dim)
        total = ti.Vector.zero(float, dim)
        for e in range(self.begin[c], self.begin[c + 1]):
            total += residual[self.member[e]]
        for a in ti.static(range(dim)):
            self.load[c * dim + a] = ti.cast(total[a], self.wide)

    @ti.func
    def product(self, b):
        """Scalar product of the last residual of body b with the solution of its aggregates; 0 without any."""
        total = ti.cast(0.0, self.wide)
        k = self.block_of_body[b]
        if k >= 0:
            first = self.block[k].first * self.dim
            for e in range(first, first + self.block[k].size):
                total += self.load[e] * self.answer[e]
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
