"""Readings: what the probes of a scene say at a moment, and what a name like `load.tension` means."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError, did_you_mean
from taichi_sim.scene.probes import Probe, ProbeSample

__all__ = ["Quantity", "Reader", "Readings", "quantity_of", "units_of"]

Floats = NDArray[np.float64]


class Readings:
    """Reads all probes of a scene, and remembers the totals of the reading before for the means since then."""

    def __init__(self, probes: Sequence[Probe]) -> None:
        self.probes = probes
        self._before: tuple[float, dict[str, Floats]] | None = None
        self._now: tuple[float, dict[str, Floats]] | None = None

    def begin(self, time: float, sample: ProbeSample) -> None:
        """Means count from here on."""
        self._before, self._now = None, (time, self._totals(sample))

    def read(self, time: float, sample: ProbeSample) -> dict[str, float]:
        """Each number of each probe, "load.tension"; read again at the same time, means stay those that they were. They are
        nan where no time has passed."""
        if self._now is None or time < self._now[0]:
            self.begin(time, sample)
        elif time > self._now[0]:
            self._before = self._now
        totals = self._totals(sample)
        self._now = (time, totals)

        def mean(probe: Probe) -> dict[str, float]:
            return probe.mean(self._growth(probe.name), self._interval()) if probe.name in totals else {}

        return self._numbers(sample, mean)

    def at_moment(self, sample: ProbeSample) -> dict[str, float]:
        """Numbers of all probes between two readings, which it leaves as they are: means are nan."""
        return self._numbers(sample, lambda probe: dict.fromkeys(probe.numbers(sample.scene.dim), float("nan")))

    def _numbers(self, sample: ProbeSample, mean: Callable[[Probe], dict[str, float]]) -> dict[str, float]:
        """Each number of each probe; mean: those that do not belong to the moment."""
        found = {}
        for probe in self.probes:
            values = mean(probe) | probe.read(sample)
            found.update({f"{probe.name}.{number}": values[number] for number in probe.numbers(sample.scene.dim)})
        return found

    def memory(self) -> list[Any]:
        """The totals that means are taken between, as plain values for `recall`."""
        return [
            None if one is None else [one[0], {name: total.tolist() for name, total in one[1].items()}]
            for one in (self._before, self._now)
        ]

    def recall(self, memory: Any) -> None:
        """Go on from there; None: from the beginning. Raises SceneError for what does not fit."""
        if memory is None:
            return
        try:
            before, now = (
                None
                if one is None
                else (float(one[0]), {name: np.array(total, float) for name, total in one[1].items()})
                for one in memory
            )
        except (TypeError, ValueError, IndexError, KeyError, AttributeError) as error:
            raise SceneError("stepping", says=f"has no readings of probes ({error})") from None
        self._before, self._now = before, now

    def _totals(self, sample: ProbeSample) -> dict[str, Floats]:
        totals = {probe.name: probe.total(sample) for probe in self.probes}
        return {name: total for name, total in totals.items() if total is not None}

    def _interval(self) -> float:
        """Seconds between the last two readings."""
        assert self._now is not None
        return float("nan") if self._before is None else self._now[0] - self._before[0]

    def _growth(self, name: str) -> Floats:
        assert self._now is not None
        now = self._now[1][name]
        if self._before is None:
            return np.full_like(now, np.nan)
        return (now - self._before[1][name]) / (self._now[0] - self._before[0])


class Reader:
    """The part of a Simulation that reads them. readings: what it remembers of that."""

    def probes(self: Any) -> dict[str, float]:
        """Every number of every probe of the scene by its name, `load.tension`, in SI units; see `Scene.add_probe`. Forces on
        walls and rates are means since they were last read at an earlier time: nan where that is now."""
        return self.readings.read(self.time, self._sample()) if self.scene.probes else {}

    def probes_at_moment(self: Any) -> dict[str, float]:
        """Every number of every probe, but means are nan: those of later readings do not begin here."""
        return self.readings.at_moment(self._sample())

    def probe(self: Any, name: str) -> Any:
        """One number, `load.tension`, or `load` where it has no other: a float; a vector, `tip`: (dim,). Reads them all. Raises
        SceneError where no probe has that name."""
        found = quantity_of(self.scene, name).value(self.probes())
        return float(found[0]) if len(found) == 1 else found

    def _begin_readings(self: Any) -> None:
        """Means count from now on."""
        self.readings = Readings(self.scene.probes)
        if self.scene.probes:
            self.readings.begin(self.time, self._sample())

    def _sample(self: Any) -> ProbeSample:
        x, v, low = self.position, self.velocity, self._state.rounded_off
        if low is not None:  # what a stiff spring carries lies in digits that single precision rounds off
            x, v = x + low[0], v + low[1]
        return ProbeSample(self.scene.at(self.time), x, v, self.torn, self.energy, self.parts.impulses())


# One of them by its name -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Quantity:
    """Quantity that a name like `load.tension` stands for, or `load` where that says it. numbers: their names in what is
    read."""

    name: str
    numbers: tuple[str, ...]
    unit: str
    from_start: bool  # it has no zero of its own: only its motion from the start can be compared with
    of_energy: bool  # what it is compared with is the largest kinetic and spring energy

    def value(self, found: Mapping[str, float]) -> Floats:
        """Numbers of the quantity, (1,) or (dim,), from what `Readings.read` found."""
        return np.array([found[number] for number in self.numbers])


def units_of(scene: Any) -> dict[str, str]:
    """The unit of each number of each probe by its name; empty for plain numbers."""
    return {f"{one.name}.{number}": one.unit(number) for one in scene.probes for number in one.numbers(scene.dim)}


def quantity_of(scene: Any, name: str) -> Quantity:
    """Raises SceneError, which says what there is, for a name that means no probe or none of its numbers."""
    probes = {probe.name: probe for probe in scene.probes}
    first, _, number = name.partition(".")
    if first not in probes:
        raise SceneError((), name, says=f"is not a probe of this scene; {did_you_mean(first, probes)}")
    probe = probes[first]
    known = probe.numbers(scene.dim)
    if name.endswith("."):
        raise SceneError((), name, says="lacks the name of a number behind the dot")
    if not number and probe.vector:
        return Quantity(
            name, tuple(f"{first}.{axis}" for axis in known if axis in "xyz"), probe.unit(""), probe.start, False
        )
    if not number and len(known) == 1:
        number = known[0]
    if number not in known:
        there = f"name one of {', '.join(f'{first}.{word}' for word in known)}"
        if not number:
            raise SceneError((), name, says=f"has several numbers; {there}")
        raise SceneError((name,), says=f"the {probe.kind} {first!r} has no number {number!r}; {there}")
    energy = probe.kind == "energy"
    return Quantity(f"{first}.{number}", (f"{first}.{number}",), probe.unit(number), probe.start, energy)
