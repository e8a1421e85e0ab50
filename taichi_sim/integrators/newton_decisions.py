"""The order in which an implicit stage is solved, what its numbers say about how to go on, and how well it was solved."""

from typing import Any

from taichi_sim.device.engine import ti

__all__ = [
    "CODES",
    "FOUND",
    "JUDGE_CHANGE",
    "JUDGE_GUESS",
    "MISSED_TOLERANCES",
    "MOST_TRIES",
    "NEXT_ITERATION",
    "NUMBERS",
    "READY",
    "SEARCHING",
    "SEARCH_ON",
    "SLOW_MODES_PART",
    "Verdicts",
    "solve_stage",
]

MOST_ITERATIONS = 100  # of Newton's method
MOST_SEARCHES = 2000  # iterations of conjugate gradients in one of them
MOST_TRIES = 8  # halvings of a change that went too far
DOUBTFUL_GUESS = 0.3  # of the impulses: a guess that leaves more is compared with none
FORCING_TERM = 0.1  # part of the residual that an iteration leaves: more would be lost to what is not linear
GAIN_WINDOW = 0.2  # part of the iterations so far, the last ones, whose gains tell what is left of slow modes
SLOW_MODES_PART = 0.2  # of the tolerance, where slow modes are solved last and the residual hides them
LOCAL_ERROR_PART = 0.05  # what a solution may add to it
SHRINKING_CHANGE = 0.5  # squared changes of two iterations; they do not in mere rounding
FINER_TARGET = 0.3  # of a squared residual that still gave too much
MISSED_TOLERANCES = 10.0  # a stage that leaves more counts as not solved

# What steers the loops, in double precision. Sizes of impulses are squares, divided by the block diagonal of the matrix [J].
NUMBERS = (
    *(
        "residual",
        "force",
        "scale",
    ),  # of the residual, of what springs do, and the larger of that and the kinetic energy
    *("noise", "load"),  # of a residual that may be rounding; of what acts from outside
    *("raised", "tries"),  # whether the potential is higher than before the change, and how often it was halved
    *(
        "residual_before",
        "moved",
        "moved_before",
    ),  # before the change; of the change of this iteration and the last one
    *("gain", "rz", "step", "saddle"),  # of conjugate gradients: what the last one gained; see `search`
    *("target", "iterations", "searches"),  # of the residual; so many iterations of either kind
    *("excess", "gained"),  # see StageWork
    "phase",  # where launches run ahead of what the host knows, see host_launch.Launched
    *("passes", "solved", "worst", "misses"),  # since the simulation was made, see SolverStatistics; solved: stages
)

# Phases of a stage: what may run next
DOUBTFUL, READY, SEARCHING, FOUND, SOLVED = range(5)
NOTHING, SEARCH_ON, JUDGE_GUESS, JUDGE_CHANGE, NEXT_ITERATION, CODES = range(6)  # what `report` says has to follow


def solve_stage(self, s, stage):
    """A stage of s seconds, from `base`: Newton's method, in each iteration conjugate gradients for the change. Compiled for one
    thread, where every loop runs inside a kernel, and run by Python, where each line launches a kernel with parallel loops."""
    self.begin(stage)
    self.linearise(s, 1.0)
    if self.doubtful():
        self.compare(s, 1.0)
        if self.raised():
            self.linearise(s, -1.0)
    self.set_target()
    while self.unsolved():
        self.start_search()
        while self.searching():
            self.search()
        self.evaluate(s, 1.0)
        part = 1.0
        while self.larger():
            self.compare(s, part)
            if self.raised():
                part = 0.5 * part
                self.evaluate(s, -part)
    self.end(stage)


