"""EnergyMonitor: whether the energy of a run is still what its motion explains. Plain numbers; no Taichi.

In a closed scene (gravity, springs, walls, contacts: nothing that works on it) energy E may only stay or fall. The energy that a
method computes does not stay: Verlet keeps v^2 + w^2 x^2 (1 - s^2) of an oscillation, s = w h / 2, so that kinetic plus elastic
energy swings by up to 1 / (1 - s^2); symplectic Euler keeps v^2 + w^2 x^2 - h w^2 x v: (1 + s) / (1 - s). Runge-Kutta and the
implicit methods only lose. Where springs stretch far their stiffness changes within a step, and resonances of the step itself
exchange up to 6 times the energy of undamped networks that recover. So what moves, W = kinetic + elastic energy, is watched
against what it would be had E stayed at the least that it was: W - gain, gain = E - least. A run is unhealthy when
W > limit (W - gain), the limit 8, or one and a half of the method's own swing where that is more.

An error of the step is no growth: where a swing turns around it hardly moves, and what it is off by is more than that. So
gain counts from a hundredth of the largest W so far on; what grows without end passes that soon.

Not energy that appeared: what rounding makes of the sums, and, where there are contacts, what overlap holds, which no sum
counts. What is pushed out may lift all balls by the height of the scene, and stretch each spring by a diameter. By methods that
only lose energy it may lift balls by what they overlapped at the sample before: that is measured.

Where user-defined forces or moving colliders do work, any energy may be right. There only growth a hundredfold above all
that came before, if that was more than rounding, raises the question. The bound on the step for the present shape answers it,
or, where the program may choose the step, runs of half of it and less: work that was done is done again, by a crowd within the
factor by which two of its moments differ. Forces of one's own have no bound; where a ball goes further in
a step than the scene is wide, such a run answers, too.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.analysis.methods import Method
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.scene import Scene

__all__ = ["LARGEST_PART", "STEP_GROWTH", "EnergyMonitor", "Growth", "size"]

MOST_GROWTH = 8.0  # of kinetic plus elastic energy, out of nothing
MOST_RISE = 0.1  # of the energy in motion that the start explains, by methods that only lose
LEAST_GROWTH = 0.01  # of the largest kinetic plus elastic energy so far
SWINGS = 1.5  # of a method's own swing, for springs that pull at once
LARGEST_PART = 0.9  # of the bound, up to which a swing is worked out; above it there is none
STEP_GROWTH = 0.005  # of the largest kinetic energy so far, by steps of a method that only loses
WORK_GROWTH = 100.0  # times what a driven scene had before: the bound is asked then
DIGITS = 64.0  # units of rounding that sums and positions may differ by
LEAST_DIGITS, MOST_DIGITS = 4, 9  # of energies in words, as many as show their difference
CANCELLED = 4.0  # the same, of terms that cancel at rest


def size(scene: Scene) -> float:
    """The longest side [m] of the box around all balls."""
    if not scene.n_balls:
        return 1.0
    low = (scene.position - scene.radius[:, None]).min(axis=0)
    return float(((scene.position + scene.radius[:, None]).max(axis=0) - low).max())


class Growth(NamedTuple):
    """Energy that nothing explains [J]: the least there was, and what there is. `sure`: False where something may do work."""

    before: float
    after: float
    sure: bool

    def __str__(self) -> str:
        for digits in range(LEAST_DIGITS, MOST_DIGITS + 1):  # a small gain of a large potential energy needs more
            before, after = f"{self.before:.{digits}g}", f"{self.after:.{digits}g}"
            if abs(float(after) - float(before) - (self.after - self.before)) <= 0.05 * abs(self.after - self.before):
                break
        return f"from {before} J to {after} J"


class EnergyMonitor:
    """Judges samples of one run (see state_probe.StateSample), one after another; `begin` forgets those before.

    held: the largest kinetic and elastic energy [J] that the energy at the start explains; low: the sample of the least total so
    far, with the most lift since; risen: the most [J] by which the total has been above that. part: the substep as a part of the
    bound for every shape.
    closed: nothing works on the scene. contacts: there are some.
    """

    def __init__(
        self, scene: Scene, method: Method, part: float, *, closed: bool, contacts: bool, precision: str
    ) -> None:
        self.closed = closed
        self.limit = max(MOST_GROWTH, SWINGS * method.swing(min(part, LARGEST_PART)))
        eps = float(np.finfo(np.float32 if precision == "f32" else np.float64).eps)
        self.digits = DIGITS * eps
        far = float(np.max(np.abs(scene.position), initial=0.0))
        self.cancelled = CANCELLED * eps * sum(element.cancelling(scene) for element in ELEMENTS)
        self.jitter = 0.5 * float(np.sum(scene.stiffness)) * (self.digits * far) ** 2
        self.slack = _overlap(scene) if contacts else 0.0
        self.only_loses = method.limit is not None and not method.limit.by_springs
        self.start, self.held, self.risen = np.inf, 0.0, 0.0
        self.least, self.most = np.inf, 0.0
        self.last: Any = None  # sample
        self.low: Any = None

    def start_at(self, sample: Any) -> None:
        """Begin a run with the state of `sample`."""
        self.start, self.held, self.risen, self.low = sample.total, max(0.0, sample.motion), 0.0, sample
        self.begin(sample)

    def begin(self, sample: Any) -> None:
        """Begin to watch from the state of `sample`."""
        self.least, self.most, self.last = sample.total, sample.motion, sample

    def judge(self, sample: Any) -> Growth | None:
        """The growth that a sample shows, or None: then it is noted."""
        growth = self.growth(sample)
        if growth is None:
            self.least, self.most, self.last = min(self.least, sample.total), max(self.most, sample.motion), sample
        return growth

    def rise(self, sample: Any) -> Growth | None:
        """Note a sample, which is kept, and give the growth above the least energy so far, or None: of methods that only lose
        energy, where it is more than a part of what the start explains."""
        if np.isinf(self.start):  # of a run that goes on from a file
            self.start, self.low = sample.total, self.low or sample
        self.held = max(self.held, sample.motion - max(0.0, sample.total - self.start))
        gain = max(0.0, self._gain(self.low, sample))
        self.risen = max(self.risen, gain)
        deeper = self.low._replace(lift=max(self.low.lift, sample.lift))
        self.low = sample if sample.total < self.low.total else deeper
        rises = self.closed and self.only_loses and gain > MOST_RISE * self.held
        return Growth(self.low.total, sample.total, True) if rises else None

    def growth(self, sample: Any, most: float = 0.0) -> Growth | None:
        """The growth that a sample shows, or None. most: kinetic plus elastic energy [J] that others have shown since then."""
        if not self.closed:
            known = self.most > self._rounding(
                self.last
            )  # from what only rounding holds, any work is growth without end
            grown = known and WORK_GROWTH * self.most < sample.motion
            return Growth(self.most, sample.motion, False) if grown else None
        gain = sample.total - self.least - self.slack - self._rounding(sample)
        if gain > LEAST_GROWTH * max(self.most, most) and sample.motion > self.limit * (sample.motion - gain):
            return Growth(self.least, sample.total, True)
        return None

    def gain_of_step(self, before: Any, after: Any, kinetic: float, climbed: float = 0.0) -> float:
        """Energy that one step gave, in parts of a kinetic energy [J]; 0 where it may be what contacts and rounding explain, or
        little, also with what steps before have climbed [J]."""
        gain = self._gain(before, after)
        return gain / kinetic if gain > max(0.0, STEP_GROWTH * kinetic - climbed) else 0.0

    def climb(self, before: Any, after: Any) -> float:
        """Energy [J] that appeared from one sample to another, less what contacts, which push balls out of each other, may have
        lifted: each by what it overlapped."""
        return float(after.total - before.total - min(before.lift, max(0.0, after.gravity - before.gravity)))

    def is_climb(self, climbed: float, sample: Any, kinetic: float) -> bool:
        """True if so much [J] up to a sample is more than rounding, and more than a little of a kinetic energy [J]."""
        return climbed - 2.0 * self._rounding(sample) > STEP_GROWTH * kinetic

    def _gain(self, before: Any, after: Any) -> float:
        """Energy [J] that `climb` gives, less what may be rounding."""
        return self.climb(before, after) - self._rounding(before) - self._rounding(after)

    def stored(self) -> list[Any] | None:
        """Plain values from which the watch goes on, for `put_back`; None where it has not begun."""
        if self.last is None:
            return None
        samples = [list(self.last), None if self.low is None else list(self.low)]
        return [self.least, self.most, *samples, self.start, self.held, self.risen]

    def put_back(self, values: Sequence[Any]) -> None:
        """Go on from what `stored` gave, its samples read."""
        self.least, self.most, self.last, self.low, self.start, self.held, self.risen = values

    @property
    def rounding(self) -> float:
        """Joule by which the sums of the last sample may be off."""
        return 0.0 if self.last is None else self._rounding(self.last)

    def _rounding(self, sample: Any) -> float:
        """Joule by which sums may be off. Elastic: each stretch by the rounding of positions, (s + ds)^2 - s^2."""
        return (
            self.digits * (sample.weight + max(0.0, sample.motion))  # below 0 by rounding itself
            + self.cancelled
            + self.jitter
            + 2.0 * float(np.sqrt(max(0.0, sample.elastic) * self.jitter))
        )


def _overlap(scene: Scene) -> float:
    """Most energy [J] that overlaps may give back: every ball lifted by the height of the scene, every spring by a diameter."""
    if not scene.n_balls:
        return 0.0
    across = 2.0 * float(np.max(scene.radius))
    g = float(np.linalg.norm(scene.gravity))
    height = float(np.ptp(scene.position @ scene.gravity)) / g if g > 0 else 0.0
    mass = float(np.sum(np.where(scene.pinned, 0.0, scene.mass)))
    return mass * g * (height + across) + 0.5 * float(np.sum(scene.stiffness)) * across**2
