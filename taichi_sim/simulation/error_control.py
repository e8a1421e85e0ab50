"""ErrorControl: the number of substeps is chosen by the error, measured over the whole run by a second solution.

Each step is made twice: with n substeps by the solution that is kept, and by a second solution whose substeps are twice as
long. Both go on by themselves from the start, so that the largest distance D of a ball between them has all that was added to
the error and all that the motion made of it since, in positions, as the user will see it.

Smooth motion: with errors e and 2^p e, p the order of the method, D = (2^p - 1) e. The order is not trusted to the last power of
two, for what is not resolved shows less of it: e <= MARGIN D / (2^(p - 1) - 1), or MARGIN D for p < 2.

Contacts: one may be noticed at the end of the substep h in which it begins, up to h late, and both solutions would notice it at
the same instant wherever they share one: D would be 0, however wrong both are. So the second solution's instants, 2 h apart,
lie in the middle between the others: it is LAG h behind. Whenever a contact begins, the two notice it h/2 apart at least, and
the error is h at most: e <= 2 D. What has begun in the last substep moves nothing yet, so both are compared one substep later,
each brought there by one that is thrown away.

Asked: at most tolerance x size of the scene for each simulated second, of any ball, from the first quarter of one on; size: the
longest side of the box around all balls. Where the estimate is more than that by now, both go back to where they began and repeat
all steps, with as many substeps as the order asks for; what was shown meanwhile was within the tolerance. They began at the
start, or where the state was last set from outside, or, with user-defined forces, which may have been changed meanwhile, where
`step` was last called. Where substeps are as short as they may become, or what was there when they began is too much, the
tolerance cannot be kept: that is said once, and the run goes on with fewer substeps.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple
from weakref import proxy

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.stability import coarsest_spring
from taichi_sim.common.errors import SceneError
from taichi_sim.kernels.contacts import statistics
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.energy_monitor import size
from taichi_sim.simulation.state_probe import StateSample
from taichi_sim.simulation.step_doubling import AHEAD, BEGUN, COARSE, FINE, NEXT, START, SecondSolution

__all__ = ["ErrorControl", "ErrorEstimate", "check_digits"]

HEAD = 0.25  # s, for which a run may be off as much from its start on
LAG = 1.5  # substeps by which the second solution is behind where there are contacts
AIM = 0.5  # of what is allowed, after going back
MARGIN = 1.25
FEWEST, MOST_TIMES = 2.0, 16.0  # times as many substeps after going back
DOUBLINGS = 16  # of the substeps, from what stability asks
WORK = 1 << 27  # balls and springs gone through in a simulated second: the most, or 4 times what stability asks
ALONE = 16  # balls' worth of what a substep of none would take
AFTER = 8  # times what stability asks: the most once the tolerance is lost
WINDOW = 64  # steps in which rounding may not use up what is allowed
MANY_CONTACTS = 3  # at once, or one of what springs join: both solutions may decide alike, and wrongly, how they act
ROUNDINGS = 4.0  # units of rounding that a window, or a substep, may add by itself


class ErrorEstimate(NamedTuple):
    """Result of error control. `tolerance`: asked, parts of `size` [m] a simulated second; `estimate`: the largest error of a
    ball so far, in parts of `size`; `lost`: since when the tolerance is not kept [s], or None; `unsure`: since when so many
    contacts act at once that the estimate is no promise [s], or None; `least`, `most`: substeps of a step; `repeated`: how
    often the run went back to repeat its steps with more of them."""

    tolerance: float
    size: float
    estimate: float
    lost: float | None
    unsure: float | None
    least: int
    most: int
    repeated: int


def check_digits(scene: Scene, tolerance: float, precision: str, dt: float, substeps: int, compensated: bool) -> None:
    """Raise SceneError where rounding alone adds more than the tolerance: a window about the rounding of positions, and, where
    sums are not compensated, each substep as much, in random directions; and where springs are so stiff that their load does not
    show in single precision, so that both solutions are off alike and their distance tells nothing."""
    eps = float(np.finfo(np.float32 if precision == "f32" else np.float64).eps)
    far = float(np.max(np.abs(scene.position), initial=0.0))
    least = ROUNDINGS * eps * far * np.sqrt(1 if compensated else WINDOW * substeps) / (WINDOW * dt * size(scene))
    if tolerance < least:
        cure = 'use precision "f64"' if precision == "f32" else "build the scene nearer to the origin"
        says = f"is less than what rounding leaves in {precision}, {least:.2g} of the scene's size a second; {cure}"
        raise SceneError("tolerance", tolerance, says=says)
    found = coarsest_spring(scene) if precision == "f32" else None
    if found is not None:
        spring, stretch, rounding = found
        raise SceneError(
            "tolerance",
            says=f"cannot be met in f32: the weight at spring {spring} stretches it by {stretch:.2g} m, and positions there are"
            f' told {rounding:.2g} m apart; use precision "f64", or softer springs',
        )


class ErrorControl:
    """Policy of a run, a Stepper, see above. many: substeps of the solution that is kept, an even number."""

    saved = ("many", "error", "past", "taken", "least", "most", "repeated", "lost", "unsure", "began", "lag")

    def __init__(self, run: Any) -> None:
        self.run: Any = proxy(run)  # no circle: what is dropped frees its memory at once
        scene, settings, dt, substeps = run.scene, run.settings, run.dt, run.substeps
        self.size = size(scene)
        self.share = settings.tolerance * self.size * dt  # m, of one step
        self.floor = substeps  # stability, and what piles need
        many = WORK * dt / (ALONE + scene.n_balls + scene.n_springs)
        self.ceiling = int(min(self.floor << DOUBLINGS, max(4 * self.floor, many)))
        order = max(1, settings.integrator.method.order)
        if (
            settings.integrator.implicit_damping
            and np.bincount(scene.pairs[scene.damping > 0].ravel()).max(initial=0) > 1
        ):
            order = 1  # of the damping halves in a network
        self.order = 1 if run.parts.contacts.active else order
        self.scale = 2.0 if run.parts.contacts.active else MARGIN / (2.0 ** max(1, order - 1) - 1.0)
        self.many = substeps
        self.error = self.past = 0.0  # m: since the start of both solutions, and before
        self.taken = 0  # steps in all
        self.least, self.most, self.repeated = substeps, substeps, 0
        self.lost: float | None = None
        self.unsure: float | None = None
        self.began = False  # whether there was a memory of the method's when both began
        self.lag = 0.0  # s, by which the second solution is behind
        self._ahead = 0.0  # the same one step on
        self._mark: tuple[Any, ...] = ()

    def report(self) -> ErrorEstimate:
        """Tolerance that was asked for, and the error that was found."""
        unit = self.size
        return ErrorEstimate(
            self.share / (unit * self.run.dt),
            unit,
            max(self.past, self.error) / unit,
            self.lost,
            self.unsure,
            self.least,
            self.most,
            self.repeated,
        )

    # One step --------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start both solutions at the present positions, which were set from outside."""
        self._second.store(FINE)
        self._second.store(COARSE)
        self.run.remembers, self.lag = False, 0.0
        self.past = max(self.past, self.error)
        self.keep()

    def forget(self) -> None:
        """Another run begins, which nothing is known of."""
        self.many = self.least = self.most = self.floor
        self.error, self.past, self.taken, self.repeated = 0.0, 0.0, 0, 0
        self.lost = self.unsure = None

    def keep(self) -> None:
        """Store the present state of both solutions as the one to go back to."""
        self._second.copy(START, FINE)
        self._second.copy(BEGUN, COARSE)
        run, monitor = self.run, self.run.monitor
        self.began = run.remembers
        own = (run.steps, self.taken, self.error, self.lag, self.least, self.most)
        self._mark = (*own, monitor.least, monitor.most, monitor.last)

    def _back_to_begin(self) -> None:
        self._second.copy(FINE, START)
        self._second.copy(COARSE, BEGUN)
        run, monitor = self.run, self.run.monitor
        run.remembers = self.began
        run.steps, self.taken, self.error, self.lag, self.least, self.most = self._mark[:6]
        monitor.least, monitor.most, monitor.last = self._mark[6:]
        monitor.low = monitor.last

    def advance(self, target: int) -> None:
        """Make a step, or go back to where both solutions began, where the steps before need more substeps."""
        run, (sample, error) = self.run, self._try()
        if not (error <= self._allowed() or self.lost is not None or self._lose(sample, error)):
            self._go_back(error)
            return
        if sample.bad is not None:
            self._lost(sample.bad)
        self._second.copy(FINE, NEXT)
        self._second.copy(COARSE, AHEAD)
        self.lag = self._ahead
        run.remembers = bool(run.parts.integrator.memory())
        growth = run.monitor.judge(sample)
        if growth is not None:
            run.checks.warn_of(growth, repeats=False)
        run.checks.look_at_energy(sample)
        run.steps += 1
        run.mark = run.end = run.steps
        run.moved = True
        run.checks.after(self.many)
        first = self.taken == self._mark[1] == 0
        self.least = self.many if first else min(self.least, self.many)
        self.most = self.many if first else max(self.most, self.many)
        self.error = error
        self.taken += 1
        if self.unsure is None and run.parts.contacts.active:
            self._doubt()
        if self.lost is not None:
            self.many = min(self.many, AFTER * self.floor)

    def _allowed(self) -> float:
        """The error [m] that there may be after this step."""
        return self.share * max(self.taken + 1, HEAD / self.run.dt)

    def _lose(self, sample: Any, error: float) -> bool:
        """Warn that the tolerance is lost, if nothing can be done about this error. Returns True if so."""
        run, before = self.run, max(self.past, self._mark[2])
        if self.many < self.ceiling and (before < AIM * self._allowed() or not np.isfinite(error)):
            return False
        if not np.isfinite(error):
            self._lost(0 if sample.bad is None else sample.bad)
        self.lost = run.time + run.dt
        run.checks.warn(
            "tolerance",
            f"the tolerance of {self.share / (self.size * run.dt):g} a second cannot be kept from t = {self.lost:.6g} s on: the"
            f" error there is about {error / self.size:.2g} of the scene's size, more than {self._allowed() / self.size:.2g},"
            f" with substeps of {run.dt / self.many:.2g} s; where small differences grow, as where many balls meet, no step is"
            " short enough",
        )
        return True

    def _go_back(self, error: float) -> None:
        """All steps once more, with more substeps."""
        times = MOST_TIMES
        if np.isfinite(error):
            times = (error / (AIM * self._allowed())) ** (1.0 / self.order)
        wanted = self.many * float(np.clip(times, FEWEST, MOST_TIMES))
        self.repeated += 1
        self._back_to_begin()
        self.many = min(2 * int(np.ceil(0.5 * wanted)), self.ceiling)

    def _try(self) -> tuple[Any, float]:
        """The second solution goes one step ahead, then the solution; a sample of it, and the error [m] by then."""
        run = self.run
        h = run.dt / self.many
        begin = run.time - self.lag
        self._ahead = LAG * h if run.parts.contacts.active else 0.0
        way = run.dt + self.lag - self._ahead
        many = max(1, int(np.ceil(way / (2.0 * h) * (1.0 - 1e-9))))
        self._from(COARSE, begin, many, way / many)
        self._second.store(AHEAD)
        if self._ahead > 0.0:
            self._from(AHEAD, begin + way, 1, self._ahead + h)
        self._second.show()
        self._from(FINE, run.time, self.many, h)
        self._second.store(NEXT)
        run.substeps, sample = self.many, run.parts.state_probe.sample()
        if self._ahead > 0.0:
            self._from(NEXT, run.time + run.dt, 1, h)
        apart = self.scale * self._second.apart()
        if self._ahead > 0.0:
            self._at(NEXT, run.time + run.dt, h)
        return sample, max(self.error, self.past + apart)

    @property
    def _second(self) -> SecondSolution:
        assert isinstance(self.run.parts.moments, SecondSolution)
        return self.run.parts.moments

    def _from(self, moment: int, time: float, many: int, h: float) -> None:
        """Run from a stored moment at `time`, in `many` substeps of h seconds; anew where contacts did not fit."""
        needed: Any = True
        while needed is not None:
            self._at(moment, time, h)
            self.run.parts.run(0, many, h, time)
            needed = self.run.parts.lacking()
            if needed is not None:
                self.run.parts = self.run.parts.with_capacity(needed)

    def _at(self, moment: int, time: float, h: float) -> None:
        """All as in a stored moment at `time`, before substeps of h seconds."""
        parts = self.run.parts
        parts.set_step(h, anew=True, holds=False)
        self._second.load(moment, h)
        parts.prime(h, time)
        if (self.run.remembers or moment in (NEXT, AHEAD)) and parts.integrator.memory():
            self._second.remember(moment)  # lists may have grown: all but the state is new then
            parts.integrator.recall()

    def _doubt(self) -> None:
        """Say once where contacts act together, or on bodies that shake: thresholds that go with h choose between bouncing,
        sticking and sliding, and both solutions may choose alike where much shorter substeps choose otherwise."""
        number = int(self.run.parts.contact_statistics()[statistics.NUMBER])
        joined = self.run.scene.joined() & ~self.run.scene.pinned
        if number >= (1 if joined.any() else MANY_CONTACTS) or self._may_have_met(joined):
            what = (
                f"{number} contacts act at once" if number >= MANY_CONTACTS else "what springs join touches something"
            )
            self.unsure = self.run.time
            self.run.checks.warn(
                "unsure",
                f"the tolerance is no promise from t = {self.run.time:.6g} s on, where {what}: whether contacts bounce, stick or"
                " slide may be decided alike at both steps that are compared. Of 160 such runs 155 kept it, the others were"
                " over by up to 4 times",
            )

    def _may_have_met(self, which: NDArray[np.bool_]) -> bool:
        """True if any of these balls was as near to a wall or a collider in this step as it moves in one: what bounces in
        between leaves no contact at the end."""
        run, scene, state = self.run, self.run.scene, self.run.parts.state
        x, speed = state.position[which], np.linalg.norm(state.velocity[which], axis=1)
        reach = scene.radius[which] + (speed + run.dt * float(np.linalg.norm(scene.gravity))) * run.dt
        for wall in scene.walls:
            if np.any(x @ np.asarray(wall.normal) - wall.offset < reach):
                return True
        for collider in scene.colliders:
            centre, _ = collider.motion.at(run.time)
            near = np.linalg.norm(x - centre[0], axis=1) < collider.extent + reach
            if near.any() and (collider.is_meshed or np.any(collider.distance(x[near], run.time) < reach[near])):
                return True
        return False

    def _lost(self, ball: int) -> None:
        """A ball is where none can be after this step; the one before is kept."""
        self._second.load(FINE, self.run.dt / self.many)
        self.run.retry.fail(ball)

    # To a snapshot and back ----------------------------------------------------------------------------------------

    def before_snapshot(self) -> None:
        """Start both solutions, if they have not begun."""
        self.run.prime()

    def stored(self) -> dict[str, Any]:
        """Plain values, besides those `saved`: where both solutions began."""
        return {"noted": [*self._mark[:-1], list(self._mark[-1])]} if self._mark else {}

    def read(self, plain: Mapping[str, Any]) -> dict[str, Any]:
        """Values of what `stored` gave. Raises KeyError, TypeError or ValueError for anything else."""
        *mark, last = plain["noted"]
        if len(mark) != 8 or not mark[0] <= plain["steps"]:
            raise ValueError(f"begun at {mark}")
        return {"_mark": (*mark, StateSample(*last))}

    def reaches(self, snapshot: Any) -> bool:
        """Both solutions are where the snapshot is."""
        self._at(FINE, self.run.time, self.run.dt / self.many)
        return True
