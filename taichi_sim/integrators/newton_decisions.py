"""The order in which an implicit stage is solved, and what its numbers say about how to go on."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_numbers import (
    BEGUN,
    CODES,
    DOUBTFUL,
    DOUBTFUL_GUESS,
    EARLY_RELEASES,
    EARLY_RESIDUAL,
    FINER_TARGET,
    FORCING_TERM,
    FOUND,
    GAIN_WINDOW,
    HEAVY_ITERATIONS,
    HELD,
    LEFT_OUT,
    LOCAL_ERROR_PART,
    LOOSE_TERM,
    MOST_ITERATIONS,
    MOST_RELEASES,
    MOST_SEARCHES,
    MOST_TRIES,
    NOT_MOVED,
    OLD_BLOCKS,
    PATIENT_ITERATIONS,
    READY,
    SEARCHING,
    SHRINKING_CHANGE,
    SOLVED,
    STEEPEST_RISE,
    TRIED,
    WITHDRAWN,
    WRONG_FRICTION,
)
from taichi_sim.integrators.newton_tally import Tallies

__all__ = ["Verdicts", "compare_potentials", "solve_stage"]


def solve_stage(self, s, stage):
    """A stage of s seconds, from `base`: Newton's method, in each iteration conjugate gradients for the change. Compiled for one
    thread, where every loop runs inside a kernel, and run by Python, where each line launches a kernel with parallel loops.
    What is done acts on the bodies that are in the phase for it, and leaves the others as they are."""
    self.begin(s, stage)
    phase = BEGUN
    while phase != SOLVED:
        if phase == READY:
            if ti.static(self.deflates):
                if self.any_heavy() == 1:
                    self.deflate()
            self.start_search()
        elif phase == SEARCHING:
            self.search()
        elif phase == TRIED or phase == DOUBTFUL:  # noqa: SIM109 (Taichi has no tuples of numbers to look in)
            self.compare(s)
        else:
            self.move(s)
            if phase == FOUND:
                self.evaluate()
            else:
                self.linearise(s)
            if ti.static(self.holds):
                self.release()
        phase = self.foremost()
    self.end(stage)


def compare_potentials(self, s):
    """Compare the potential of each body in doubt before its guess, or its change, was added with that after it."""
    for added in range(2):
        self.weigh(s, 1.0 - added)
    self.judge_potentials()


@ti.data_oriented
class Verdicts(Tallies):
    """The part of a StageSolver that answers the questions of `solve_stage`."""

    @ti.func
    def begin_body(self, b):
        """The guess of body b is to be added and looked at."""
        self.number[b].iterations = 0.0
        self.number[b].passes = 0.0
        self.number[b].searches = 0.0
        self.number[b].moved = NOT_MOVED
        self.number[b].flies = 0.0
        self.number[b].change = 1.0
        self.number[b].part = 1.0
        self.number[b].phase = BEGUN
        if ti.static(self.holds):
            self.number[b].releases = 0.0
            self.number[b].shifted = 0.0

    @ti.func
    def judge_guess(self, b):
        """The phase of body b after its guess was added. A body on which nothing but rounding acts is not solved for: TR-BDF2
        would take what it finds for a slope, and carry that on."""
        begun = self.number[b].phase == BEGUN
        self.number[b].change = 0.0
        unmoved = self.number[b].iterations == 0.0
        if unmoved and self.is_rounding(b, self.number[b].within, self.number[b].noise):
            self.number[b].flies = 1.0
            self.number[b].phase = SOLVED
        elif begun and self.doubtful(b) == 1:
            self.number[b].phase = DOUBTFUL
        else:
            self.accept_guess(b)

    @ti.func
    def accept_guess(self, b):
        """The phase of body b, whose guess is good, or withdrawn, or whose blocks were made anew."""
        if self.number[b].iterations == 0.0:
            self.allow(b)
        self.go_on(b)

    @ti.func
    def go_on(self, b):
        """The phase of body b after an iteration of Newton's method, or before the first. What acts is measured where the stage
        is: at a guess that strains a body far it is much larger. Blocks of such a guess are made anew before the
        stage counts as solved."""
        scale, before = self.number[b].scale, self.number[b].scale_of_blocks
        self.number[b].target = scale * self.number[b].allowed
        if self.unsolved(b) == 1:
            self.number[b].phase = READY
            if ti.static(self.holds and self.order == 1):
                if self.releases_early(b):
                    self.number[b].phase = HELD
        elif ti.max(scale, before) > OLD_BLOCKS * ti.min(scale, before) and self.number[b].iterations < MOST_ITERATIONS:
            self.number[b].phase = WITHDRAWN
        else:
            self.number[b].phase = SOLVED
            if ti.static(self.holds):
                if self.number[b].near > 0.0 and self.number[b].releases < MOST_RELEASES:
                    self.number[b].phase = HELD

    @ti.func
    def releases_early(self, b):
        """True if what surfaces do to body b is looked at before it is solved: to solve for what they do not do is in vain."""
        few = self.number[b].near > 0.0 and self.number[b].releases < EARLY_RELEASES
        small = self.number[b].residual < EARLY_RESIDUAL * self.number[b].scale
        return few and small and self.number[b].moved < NOT_MOVED

    @ti.func
    def amiss(self, b, pull, wrong):
        """True if surfaces have impulses of this size [J] on body b that they cannot give, or lack them, more than the residual
        may be, or of an unsolved one is, or friction that they cannot give [N s], of a part of what they bear."""
        most = self.number[b].target
        if ti.static(self.order == 1):
            most = ti.max(most, ti.min(self.number[b].residual, self.number[b].moved))
        return pull > most or wrong > WRONG_FRICTION * self.number[b].borne

    @ti.func
    def judge_pull(self, b, pull, wrong):
        """The phase of body b: where impulses of surfaces are `amiss`, it goes on with others."""
        self.number[b].phase = SOLVED
        if ti.static(self.order == 1):
            if self.unsolved(b) == 1:
                self.number[b].phase = READY
        if self.amiss(b, pull, wrong):
            self.number[b].phase = WITHDRAWN
            self.number[b].moved = NOT_MOVED
            self.number[b].releases += 1.0

    @ti.func
    def next_search(self, b):
        """The phase of body b after an iteration of conjugate gradients, or before the first."""
        self.number[b].phase = SEARCHING
        if self.searching(b) == 0:
            self.number[b].phase = FOUND
            self.number[b].change = 1.0
            self.number[b].part = 1.0

    @ti.func
    def judge_change(self, b):
        """The phase of body b after its change was added, or a part of it taken back."""
        self.number[b].change = 0.0
        if self.larger(b) == 1:
            self.number[b].phase = TRIED
        else:
            self.go_on(b)

    @ti.func
    def judge_potential(self, b, raised):
        """The phase of body b, whose potential was raised by its guess or its change, or was not."""
        guessed = self.number[b].phase == DOUBTFUL
        if raised and guessed:
            self.number[b].phase = WITHDRAWN
            self.number[b].change = -1.0
        elif raised:
            part = 0.5 * self.number[b].part
            self.number[b].phase = FOUND
            self.number[b].change = -part
            self.number[b].part = part
            self.number[b].tries += 1.0
        elif guessed:
            self.accept_guess(b)
        else:
            self.go_on(b)

    @ti.func
    def foremost(self):
        """The most urgent phase of all bodies."""
        phase = SOLVED
        if ti.static(self.bodies.several):
            ti.loop_config(serialize=ti.static(self.bodies.few))
            for b in range(self.bodies.count):
                ti.atomic_max(phase, ti.cast(self.number[b].phase, ti.i32))
        else:
            phase = ti.cast(self.number[0].phase, ti.i32)
        return phase

    @ti.func
    def heavy(self, b):
        """True if the next search of body b is one of many on surfaces, which are to leave it no momentum."""
        number = self.number[b]
        many = number.iterations >= HEAVY_ITERATIONS and number.near > 0.0
        return many and number.phase == READY and self.free.mass[b] > 0.0

    @ti.func
    def any_heavy(self):
        """1 if any body is `heavy`, else 0."""
        found = 0
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.heavy(b):
                ti.atomic_max(found, 1)
        return found

    @ti.func
    def report(self):
        """CODES times the most iterations of any present search, and the most urgent phase."""
        most = 0
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            ti.atomic_max(most, ti.cast(self.number[b].searches, ti.i32))
        return CODES * most + self.foremost()

    @ti.func
    def doubtful(self, b):
        """1 if the guess leaves so much that none may be better, else 0."""
        return ti.cast(self.number[b].residual > DOUBTFUL_GUESS**2 * self.number[b].scale, ti.i32)

    @ti.func
    def unsolved(self, b):
        """1 if another iteration is due, else 0: the first is, for a small residual may hide a slow mode. Then not where the
        residual is small, nor where the last change was, unless it gives energy; nor where the residual may be rounding and
        changes do not shrink any more."""
        residual, moved = self.number[b].residual, self.number[b].moved
        iterations = self.number[b].iterations
        least = ti.min(residual, moved)
        finer = ti.select(self.number[b].excess > 0.0, ti.cast(FINER_TARGET, self.wide), 1.0)
        if ti.static(self.holds):
            share = LEFT_OUT * self.number[b].borne / ti.max(self.number[b].lack, 1e-300)
            if share < 1.0:
                finer = ti.min(finer, FINER_TARGET, ti.max(share, 0.01) ** 2)
        if iterations > 0.0 and finer < 1.0 and least <= self.number[b].target:
            finest = self.number[b].scale * self.finest**2
            self.number[b].target = ti.max(finer * least, finest)
        target = self.number[b].target
        large = residual > target and moved > target and self.number[b].searches < MOST_SEARCHES
        if residual < self.number[b].noise and iterations > 1.0:
            large = large and moved < SHRINKING_CHANGE * self.number[b].moved_before
        first = iterations == 0.0 and residual > 0.0
        return ti.cast(first or (large and iterations < MOST_ITERATIONS), ti.i32)

    @ti.func
    def add_gain(self, b, gain):
        """Add the gain of an iteration of conjugate gradients to that of the last ones: where these converge slowly, many small
        gains are left."""
        kept = ti.max(0.0, 1.0 - 1.0 / ti.max(1.0, GAIN_WINDOW * (self.number[b].searches + 1.0)))
        self.number[b].gain = kept * self.number[b].gain + gain

    @ti.func
    def searching(self, b):
        """1 if the search is to go on, else 0: by what the last iterations gained, which sees the slow modes that the residual
        hides.

        What is left, squared in the norm of the matrix, is the sum of all gains to come (Hestenes and Stiefel, 1952).
        """
        forcing = FORCING_TERM
        if ti.static(self.holds and self.order == 1):
            if self.number[b].near > 0.0 and self.number[b].iterations > HEAVY_ITERATIONS:
                forcing = LOOSE_TERM
        goal = ti.max(forcing**2 * self.number[b].moved, 0.1 * self.number[b].target)
        searches = self.number[b].searches
        more = (self.number[b].gain > goal or searches < 2.0) and self.number[b].rz > 0.0
        return ti.cast(more and searches < MOST_SEARCHES, ti.i32)

    @ti.func
    def allow(self, b):
        """Set what part of what acts the residual may become, once it is known how far the change of the step before fits this
        one.

        What is left then is the acceleration's change, of order h, so that this part of its `order`-th power is a part of the
        local error of the method; where a step does not resolve the motion, the tolerance it is.
        """
        force, residual = self.number[b].force, self.number[b].residual
        part = ti.cast(self.tolerance, self.wide)
        if force > 0.0:
            part = ti.min(part, LOCAL_ERROR_PART * (residual / force) ** (0.5 * self.order))
        self.number[b].allowed = ti.max(self.least, part) ** 2

    @ti.func
    def larger(self, b):
        """1 if the change may have gone too far, so that half of it is worth a try, else 0: it raised the residual. It did
        where it raised the potential too. The residual alone may rise where a stiff body rotates. Such changes may follow each
        other without end, so late ones may not raise the potential. Along a whole change its slope starts at -`moved` and ends at
        -`onward`. What the matrix does not know grows at least evenly, so that the mean slope is at most that of both."""
        number = self.number[b]
        larger = number.residual > number.residual_before or number.iterations > PATIENT_ITERATIONS
        falls = number.part == 1.0 and number.onward > -STEEPEST_RISE * number.moved
        return ti.cast(larger and not falls and number.tries < MOST_TRIES, ti.i32)
