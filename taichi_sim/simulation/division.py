"""Division: a substep that gains energy is made again in 2, 4, ... parts, up to the first number that gains none."""

from collections.abc import Sequence
from typing import Any
from weakref import proxy

from taichi_sim.common.quantities import counted
from taichi_sim.device.engine import ti
from taichi_sim.simulation.energy_monitor import STEP_GROWTH
from taichi_sim.simulation.moments import KEPT, LIVE, Moments
from taichi_sim.simulation.state_probe import StateSample

__all__ = ["Beginning", "Division"]

MOST_PARTS = 64  # of a substep
# substeps that gain nothing, after which half of their parts are tried; twice as many after each trial that fails: other steps
# leave bodies at rest in another shape, so that they shake where parts change often
CALM, MOST_CALM = 4, 1024
# what is known at first, see Division
NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0, 1, 1, 0, CALM)
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
    """Makes the substeps of a run, a Stepper, and knows what they gained. What it decides depends on the states that a substep
    starts from and comes to, and on what it knows of the substeps before.

    kinetic [J]: the largest kinetic energy of all looks. gained: the most that a substep has gained, in parts of that; climbed:
    the most by which the energy has come above the least so far, by whatever substeps. climb [J]: by which it is above that now;
    told [J]: the part of this for which nothing more is divided. number: of substeps that were divided; finest: parts of one at
    most; parts: of the last one; calm: substeps since more were needed, or half was tried; wait: those after which half is
    tried. present: parts of a substep that the present fields are primed for.
    """

    def __init__(self, run: Any) -> None:
        self.run: Any = proxy(run)  # no circle: what is dropped frees its memory at once
        self.put_back(NOTHING)

    def start_at(self, sample: StateSample) -> None:
        """Begin with the state of `sample`, of which what ran before has no say."""
        self.put_back([sample.kinetic, *NOTHING[1:]])

    def known(self) -> list[float]:
        """Numbers from which it goes on."""
        energies = [self.kinetic, self.gained, self.climbed, self.climb, self.told]
        return [*energies, self.number, self.finest, self.parts, self.calm, self.wait]

    def put_back(self, known: Sequence[float]) -> None:
        """Go on from what is `known`, in fields that are primed for whole substeps."""
        self.kinetic, self.gained, self.climbed, self.climb, self.told = map(float, known[:5])
        self.number, self.finest, self.parts, self.calm, self.wait = map(int, known[5:])
        self.present = 1

    def said(self) -> list[str]:
        """Words on the substeps that were divided; none where nothing was."""
        if not self.number:
            return []
        many = counted(self.number, "substep that", "substeps, each of which")
        return [f"{many} gained energy made again in parts, {self.finest} at most"]

    def advance(self, number: int, before: StateSample) -> StateSample:
        """Make substep `number` since what is kept, from the state of `before`. Returns a sample of what it comes to."""
        sample, gain = self._divided(number, before) if self.run.parts.beginning else self._run(number, 1, before)
        self.kinetic = max(self.kinetic, sample.kinetic)
        self.gained = max(self.gained, gain if gain > STEP_GROWTH else 0.0)
        monitor = self.run.monitor
        self.climb = max(0.0, self.climb + monitor.climb(before, sample))
        self.told = min(self.told, self.climb)
        if monitor.is_climb(self.climb - self.told, sample, self.kinetic):
            self.told = self.climb
        if monitor.is_climb(self.climb, sample, self.kinetic):
            self.climbed = max(self.climbed, self.climb / self.kinetic)
        return sample

    def _divided(self, number: int, before: StateSample) -> tuple[StateSample, float]:
        """Make the substep in as many parts as it needs. Returns a sample, and what it gained in parts of the largest kinetic
        energy."""
        beginning = self.run.parts.beginning
        beginning.h[LIVE] = self.run.h / self.present
        beginning.store(KEPT)
        tries_half = self.parts > 1 and self.calm >= self.wait
        first = parts = tried = self.parts // 2 if tries_half else self.parts
        # what goes on in as many parts as before needs no priming
        sample, gain = self._run(number, parts, before) if parts == self.present else self._again(number, parts, before)
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
        run, h = self.run, self.run.h / parts
        integrator = run.parts.integrator
        self._begin(KEPT, parts)
        run.parts.prime(h, run.marked + number * run.h)
        if (number > 0 or run.remembers) and integrator.memory():
            run.parts.beginning.remember(KEPT)
            integrator.recall()
        return self._run(number, parts, before)

    def _begin(self, moment: int, parts: int) -> None:
        """Begin anew from a moment, in substeps of so many parts of the run's; `prime` is due."""
        h = self.run.h / parts
        self.run.parts.set_step(h, holds=False)
        self.run.parts.beginning.begin(moment, h)
        self.present = parts

    def make_whole(self) -> None:
        """Have in the present fields what whole substeps start from; `prime` is due."""
        beginning = self.run.parts.beginning
        if beginning is not None and self.present == 1:
            self.run.parts.set_step(self.run.h, holds=False)  # an interrupted call may have left parts of it
        elif beginning is not None:
            beginning.h[LIVE] = self.run.h / self.present
            beginning.store(KEPT)
            self._begin(KEPT, 1)

    def _run(self, number: int, parts: int, before: StateSample) -> tuple[StateSample, float]:
        """Run the substep, and look at what it comes to."""
        run = self.run
        run.parts.run(number * parts, parts, run.h / parts, run.marked)
        after = run.parts.state_probe.sample()
        kinetic = max(self.kinetic, after.kinetic)
        return after, run.monitor.gain_of_step(before, after, kinetic, self.climb - self.told)
