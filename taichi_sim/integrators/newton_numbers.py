"""Numbers that steer how an implicit stage is solved, and what all parts of its solver know of it."""

from typing import Any

from taichi_sim.device.engine import ti

__all__ = [
    "ADDED_NOISE",
    "BEGUN",
    "CODES",
    "DOUBTFUL",
    "DOUBTFUL_GUESS",
    "EARLY_RELEASES",
    "EARLY_RESIDUAL",
    "FINER_TARGET",
    "FORCING_TERM",
    "FOUND",
    "GAIN_WINDOW",
    "GIVEN_PARTS",
    "HEAVY_ITERATIONS",
    "HELD",
    "HELD_NUMBERS",
    "LEFT_OUT",
    "LOCAL_ERROR_PART",
    "LOOSE_TERM",
    "MISSED_TOLERANCES",
    "MOST_ITERATIONS",
    "MOST_RELEASES",
    "MOST_SEARCHES",
    "MOST_SIZE",
    "MOST_TRIES",
    "NOT_MOVED",
    "NUMBERS",
    "OLD_BLOCKS",
    "PATIENT_ITERATIONS",
    "READY",
    "SEARCHING",
    "SHRINKING_CHANGE",
    "SOLVED",
    "STEEPEST_RISE",
    "TALLY",
    "TRIED",
    "WITHDRAWN",
    "WRONG_FRICTION",
    "Stage",
]

MOST_ITERATIONS = 300  # of Newton's method: crumpled steel takes more than 200 in a step of 1/60 s
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
MOST_SIZE = 1e300  # J, of a residual that is a number
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


@ti.data_oriented
class Stage:
    """Members that the parts of a StageSolver share, see there and HeldBalls."""

    number: Any  # (bodies) of NUMBERS
    tally: Any  # (1) of TALLY
    stage: Any  # (1) what bodies made of this stage
    bodies: Any
    part: Any  # sums over parts of bodies
    wide: Any
    tolerance: float
    order: int
    measures_anew: bool  # whether what acts is measured in each round
    least: float
    rounding: float
    finest: float
    holds: bool  # whether surfaces may hold balls
    deflates: bool  # whether they may hold those of free bodies, by implicit Euler
    free: Any  # a FreeBodies
    model: Any
    base: Any  # see StageSolver, for these
    q: Any
    kick: Any
    first: Any
    low: Any
    dv: Any  # (n) [m/s] change of the velocities to be added
    ahead: Any  # (n) base, padded: x, with what rounding took from it, in double precision
    sum: Any  # (n) residual, then what a search leaves of it
    product: Any
    residual: Any
    inverse_block: Any  # (n) of the diagonal
    swings: bool  # whether contacts ask how balls swing
    part_of_step: float  # that a stage takes
    rough: Any
    levels: Any
    held: Any  # a HeldBalls
    rubs: bool  # whether there is friction
    turns: Any
    turns_freely: bool
    deflation: Any
    springs: Any
    has_springs: bool
    damped: bool
    start: Any  # of each ball's springs in own_spring
    own_spring: Any
    spring_block: Any
    potential_start: Any
    potential_entry: Any
    elements: Any
    has_elements: bool
    gas: Any
    inflated: bool
    n: int
    dim: int
    eps: float
    eps_of_places: float

    @ti.func
    def mass(self, i):
        """Mass of ball i [kg]; 0 where it is pinned."""
        w = self.model.inverse_mass[i]
        return ti.select(w > 0.0, 1.0 / ti.select(w > 0.0, w, 1.0), 0.0)
