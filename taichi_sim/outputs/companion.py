"""Companion: a second run at half the step and with other rounding, by which the errors of both are estimated."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.analysis.richardson import error_from
from taichi_sim.common.errors import SceneError, UnstableError
from taichi_sim.scene.other_rounding import other_neighbour, rounded_otherwise

__all__ = ["Companion", "StepError"]

ROUNDING = {"f32": 2.0**-24, "f64": 2.0**-53}  # of a number of its size
LAST = 8  # part of the frames by which the error of the last is judged


class StepError(NamedTuple):
    """Estimated errors of step and rounding. step [s]: of the second run; rms, largest [m]: of the free balls' positions at the
    end; energy [J]: of the total energy at the end; probes: of each number's last, least and largest value; why: words where
    the second run failed and nothing is known."""

    step: float
    rms: float = float("nan")
    largest: float = float("nan")
    energy: float = float("nan")
    probes: Mapping[str, tuple[float, float, float]] = {}
    why: str = ""
    rounded: bool = False  # otherwise, too, in the second run


class Companion:
    """Keeps what the first run starts from and reads, and repeats it at half the step with other rounding.

    In single precision what the scene is made of, where it starts and the step are rounded to the other of their two neighbours,
    so that both runs enclose the scene as it is meant. Contacts, and forces that begin or end at some moment, make any method one
    of first order. No number is known better than to the rounding of its own size.
    """

    def __init__(self, simulation: Any) -> None:
        if simulation.settings.tolerance is not None:
            raise SceneError("error", says="is estimated already where a tolerance is given; leave one of them out")
        self._start = simulation.snapshot()
        self._readings: list[tuple[float, dict[str, float]]] = []

    def note(self, frame: Frame) -> None:
        """Keep what the first run reads at a frame."""
        self._readings.append((frame.time, dict(frame.probes)))

    def compare(self, simulation: Any, advance: Callable[[int, float], None]) -> StepError:
        """Run again and compare at the frames' times. simulation: the first run at its end; advance takes the number of frames
        done and the simulated seconds."""
        half, single = simulation.dt / simulation.substeps / 2.0, simulation.backend.precision == "f32"
        end, free = simulation.position, ~simulation.scene.pinned
        energy = simulation.energy()
        with self._second(simulation) as again:
            found: list[dict[str, float]] = []
            try:
                for index, (time, _) in enumerate(self._readings):
                    again.step(max(0, round((time - again.time) / again.dt)))
                    found.append(again.probes())
                    advance(index + 1, time - self._start.time)
            except UnstableError as error:
                return StepError(half, why=str(error).split("; the last good")[0], rounded=single)
            off = np.linalg.norm((again.position - end)[free], axis=1)
            changed = abs(again.energy().total - energy.total)
            order = _order(again)
        digit = ROUNDING[simulation.backend.precision]
        place = digit * np.linalg.norm(end[free], axis=1)
        rms, rounded = (float(np.sqrt(np.mean(one**2))) if off.size else 0.0 for one in (off, place))
        probes = {
            name: _off(mine, [one[name] for one in found], order, digit) for name, mine in self._by_name().items()
        }
        return StepError(
            half,
            error_from(rms, order) + rounded,
            error_from(float(off.max(initial=0.0)), order) + float(place.max(initial=0.0)),
            error_from(changed, order) + digit * float(np.abs(energy[:3]).sum()),
            probes,
            rounded=single,
        )

    def _second(self, simulation: Any) -> Any:
        """The second run, at the start of the first."""
        if simulation.backend.precision == "f64":
            again, start = simulation.at_half_step(), self._start
        else:
            scene, half = simulation.scene, float(other_neighbour(simulation.dt / 2.0))
            again = simulation.at_half_step(rounded_otherwise(scene), half)
            given = self._start.position == scene.position.astype(np.float32)  # not so where it has moved before
            start = replace(
                self._start, position=np.where(given, other_neighbour(scene.position), self._start.position)
            )
        try:
            again.resume(start)
        except BaseException:
            again.close()
            raise
        return again

    def _by_name(self) -> dict[str, list[float]]:
        names = self._readings[0][1] if self._readings else {}
        return {name: [probes[name] for _, probes in self._readings] for name in names}


def _order(simulation: Any) -> float:
    """Order of convergence of the method in this scene, at least 1."""
    smooth = not simulation.parts.contacts.active and not np.isfinite(simulation.scene.break_strain).any()
    order = simulation.settings.integrator.method.order if smooth else 1
    return order if order > 0 else 1


def _off(mine: list[float], other: list[float], order: float, digit: float) -> tuple[float, float, float]:
    """Errors of the last, least and largest value of one number; digit: a part of it by which any value is rounded.

    Differences that swing, and those of rounding, pass through 0: the last value is as wrong as the frames before it.
    """
    before = len(mine) - 1 - len(mine) // LAST
    near = [abs(a - b) for a, b in zip(mine[before:], other[before:]) if not np.isnan(a - b)]
    ends = list(zip(_summed_up(mine), _summed_up(other)))
    differences = [max(near, default=float("nan")), *(abs(a - b) for a, b in ends[1:])]
    last, least, most = (error_from(d, order) + digit * abs(a) for d, (a, _) in zip(differences, ends))
    return last, least, most


def _summed_up(values: list[float]) -> tuple[float, float, float]:
    """Last, least and largest; what is not known at first is left out of the latter."""
    known = [value for value in values if not np.isnan(value)] or [float("nan")]
    return values[-1], min(known), max(known)
