"""Companion: a second run at half the step, by which the step error of the first is estimated."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.errors import SceneError, UnstableError

__all__ = ["Companion", "StepError"]


class StepError(NamedTuple):
    """Estimated errors of the step. step [s]: of the second run; rms, largest [m]: of the free balls' positions at the end;
    energy [J]: of the total energy at the end; probes: of each number's last, least and largest value; why: words where the
    second run failed and nothing is known."""

    step: float
    rms: float = float("nan")
    largest: float = float("nan")
    energy: float = float("nan")
    probes: Mapping[str, tuple[float, float, float]] = {}
    why: str = ""


class Companion:
    """Keeps what the first run starts from and reads, and repeats it at half the step.

    Where the error of a method of order p is C h^p, the values at h and h/2 differ by (1 - 2^-p) of it. Contacts, and forces that
    begin or end at some moment, make any method one of first order.
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
        half = simulation.dt / simulation.substeps / 2.0
        end, free = simulation.position, ~simulation.scene.pinned
        energy = simulation.energy().total
        with simulation.at_half_step() as again:
            again.resume(self._start)
            found: list[dict[str, float]] = []
            try:
                for index, (time, _) in enumerate(self._readings):
                    again.step(max(0, round((time - again.time) / again.dt)))
                    found.append(again.probes())
                    advance(index + 1, time - self._start.time)
            except UnstableError as error:
                return StepError(half, why=str(error).split("; the last good")[0])
            off = np.linalg.norm((again.position - end)[free], axis=1)
            changed = abs(again.energy().total - energy)
            factor = _factor(again)
        rms = float(np.sqrt(np.mean(off**2))) if off.size else 0.0
        probes = {
            name: tuple(factor * abs(a - b) for a, b in zip(_summed_up(mine), _summed_up([one[name] for one in found])))
            for name, mine in self._by_name().items()
        }
        return StepError(half, factor * rms, factor * float(off.max(initial=0.0)), factor * changed, probes)  # type: ignore[arg-type]

    def _by_name(self) -> dict[str, list[float]]:
        names = self._readings[0][1] if self._readings else {}
        return {name: [probes[name] for _, probes in self._readings] for name in names}


def _factor(simulation: Any) -> float:
    """What the difference of the two runs is multiplied by."""
    smooth = not simulation.parts.contacts.active and not np.isfinite(simulation.scene.break_strain).any()
    order = simulation.settings.integrator.method.order if smooth else 1
    return float(2.0**order / (2.0**order - 1.0)) if order > 0 else 2.0


def _summed_up(values: list[float]) -> tuple[float, float, float]:
    """Last, least and largest; what is not known at first is left out of the latter."""
    known = [value for value in values if not np.isnan(value)] or [float("nan")]
    return values[-1], min(known), max(known)
