"""Stepper: from step to step, in chunks. At the end of each the state is looked at and kept, and the run begins anew from what is
kept: what follows depends on nothing else. A run that leaves what is safe is warned of, or, where the step was left to the
program, taken back to what was kept and repeated with shorter substeps.

Chunks end at numbers of steps that do not depend on how many steps are asked for at a time. Whatever is repeated comes to the
same bits, so that all decisions belong to numbers of steps: that a ball is lost to the step in which that happens, also where the
look at it comes later; everything else to the end of a chunk.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from taichi_sim.analysis.stability import Stability
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.objects import ball_in_words
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.assembly import Assembly
from taichi_sim.simulation.contact_capacity import ContactCapacity
from taichi_sim.simulation.division import Division
from taichi_sim.simulation.energy_monitor import EnergyMonitor
from taichi_sim.simulation.error_control import ErrorControl
from taichi_sim.simulation.moments import KEPT, LIVE
from taichi_sim.simulation.retry import Retry
from taichi_sim.simulation.run_checks import RunChecks
from taichi_sim.simulation.settings import Settings
from taichi_sim.simulation.state_probe import StateSample, sample_of

__all__ = ["Stepper"]

CHUNK, LONGEST_CHUNK = 256, 4096  # substeps between two ends of chunks
WORK = 1 << 21  # balls and springs gone through in a chunk of small scenes: its end costs about a hundredth


class Stepper:
    """Advances the parts of a simulation, `dt` at a time in `substeps` parts, which its policy decides on: Retry, or, where a
    tolerance is asked for, ErrorControl.

    steps: made since `begin` [s]. mark: what is kept is of that step; end: of the chunk. remembers: whether a method's own memory
    belongs to what is kept. own: forces or a method of the user's, which may do work, and may be changed between calls. watched:
    what is known of substeps that were looked at, see Division, as it was when the present was last kept.
    """

    saved: tuple[str, ...] = (
        "begin",
        "steps",
        "mark",
        "end",
        "substeps",
        "may_shorten",
        "primed",
        "moved",
        "remembers",
        "largest_motion",
        "watched",
    )

    def __init__(
        self, scene: Scene, settings: Settings, parts: Assembly, dt: float, substeps: int, safe: Stability, own: bool
    ) -> None:
        self.scene, self.settings, self.parts, self.safe = scene, settings, parts, safe
        self.dt, self.substeps = dt, substeps
        self.steps, self.begin, self.mark, self.end = 0, 0.0, 0, 0
        self.may_shorten = settings.dt == "auto" and settings.tolerance is None
        longest = CHUNK if own else LONGEST_CHUNK
        self.chunk = int(np.clip(WORK // max(1, scene.n_balls + scene.n_springs), CHUNK, longest))
        self.method = settings.integrator.method
        self.own = own
        self.primed = self.remembers = self._begun = self.halfway = False
        self.moved = False  # by steps, since places were set
        # J, kinetic and elastic, of all looks: reports alone may know of those within a chunk
        self.largest_motion = 0.0
        parts.moments.h[LIVE] = self.h
        self._seen: StateSample | None = None  # of the present state, where it is known
        self.checks, self.retry, self.division = RunChecks(self), Retry(self), Division(self)
        self.watched, self.counts = self.division.known(), parts.moments.counts()
        self.policy: Retry | ErrorControl = self.retry if settings.tolerance is None else ErrorControl(self)
        self.monitor = EnergyMonitor(
            scene,
            self.method,
            self.checks.part_of_bound,
            closed=not self.checks.drivers,
            contacts=parts.contacts.active,
            precision=parts.backend.precision,
        )

    @property
    def h(self) -> float:
        """Seconds per substep."""
        return self.dt / self.substeps

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self.begin + self.steps * self.dt

    def set_time(self, time: float) -> None:
        """Continue from `time` [s]: a number of steps, or, saved with another step, whatever it is."""
        self.steps, self.begin = round(time / self.dt), 0.0
        if abs(self.time - time) > 1e-9 * time:
            self.steps, self.begin = 0, time
        self.mark = self.end = self.steps
        self.policy.forget()

    # Moving on -----------------------------------------------------------------------------------------------------

    def step(self, n: int) -> None:
        """Advance by n steps; 0 only compiles."""
        self._keep_own()
        self.prime()
        if n == 0:
            self.start()
            self.parts.run((self.steps - self.mark) * self.substeps, 0, self.h, self.marked)
        target = self.steps + n
        while self.steps < target:
            self.policy.advance(target)

    def _keep_own(self) -> None:
        """A user's forces may be changed now: steps before are not repeated with them."""
        if self.own and self.primed:
            self.policy.keep()

    def begin_here(self) -> None:
        """Places or velocities were set from outside; nothing of what an interrupted call left is made again over them."""
        self.primed = self.halfway = False
        self._seen = None

    def prime(self) -> None:
        """Make what a step expects, where positions were set from outside."""
        if self.primed:
            return
        self.keep(goes_on=False)
        self.new_chunk()
        self.start()
        sample = self.parts.state_probe.sample()  # also compiles it, so that step(0) leaves nothing to compile
        if sample.bad is not None:
            state = self.parts.state
            x, v = state.position[sample.bad].tolist(), state.velocity[sample.bad].tolist()
            ball = ball_in_words(self.scene.objects, sample.bad)
            says = f"{ball} starts at {x} with {v}; position and velocity must be below 1e12 m and m/s"
            raise SceneError(f"balls.position[{sample.bad}]", says=says)
        self.monitor.start_at(sample)
        self.largest_motion, self.checks.fastest = sample.motion, sample.speed
        self.division.start_at(sample)
        self.watched = self.division.known()
        self.primed, self.moved = True, False
        self.policy.start()

    @property
    def marked(self) -> float:
        """Seconds at what is kept."""
        return self.begin + self.mark * self.dt

    def keep(self, goes_on: bool) -> None:
        """The present state is good. goes_on: a step led to it, so that what the method remembers belongs to it."""
        integrator = self.parts.integrator
        self.division.make_whole()
        self.remembers = goes_on and bool(integrator.memory()) and integrator.remembers()
        self.parts.moments.store(KEPT)
        self.parts.state.keep()
        self.mark = self.steps
        self.watched, self.counts = self.division.known(), self.parts.moments.counts()

    def new_chunk(self) -> None:
        """Begin a chunk, the steps that run before the state is checked again, with this step, from the state last kept."""
        self._begun = False
        self.end = self.steps + max(1, self.chunk // self.substeps)

    def start(self) -> None:
        """Begin anew from what is kept, where the present fields are that: find contacts, with as much room as they need."""
        if self._begun:
            return
        self.parts.prime(self.h, self.marked)
        while (needed := self.parts.lacking()) is not None:
            self._make_room(needed)
            self.parts.prime(self.h, self.marked)
        if self.remembers:
            self.parts.moments.remember(KEPT)
            self.parts.integrator.recall()
        self._begun = True
        self._seen = None  # contacts may have changed velocities

    def _make_room(self, needed: ContactCapacity) -> None:
        """Go back to what is kept, with room for what is needed. Raises SceneError where there is none."""
        self.go_back()
        self.parts = self.parts.with_capacity(needed)
        self.parts.moments.load(KEPT, self.h)
        said = f"from t = {self.marked:.6g} s on more room for contacts"
        if said not in self.checks.decisions:
            self.checks.decisions.append(said)

    def go_back(self) -> None:
        """Go back to what is kept."""
        self.parts.set_step(self.h, holds=False)  # a substep may have been interrupted in parts
        self.parts.state.restore()
        self.parts.moments.load(KEPT, self.h)
        self.steps, self._begun, self.halfway = self.mark, False, False
        self._seen = None
        self.division.put_back(self.watched)
        self.parts.moments.recount(self.counts)

    def run_to(self, target: int) -> StateSample:
        """Run up to a number of steps. Where contacts did not fit, run from what is kept again with more room, to the same bits
        as if it had been there from the beginning."""
        if self.halfway:  # interrupted, perhaps in the midst of a step
            self.go_back()
        self.start()
        if target > self.steps:
            self._launch(target)
        while (needed := self.parts.lacking()) is not None:
            self._make_room(needed)
            self.start()
            self._launch(target)
        return self.look()

    def look(self) -> StateSample:
        """Sample of the state that `run_to` or `go_back` led to, taken once."""
        if self._seen is None:
            self._seen = self.parts.state_probe.sample()
        return self._seen

    def _launch(self, target: int) -> None:
        first, substeps = (self.steps - self.mark) * self.substeps, (target - self.steps) * self.substeps
        self.halfway = True
        if self.checks.watches_steps:
            self._launch_each(first, substeps)
        else:
            self._seen = None
            self.parts.run(first, substeps, self.h, self.marked)
        self.steps, self.halfway = target, False

    def _launch_each(self, first: int, substeps: int) -> None:
        """Run substeps one at a time, and look at what each gains."""
        seen = self.look()
        for number in range(first, first + substeps):
            self._seen = None
            self._seen = seen = self.division.advance(number, seen)

    def divide(self, substeps: int) -> None:
        """Take so many substeps from now on, from what is kept."""
        self.substeps = substeps
        self.go_back()

    # To a snapshot and back ----------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """All that a run needs to go on with the same bits: what is kept, and how many steps lead from there to the present."""
        if not self.scene.n_balls:
            return replace(self.parts.snapshot(), time=self.time, stepping={"of": self._kind()})
        self.policy.before_snapshot()
        parts = self.parts
        stepping = {
            "of": self._kind(),
            **{name: getattr(owner, name) for owner in (self, self.policy) for name in owner.saved},
            "h": list(parts.moments.h),
            "room": list(parts.room),
            "monitor": self.monitor.stored(),
            **self.checks.stored(),
            **self.policy.stored(),
        }
        return replace(parts.snapshot(), time=self.time, stepping=stepping, memory=parts.stored() | self.counts)

    def _kind(self) -> str:
        """Settings that a run depends on besides the scene and what is kept: none with other settings has the same bits."""
        parts = self.parts
        own = (type(self.policy).__name__, self.method, self.dt, parts.backend.precision, parts.contacts.name)
        return " ".join(map(str, (*own, parts.contacts.iterations, parts.order_of_sums)))

    def resume(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot. Raises SceneError, and changes nothing, for what does not fit."""
        if not self.scene.n_balls or snapshot.stepping.get("of") != self._kind():
            self._begin_at(snapshot)
            return
        try:
            values = self._checked(snapshot)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            raise SceneError("stepping", says=f"is not what Simulation.snapshot gives ({error})") from None
        self._put_back(values, snapshot)
        if not self.policy.reaches(snapshot):
            self.checks.warn(
                "machine",
                "what is computed here differs from what was saved, as on another machine or in another scene: it goes on from"
                " the positions saved",
            )
            self._begin_at(snapshot)

    def _begin_at(self, snapshot: Snapshot) -> None:
        """Begin a run at the present state of a snapshot."""
        self.set_time(snapshot.time)
        if self.scene.n_balls:
            self.parts.resume(snapshot)
            self.parts.contacts.forget()
            self.begin_here()

    def _checked(self, snapshot: Snapshot) -> dict[str, Any]:
        """The plain values of a snapshot of this run."""
        given = snapshot.stepping
        owners = {name: owner for owner in (self, self.policy) for name in owner.saved}
        values = {name: _as_is(getattr(owner, name), given[name]) for name, owner in owners.items()}
        steps, mark, end, substeps = (values[name] for name in ("steps", "mark", "end", "substeps"))
        most = max(1, self.chunk // self.retry.first)
        if not (
            0 <= mark <= steps <= end <= mark + most and 1 <= substeps < 1 << 31 and values["largest_motion"] >= 0.0
        ):
            raise ValueError(f"steps {steps} from {mark} to {end} in {substeps} parts")
        if not abs(values["begin"] + steps * self.dt - snapshot.time) <= 1e-9 * snapshot.time:
            raise ValueError(f"{steps} steps since {values['begin']} s end at another time than {snapshot.time} s")
        Division(self).put_back(values["watched"])
        self.checks.read(given)
        room = ContactCapacity(*(int(entries) for entries in given["room"]))
        if any(one > have for one, have in zip(room, self.parts.room)):
            self.parts = self.parts.with_room(room)
            self.primed = False  # what contacts held is gone
        self.parts.check(snapshot.memory, given["h"])
        _monitored(given["monitor"])
        return values | self.policy.read(given)

    def _put_back(self, values: Mapping[str, Any], snapshot: Snapshot) -> None:
        """The plain values, and what was kept."""
        self.parts.resume(snapshot)
        self.parts.put_back(snapshot.memory, snapshot.stepping["h"])
        for name, value in values.items():
            setattr(self if name in self.saved else self.policy, name, value)
        self.counts = self.parts.moments.counts()
        self.checks.put_back(snapshot.stepping)
        self.parts.set_step(self.h, holds=False)
        monitored = _monitored(snapshot.stepping["monitor"])
        if monitored is not None:
            self.monitor.put_back(monitored)


def _monitored(given: Any) -> list[Any] | None:
    """Values from which an energy monitor goes on, of a snapshot's plain values."""
    if given is None:
        return None
    least, most, last, low, *rest = given
    start, held, risen = map(float, rest)
    return [float(least), float(most), sample_of(last), None if low is None else sample_of(low), start, held, risen]


def _as_is(present: Any, given: Any) -> Any:
    """A plain value of the type that it has at present; one that may be missing is a number."""
    kind = float if present is None else type(present)
    return None if given is None and kind is float else kind(given)
