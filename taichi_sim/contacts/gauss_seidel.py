"""Gauss-Seidel: each contact changes the velocities that the next one sees, which needs half the iterations."""

from taichi_sim.contacts.base import ContactRule
from taichi_sim.contacts.pairs import BLOCK
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.contacts import impact_iterations, pair_impacts, pair_solve, pair_sweeps

__all__ = ["GaussSeidel"]


@ti.data_oriented
class GaussSeidel(ContactRule):
    """Pairs in turn, in an order that does not depend on the number of threads; walls after them. Where a scene has pairs and
    walls only, what closes fast bounces first, one by one, which is exact; with sticks or triangles the energy limiter sees to it
    that crowds which bounce gain none."""

    name = "gauss_seidel"
    in_turn = warm_starts = softens = impacts_in_turn = energy_limiter = True

    def allocate(self, fields: Fields) -> None:
        """For impacts in turn: `mark`, `struck` of blocks, `stirred`, `rebounds` of balls, see pair_impacts; for line searches
        of islands of balls see impact_iterations. `still`, `kicked` [m/s]: velocities when contacts were found, and what forces
        added."""
        n, dim = self.n, self.model.dim
        if self.strikes:
            self.most_blocks = n // BLOCK + 2
            self.mark, self.struck = fields.integers(2 * self.most_blocks), fields.integers(self.most_blocks)
            self.stirred, self.rebounds = fields.integers(n), fields.integers(n)
        if self.accelerates:
            self.island, self.awake = fields.integers(n), fields.integers(n)
            self.way = fields.vectors(n, dim)
            self.slope, self.bend, self.far = (fields.reals(n) for _ in range(3))
        if self.loaded:
            self.still, self.kicked = fields.vectors(n, dim), fields.vectors(n, dim)

    @ti.func
    def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
        """Impacts one by one, then what rests."""
        if ti.static(self.active):
            pair_impacts.note_kicks(self, ball)
            if ti.static(self.bounces and impacts):
                pair_impacts.all_rounds(self, ball, time)
            self.begin(ball, impacts)
            if ti.static(impacts):
                self.iterate(ball, time, pair_solve.FIRST)
            else:
                self.iterate(ball, time, pair_solve.LAST)
            self.repeat(ball, iterations - 1, pair_solve.NEXT)
            if ti.static(self.strikes and impacts):
                impact_iterations.settle(self, ball)
                if ti.static(self.warm):
                    pair_sweeps.each_block(self, ball, pair_impacts.limit_block, 0.0, None)
            self.limit_energy(ball, iterations, impacts)
            if ti.static(self.has_sticks and self.warm):
                self.sticks.end_rows(ball)

    @ti.func
    def relax(self, ball: ti.template(), time):
        """One iteration that takes back."""
        if ti.static(self.soft):
            self.begin_relaxing(ball)
            self.iterate(ball, time, pair_solve.RELAX)

    @ti.func
    def iterate(self, ball: ti.template(), time, how: ti.template()):
        """Sticks and triangles from old velocities, then pairs in turn, then walls."""
        closes = ti.static(self.has_grid and self.warm and how.takes_back)
        if ti.static(self.has_joints):
            if ti.static(how.starts):
                for part in ti.static(self.joints):
                    part.solve_rows(ball, self, time)
            for i in range(self.n):
                p, t = self.joint_impulses(ball, i, how)
                self.apply(i, p, t)
        if ti.static(self.has_grid):
            pair_sweeps.each_block(self, ball, pair_solve.block_in_turn, time, how)
        if ti.static(self.has_walls or closes):
            for i in range(self.n):
                p, t = ti.Vector.zero(float, self.model.dim), pair_sweeps.zero_spin(self)
                if ti.static(self.has_walls):
                    p, t = self.walls.gather(ball, self, i, time)
                if ti.static(closes):
                    self.put_back_pairs(ball, i)
                if ti.static(self.has_walls):
                    self.apply(i, p, t)

    @ti.func
    def clear(self, i):
        """Nothing has moved fast yet."""
        if ti.static(self.strikes):
            self.stirred[i], self.rebounds[i], self.pairs.latest[i] = pair_impacts.CALM, 0, pair_impacts.NO_ROW

    @ti.func
    def found(self, ball: ti.template()):
        """Which balls arrive fast at walls, and from when on forces are told from impacts."""
        if ti.static(self.strikes and self.among):
            pair_impacts.alert(self)
        if ti.static(self.loaded):
            for i in range(self.n):
                self.still[i] = ball[i].v
