"""Levels: the coarse part of the preconditioner of conjugate gradients.

A block of the diagonal sees a ball and its neighbours, so that what moves many balls together takes as many iterations as there
are balls across. Levels of ever larger aggregates see that (additive multilevel; Bramble, Pasciak, Xu 1990):

    z = D^-1 r + sum_l P_l (D_l^-1 - E_l^-1) P_l^T r,

P_l the smooth functions of the nodes of level l, see geometry.aggregation, D_l about the blocks of the diagonal of P_l^T A P_l:
the blocks of A that balls have by strains, summed with weights squared, times how much less a node's function changes than those
of single balls; likewise those by curvatures. E_l has the same sums without that factor: what the level below makes of such a
function, so that nothing counts twice where masses are most of A. No element is asked for more than its blocks. Functions depend
on the mesh alone, and torn springs drop out of the blocks. No node has balls of two bodies.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.geometry.aggregation import levels_of
from taichi_sim.integrators.bodies import Bodies
from taichi_sim.kernels import reductions

__all__ = ["Levels"]

FEWEST_BALLS = 32  # free ones of a body, for which levels pay
NEGATIVE_ROUNDING = 8.0  # of a block by its trace, in units of the machine's


@ti.data_oriented
class Levels:
    """Levels above the free balls of a scene's bodies. elements: a StageElements, or None.

    Points are the balls, then the nodes of all levels, the finest first; ends[l] is the first node of level l. Fields: `below`,
    the points that a node has a weight of, from first_below[node] to first_below[node + 1]; `above`, the nodes that have one of a
    point; `stiff`, `curved` (points): parts of blocks by strains and by curvatures [kg]; `inverse`, `answer` (nodes): D_l^-1 -
    E_l^-1, and what that makes of a residual; `takes` (balls), where they may be `dragged`: the part of what is around a ball
    that it shares, by which functions have it: what drag holds does not move with others.
    """

    def __init__(self, model: Model, bodies: Bodies, elements: Any, dragged: bool, fields: Fields) -> None:
        scene, self.n, self.dim, self.wide = model.scene, model.n, model.dim, fields.wide
        self.dragged = dragged
        balls = np.bincount(bodies.body[~scene.pinned], minlength=bodies.count)
        large = bodies.joined & (balls >= FEWEST_BALLS)
        taken = np.flatnonzero(~scene.pinned & large[bodies.body])
        self.has_curvature = elements is not None and elements.has_curvature
        edges = scene.pairs if elements is None else np.concatenate([scene.pairs, elements.edges()])
        levels = _levels(taken, edges, scene.mass, bodies.body, (0, 1, 2) if self.has_curvature else (0, 1))
        self.active = len(levels) > 0
        self.ends = tuple(np.cumsum([0, *(len(level.body) for level in levels)]).tolist())
        self.count = self.ends[-1]
        if not self.active:
            return
        node, point, weight = _entries(levels, taken, self.n)
        self.first_below, self.below = _lists(node, "point", point, weight, self.count, fields)
        self.first_above, self.above = _lists(point, "node", node, weight, self.n + self.count, fields)
        self.body = fields.integers(np.concatenate([level.body for level in levels]))
        self.mass = fields.reals(np.concatenate([level.mass for level in levels]))
        shares = [np.concatenate(share) for share in zip(*(level.shares for level in levels))]
        self.mass_share, self.share = fields.reals(shares[0]), fields.reals(shares[1])
        self.stiff = fields.matrices(self.n + self.count, self.dim)
        if self.has_curvature:
            self.curved_share = fields.reals(shares[2])
            self.curved = fields.matrices(self.n + self.count, self.dim)
        if dragged:
            self.takes = fields.reals(self.n)
        self.inverse = fields.matrices(self.count, self.dim)
        self.answer = fields.vectors(self.count, self.dim)
        self.rounding = NEGATIVE_ROUNDING * (2.0**-52 if fields.real == ti.f64 else 2.0**-23)

    @ti.func
    def _climb(self, visit: ti.template(), arguments: ti.template()):
        """visit(node, *arguments) for all nodes, each after those of the levels below it."""
        for c in range(self.ends[1]):
            visit(c, *arguments)
        if ti.static(reductions.on_device()):
            for level in ti.static(range(1, len(self.ends) - 1)):
                for c in range(self.ends[level], self.ends[level + 1]):
                    visit(c, *arguments)
        else:  # few nodes, that one thread visits sooner than several wake up
            ti.loop_config(serialize=True)
            for c in range(self.ends[1], self.count):
                visit(c, *arguments)

    @ti.func
    def _descend(self, visit: ti.template(), arguments: ti.template()):
        """visit(node, *arguments) for all nodes, each after those of the levels above it."""
        if ti.static(reductions.on_device()):
            for level in ti.static(range(len(self.ends) - 2, 0, -1)):
                for c in range(self.ends[level], self.ends[level + 1]):
                    visit(c, *arguments)
        else:
            ti.loop_config(serialize=True)
            for k in range(self.count - self.ends[1]):
                visit(self.count - 1 - k, *arguments)
        for c in range(self.ends[1]):
            visit(c, *arguments)

    @ti.func
    def note(self, i, stiff, curved, inertia, drag):
        """Note what ball i's block has by strains and by curvatures, of its inertia [kg], and of drag, in units of that."""
        takes = 1.0
        if ti.static(self.dragged):
            around = (stiff + curved).trace() / self.dim + inertia
            takes = ti.cast(around / (around + drag * inertia), float)
            self.takes[i] = takes
        self.stiff[i] = takes * takes * ti.cast(stiff, float)
        if ti.static(self.has_curvature):
            self.curved[i] = takes * takes * ti.cast(curved, float)

    @ti.func
    def factor(self, solver: ti.template()):
        """`inverse` of the nodes of each body of which solver.begins(body) is true, from what is noted of balls."""
        self._climb(self._condense, (solver,))

    @ti.func
    def _condense(self, c, solver: ti.template()):
        if solver.begins(self.body[c]):
            block = self._sum_below(self.stiff, c)
            own = self.share[c] * block
            self.stiff[self.n + c] = own
            if ti.static(self.has_curvature):
                curved = self._sum_below(self.curved, c)
                block += curved
                curved *= self.curved_share[c]
                self.curved[self.n + c] = curved
                own += curved
            block *= self.mass_share[c]
            # blocks are positive semidefinite but for rounding
            mass = (self.mass[c] + self.rounding * block.trace()) * ti.Matrix.identity(float, self.dim)
            inverse = ti.cast(own + mass, self.wide).inverse() - ti.cast(block + mass, self.wide).inverse()
            self.inverse[c] = ti.cast(inverse, float)

    @ti.func
    def _sum_below(self, part: ti.template(), c):
        """Sum of a part of the blocks below node c, with weights squared."""
        total = ti.Matrix.zero(float, self.dim, self.dim)
        for e in range(self.first_below[c], self.first_below[c + 1]):
            weight = self.below[e].weight
            total += weight * weight * part[self.below[e].point]
        return total

    @ti.func
    def solve(self, residual: ti.template()):
        """Find the answers of all levels to a residual, of balls in its first n entries; the others become that of nodes."""
        self._climb(self._restrict, (residual,))
        self._descend(self._add_above, ())

    @ti.func
    def _restrict(self, c, residual: ti.template()):
        total = ti.Vector.zero(float, self.dim)
        for e in range(self.first_below[c], self.first_below[c + 1]):
            point, weight = self.below[e].point, self.below[e].weight
            if ti.static(self.dragged):
                if point < self.n:
                    weight *= self.takes[point]
            total += weight * residual[point]
        residual[self.n + c] = total
        self.answer[c] = self.inverse[c] @ total

    @ti.func
    def _add_above(self, c):
        self.answer[c] = self.answer[c] + self.shift(self.n + c)

    @ti.func
    def shift(self, k):
        """Answer at point k of the levels above it to the last residual."""
        v = ti.Vector.zero(float, self.dim)
        for e in range(self.first_above[k], self.first_above[k + 1]):
            v += self.above[e].weight * self.answer[self.above[e].node]
        if ti.static(self.dragged):
            if k < self.n:
                v *= self.takes[k]
        return v


