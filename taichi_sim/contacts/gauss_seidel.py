"""Gauss-Seidel: each contact changes the velocities that the next one sees, which needs half the iterations."""

from taichi_sim.contacts.iterated_rule import IteratedRule
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.parts import STEP
from taichi_sim.kernels.contacts import impact_iterations, pair_impacts, pair_solve, pair_sweeps, struck_pairs
from taichi_sim.kernels.contacts.pairs import LIST_BLOCK

__all__ = ["GaussSeidel"]


@ti.data_oriented
class GaussSeidel(IteratedRule):
    """Pairs in turn, in an order that does not depend on the number of threads; walls after them. Where a scene has pairs and
    walls only, what closes fast bounces first, one by one, which is exact; with sticks or triangles the energy limiter sees to it
    that crowds which bounce gain none."""

    name = "gauss_seidel"
    in_turn = warm_starts = softens = impacts_in_turn = energy_limiter = True

    def allocate(self, fields: Fields) -> None:
        """Allocate the fields of impacts in turn (see pair_impacts) and of line searches of islands of balls (see
        impact_iterations)."""
        n, dim = self.n, self.model.dim
        if self.plan.impacts_in_turn:
            self.block_limit = n // LIST_BLOCK + 2  # blocks, at most
            # 1: something closes fast in a block, in this round, then the same for the next; 1: something bounced in it
            self.block_is_active = fields.integers(2 * self.block_limit)
            self.block_was_struck = fields.integers(self.block_limit)
            # disturbed: round after the last impact on a ball or one in its list, 0: one closes fast, or UNDISTURBED;
            self.disturbed = fields.integers(n)
        if self.plan.bounces:
            self.since_impact = fields.reals(n)  # s, of the last one on a ball; a step where it had none
        if self.plan.throws_back:
            # impacts of this step in their order: the balls, 1 + e, the part of the step before the touch, and the normal
            columns = {"one": ti.i32, "other": ti.i32, "gain": fields.real, "part": fields.real}
            most = struck_pairs.FEW_IMPACTS + struck_pairs.IMPACTS_PER_BALL * n
            self.struck = fields.table(columns | {"normal": ti.types.vector(dim, fields.real)}, most)
            self.struck_number = fields.integers(1)
            # m/s, of what bounced: kick that was not known then, and what is thrown back of it
            self.late_kick, self.thrown = fields.vectors(n, dim), fields.vectors(n, dim)
        if self.plan.line_search:
            # island: a ball of the same one, in the end its root; island_was_struck: 1 of a root, something bounced in it
            self.island, self.island_was_struck = fields.integers(n), fields.integers(n)
            # iterations of this step, -1: none. The last that took the contacts a ball lists; that counted its change; of a root
            self.last_iteration, self.last_extension, self.island_iteration = (fields.integers(n) for _ in range(3))
            self.velocity_change = fields.vectors(n, dim)  # m/s, by the last iteration
            # of a root: slope and curvature [J] along that change, and how many times it may be made again
            self.slope, self.curvature, self.longest_extension = (fields.reals(n) for _ in range(3))

    @ti.func
    def before_iterations(self, ball: ti.template(), time, impacts: ti.template()):
        """Impacts one by one."""
        if ti.static(self.plan.bounces and not self.plan.at_search and impacts):
            pair_impacts.all_rounds(self, ball, time)

    @ti.func
    def after_iterations(self, ball: ti.template(), impacts: ti.template()):
        """Further iterations where something was struck."""
        if ti.static(self.plan.impacts_in_turn and impacts):
            impact_iterations.settle(self, ball)
            if ti.static(self.plan.warm_starts):
                pair_sweeps.each_block(self, ball, pair_impacts.limit_block, 0.0, None)

    @ti.func
    def iterate(self, ball: ti.template(), time, how: ti.template()):
        """Sticks and triangles from old velocities, then pairs in turn, then walls."""
        closes = ti.static(self.plan.pairs and self.plan.warm_starts and how.takes_back)
        if ti.static((self.plan.sticks or self.plan.triangles) and how.starts):  # else all was applied before the move
            for part in ti.static(self.sticks_and_triangles):
                part.solve_contacts(ball, self, time)
            for i in range(self.n):
                p, t = self.impulses_of_sticks_and_triangles(ball, i, how)
                self.apply(i, p, t)
        end = ti.static(self._end_with_walls if self.plan.walls or closes else None)
        if ti.static(self.plan.neighbours):
            pair_sweeps.each_ball(self, ball, pair_solve.ball_in_turn, end, time, how)
        elif ti.static(end):
            pair_sweeps.each_end(self, ball, end, time, how)

    @ti.func
    def _end_with_walls(self, ball: ti.template(), i, time, how: ti.template()):
        if ti.static(how.takes_back):
            self.exclude_pairs(ball, i)
        if ti.static(self.plan.walls):
            p, t = self.walls.gather(ball, self, i, time)
            self.apply(i, p, t)

    @ti.func
    def clear(self, i):
        """Clear the marks of what moves fast at ball i."""
        if ti.static(self.plan.impacts_in_turn):
            self.disturbed[i], self.impacts[i] = pair_impacts.UNDISTURBED, 0
            self.pairs.first_from_others[i] = pair_impacts.NO_CONTACT
        if ti.static(self.plan.bounces):
            self.since_impact[i] = 1.0 / self.rate[0]

    @ti.func
    def found(self, ball: ti.template(), role: ti.template()):
        """Mark the balls that arrive fast at walls; impacts one by one, where forces are asked for only then."""
        if ti.static(self.plan.impacts_in_turn and self.plan.walls_in_turn):
            pair_impacts.mark_arrivals_at_walls(self)
        if ti.static(self.plan.at_search):
            struck_pairs.clear(self)
            struck_pairs.look_back(self, role == STEP)
            pair_impacts.all_rounds(self, ball, self.plan.friction_part / self.rate[0])
