"""Stepper: from step to step, with a sample of the state after each chunk. A run that leaves what is safe is warned of, or, where
the step was left to the program, taken back and repeated with shorter substeps."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.outcome import DEEP, Scales, cure_of_depth, takes_nothing
from taichi_sim.analysis.stability import Stability, present_limit
from taichi_sim.common.errors import SceneError, UnstableError
from taichi_sim.kernels.contacts import statistics
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.assembly import Assembly
from taichi_sim.simulation.energy_monitor import LARGEST_PART, EnergyMonitor, Growth, size
from taichi_sim.simulation.settings import Settings
from taichi_sim.simulation.state_probe import StateSample

__all__ = ["Stepper"]

CHUNK, LONGEST_CHUNK = 256, 4096  # substeps between two samples
WORK = 1 << 21  # balls and springs gone through between two samples in small scenes: one costs about a hundredth
CHUNKS_PER_BOUND = (
    16  # from one bound for the present shape to the next, in scenes of at most MOST_BOUNDED balls and springs
)
MOST_BOUNDED = 20_000
MOST_HALVINGS = 6  # of the substep, before a run is given up
SAME_ENERGY = 2.0  # times the energy by another step: work that was done


class Stepper:
    """Advances the parts of a simulation, `dt` at a time in `substeps` parts.

    steps: made since `begin` [s]. own: forces or a method of the user's, which may do work.
    """

    def __init__(
        self, scene: Scene, settings: Settings, parts: Assembly, dt: float, substeps: int, safe: Stability, own: bool
    ) -> None:
        self.scene, self.settings, self.parts, self.safe = scene, settings, parts, safe
        self.dt, self.substeps = dt, substeps
        self.steps, self.begin = 0, 0.0
        self.chunk = int(np.clip(WORK // max(1, scene.n_balls + scene.n_springs), CHUNK, LONGEST_CHUNK))
        self.may_shorten = settings.dt == "auto"
        self.method = settings.integrator.method
        self.primed = False
        self._warned: set[str] = set()
        self._chunks, self._unseen = 0, 0
        part = self.h / safe.dt_any_shape if safe.dt_any_shape > 0 else 0.0
        moves = parts.colliders is not None and parts.colliders.moves
        driven = bool(scene.moving_pins or scene.gases or scene.wind is not None)
        self.driven, self.size = own or moves or driven, size(scene)
        self.squeezes = parts.contacts.active and (moves or bool(scene.moving_pins))
        self.moved = False  # by steps, since places were set
        self.monitor = EnergyMonitor(
            scene,
            self.method,
            part,
            closed=not self.driven,
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
        """Go on from `time` [s]: a number of steps, or, saved with another step, whatever it is."""
        self.steps, self.begin = round(time / self.dt), 0.0
        if abs(self.time - time) > 1e-9 * time:
            self.steps, self.begin = 0, time

    # Moving on -----------------------------------------------------------------------------------------------------

    def step(self, n: int) -> None:
        """Advance by n steps; 0 only compiles."""
        self.prime()
        if n == 0:
            self.parts.run(0, self.h, self.time)
        while n:
            now = min(n, max(1, self.chunk // self.substeps))
            self.advance(now)
            n -= now

    def prime(self) -> None:
        """Make what a step expects, where positions were set from outside."""
        if self.primed:
            return
        self._prime_parts()
        sample = self.parts.state_probe.sample()  # also compiles it, so that step(0) leaves nothing to compile
        if sample.bad is not None:
            state = self.parts.state
            x, v = state.position[sample.bad].tolist(), state.velocity[sample.bad].tolist()
            says = f"ball {sample.bad} starts at {x} with {v}; position and velocity must be below 1e12 m and m/s"
            raise SceneError(f"balls.position[{sample.bad}]", says=says)
        self.parts.state.keep()
        self.monitor.begin(sample)
        self.primed, self.moved = True, False

    def _prime_parts(self) -> None:
        """Find contacts at the present positions, with as much capacity as they need."""
        self.parts.prime(self.h, self.time)
        while (needed := self.parts.lacking()) is not None:
            self.parts = self.parts.with_capacity(needed)
            self.parts.prime(self.h, self.time)

    def advance(self, steps: int) -> None:
        """A chunk of steps, and a sample of the result."""
        sample = self._run(steps)
        growth = None if sample.bad is not None else self.monitor.judge(sample)
        if sample.bad is not None or growth is not None:
            if self.may_shorten and self._shorten(steps, growth):
                return
            if sample.bad is not None:
                self._search(steps)
                return
            self._warn_of(growth, self.time + steps * self.dt, steps)
        self._accept(steps)

    def _run(self, steps: int) -> StateSample:
        """Run the parts. Where contacts did not fit, the steps are repeated from the last good state with more capacity."""
        self.parts.run(steps * self.substeps, self.h, self.time)
        while (needed := self.parts.lacking()) is not None:
            self.parts.state.restore()
            self.parts = self.parts.with_capacity(needed)
            self._prime_parts()
            self.parts.state.keep()
            self.parts.run(steps * self.substeps, self.h, self.time)
        return self.parts.state_probe.sample()

    def _accept(self, steps: int) -> None:
        self.steps += steps
        self.parts.state.keep()
        self._check_solver()
        if (
            self.strays
            and self._chunks % CHUNKS_PER_BOUND == 0
            and self.scene.n_balls + self.scene.n_springs <= MOST_BOUNDED
        ):
            self._check_bound()
        self._chunks += 1
        self.moved = True
        self._unseen += steps * self.substeps
        if self.squeezes and self._unseen >= CHUNK:
            self._unseen = 0
            self.contact_statistics(7)

    def contact_statistics(self, stacklevel: int = 4) -> NDArray[np.float64]:
        """Statistics of all contacts, see kernels.contacts.statistics. Warns once, of the line that many calls further out, where
        steps have brought balls deep into something."""
        totals = self.parts.contact_statistics()
        part = float(totals[statistics.LARGEST_PART])
        if self.moved and part > DEEP:
            self._warn(
                "depth",
                f"at t = {self.time:.6g} s ball {int(totals[statistics.BALL])} overlaps what it touches by {part:.2g} of the"
                f" smaller radius: {cure_of_depth(self.squeezes, self.parts.contacts.iterations)}",
                stacklevel,
            )
        return totals

    def scales(self) -> Scales:
        """What the run is judged by."""
        scene, monitor = self.scene, self.monitor
        part = self.h / self.safe.dt_any_shape if self.safe.dt_any_shape > 0 else 0.0
        return Scales(
            slow=2.0 * float(np.linalg.norm(scene.gravity)) * self.h,
            closed=monitor.closed,
            lossless=monitor.closed and takes_nothing(scene, self.method),
            motion=monitor.most,
            swing=1.0 - 1.0 / self.method.swing(min(part, LARGEST_PART)),
            squeezes=self.squeezes,
        )

    def _back(self) -> None:
        """To the last good state."""
        self.parts.state.restore()
        self._prime_parts()

    # When it goes wrong --------------------------------------------------------------------------------------------

    def _shorten(self, steps: int, growth: Growth | None) -> bool:
        """Repeat a chunk with substeps halved until it behaves, and stay there. False, and all as it was, where no spring and no
        user-defined forces limits the method, so that a shorter step is no cure for a ball that left the world."""
        if growth is None and not self.driven and not 0.0 < self.safe.dt_any_shape < np.inf:
            return False
        before, last = self.substeps, np.inf if growth is None else growth.after
        for _ in range(MOST_HALVINGS):
            self._back()
            self._divide(2 * self.substeps)
            self.monitor.begin(self.monitor.last)  # what was gained before the chunk is not given back by shorter steps
            sample = self._run(steps)
            again = None if sample.bad is not None else self.monitor.judge(sample)
            worked = again is not None and not again.sure and last / SAME_ENERGY < again.after < last * SAME_ENERGY
            last = np.inf if again is None else again.after
            if worked:
                self.monitor.begin(sample)
            if worked and self.substeps == 2 * before:  # nothing was wrong
                self._accept(steps)
                self._divide(before)
                return True
            if sample.bad is None and (again is None or worked):
                what = "a ball left the world" if growth is None else f"energy grew {_from_to(growth)}"
                self._warn(
                    "shorter",
                    f"{what} by t = {self.time + steps * self.dt:.6g} s at substeps of {self.dt / before:.6g} s; taken back to"
                    f" t = {self.time:.6g} s and repeated with substeps of {self.h:.6g} s, which are kept",
                )
                self._accept(steps)
                return True
        self._back()
        self._divide(before)
        if growth is None:
            return False
        self._fail_by_growth(growth, steps)
        return True

    def _divide(self, substeps: int) -> None:
        """Take so many substeps from now on, from the present state."""
        self.substeps = substeps
        self.parts.set_step(self.h)
        self._prime_parts()

    def _search(self, steps: int) -> None:
        """A bad chunk once more, step by step, up to the last good one."""
        self._back()
        for _ in range(steps):
            sample = self._run(1)
            if sample.bad is not None:
                self._fail(sample.bad)
            self._accept(1)

    def _fail(self, ball: int) -> None:
        self.parts.state.restore()
        self.primed = False
        scene, time = self.scene, self.time + self.dt
        own = np.flatnonzero((scene.pairs == ball).any(axis=1))
        spring = int(own[np.argmax(scene.stiffness[own] + scene.damping[own])]) if len(own) else None
        safe = self.safe.dt_any_shape
        hint = f"; the largest safe step is {safe:.6g} s, this run used {self.h:.6g} s" if np.isfinite(safe) else ""
        joined = f" at spring {spring}" if spring is not None else ""
        raise UnstableError(
            f"ball {ball}{joined} is not finite or left the world at t = {time:.6g} s{hint}; the last good state,"
            f" t = {self.time:.6g} s, is kept",
            time,
            ball,
            spring,
            safe if np.isfinite(safe) else None,
        )

    def _fail_by_growth(self, growth: Growth, steps: int) -> None:
        self.primed = False
        ball = int(np.argmax(np.sum(self.parts.state.velocity**2, axis=1)))
        end = self.time + steps * self.dt
        safe = self.safe.dt_any_shape
        raise UnstableError(
            f"energy grows {_from_to(growth)} by t = {end:.6g} s, also with substeps of {self.h / 2**MOST_HALVINGS:.6g} s, and"
            f" nothing explains it; ball {ball} is the fastest; the last good state, t = {self.time:.6g} s, is kept",
            end,
            ball,
            None,
            safe if np.isfinite(safe) else None,
        )

    # Warnings: one of a kind ---------------------------------------------------------------------------------------

    def _warn_of(self, growth: Growth | None, time: float, steps: int = 0) -> None:
        """Energy came from nowhere, and the step was the user's choice. One that only may be wrong is judged by the bound, and,
        where balls are that fast, by a run of these last `steps` with half of it."""
        if growth is None or "growth" in self._warned:
            return
        limited = 0.0 < self.safe.dt_any_shape < np.inf
        limit, spring = self._present() if limited else (np.inf, -1)
        if not growth.sure and self.h <= limit:
            sample = self.parts.state_probe.sample()
            if steps and sample.speed * self.h > self.size and not self._works(steps, growth):
                self._warn(
                    "growth",
                    f"energy grew {_from_to(growth)} by t = {time:.6g} s, and a ball goes further than the scene is wide in a"
                    f" step of {self.h:.6g} s; half of it gives another energy: user-defined forces act explicitly; take shorter"
                    " steps",
                )
            self.monitor.begin(self.parts.state_probe.sample())
            return
        if limited:
            cure = f"; in this shape {_limiting(spring)} {self.method} to {limit:.6g} s, {self.h:.6g} s is used"
        else:
            cure = f"; {self.h:.6g} s is used: take shorter steps" + (
                ", or more contact_iterations" if self.parts.contacts.active else ""
            )
        self._warn("growth", f"energy grew {_from_to(growth)} by t = {time:.6g} s, which nothing explains{cure}")

    def _works(self, steps: int, growth: Growth) -> bool:
        """Whether the last steps, not accepted yet, come to the same energy with half of the substep; then as they were."""
        before = self.substeps
        self._back()
        self._divide(2 * before)
        sample = self._run(steps)
        self._back()
        self._divide(before)
        self._run(steps)
        return sample.bad is None and growth.after / SAME_ENERGY < sample.motion < growth.after * SAME_ENERGY

    def _check_solver(self) -> None:
        """Whether an implicit method has left a stage unsolved."""
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
        """Whether the shape has stiffened so that the step is not safe, where it is not safe in every shape."""
        if self._warned & {"bound", "growth"}:
            return
        limit, spring = self._present()
        if self.h > limit:
            self._warn(
                "bound",
                f"at t = {self.time:.6g} s the step of {self.h:.6g} s is not safe: in this shape {_limiting(spring)}"
                f" {self.method} to {limit:.6g} s",
            )

    def _present(self) -> tuple[float, int]:
        return present_limit(self.scene, self.method, self.parts.state.position, self.parts.forces.declared)

    def _warn(self, kind: str, text: str, stacklevel: int = 6) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(text, stacklevel=stacklevel)

    # To a snapshot and back ----------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """All that a run needs to go on with the same steps."""
        stepping, memory = self._stepping()
        stepping = {"of": self._kind(), **stepping}
        return replace(self.parts.snapshot(), time=self.time, stepping=stepping, memory=memory)

    def _kind(self) -> str:
        """Whose stepping values and memory a snapshot holds: no other method, or way of choosing steps, can use them."""
        return f"{type(self).__name__}.{self.method}"

    def resume(self, snapshot: Snapshot) -> None:
        """Go on from there."""
        self.set_time(snapshot.time)
        if self.scene.n_balls:
            self.parts.resume(snapshot)
            self.parts.contacts.forget()
            self.primed = False
            if snapshot.stepping.get("of") == self._kind():
                own = {name: value for name, value in snapshot.stepping.items() if name != "of"}
                self._set_stepping(own, snapshot.memory)

    def _stepping(self) -> tuple[dict[str, Any], dict[str, NDArray]]:
        """What is the stepper's own, and the method's memory."""
        integrator = self.parts.integrator
        memory = integrator.memory() if self.primed and integrator.remembers() else []
        own = {f"memory.{k}": self.parts.state.values(field) for k, field in enumerate(memory)}
        return {"may_shorten": self.may_shorten}, own

    def _set_stepping(self, stepping: Mapping[str, Any], memory: Mapping[str, NDArray]) -> None:
        """The reverse."""
        self.may_shorten = bool(stepping.get("may_shorten", self.may_shorten))
        if memory:
            self.prime()  # lists may grow: all fields are new then
            for k, field in enumerate(self.parts.integrator.memory()):
                self.parts.state.set_values(field, memory[f"memory.{k}"])
            self.parts.integrator.recall()


def _from_to(growth: Growth) -> str:
    return f"from {growth.before:.4g} J to {growth.after:.4g} J"


def _limiting(spring: int) -> str:
    return f"spring {spring} limits" if spring >= 0 else "cells, bending, gas and user-defined forces limit"