@ti.data_oriented
class Verdicts:
    """Questions that `solve_stage` asks.

    What a solution leaves may not give energy. With the residual r = m (q - v) + s F, the equation of implicit Euler times v says
    that energy changes by -r . v - m (v - v0)^2 / 2 less what convexity and damping take: -r . v has to stay below a part of the
    second term, in the stages of TR-BDF2, too. The norm of r cannot see this: it divides what a stiff spring leaves by s^2 k, and
    a spring that rotates in a step has v along it. Each body is judged by itself, see StageWork.
    """

    number: Any  # (1) of NUMBERS
    wide: Any
    tolerance: float
    asked: float  # of a solution: the tolerance, or a part of it
    order: int
    least: float
    rounding: float
    finest: float
    slow: bool  # whether conjugate gradients lack the aggregates that solve slow modes first
    gated: bool  # whether launches run ahead: what is out of turn does nothing

    @ti.func
    def in_phase(self, phase):
        """True if what belongs to a phase is to run."""
        yes = True
        if ti.static(self.gated):
            yes = self.number[0].phase == phase
        return yes

    @ti.func
    def open_stage(self):
        """The phase after the guess."""
        if self.doubtful() == 1:
            self.number[0].phase = DOUBTFUL
        else:
            self.accept_guess()

    @ti.func
    def accept_guess(self):
        """The phase of a stage whose guess is good, or withdrawn."""
        self.set_target()
        self.number[0].phase = ti.select(self.unsolved() == 1, READY, SOLVED)

    @ti.func
    def next_search(self):
        """The phase after an iteration of conjugate gradients, or before the first."""
        self.number[0].phase = ti.select(self.searching() == 1, SEARCHING, FOUND)

    @ti.func
    def report(self):
        """CODES times the iterations of the present search, and what has to follow."""
        follows, searches = NOTHING, 0
        phase = self.number[0].phase
        if phase == SEARCHING or phase == FOUND:  # noqa: SIM109 (Taichi has no tuples of numbers to look in)
            searches = ti.cast(self.number[0].searches, ti.i32)
        if phase == SEARCHING:
            follows = SEARCH_ON
        elif phase == DOUBTFUL:
            follows = JUDGE_GUESS
        elif phase == FOUND:
            if self.larger() == 1:
                follows = JUDGE_CHANGE
            elif self.unsolved() == 1:
                follows = NEXT_ITERATION
                self.number[0].phase = READY
            else:
                self.number[0].phase = SOLVED
        return CODES * searches + follows

    @ti.func
    def doubtful(self):
        """1 if the guess leaves so much that none may be better, else 0."""
        return ti.cast(self.number[0].residual > DOUBTFUL_GUESS**2 * self.number[0].scale, ti.i32)

    @ti.func
    def raised(self):
        """1 if the change raised the potential, else 0."""
        return ti.cast(self.number[0].raised > 0.0, ti.i32)

    @ti.func
    def unsolved(self):
        """1 if another iteration is due, else 0: the first is, for a small residual may hide a slow mode. Then not where the
        residual is small, nor where the last change was, unless it gives energy; nor where the residual may be rounding and
        changes do not shrink any more."""
        residual, moved = self.number[0].residual, self.number[0].moved
        iterations = self.number[0].iterations
        least = ti.min(residual, moved)
        if iterations > 0.0 and self.number[0].excess > 0.0 and least <= self.number[0].target:
            finest = self.number[0].scale * self.finest**2
            self.number[0].target = ti.max(FINER_TARGET * least, finest)
        target = self.number[0].target
        large = residual > target and moved > target and self.number[0].searches < MOST_SEARCHES
        if residual < self.number[0].noise and iterations > 1.0:
            large = large and moved < SHRINKING_CHANGE * self.number[0].moved_before
        first = iterations == 0.0 and residual > 0.0
        return ti.cast(first or (large and iterations < MOST_ITERATIONS), ti.i32)

    @ti.func
    def add_gain(self, gain):
        """Add the gain of an iteration of conjugate gradients; where these converge slowly, to that of the last few."""
        kept = ti.cast(0.0, self.wide)
        if ti.static(self.slow):
            kept = ti.max(0.0, 1.0 - 1.0 / ti.max(1.0, GAIN_WINDOW * (self.number[0].searches + 1.0)))
        self.number[0].gain = kept * self.number[0].gain + gain

    @ti.func
    def searching(self):
        """1 if the search is to go on, else 0: by what the last iteration gained, which sees the slow modes that the residual
        hides.

        What is left, squared in the norm of the matrix, is the sum of all gains to come (Hestenes and Stiefel, 1952). Without
        aggregates many small ones come, so that the last few are taken, see `add_gain`.
        """
        goal = ti.max(FORCING_TERM**2 * self.number[0].moved, 0.1 * self.number[0].target)
        searches = self.number[0].searches
        more = (self.number[0].gain > goal or searches < 2.0) and self.number[0].rz > 0.0
        return ti.cast(more and searches < MOST_SEARCHES, ti.i32)

    @ti.func
    def set_target(self):
        """Set how small the residual has to become, once it is known how far the change of the step before fits this one.

        What is left then is the acceleration's change, of order h, so that this part of its `order`-th power is a part of the
        local error of the method; where a step does not resolve the motion, the tolerance it is.
        """
        force, residual = self.number[0].force, self.number[0].residual
        part = ti.cast(self.asked, self.wide)
        if force > 0.0:
            part = ti.min(part, LOCAL_ERROR_PART * (residual / force) ** (0.5 * self.order))
        self.number[0].target = self.number[0].scale * ti.max(self.least, part) ** 2

    @ti.func
    def larger(self):
        """1 if the change may have gone too far, so that half of it is worth a try, else 0: it raised the residual. It did
        where it raised the potential too. One of them alone may rise: the potential by damping, whose direction rotates, the
        residual where a stiff body rotates."""
        larger = self.number[0].residual > self.number[0].residual_before
        return ti.cast(larger and self.number[0].tries < MOST_TRIES, ti.i32)

    @ti.func
    def judge(self):
        """Note how well the stage was solved."""
        self.number[0].solved += 1.0
        left, moved, scale = self.number[0].residual, self.number[0].moved, self.number[0].scale
        if moved > 0.0:
            left = ti.min(left, moved)
        if not left >= 0.0:  # the matrix was not positive definite
            left = scale
        noise = self.number[0].noise
        acts = scale > noise or left > noise or self.number[0].load > 0.0
        if acts:  # else all of it is rounding
            left = ti.max(ti.sqrt(left / scale), self.number[0].gained)
            self.number[0].worst = ti.max(self.number[0].worst, left)
            if left > MISSED_TOLERANCES * self.tolerance:
                self.number[0].misses += 1.0
