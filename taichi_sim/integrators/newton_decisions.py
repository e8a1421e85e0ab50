"""The order in which an implicit stage is solved, what its numbers say about how to go on, and how well it was solved."""

from typing import Any

from taichi_sim.device.engine import ti

__all__ = [
    "BEGUN",
    "CODES",
    "DOUBTFUL",
    "FOUND",
    "HEAVY_ITERATIONS",
    "HELD",
    "HELD_NUMBERS",
    "MISSED_TOLERANCES",
    "NUMBERS",
    "READY",
    "SEARCHING",
    "SOLVED",
    "TALLY",
    "TRIED",
    "WITHDRAWN",
    "Verdicts",
    "compare_potentials",
    "solve_stage",
]

MOST_ITERATIONS = 100  # of Newton's method
PATIENT_ITERATIONS = 20  # after which none may raise the potential
MOST_SEARCHES = 2000  # iterations of conjugate gradients in one of them
MOST_TRIES = 8  # halvings of a change that went too far
DOUBTFUL_GUESS = 0.3  # of the impulses: a guess that leaves more is compared with none
FORCING_TERM = 0.1  # part of the residual that an iteration leaves: more would be lost to what is not linear
LOOSE_TERM = 0.3  # the same, where many iterations have been made on surfaces: more is lost
HEAVY_ITERATIONS = 3  # of Newton's method, after which they are many
GAIN_WINDOW = 0.1  # part of the iterations so far, the last ones, whose gains tell what is left
LOCAL_ERROR_PART = 0.05  # what a solution may add to it
STEEPEST_RISE = 0.5  # of the descent with which a change starts: a potential that rises by less at its end fell in all
SHRINKING_CHANGE = 0.5  # squared changes of two iterations; they do not in mere rounding
GIVEN_PARTS = {1: 0.5, 2: 0.02}  # by order, of (v - v0)^2 m / 2: what a solution may give back
ADDED_NOISE = 4.0  # times the noise that is solved for: what flights add up before that happens
OLD_BLOCKS = 4.0  # times that what acts has become since blocks were made, or one by that
FINER_TARGET = 0.3  # of a squared residual that still gave too much
LEFT_OUT = 0.01  # of what surfaces bear, of momentum
WRONG_FRICTION = 0.05  # of the same
MOST_RELEASES = 8  # times in a stage that what surfaces do to balls is renewed
NOT_MOVED = 1e300  # in place of a change, where there was none since that was renewed
EARLY_RELEASES = 4  # of those, before the stage is solved
EARLY_RESIDUAL = 0.1  # squared residual, of the scale, at which they begin
MISSED_TOLERANCES = 10.0  # a stage that leaves more counts as not solved

# What steers the loops, of each body, in double precision. Sizes of impulses are squares, divided by the block diagonal of the
# matrix [J].
NUMBERS = (
    "phase",  # see below
    *("residual", "force", "scale"),  # of the residual, of what springs do, the larger of that and the kinetic energy
    *(
        "within",
        "noise",
        "load",
    ),  # of what deforms; of a residual that may be rounding; of what acts from outside and deforms
    "scale_of_blocks",  # `scale` when blocks were made
    "flies",  # 1 where nothing but rounding acts, else 0
    *(
        "change",
        "part",
        "tries",
    ),  # multiple of the change to be added next; how much of it was; how often it was halved
    *(
        "residual_before",
        "moved",
        "moved_before",
        "onward",
    ),  # before the change; of the change of this iteration and the last one; what is left of it that leads on
    *("gain", "rz", "step", "saddle"),  # of conjugate gradients: what the last ones gained; see `search`
    *("allowed", "target"),  # part of the scale that the residual may become, and that
    *("iterations", "searches"),  # so many of either kind
    *("excess", "gained"),  # see Verdicts.note_work
    "passes",  # over springs, in this stage
)
# where balls may be held: so many; how often what holds them was renewed; impulses that surfaces bear, and that are left out
# [N s]; what deflation gained of the next change
HELD_NUMBERS = ("near", "releases", "borne", "lack", "shifted")
TALLY = ("solved", "passes", "worst", "misses")  # since the simulation was made, see SolverStatistics; solved: stages

# Phases of a body in a stage: what has to be done for it next, the most urgent last, so that all bodies go on together. HELD: it
# is solved, if surfaces hold those balls that they push, and with the friction that they allow.
SOLVED, HELD, READY, TRIED, FOUND, SEARCHING, DOUBTFUL, WITHDRAWN, BEGUN, CODES = range(10)


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
class Verdicts:
    """Questions that `solve_stage` asks.

    What a solution leaves may not give energy. With the residual r = m (q - v) + s F, the equation of implicit Euler times v says
    that energy changes by -r . v - m (v - v0)^2 / 2 less what convexity and damping take: -r . v has to stay below a part of the
    second term; in the stages of TR-BDF2, which takes less, below a smaller one. The norm of r cannot see this: it divides what
    a stiff spring leaves by s^2 k, and a spring that rotates in a step has v along it. What r gives counts in the frame of the
    body.
    """

    number: Any  # (bodies) of NUMBERS
    tally: Any  # (1) of TALLY
    stage: Any  # (1) what bodies made of this stage
    bodies: Any
    part: Any  # sums over parts of bodies
    wide: Any
    tolerance: float
    order: int
    least: float
    rounding: float
    finest: float
    holds: bool  # whether surfaces may hold balls
    deflates: bool  # whether they may hold those of free bodies, by implicit Euler
    free: Any  # a FreeBodies

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
    def is_rounding(self, b, acting, noise):
        """True if what acts on body b, but for what acts on all of a free one alike, is rounding up to a noise [J]."""
        return acting <= noise and self.number[b].load == 0.0

    @ti.func
    def go_on(self, b):
        """The phase of body b after an iteration of Newton's method, or before the first. Implicit Euler measures what acts
        where the stage is: at a guess that strains a body far it is much larger. Blocks of such a guess are made anew before the
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
