"""Jacobi: impulses are summed from old velocities and applied at the end of an iteration; with split masses, or whole ones."""

from taichi_sim.contacts.iterated_rule import IteratedRule
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.contacts import pair_solve, pair_sweeps
from taichi_sim.kernels.vectors import zero_scalar_in_2d
from taichi_sim.scene.scene import max_restitution

__all__ = ["Jacobi", "Sum"]

# of an iteration with split masses; below 2 they converge, above 1.3 friction could make one add energy
RELAXATION = 1.3
FEW_ITERATIONS = 4  # with fewer, what one overshoots is not taken back by the next


@ti.data_oriented
class Jacobi(IteratedRule):
    """Each ball splits its mass between its contacts, see kernels.contacts.contact_law.share, so that an iteration never adds
    energy and iterations converge. Needs no order: GPUs and atomics take all contacts at once."""

    name = "jacobi"
    split = warm_starts = softens = energy_limiter = gathers = True

    def allocate(self, fields: Fields) -> None:
        """Allocate the sums of an iteration for each ball, and choose the relaxation."""
        self.relaxation = RELAXATION
        if self.iterations < FEW_ITERATIONS:  # one changes the energy by sum lambda |u| (relaxation (1 + e) / 2 - 1)
            self.relaxation = min(RELAXATION, 2.0 / (1.0 + max_restitution(self.model.scene)))
        self.impulse = fields.vectors(self.n, self.model.dim)  # N s
        self.solved_at_once = max(
            [self.n, *(part.most_solved for part in self.sticks_and_triangles)]
        )  # balls and contacts
        if self.model.spins:
            self.angular_impulse = fields.spins(self.n, self.model.dim)  # N s, in units of the radius

    @ti.func
    def iterate(self, ball: ti.template(), time, how: ti.template()):
        """Solve all contacts from the same velocities."""
        if ti.static(self.plan.gathers):
            for k in range(self.solved_at_once):
                if ti.static(how.starts):
                    for part in ti.static(self.sticks_and_triangles):
                        part.solve_one(k, ball, self, time)
                if k < self.n:
                    self._clear_impulse(k)
                    if ti.static(self.plan.neighbours):
                        pair_solve.ball_at_once(self, ball, k, time, how)
        else:
            if ti.static(how.starts):
                for part in ti.static(self.sticks_and_triangles):
                    part.solve_contacts(ball, self, time)
            for i in range(self.n):
                self._clear_impulse(i)
                self._add_sticks_and_triangles(ball, i, how)
            if ti.static(self.plan.neighbours):
                pair_sweeps.each_ball(self, ball, pair_solve.ball_at_once, None, time, how)
        for i in range(self.n):
            if ti.static(self.plan.gathers):
                self._add_sticks_and_triangles(ball, i, how)
            p, t = ti.Vector.zero(float, self.model.dim), zero_scalar_in_2d(self.model.dim)
            if ti.static(self.plan.walls):
                p, t = self.walls.gather(ball, self, i, time)
            angular = zero_scalar_in_2d(self.model.dim)
            if ti.static(self.model.spins):
                angular = self.angular_impulse[i]
            self.apply(i, self.impulse[i], angular)
            if ti.static(how.takes_back):
                self.exclude_pairs(ball, i)
            if ti.static(self.plan.walls):
                self.apply(i, p, t)

    @ti.func
    def _clear_impulse(self, i):
        self.impulse[i] = ti.Vector.zero(float, self.model.dim)
        if ti.static(self.model.spins):
            self.angular_impulse[i] = zero_scalar_in_2d(self.model.dim)

    @ti.func
    def _add_sticks_and_triangles(self, ball: ti.template(), i, how: ti.template()):
        if ti.static((self.plan.sticks or self.plan.triangles) and how.starts):  # else all was applied before the move
            p, t = self.impulses_of_sticks_and_triangles(ball, i, how)
            self.impulse[i] = self.impulse[i] + p
            if ti.static(self.model.spins):
                self.angular_impulse[i] = self.angular_impulse[i] + t


@ti.data_oriented
class Sum(Jacobi):
    """Jacobi's iteration without its split masses: exact for balls that have one contact, but it over-corrects wherever a ball
    has several, so that packs gain energy. Contacts are rigid, and nothing limits the energy. Here for study."""

    name = "sum"
    sums_plainly = True
    split = softens = energy_limiter = False