def _levels(taken: NDArray, edges: NDArray, mass: NDArray, body: NDArray, orders: tuple[int, ...]) -> list[Any]:
    """Levels above the balls `taken`; edges (m, 2) between any balls."""
    if len(taken) == 0:
        return []
    number = np.full(len(mass), -1)
    number[taken] = np.arange(len(taken))
    ends = number[edges]
    known = (ends >= 0).sum(axis=1)
    held = np.bincount(ends[known == 1].max(axis=1), minlength=len(taken))
    among = ends[(known == 2) & (ends[:, 0] != ends[:, 1])]
    return levels_of(among, held, mass[taken], body[taken], orders)


def _entries(levels: list[Any], taken: NDArray, n: int) -> tuple[NDArray, NDArray, NDArray]:
    """Node, point and weight of each weight of all levels."""
    found, points, first = [], taken, 0
    for level in levels:
        entries = level.weight.tocoo()
        found.append((first + entries.col, points[entries.row], entries.data))
        points = n + first + np.arange(len(level.body))
        first += len(level.body)
    node, point, weight = (np.concatenate(column) for column in zip(*found))
    return node, point, weight


def _lists(owner: NDArray, name: str, other: NDArray, weight: NDArray, count: int, fields: Fields) -> tuple[Any, Any]:
    """Lists of `count` owners: their beginnings, and a table of entries, `weight` and the other one by its name."""
    order = np.lexsort((other, owner))
    first = fields.integers(np.append(0, np.cumsum(np.bincount(owner, minlength=count))))
    data = {name: other[order], "weight": weight[order]}
    return first, fields.table({name: ti.i32, "weight": fields.real}, len(order), data)
