"""Stepper: from step to step, in chunks. At the end of each the state is looked at and kept, and the run begins anew from what is
kept: what follows depends on nothing else. A run that leaves what is safe is warned of, or, where the step was left to the
program, taken back to what was kept and repeated with shorter substeps.

Chunks end at numbers of steps that do not depend on how many steps are asked for at a time. Whatever is repeated comes to the
same bits, so that all decisions belong to numbers of steps: that a ball is lost to the step in which that happens, also where the
look at it comes later; everything else to the end of a chunk.
"""

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.outcome import DEEP, STARTS_DEEP, Scales, cure_of_depth, takers
from taichi_sim.analysis.stability import Stability, explicit_parts, present_limit
from taichi_sim.analysis.touching import overlap, overlap_at_start
from taichi_sim.common.errors import SceneError, UnstableError
from taichi_sim.kernels.contacts import statistics
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.objects import ball_in_words, pair_in_words
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.assembly import Assembly, ContactCapacity
from taichi_sim.simulation.energy_monitor import LARGEST_PART, EnergyMonitor, Growth, size
from taichi_sim.simulation.moments import KEPT, LIVE
from taichi_sim.simulation.settings import Settings
from taichi_sim.simulation.state_probe import StateSample

__all__ = ["Stepper"]

CHUNK, LONGEST_CHUNK = 256, 4096  # substeps between two ends of chunks
RUSH = 0.2  # of the smallest radius: moves in a substep, above which crowds lie deep in each other
WORK = 1 << 21  # balls and springs gone through in a chunk of small scenes: its end costs about a hundredth
LOOKS_PER_BOUND = 16  # from one bound for the present shape to the next, in scenes of at most
MOST_BOUNDED = 20_000  # balls and springs
MOST_HALVINGS = 6  # of the substep that a run began with, before it is given up
# times the energy by another step: work that was done; by a crowd it differs from one moment to the next, while what is
# unstable grows a hundredfold, or not at all
SAME_ENERGY = 10.0


