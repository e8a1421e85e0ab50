"""IteratedRule: solves that start from accumulated impulses and go over all contacts several times."""

from taichi_sim.contacts.base import ContactRule
from taichi_sim.device.engine import ti
from taichi_sim.device.parts import STEP, Part
from taichi_sim.kernels.contacts import energy_limiter, pair_impacts, pair_solve

__all__ = ["IteratedRule"]

FEW_ITERATIONS = 4  # up to which a launch of its own for each is not worth what it spares in compiling


@ti.data_oriented
class IteratedRule(ContactRule):
    """Base of rules that iterate. To be given: `iterate`, one iteration; what comes before the first and after the last one."""

    @ti.func
    def iterate(self, ball: ti.template(), time, how: ti.template()):
        """One iteration over all contacts, see kernels.contacts.pair_solve.Iteration."""

    @ti.func
    def before_iterations(self, ball: ti.template(), time, impacts: ti.template()):
        """Do what comes first, before accumulated impulses are applied."""

    @ti.func
    def after_iterations(self, ball: ti.template(), impacts: ti.template()):
        """Do what comes last, before the energy limiter."""

    def solving(self) -> list[Part]:
        """The parts that solve all contacts before a move. Where there are many iterations, those after the first are one."""
        whole = super().solving()
        if self.iterations <= FEW_ITERATIONS or type(self).solve is not IteratedRule.solve or not whole:
            return whole
        further = Part(self, "_iterate_further", STEP, self.iterations - 1)
        return [Part(self, "_iterate_first", STEP), further, Part(self, "_end_solve", STEP)]

    @ti.func
    def _iterate_first(self, role: ti.template(), h, time):
        self.open_solve(self.state.ball, self.plan.friction_part * h, True)

    @ti.func
    def _iterate_further(self, role: ti.template(), h, time):
        self.iterate(self.state.ball, 0.0, pair_solve.NEXT)

    @ti.func
    def _end_solve(self, role: ti.template(), h, time):
        self.end_solve(self.state.ball, self.iterations, True)

    @ti.func
    def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
        """All contacts, iteration by iteration."""
        if ti.static(self.active):
            self.open_solve(ball, time, impacts)
            self.repeat(ball, iterations - 1, pair_solve.NEXT)
            self.end_solve(ball, iterations, impacts)

    @ti.func
    def open_solve(self, ball: ti.template(), time, impacts: ti.template()):
        """Start from what was accumulated, and the first iteration."""
        pair_impacts.note_velocity_from_forces(self, ball)
        self.before_iterations(ball, time, impacts)
        self.begin(ball, impacts)
        if ti.static(impacts):
            self.iterate(ball, time, pair_solve.FIRST)
        else:
            self.iterate(ball, time, pair_solve.LAST)

    @ti.func
    def end_solve(self, ball: ti.template(), iterations: ti.template(), impacts: ti.template()):
        """Do what follows the iterations."""
        self.after_iterations(ball, impacts)
        self.limit_energy(ball, iterations, impacts)
        if ti.static(self.plan.sticks and self.plan.warm_starts):
            self.sticks.end_contacts(ball)

    @ti.func
    def relax(self, ball: ti.template(), time):
        """One iteration that takes back; accumulated impulses are applied already."""
        if ti.static(self.plan.soft):
            for i in range(self.n):
                self.velocity_before[i] = ball[i].v
                if ti.static(self.plan.loaded):
                    self.from_forces[i].v = ball[i].v - self.velocity_when_found[i]
                if ti.static(self.plan.walls):
                    self.walls.begin(ball, self, i, False, False)
                self.exclude_pairs(ball, i)
            self.iterate(ball, time, pair_solve.RELAX)

    @ti.func
    def repeat(self, ball: ti.template(), number: ti.template(), how: ti.template()):
        """Run so many iterations."""
        if ti.static(self.plan.serial):
            for _ in range(number):
                self.iterate(ball, 0.0, how)
        else:  # at the top level of a kernel only an unrolled loop leaves the inner ones parallel
            for _ in ti.static(range(number)):
                self.iterate(ball, 0.0, how)

    @ti.func
    def limit_energy(self, ball: ti.template(), iterations: ti.template(), impacts: ti.template()):
        """Make stopped contacts bounce, as far as energy allows."""
        if ti.static(self.plan.limits_energy):
            if ti.static(impacts):
                energy_limiter.note_stopped(self, ball)
                self.repeat(ball, iterations, pair_solve.BOUNCE)
            else:  # what carried an impact is no load that rests: one iteration may not undo it
                energy_limiter.compare_with_before(self)
            energy_limiter.limit(self, ball)

    @ti.func
    def impulses_of_sticks_and_triangles(self, ball: ti.template(), i, how: ti.template()):
        """Impulse and angular impulse on ball i from sticks and triangles in an iteration."""
        p, t = self.gather_sticks_and_triangles(ball, i)
        if ti.static(how.takes_back and self.plan.pairs and self.plan.warm_starts):  # no pair accumulates these
            self.warm_velocity[i] = self.warm_velocity[i] + self.model.inverse_mass[i] * p
            if ti.static(self.model.spins):
                response = self.model.spin_response(i) * self.model.inverse_mass[i]
                self.warm_spin[i] = self.warm_spin[i] + response * t
        return p, t
