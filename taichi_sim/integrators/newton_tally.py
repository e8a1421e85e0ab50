"""Tally of how well implicit stages were solved: what the rest of its residual gives to bodies, and what is left of it."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_numbers import ADDED_NOISE, GIVEN_PARTS, MISSED_TOLERANCES, MOST_SIZE, Stage

__all__ = ["Tallies"]


@ti.data_oriented
class Tallies(Stage):
    """The part of a StageSolver that tells how well it has solved.

    What a solution leaves may not give energy. With the residual r = m (q - v) + s F, the equation of implicit Euler times v says
    that energy changes by -r . v - m (v - v0)^2 / 2 less what convexity and damping take: -r . v has to stay below a part of the
    second term; in the stages of TR-BDF2, which takes less, below a smaller one. The norm of r cannot see this: it divides what
    a stiff spring leaves by s^2 k, and a spring that rotates in a step has v along it. What r gives counts in the frame of the
    body.
    """

    @ti.func
    def note_work(self, b):
        """Set what the residual gives to body b: `excess` [J], beyond what it may, and `gained`, the part of its kinetic energy
        that is more than the method takes, where that is not rounding."""
        given, taken = self.bodies.total(self.part.given, b), self.bodies.total(self.part.taken, b)
        moving = self.bodies.total(self.part.moving, b)
        self.number[b].excess = ti.max(0.0, given - ti.static(GIVEN_PARTS[self.order]) * taken - self.rounding * moving)
        gain = given - taken
        gained = 0.0 * gain
        if gain > MISSED_TOLERANCES * self.tolerance * moving and gain > self.tolerance**2 * self.number[b].scale:
            gained = gain / ti.max(gain, moving)
        self.number[b].gained = gained

    @ti.func
    def is_rounding(self, b, acting, noise):
        """True if what acts on body b, but for what acts on all of a free one alike, is rounding up to a noise [J]."""
        return acting <= noise and self.number[b].load == 0.0

    @ti.func
    def is_lost(self, b):
        """True if forces on body b are no numbers. A comparison with nan is false."""
        return not self.number[b].residual < MOST_SIZE

    @ti.func
    def judge(self, b):
        """Note how well the stage was solved for body b."""
        left, moved, scale = self.number[b].residual, self.number[b].moved, self.number[b].scale
        if moved > 0.0:
            left = ti.min(left, moved)
        if not left >= 0.0:  # the matrix was not positive definite
            left = scale
        indefinite = self.number[b].residual < 0.0 or self.number[b].force < 0.0  # even where nothing else acts
        ti.atomic_max(self.stage[0].passes, ti.cast(self.number[b].passes, ti.i32))
        within = ti.min(self.number[b].within, scale)
        if not self.is_rounding(b, ti.max(within, left), ADDED_NOISE * self.number[b].noise):
            left = ti.max(ti.sqrt(left / scale), self.number[b].gained)
            ti.atomic_max(self.stage[0].worst, ti.cast(left, float))
            if left > MISSED_TOLERANCES * self.tolerance:
                self.stage[0].missed = 1
        if indefinite:
            ti.atomic_max(self.stage[0].worst, ti.cast(1.0, float))
            self.stage[0].missed = 1

    @ti.func
    def judge_all(self):
        """Add up how well the stage was solved: for the worst body."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.stage[0].passes = 0
            self.stage[0].missed = 0
            self.stage[0].worst = 0.0
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            self.judge(b)
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.tally[0].solved += 1.0
            self.tally[0].passes += self.stage[0].passes
            self.tally[0].misses += self.stage[0].missed
            self.tally[0].worst = ti.max(self.tally[0].worst, ti.cast(self.stage[0].worst, self.wide))
