"""Division: a substep that gains energy is made again in 2, 4, ... parts, up to the first number that gains none."""

from typing import Any
from weakref import proxy

from taichi_sim.common.quantities import counted
from taichi_sim.device.engine import ti
from taichi_sim.simulation.moments import KEPT, LIVE, Moments
from taichi_sim.simulation.state_probe import StateSample

__all__ = ["Beginning", "Division"]

MOST_PARTS = 64  # of a substep
FUTILE = 4  # times the number of parts that gains least, beyond which no more are tried


@ti.data_oriented
class Beginning(Moments):
    """State that a substep starts from. To begin anew from it leaves no trace of what was made since: it also holds what the
    method has counted and what followers of the state have."""

    def _hold(self, contacts: Any) -> None:
        super()._hold(contacts)
        self.live += self.integrator.counters()
        self.live += [field for part in self.state.followers for field in part.live()]

    def begin(self, h: float) -> None:
        """Begin anew with substeps of h seconds; `prime` is due."""
        self.load(KEPT, h)
        for part in self.state.followers:
            part.renew()


class Division:
    """Makes the substeps of a run, a Stepper. What it decides depends on the states that a substep starts from and comes to, on
    the largest kinetic energy before, and on the number of parts of the substep before.

    number: of substeps that were divided; finest: parts of one at most; parts: of the last one.
    """

    def __init__(self, run: Any) -> None:
        self.run: Any = proxy(run)  # no circle: what is dropped frees its memory at once
        self.number, self.finest, self.parts = 0, 1, 1

    def said(self) -> list[str]:
        """Words on the substeps that were divided; none where nothing was."""
        if not self.number:
            return []
        many = counted(self.number, "substep that", "substeps, each of which")
        return [f"{many} gained energy made again in parts, {self.finest} at most"]

    def advance(self, number: int, before: StateSample) -> tuple[StateSample, float]:
        """Make substep `number` since what is kept, from the state of `before`. Returns a sample of the state that it comes to,
        and what it gained in parts of the largest kinetic energy."""
        run, beginning = self.run, self.run.parts.beginning
        if beginning is None:  # the number of substeps is the user's
            return self._run(number, 1, before)
        beginning.h[LIVE] = run.h
        beginning.store(KEPT)
        parts = tried = max(1, self.parts // 2)  # what bodies in touch need changes little from step to step
        sample, gain = self._again(number, parts, before) if parts > 1 else self._run(number, 1, before)
        least = gain
        while gain > 0.0 and tried < min(MOST_PARTS, FUTILE * parts):
            tried *= 2
            sample, gain = self._again(number, tried, before)
            if gain < least:
                parts, least = tried, gain
        if parts != tried:  # no number of parts has done: the one that gains least
            sample, gain = self._again(number, parts, before)
        if parts > 1:
            beginning.store(KEPT)
            self._begin(number + 1, 1, True)
            self.number += 1
            self.finest = max(self.finest, parts)
        self.parts = parts
        return sample, gain

    def _again(self, number: int, parts: int, before: StateSample) -> tuple[StateSample, float]:
        """Make the substep in so many parts, from its beginning."""
        self._begin(number, parts, number > 0 or self.run.remembers)
        return self._run(number, parts, before)

    def _begin(self, number: int, parts: int, remembers: bool) -> None:
        """Begin anew, at substep `number`, in substeps of so many parts of the run's."""
        run, h = self.run, self.run.h / parts
        beginning, integrator = run.parts.beginning, run.parts.integrator
        run.parts.set_step(h, holds=False)
        beginning.begin(h)
        run.parts.prime(h, run.marked + number * run.h)
        if remembers and integrator.memory():
            beginning.remember(KEPT)
            integrator.recall()

    def _run(self, number: int, parts: int, before: StateSample) -> tuple[StateSample, float]:
        run = self.run
        run.parts.run(number * parts, parts, run.h / parts, run.marked)
        after = run.parts.state_probe.sample()
        return after, run.monitor.gain_of_step(before, after, max(run.kinetic, after.kinetic))
