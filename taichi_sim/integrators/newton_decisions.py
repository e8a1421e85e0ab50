"""Verdicts: what the numbers of an implicit stage say about how to go on with it, and how well it was solved."""

from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.kernels.springs import newton_terms as parts

__all__ = ["MISSED", "MOST_TRIES", "Verdicts"]

MOST_ROUNDS = 100  # of Newton's method
MOST_TURNS = 2000  # of conjugate gradients in a round
MOST_TRIES = 8  # halvings of a change that went too far
DOUBT = 0.3  # of the impulses: a guess that leaves more is compared with none
FORCING = 0.1  # part of the residual that a round leaves: more would be lost to what is not linear
LOCAL = 0.05  # part of the local error that a solution may add
SHRINKING = 0.5  # squared changes of two rounds; they do not in mere rounding
FINER = 0.3  # of a squared residual that still gave too much
MISSED = 10.0  # tolerances; a stage that leaves more counts as not solved


@ti.data_oriented
class Verdicts:
    """Questions that `control` asks of a stage; `number`: see kernels.implicit.

    What a solution leaves may not give energy. With the residual r = m (q - v) + s F, the equation of implicit Euler times v says
    that energy changes by -r . v - m (v - v0)^2 / 2 less what convexity and damping take: -r . v has to stay below a part of the
    second term, in the stages of TR-BDF2, too. The norm of r cannot see this: it divides what a stiff spring leaves by s^2 k, and
    a spring that turns in a step has v along it. Each body is judged by itself, see StageWork.
    """

    number: Any
    wide: Any
    tolerance: float
    order: int
    least: float
    rounding: float
    finest: float

    @ti.func
    def doubtful(self):
        """Whether the guess leaves so much that none may be better."""
        return ti.cast(self.number[parts.RESIDUAL] > DOUBT**2 * self.number[parts.SCALE], ti.i32)

    @ti.func
    def raised(self):
        """Whether it was raised."""
        return ti.cast(self.number[parts.RAISED] > 0.0, ti.i32)

    @ti.func
    def unsolved(self):
        """Whether another round is due: the first is, for a small residual may hide a slow mode. Then not where the residual is
        small, nor where the last change was, unless it gives energy; nor where the residual may be rounding and changes do not
        shrink any more."""
        turns = self.number[parts.TURNS] < MOST_TURNS
        least = ti.min(self.number[parts.RESIDUAL], self.number[parts.MOVED])
        if self.number[parts.ROUNDS] > 0.0 and self.number[parts.EXCESS] > 0.0 and least <= self.number[parts.TARGET]:
            finest = self.number[parts.SCALE] * self.finest**2
            self.number[parts.TARGET] = ti.max(FINER * least, finest)
        target = self.number[parts.TARGET]
        large = self.number[parts.RESIDUAL] > target and self.number[parts.MOVED] > target and turns
        if self.number[parts.RESIDUAL] < self.number[parts.NOISE] and self.number[parts.ROUNDS] > 1.0:
            large = large and self.number[parts.MOVED] < SHRINKING * self.number[parts.EARLIER]
        first = self.number[parts.ROUNDS] == 0.0 and self.number[parts.RESIDUAL] > 0.0
        return ti.cast(first or (large and self.number[parts.ROUNDS] < MOST_ROUNDS), ti.i32)

    @ti.func
    def searching(self):
        """Whether another turn is due: by what the last one gained, which sees the slow modes that the residual hides."""
        goal = ti.max(FORCING**2 * self.number[parts.MOVED], 0.1 * self.number[parts.TARGET])
        turns = self.number[parts.TURNS]
        more = (self.number[parts.GAIN] > goal or turns < 2.0) and self.number[parts.RZ] > 0.0 and turns < MOST_TURNS
        return ti.cast(more, ti.i32)

    @ti.func
    def set_target(self):
        """How small the residual has to become, once it is known how far the change of the step before fits this one.

        What is left then is the acceleration's change, of order h, so that this part of its `order`-th power is a part of the
        local error of the method; where a step does not resolve the motion, the tolerance it is.
        """
        ff, rr = self.number[parts.FORCE], self.number[parts.RESIDUAL]
        part = ti.cast(self.tolerance, self.wide)
        if ff > 0.0:
            part = ti.min(part, LOCAL * (rr / ff) ** (0.5 * self.order))
        self.number[parts.TARGET] = self.number[parts.SCALE] * ti.max(self.least, part) ** 2

    @ti.func
    def larger(self):
        """Whether the change may have gone too far, so that half of it is worth a try: it raised the residual. It did where it
        raised the potential too. One of them alone may rise: the potential by damping, whose direction turns, the residual
        where a stiff body turns."""
        larger = self.number[parts.RESIDUAL] > self.number[parts.LEFT]
        return ti.cast(larger and self.number[parts.TRIES] < MOST_TRIES, ti.i32)

    @ti.func
    def judge(self):
        """Note how well the stage was solved."""
        self.number[parts.SOLVED] += 1.0
        left, moved, scale = self.number[parts.RESIDUAL], self.number[parts.MOVED], self.number[parts.SCALE]
        if moved > 0.0:
            left = ti.min(left, moved)
        if not left >= 0.0:  # the matrix was not positive definite
            left = scale
        noise = self.number[parts.NOISE]
        acts = scale > noise or left > noise or self.number[parts.LOAD] > 0.0
        if acts:  # else all of it is rounding
            left = ti.sqrt(left / scale)
            left = ti.max(left, self.number[parts.GAINED])
            self.number[parts.WORST] = ti.max(self.number[parts.WORST], left)
            if left > MISSED * self.tolerance:
                self.number[parts.MISSES] += 1.0
