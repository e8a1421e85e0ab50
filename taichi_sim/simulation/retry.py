"""Retry: a run goes from chunk to chunk, at the end of which it is looked at. Where it leaves what is safe, its chunk is repeated
with shorter substeps, or it ends with the last good state."""

from typing import Any
from weakref import proxy

import numpy as np

from taichi_sim.common.errors import UnstableError
from taichi_sim.scene.objects import ball_in_words
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.energy_monitor import Growth
from taichi_sim.simulation.state_probe import StateSample

__all__ = ["Retry"]

MOST_HALVINGS = 6  # of the substep that a run began with, before it is given up
# times the energy by another step: work that was done; by a crowd it differs from one moment to the next, while what is
# unstable grows a hundredfold, or not at all
SAME_ENERGY = 10.0


class Retry:
    """Policy of a run, a Stepper, that may repeat its chunks. first, most: substeps of a step, at the beginning and the most that
    are tried."""

    saved: tuple[str, ...] = ()

    def __init__(self, run: Any) -> None:
        self.run: Any = proxy(run)  # no circle: what is dropped frees its memory at once
        self.first, self.most = run.substeps, run.substeps << MOST_HALVINGS

    def start(self) -> None:
        """The run begins at positions that were set from outside."""

    def forget(self) -> None:
        """Another run begins."""

    def report(self) -> None:
        """No error is known."""

    def keep(self) -> None:
        """Repeat nothing of what was done so far, from now on."""
        run = self.run
        if run.steps > run.mark and not run.halfway:
            run.keep(goes_on=True)

    def advance(self, target: int) -> None:
        """Run up to a number of steps, the end of the chunk at most, and look at the result."""
        run, first = self.run, self.run.steps
        target = min(target, run.end)
        sample = run.run_to(target)
        if sample.bad is not None:
            sample = self._find_again(target)
        whole = target == run.end
        growth = run.monitor.judge(sample) if whole else run.monitor.growth(sample, run.largest_motion)
        if growth is None:
            run.largest_motion = max(run.largest_motion, sample.motion)
        elif not run.may_shorten or run.checks.is_heat(growth):
            run.checks.warn_of(growth)
        elif whole:
            self._shorten(growth)
        if growth is None or not run.may_shorten:
            run.checks.look_at_energy(sample)
        run.moved = True
        run.checks.fastest = max(run.checks.fastest, sample.speed)
        if whole:
            run.keep(goes_on=True)
            run.new_chunk()
        run.checks.after((target - first) * run.substeps)

    def _find_again(self, target: int) -> StateSample:
        """Repeat a chunk in which a ball is lost by step `target`, with substeps halved until none is, which are kept. Where
        neither springs nor user-defined forces limit the method, a shorter step is no cure for a ball that left the world."""
        run, before = self.run, self.run.substeps
        if run.may_shorten and (run.checks.drivers or 0.0 < run.safe.dt_any_shape < np.inf):
            while run.substeps < self.most:
                run.divide(2 * run.substeps)
                sample = run.run_to(target)
                if sample.bad is None:
                    self._warn_of_shorter("a ball left the world", before)
                    return sample
            run.divide(before)
        return self._search(target)

    def _search(self, target: int) -> StateSample:
        """The chunk once more, step by step, up to the first that is bad; the one before is kept."""
        run = self.run
        run.go_back()
        sample = run.look()
        for step in range(run.mark + 1, target + 1):
            sample = run.run_to(step)
            if sample.bad is not None:
                run.go_back()
                run.run_to(step - 1)
                self.fail(sample.bad)
        return sample

    def _shorten(self, growth: Growth) -> None:
        """Repeat the chunk with substeps halved until it behaves, and stay there."""
        run = self.run
        before, found, end = run.substeps, [growth.after], run.steps
        while run.substeps < self.most:
            run.divide(2 * run.substeps)
            run.monitor.begin(run.monitor.last)  # what was gained before the chunk is not given back by shorter steps
            sample = run.run_to(end)
            again = None if sample.bad is not None else run.monitor.judge(sample)
            like = [False]
            if sample.bad is None and not growth.sure:
                like = [e / SAME_ENERGY < sample.motion < e * SAME_ENERGY for e in found]
                found.append(sample.motion)
            worked = any(like)
            if like[0]:  # nothing was wrong
                run.divide(before)
                run.monitor.begin(run.run_to(end))
                return
            if worked:
                run.monitor.begin(sample)
            if sample.bad is None and (again is None or worked):
                self._warn_of_shorter(f"energy grew {growth}", before)
                return
        run.divide(before)
        self._fail_by_growth(growth, end)

    def works(self, growth: Growth) -> bool:
        """True if the chunk so far comes to the same energy with half of the substep. Afterwards all is as it was."""
        run = self.run
        before, now = run.substeps, run.steps
        run.divide(2 * before)
        sample = run.run_to(now)
        run.divide(before)
        run.run_to(now)
        return sample.bad is None and growth.after / SAME_ENERGY < sample.motion < growth.after * SAME_ENERGY

    def _warn_of_shorter(self, what: str, before: int) -> None:
        run = self.run
        run.checks.decisions.append(f"from t = {run.marked:.6g} s on substeps of {run.h:.6g} s: {what}")
        run.checks.warn(
            "shorter",
            f"{what} by t = {run.time:.6g} s at substeps of {run.dt / before:.6g} s; taken back to t = {run.marked:.6g} s and"
            f" repeated with substeps of {run.h:.6g} s, which are kept",
        )

    def fail(self, ball: int) -> None:
        """Raise UnstableError for a ball that is lost in the next step."""
        run, scene, time = self.run, self.run.scene, self.run.time + self.run.dt
        own = np.flatnonzero((scene.pairs == ball).any(axis=1))
        spring = int(own[np.argmax(scene.stiffness[own] + scene.damping[own])]) if len(own) else None
        safe = run.safe.dt_any_shape
        hint = f"; the largest safe step is {safe:.6g} s, this run used {run.h:.6g} s" if np.isfinite(safe) else ""
        what = ball_in_words(scene.objects, ball) + (f" at spring {spring}" if spring is not None else "")
        self._end(f"{what} is not finite or left the world at t = {time:.6g} s{hint}", time, ball, spring)

    def _fail_by_growth(self, growth: Growth, step: int) -> None:
        run = self.run
        ball = int(np.argmax(np.sum(run.parts.state.velocity**2, axis=1)))
        time = run.begin + step * run.dt
        self._end(
            f"energy grows {growth} by t = {time:.6g} s, also with substeps of {run.dt / self.most:.6g} s, and"
            f" {run.method.why_energy_grows() or 'nothing explains it'}; {ball_in_words(run.scene.objects, ball)} is the fastest",
            time,
            ball,
            None,
        )

    def _end(self, what: str, time: float, ball: int, spring: int | None) -> None:
        """Raise UnstableError; the last good state is the present one."""
        run, safe = self.run, self.run.safe.dt_any_shape
        run.primed = False
        kept = f"the last good state, t = {run.time:.6g} s, is kept"
        raise UnstableError(f"{what}; {kept}", time, ball, spring, safe if np.isfinite(safe) else None)

    # To a snapshot and back ------------------------------------------------------------------------------------------

    def before_snapshot(self) -> None:
        """Have something kept, and the present at the end of a step."""
        run = self.run
        if run.halfway:
            run.run_to(run.steps)
        if run.own and run.primed:
            self.keep()
        if not run.primed:
            run.keep(goes_on=False)

    def stored(self) -> dict[str, Any]:
        """No plain values besides the run's."""
        return {}

    def read(self, plain: Any) -> dict[str, Any]:
        """No values of these."""
        return {}

    def reaches(self, snapshot: Snapshot) -> bool:
        """Run on from what was kept. Returns True if that leads to where the snapshot is: on the same kind of machine it
        does."""
        run, steps = self.run, self.run.steps
        run.go_back()
        if run.primed:
            run.run_to(steps)
        run.steps = steps
        return np.array_equal(run.parts.state.position, snapshot.position)
