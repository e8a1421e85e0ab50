"""Jacobi with split masses: impulses are summed from old velocities and applied at the end of an iteration."""

from taichi_sim.contacts.base import ContactRule
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.contacts import pair_solve, pair_sweeps
from taichi_sim.scene.scene import max_restitution

__all__ = ["Jacobi"]

RELAXATION = (
    1.3  # of an iteration with split masses; below 2 they converge, above 1.3 friction could make one add energy
)
FEW_ITERATIONS = 4  # with fewer, what one overshoots is not taken back by the next


@ti.data_oriented
class Jacobi(ContactRule):
    """Each ball splits its mass between its contacts, see kernels.contacts.contact_law.share, so that an iteration never adds
    energy and iterations converge. Needs no order: GPUs and atomics take all contacts at once."""

    name = "jacobi"
    split = warm_starts = softens = energy_limiter = True

    def allocate(self, fields: Fields) -> None:
        """`impulse` [N s] and `angular_impulse` of pairs in an iteration; `tensor`: sum of n n^T over the contacts of a ball."""
        self.relaxation = RELAXATION
        if self.iterations < FEW_ITERATIONS:  # one changes the energy by sum lambda |u| (relaxation (1 + e) / 2 - 1)
            self.relaxation = min(RELAXATION, 2.0 / (1.0 + max_restitution(self.model.scene)))
        self.impulse = fields.vectors(self.n, self.model.dim)
        if self.spins:
            self.angular_impulse = fields.spins(self.n, self.model.dim)
        if self.by_tensor:
            self.tensor = fields.matrices(self.n, self.model.dim)

    @ti.func
    def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
        """All contacts, iteration by iteration."""
        if ti.static(self.active):
            self.begin(ball, impacts)
            if ti.static(impacts):
                self.iterate(ball, time, pair_solve.FIRST)
            else:
                self.iterate(ball, time, pair_solve.LAST)
            self.repeat(ball, iterations - 1, pair_solve.NEXT)
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
        """All contacts from the same velocities."""
        if ti.static(how.starts):
            for part in ti.static(self.joints):
                part.solve_rows(ball, self, time)
        for i in range(self.n):
            p, t = self.joint_impulses(ball, i, how)
            self.impulse[i] = p
            if ti.static(self.spins):
                self.angular_impulse[i] = t
        if ti.static(self.has_grid):
            pair_sweeps.each_block(self, ball, pair_solve.block_at_once, time, how)
        for i in range(self.n):
            p, t = ti.Vector.zero(float, self.model.dim), pair_sweeps.zero_spin(self)
            if ti.static(self.has_walls):
                p, t = self.walls.gather(ball, self, i, time)
            twist = pair_sweeps.zero_spin(self)
            if ti.static(self.spins):
                twist = self.angular_impulse[i]
            self.apply(i, self.impulse[i], twist)
            if ti.static(self.has_grid and self.warm and how.takes_back):
                self.put_back_pairs(ball, i)
            if ti.static(self.has_walls):
                self.apply(i, p, t)

    @ti.func
    def clear(self, i):
        """No contact has a direction yet."""
        if ti.static(self.by_tensor):
            self.tensor[i] = ti.Matrix.zero(float, self.model.dim, self.model.dim)