class Stepper:
    """Advances the parts of a simulation, `dt` at a time in `substeps` parts.

    steps: made since `begin` [s]. mark: what is kept is of that step; end: of the chunk. remembers: whether a method's own memory
    belongs to what is kept. own: forces or a method of the user's, which may do work, and may be changed between calls.
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
    )

    def __init__(
        self, scene: Scene, settings: Settings, parts: Assembly, dt: float, substeps: int, safe: Stability, own: bool
    ) -> None:
        self.scene, self.settings, self.parts, self.safe = scene, settings, parts, safe
        self.dt, self.substeps, self._first_substeps = dt, substeps, substeps
        self.steps, self.begin, self.mark, self.end = 0, 0.0, 0, 0
        self.may_shorten = settings.dt == "auto"
        longest = CHUNK if own else LONGEST_CHUNK
        self.chunk = int(np.clip(WORK // max(1, scene.n_balls + scene.n_springs), CHUNK, longest))
        self.method = settings.integrator.method
        self.own = own
        self.primed = self.remembers = self._begun = self._halfway = False
        self._warned: set[str] = set()
        self.decisions: list[str] = []  # what was decided on the way, in words, each with its time
        self._looks, self._unseen = 0, 0
        part = self.h / safe.dt_any_shape if safe.dt_any_shape > 0 else 0.0
        moves = parts.colliders is not None and parts.colliders.moves
        self.drivers = tuple(self._drivers(moves))
        self.size = size(scene)
        self.squeezes = parts.contacts.active and (moves or bool(scene.moving_pins))
        self._fastest = 0.0  # m/s, of all looks
        self._rush = RUSH * float(scene.radius.min()) if parts.plan.pairs else np.inf  # m a substep
        self.moved = False  # by steps, since places were set
        # J, kinetic and elastic, of all looks: reports alone may know of those within a chunk
        self.largest_motion = 0.0
        parts.moments.h[LIVE] = self.h
        self.monitor = EnergyMonitor(
            scene,
            self.method,
            part,
            closed=not self.drivers,
            contacts=parts.contacts.active,
            precision=parts.backend.precision,
        )
        # beyond the bound for every shape the present one decides; where nothing is safe that was said at the start
        self._single = parts.backend.precision == "f32"
        self.solves = parts.integrator.solver_report() is not None
        self.strays = part > 1.0 + 1e-9

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

    # Moving on -----------------------------------------------------------------------------------------------------

    def step(self, n: int) -> None:
        """Advance by n steps; 0 only compiles."""
        self._keep_own()
        self.prime()
        if n == 0:
            self._start()
            self.parts.run((self.steps - self.mark) * self.substeps, 0, self.h, self._marked)
        target = self.steps + n
        while self.steps < target:
            self._go_on(min(target, self.end))

    def _keep_own(self) -> None:
        """A user's forces may be changed now: steps before are not repeated with them."""
        if self.own and self.primed and self.steps > self.mark and not self._halfway:
            self._keep(goes_on=True)

    def begin_here(self) -> None:
        """Places or velocities were set from outside; nothing of what an interrupted call left is made again over them."""
        self.primed = self._halfway = False

    def prime(self) -> None:
        """Make what a step expects, where positions were set from outside."""
        if self.primed:
            return
        self._keep(goes_on=False)
        self._new_chunk()
        self._begun = False
        self._start()
        sample = self.parts.state_probe.sample()  # also compiles it, so that step(0) leaves nothing to compile
        if sample.bad is not None:
            state = self.parts.state
            x, v = state.position[sample.bad].tolist(), state.velocity[sample.bad].tolist()
            ball = ball_in_words(self.scene.objects, sample.bad)
            says = f"{ball} starts at {x} with {v}; position and velocity must be below 1e12 m and m/s"
            raise SceneError(f"balls.position[{sample.bad}]", says=says)
        self.monitor.begin(sample)
        self.largest_motion, self._fastest = sample.motion, sample.speed
        self.primed, self.moved = True, False

    @property
    def _most(self) -> int:
        """Substeps of a step, the most that are tried."""
        return self._first_substeps << MOST_HALVINGS

    @property
    def _marked(self) -> float:
        """Seconds at what is kept."""
        return self.begin + self.mark * self.dt

    def _keep(self, goes_on: bool) -> None:
        """The present state is good. goes_on: a step led to it, so that what the method remembers belongs to it."""
        integrator = self.parts.integrator
        self.remembers = goes_on and bool(integrator.memory()) and integrator.remembers()
        self.parts.moments.store(KEPT)
        self.parts.state.keep()
        self.mark = self.steps

    def _new_chunk(self) -> None:
        self.end = self.steps + max(1, self.chunk // self.substeps)

    def _start(self) -> None:
        """Begin anew from what is kept, where the present fields are that: find contacts, with as much room as they need."""
        if self._begun:
            return
        self.parts.prime(self.h, self._marked)
        while (needed := self.parts.lacking()) is not None:
            self._make_room(needed)
            self.parts.prime(self.h, self._marked)
        if self.remembers:
            self.parts.moments.remember(KEPT)
            self.parts.integrator.recall()
        self._begun = True

    def _make_room(self, needed: ContactCapacity) -> None:
        """Go back to what is kept, with room for what is needed. Raises SceneError where there is none."""
        self._back()
        self.parts = self.parts.with_capacity(needed)
        self.parts.moments.load(KEPT, self.h)
        said = f"from t = {self._marked:.6g} s on more room for contacts"
        if said not in self.decisions:
            self.decisions.append(said)

    def _back(self) -> None:
        """Go back to what is kept."""
        self.parts.state.restore()
        self.parts.moments.load(KEPT, self.h)
        self.steps, self._begun, self._halfway = self.mark, False, False

    def _run(self, target: int) -> StateSample:
        """Run up to a number of steps. Where contacts did not fit, run from what is kept again with more room, to the same bits
        as if it had been there from the beginning."""
        if self._halfway:  # interrupted, perhaps in the midst of a step
            self._back()
        self._start()
        if target > self.steps:
            self._launch(target)
        while (needed := self.parts.lacking()) is not None:
            self._make_room(needed)
            self._start()
            self._launch(target)
        return self.parts.state_probe.sample()

    def _launch(self, target: int) -> None:
        first = (self.steps - self.mark) * self.substeps
        self._halfway = True
        self.parts.run(first, (target - self.steps) * self.substeps, self.h, self._marked)
        self.steps, self._halfway = target, False

    def _go_on(self, target: int) -> None:
        """Run up to a number of steps, the end of the chunk at most, and look at the result."""
        first = self.steps
        sample = self._run(target)
        if sample.bad is not None:
            sample = self._find_again(target)
        whole = target == self.end
        growth = self.monitor.judge(sample) if whole else self.monitor.growth(sample, self.largest_motion)
        if growth is None:
            self.largest_motion = max(self.largest_motion, sample.motion)
        elif not self.may_shorten:
            self._warn_of(growth)
        elif whole:
            self._shorten(growth)
        self.moved = True
        self._fastest = max(self._fastest, sample.speed)
        if whole:
            self._keep(goes_on=True)
            self._begun = False
            self._new_chunk()
        self._check((target - first) * self.substeps)

    def _check(self, substeps: int) -> None:
        """Check the run after so many substeps; it changes nothing."""
        self._check_solver()
        if (
            self.strays
            and self._looks % LOOKS_PER_BOUND == 0
            and self.scene.n_balls + self.scene.n_springs <= MOST_BOUNDED
        ):
            self._check_bound()
        self._looks += 1
        self._unseen += substeps
        if self._unseen >= CHUNK:
            self.look_at_depth(8)

    def look_at_depth(self, stacklevel: int) -> None:
        """Warn where balls lie deep in something, if anything here may bring them there: what moves, or speed."""
        if self._unseen and (self.squeezes or self._rushes):
            self._unseen = 0
            self.contact_statistics(stacklevel)

    @property
    def _rushes(self) -> bool:
        """True if a ball has been so fast that contacts may not have held it."""
        return self._fastest * self.h > self._rush

    def contact_statistics(self, stacklevel: int = 4) -> NDArray[np.float64]:
        """Statistics of all contacts, see kernels.contacts.statistics. Warns once, of the line that many calls further out, where
        steps have brought balls deep into something."""
        totals = self.parts.contact_statistics()
        part = float(totals[statistics.LARGEST_PART])
        if part > DEEP and (self.moved or self.time == 0.0):
            self._warn_of_depth(int(totals[statistics.BALL]), part, stacklevel + 1)
        return totals

    def _warn_of_depth(self, ball: int, part: float, stacklevel: int) -> None:
        scene, position = self.scene, self.parts.state.position
        began = overlap_at_start(scene, position, self.time, ball, part)
        if began > DEEP:
            where = overlap(scene, scene.position, 0.0, ball, began)
            self._warn(STARTS_DEEP, f"at the start {where}: {STARTS_DEEP}", stacklevel)
        elif self.moved:
            where = overlap(scene, position, self.time, ball, part)
            cure = cure_of_depth(self.squeezes, self._rush / self._fastest if self._rushes else None)
            self._warn("depth", f"at t = {self.time:.6g} s {where}; {cure}", stacklevel)

    def _drivers(self, colliders_move: bool) -> Iterator[str]:
        """Parts that may add energy to the scene or take it, in words."""
        scene, forces = self.scene, self.parts.arguments[4]
        if colliders_move:
            yield "moving colliders"
        if scene.moving_pins:
            yield "moving pins"
        if scene.motors:
            yield "motors"
        yield from (element.name for element in ELEMENTS if element.gives_energy and element.count(scene))
        if self.own:
            yield "forces of your own" if forces else "a method or contact rule of your own"

    def scales(self) -> Scales:
        """Scales by which the run is judged."""
        scene, monitor = self.scene, self.monitor
        part = self.h / self.safe.dt_any_shape if self.safe.dt_any_shape > 0 else 0.0
        touches, torn = self.parts.contacts.active, self.parts.torn
        return Scales(
            slow=2.0 * float(np.linalg.norm(scene.gravity)) * self.h,
            drivers=self.drivers,
            takers=takers(scene, touches, torn is not None and bool(torn.any())),
            motion=max(monitor.most, self.largest_motion),
            swing=1.0 - 1.0 / self.method.swing(min(part, LARGEST_PART)),
            swing_power=self.method.swing_power,
            squeezes=self.squeezes,
            starts_deep=STARTS_DEEP in self._warned,
            damps="" if self.method.conserves else self.method.name,
            gains=self.method.why_energy_grows(),
            touches=touches,
        )

    # When it goes wrong --------------------------------------------------------------------------------------------

    def _find_again(self, target: int) -> StateSample:
        """A ball is lost by step `target`: the chunk once more with substeps halved until none is, which are kept. Where neither
        springs nor user-defined forces limit the method, a shorter step is no cure for a ball that left the world."""
        before = self.substeps
        if self.may_shorten and (self.drivers or 0.0 < self.safe.dt_any_shape < np.inf):
            while self.substeps < self._most:
                self._divide(2 * self.substeps)
                sample = self._run(target)
                if sample.bad is None:
                    self._warn_of_shorter("a ball left the world", before)
                    return sample
            self._divide(before)
        return self._search(target)

    def _shorten(self, growth: Growth) -> None:
        """Repeat the chunk with substeps halved until it behaves, and stay there."""
        before, found, end = self.substeps, [growth.after], self.steps
        while self.substeps < self._most:
            self._divide(2 * self.substeps)
            self.monitor.begin(self.monitor.last)  # what was gained before the chunk is not given back by shorter steps
            sample = self._run(end)
            again = None if sample.bad is not None else self.monitor.judge(sample)
            like = [False]
            if sample.bad is None and not growth.sure:
                like = [e / SAME_ENERGY < sample.motion < e * SAME_ENERGY for e in found]
                found.append(sample.motion)
            worked = any(like)
            if like[0]:  # nothing was wrong
                self._divide(before)
                self.monitor.begin(self._run(end))
                return
            if worked:
                self.monitor.begin(sample)
            if sample.bad is None and (again is None or worked):
                self._warn_of_shorter(f"energy grew {_from_to(growth)}", before)
                return
        self._divide(before)
        self._fail_by_growth(growth, end)

    def _warn_of_shorter(self, what: str, before: int) -> None:
        self.decisions.append(f"from t = {self._marked:.6g} s on substeps of {self.h:.6g} s: {what}")
        self._warn(
            "shorter",
            f"{what} by t = {self.time:.6g} s at substeps of {self.dt / before:.6g} s; taken back to t = {self._marked:.6g} s and"
            f" repeated with substeps of {self.h:.6g} s, which are kept",
            7,
        )

    def _divide(self, substeps: int) -> None:
        """Take so many substeps from now on, from what is kept."""
        self.substeps = substeps
        self.parts.set_step(self.h, holds=False)
        self._back()

    def _search(self, target: int) -> StateSample:
        """The chunk once more, step by step, up to the first that is bad; the one before is kept."""
        self._back()
        sample = self.parts.state_probe.sample()
        for step in range(self.mark + 1, target + 1):
            sample = self._run(step)
            if sample.bad is not None:
                self._back()
                self._run(step - 1)
                self._fail(sample.bad)
        return sample

    def _fail(self, ball: int) -> None:
        self.primed = False
        scene, time = self.scene, self.time + self.dt
        own = np.flatnonzero((scene.pairs == ball).any(axis=1))
        spring = int(own[np.argmax(scene.stiffness[own] + scene.damping[own])]) if len(own) else None
        safe = self.safe.dt_any_shape
        hint = f"; the largest safe step is {safe:.6g} s, this run used {self.h:.6g} s" if np.isfinite(safe) else ""
        joined = f" at spring {spring}" if spring is not None else ""
        what = ball_in_words(scene.objects, ball) + joined
        raise UnstableError(
            f"{what} is not finite or left the world at t = {time:.6g} s{hint}; the last good state,"
            f" t = {self.time:.6g} s, is kept",
            time,
            ball,
            spring,
            safe if np.isfinite(safe) else None,
        )

    def _fail_by_growth(self, growth: Growth, step: int) -> None:
        self.primed = False
        ball = int(np.argmax(np.sum(self.parts.state.velocity**2, axis=1)))
        end = self.begin + step * self.dt
        safe = self.safe.dt_any_shape
        fastest = ball_in_words(self.scene.objects, ball)
        raise UnstableError(
            f"energy grows {_from_to(growth)} by t = {end:.6g} s, also with substeps of {self.dt / self._most:.6g} s, and"
            f" {self.method.why_energy_grows() or 'nothing explains it'}; {fastest} is the fastest; the last good state,"
            f" t = {self.time:.6g} s, is kept",
            end,
            ball,
            None,
            safe if np.isfinite(safe) else None,
        )

    # Warnings: one of a kind ---------------------------------------------------------------------------------------

    def _warn_of(self, growth: Growth, repeats: bool = True) -> None:
        """Energy came from nowhere, and the step was the user's choice. One that only may be wrong is judged by the bound, and,
        where balls are that fast, by a run of the chunk with half of it."""
        if "growth" in self._warned:
            return
        limited = 0.0 < self.safe.dt_any_shape < np.inf
        limit, spring = self._present() if limited else (np.inf, -1)
        time = self.time
        if not growth.sure and self.h <= limit:
            sample = self.parts.state_probe.sample()
            if repeats and sample.speed * self.h > self.size and not self._works(growth):
                self._warn(
                    "growth",
                    f"energy grew {_from_to(growth)} by t = {time:.6g} s, and a ball goes further than the scene is wide in a"
                    f" step of {self.h:.6g} s; half of it gives another energy: user-defined forces act explicitly; take shorter"
                    " steps",
                )
            self.monitor.begin(sample)
            return
        why = self.method.why_energy_grows()
        if why and self.h <= limit:
            self._warn(
                "growth",
                f"energy grew {_from_to(growth)} by t = {time:.6g} s, as {why}; {self.h:.6g} s is used: take shorter steps",
            )
            return
        grew = f"energy grew {_from_to(growth)} by t = {time:.6g} s"
        if self.h > limit:
            self._warn(
                "growth",
                f"{grew}, because the step of {self.h:.6g} s is too long: in this shape"
                f" {self._limiting(spring, limit)}",
            )
            return
        more = ", or more contact_iterations" if self.parts.contacts.active else ""
        self._warn("growth", f"{grew}, which nothing explains; {self.h:.6g} s is used: take shorter steps{more}")

    def _limiting(self, spring: int, limit: float) -> str:
        """Words on the spring that limits the step to so many seconds, or, below 0, on what else does."""
        if spring < 0:
            parts = explicit_parts(self.scene, self.method, self.parts.forces.declared)
            return f"{self.method} takes {parts} explicitly, which limits it to {limit:.6g} s"
        ends = pair_in_words(self.scene.objects, *self.scene.pairs[spring].tolist())
        return f"spring {spring} ({ends}) limits {self.method} to {limit:.6g} s"

    def _works(self, growth: Growth) -> bool:
        """True if the chunk so far comes to the same energy with half of the substep. Afterwards all is as it was."""
        before, now = self.substeps, self.steps
        self._divide(2 * before)
        sample = self._run(now)
        self._divide(before)
        self._run(now)
        return sample.bad is None and growth.after / SAME_ENERGY < sample.motion < growth.after * SAME_ENERGY

    def _check_solver(self) -> None:
        """Warn if an implicit method has left a stage unsolved."""
        if not self.solves or "solver" in self._warned:
            return
        found = self.parts.integrator.solver_report()
        if found is not None and found.misses:
            single = '; single precision may be what stands in the way: try "f64"' if self._single else ""
            self._warn(
                "solver",
                f"{self.method} left {found.worst:.2g} of the impulses of a stage unsolved by t = {self.time:.6g} s, more than"
                f" ten times its tolerance of {found.tolerance:g}: take shorter steps{single}",
            )

    def _check_bound(self) -> None:
        """Warn if the shape has stiffened so that the step is not safe, where it is not safe in every shape."""
        if self._warned & {"bound", "growth"}:
            return
        limit, spring = self._present()
        if self.h > limit:
            self._warn(
                "bound",
                f"at t = {self.time:.6g} s the step of {self.h:.6g} s is not safe: in this shape"
                f" {self._limiting(spring, limit)}",
            )

    def _present(self) -> tuple[float, int]:
        parts, scene = self.parts, self.scene.at(self.time)
        return present_limit(scene, self.method, parts.state.position, parts.forces.declared, parts.torn)

    def _warn(self, kind: str, text: str, stacklevel: int = 6) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(text, stacklevel=stacklevel)

    # To a snapshot and back ----------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """All that a run needs to go on with the same bits: what is kept, and how many steps lead from there to the present."""
        if not self.scene.n_balls:
            return replace(self.parts.snapshot(), time=self.time, stepping={"of": self._kind()})
        self._before_snapshot()
        parts = self.parts
        monitor = (
            None if self.monitor.last is None else [self.monitor.least, self.monitor.most, list(self.monitor.last)]
        )
        stepping = {
            "of": self._kind(),
            **{name: getattr(self, name) for name in self.saved},
            "h": list(parts.moments.h),
            "room": list(parts.room),
            "monitor": monitor,
            "warned": sorted(self._warned),
            "decisions": self.decisions,
            "looks": [self._looks, self._unseen],
        }
        return replace(parts.snapshot(), time=self.time, stepping=stepping, memory=parts.stored())

    def _before_snapshot(self) -> None:
        if self._halfway:
            self._run(self.steps)
        self._keep_own()
        if not self.primed:
            self._keep(goes_on=False)

    def _kind(self) -> str:
        """Settings that a run depends on besides the scene and what is kept: none with other settings has the same bits."""
        parts = self.parts
        own = (type(self).__name__, self.method, self.dt, parts.backend.precision, parts.contacts.name)
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
        if not self._reaches(snapshot):
            self._warn(
                "machine",
                "what this machine computes differs in the last digits from what was saved: it goes on from the positions saved",
                4,
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
        values = {name: _as_is(getattr(self, name), given[name]) for name in self.saved}
        steps, mark, end, substeps = (values[name] for name in ("steps", "mark", "end", "substeps"))
        most = max(1, self.chunk // self._first_substeps)
        if not (
            0 <= mark <= steps <= end <= mark + most and 1 <= substeps < 1 << 31 and values["largest_motion"] >= 0.0
        ):
            raise ValueError(f"steps {steps} from {mark} to {end} in {substeps} parts")
        if not abs(values["begin"] + steps * self.dt - snapshot.time) <= 1e-9 * snapshot.time:
            raise ValueError(f"{steps} steps since {values['begin']} s end at another time than {snapshot.time} s")
        values["_warned"] = set(map(str, given["warned"]))
        values["decisions"] = list(map(str, given["decisions"]))
        values["_looks"], values["_unseen"] = (int(one) for one in given["looks"])
        room = ContactCapacity(*(int(entries) for entries in given["room"]))
        if any(one > have for one, have in zip(room, self.parts.room)):
            self.parts = self.parts.with_room(room)
            self.primed = False  # what contacts held is gone
        self.parts.check(snapshot.memory, given["h"])
        _monitored(given["monitor"])
        return values

    def _put_back(self, values: Mapping[str, Any], snapshot: Snapshot) -> None:
        """The plain values, and what was kept."""
        self.parts.resume(snapshot)
        self.parts.put_back(snapshot.memory, snapshot.stepping["h"])
        for name, value in values.items():
            setattr(self, name, value)
        self.parts.set_step(self.h, holds=False)
        monitored = _monitored(snapshot.stepping["monitor"])
        if monitored is not None:
            self.monitor.least, self.monitor.most, self.monitor.last = monitored

    def _reaches(self, snapshot: Snapshot) -> bool:
        """Run on from what was kept. Returns True if that leads to where the snapshot is: on the same kind of machine it
        does."""
        steps = self.steps
        self._back()
        if self.primed:
            self._run(steps)
        self.steps = steps
        return np.array_equal(self.parts.state.position, snapshot.position)


def _monitored(given: Any) -> tuple[float, float, StateSample] | None:
    """Values from which an energy monitor goes on, of a snapshot's plain values."""
    if given is None:
        return None
    least, most, (bad, *numbers) = given
    return float(least), float(most), StateSample(None if bad is None else int(bad), *map(float, numbers))


def _as_is(present: Any, given: Any) -> Any:
    """A plain value of the type that it has at present; one that may be missing is a number."""
    kind = float if present is None else type(present)
    return None if given is None and kind is float else kind(given)


def _from_to(growth: Growth) -> str:
    return f"from {growth.before:.4g} J to {growth.after:.4g} J"
