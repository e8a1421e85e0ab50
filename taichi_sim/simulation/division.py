"""Division: a substep that gains energy is made again in 2, 4, ... parts, up to the first number that gains none."""

from collections.abc import Sequence
from typing import Any
from weakref import proxy

from taichi_sim.common.quantities import counted
from taichi_sim.device.engine import ti
from taichi_sim.simulation.moments import KEPT, LIVE, Moments
from taichi_sim.simulation.state_probe import StateSample

__all__ = ["Beginning", "Division"]

NEXT = KEPT + 1  # moment: what the substep has come to
MOST_PARTS = 64  # of a substep
# substeps that gain nothing, after which half of their parts are tried; twice as many after each trial that fails: other steps
# leave bodies at rest in another shape, so that they shake where parts change often
CALM, MOST_CALM = 4, 1024
FUTILE = 4  # times the number of parts that gains least, beyond which no more are tried


@ti.data_oriented
class Beginning(Moments):
    """State that a substep starts from. To begin anew from it leaves no trace of what was made since: it also holds what the
    method has counted and what followers of the state have."""

    def _hold(self, contacts: Any) -> None:
        super()._hold(contacts)
        self.live += self.integrator.counters()
        self.live += [field for part in self.state.followers for field in part.live()]

    def begin(self, moment: int, h: float) -> None:
        """Begin anew from a moment with substeps of h seconds; `prime` is due."""
        self.load(moment, h)
        for part in self.state.followers:
            part.renew()


class Division:
    """Makes the substeps of a run, a Stepper. What it decides depends on the states that a substep starts from and comes to, on
    the largest kinetic energy before, and on the parts of the substeps before.

    number: of substeps that were divided; finest: parts of one at most; parts: of the last one; calm: substeps since more were
    needed, or half was tried; wait: those after which half is tried.
    """

    def __init__(self, run: Any) -> None:
        self.run: Any = proxy(run)  # no circle: what is dropped frees its memory at once
        self.put_back(())

    def counts(self) -> list[int]:
        """Numbers from which it goes on."""
        return [self.number, self.finest, self.parts, self.calm, self.wait]

    def put_back(self, counts: Sequence[float]) -> None:
        """Go on from the numbers of `counts`; begin, where there are none."""
        self.number, self.finest, self.parts, self.calm, self.wait = map(int, counts or (0, 1, 1, 0, CALM))

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
        tries_half = self.parts > 1 and self.calm >= self.wait
        first = parts = tried = self.parts // 2 if tries_half else self.parts
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
            self.number += 1
            self.finest = max(self.finest, parts)
        if parts > first:
            self.wait = min(2 * self.wait, MOST_CALM) if tries_half or self.calm < CALM else CALM
        self.calm = 0 if tries_half or parts > first else self.calm + 1
        self.parts = parts
        return sample, gain

    def _again(self, number: int, parts: int, before: StateSample) -> tuple[StateSample, float]:
        """Make the substep in so many parts, from its beginning."""
        self._begin(KEPT, number, parts, number > 0 or self.run.remembers)
        return self._run(number, parts, before)

    def _begin(self, moment: int, number: int, parts: int, remembers: bool) -> None:
        """Begin anew from a moment, at substep `number`, in substeps of so many parts of the run's."""
        run, h = self.run, self.run.h / parts
        beginning, integrator = run.parts.beginning, run.parts.integrator
        run.parts.set_step(h, holds=False)
        beginning.begin(moment, h)
        run.parts.prime(h, run.marked + number * run.h)
        if remembers and integrator.memory():
            beginning.remember(moment)
            integrator.recall()

    def _run(self, number: int, parts: int, before: StateSample) -> tuple[StateSample, float]:
        """Run the substep. What it comes to is looked at where the next one begins: contacts may change velocities there."""
        run = self.run
        run.parts.run(number * parts, parts, run.h / parts, run.marked)
        if parts > 1:
            run.parts.beginning.store(NEXT)
            self._begin(NEXT, number + 1, 1, True)
        after = run.parts.state_probe.sample()
        return after, run.monitor.gain_of_step(before, after, max(run.kinetic, after.kinetic))
