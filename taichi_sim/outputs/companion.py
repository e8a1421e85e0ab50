"""Companion: a second run at half the step and with other rounding, by which the errors of both are estimated; of methods of
order 1, and where contacts or tearing happen within steps, a third one at a quarter."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf, nan, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.between_samples import beyond, steps_between
from taichi_sim.analysis.frame import Frame
from taichi_sim.analysis.probe_readings import units_of
from taichi_sim.analysis.richardson import error_from, error_of_events, error_of_three, rms
from taichi_sim.analysis.spring_bounds import largest_eigenvalue
from taichi_sim.common.errors import SceneError, UnstableError
from taichi_sim.common.quantities import measured, plain_number
from taichi_sim.scene.other_rounding import other_neighbour, rounded_otherwise

__all__ = ["Companion", "StepError", "settle_further"]

ROUNDING = {"f32": 2.0**-24, "f64": 2.0**-53}  # of a number of its size
CERTAIN = 8.0  # times the rounding of a number: differences above that are not of rounding alone
NOTED = 0.01  # of a quantity's range: extremes further between readings are worth a line
NAMED = 2  # quantities with extremes between readings
LOSES = 0.04  # of its amplitude in a step: motion that is gone before its peak
RESOLVED = 0.3  # omega h, up to which methods of first order keep more than that
SLOW = ("position",)  # kinds of probes that fast motion along springs hardly moves
LAST = 8  # part of the readings by which the error of the last is judged
CLOSER = 0.1  # of the net force that settling left: what the second run is settled to
AT_REST = 0.5  # of the same: with less, the difference to what is settled further tells most of what settling left


class StepError(NamedTuple):
    """Estimated errors of step and rounding, nan where the runs show no order. step [s]: of the second run; rms, largest [m]: of
    the free balls' positions at the end; energy [J]: of the total energy at the end; probes: of each number's last, least and
    largest value, of the latter two also that they may lie between readings; why: words where the second run failed and nothing
    is known; runs: how many there were."""

    step: float
    rms: float = float("nan")
    largest: float = float("nan")
    energy: float = float("nan")
    probes: Mapping[str, tuple[float, float, float]] = {}
    why: str = ""
    rounded: bool = False  # otherwise, too, in the second run
    runs: int = 2
    settled: bool = False  # closer to rest in the second run, so that these are also of what settling left
    hidden: str = (
        ""  # motion of springs that the method takes away in all runs alike, in words; extremes are not known then
    )

    @property
    def unseen(self) -> list[str]:
        """Names of quantities whose runs show no order."""
        quantities = {"the positions": self.rms, "the energy": self.energy}
        names = [name for name, off in quantities.items() if np.isnan(off)]
        return names + [name for name, off in self.probes.items() if np.isnan(off).all()]


class _Run(NamedTuple):
    """Result of one run: positions of free balls [m], energy [J], and numbers by name at each reading."""

    place: NDArray
    energy: float
    probes: dict[str, NDArray]


def settle_further(simulation: Any, left: Any, share: float) -> bool:
    """Bring a simulation to rest to a share of the net force that an earlier settling left. False where there was none, it left
    nothing, or rounding forbids less."""
    if left is None or not left.residual or not left.load:
        return False
    with warnings.catch_warnings(record=True):  # what stays too large is not included, and said so
        warnings.simplefilter("always")
        return bool(simulation.settle(share * left.residual / left.load).residual < AT_REST * left.residual)


class _Reading(NamedTuple):
    """Numbers of all probes at a time [s]: of a frame, or of a step between, where means are nan."""

    time: float
    is_frame: bool
    values: NDArray


class Companion:
    """Keeps what the first run starts from and reads, and repeats it at half the step with other rounding.

    Probes are read at the steps between frames, too, so that a peak does not depend on frames. every: steps from one reading to
    the next.

    In single precision what the scene is made of, where it starts and the step are rounded to the other of their two neighbours,
    so that both runs enclose the scene as it is meant. What was settled is settled further. Methods of first order, contacts and
    tearing get a third run at a quarter of the step: the order of such methods may not be seen at large steps, and contacts and
    tearing, which begin and end within a step, show none. No number is known better than to the rounding of its own size.
    """

    def __init__(self, simulation: Any, duration: float) -> None:
        if simulation.settings.tolerance is not None:
            raise SceneError("error", says="is estimated already where a tolerance is given; leave one of them out")
        self._start = simulation.snapshot()
        # a run that has begun is not at the place of rest any more
        self._settled = simulation.settled if self._start.time == 0.0 else None
        self._readings: list[_Reading] = []
        self._names = list(units_of(simulation.scene))
        self.every = steps_between(simulation, duration, len(self._names))
        self._tears = simulation.parts.tearing is not None

    def note(self, frame: Frame) -> None:
        """Keep what the first run reads at a frame."""
        if self._readings and self._readings[-1].time == frame.time and not self._readings[-1].is_frame:
            self._readings.pop()
        self._readings.append(_Reading(frame.time, True, np.array([*frame.probes.values()])))

    def look(self, simulation: Any) -> None:
        """Keep what it reads at a step between frames."""
        self._readings.append(_Reading(simulation.time, False, np.array([*simulation.probes_at_moment().values()])))

    def extremes(self) -> dict[str, tuple[float, float, float]]:
        """Each number's last, least and largest value."""
        return {name: _summed_up(values) for name, values in self._read().items()}

    def _read(self) -> dict[str, NDArray]:
        return _by_name(self._names, [one.values for one in self._readings])

    def compare(
        self, simulation: Any, advance: Callable[[int, float], None], begin: Callable[[str], object] = str
    ) -> StepError:
        """Run again and compare at the frames' times. simulation: the first run at its end; advance takes the number of frames
        done and the simulated seconds; begin gets, before each run, its frames in words."""
        half, single = simulation.dt / simulation.substeps / 2.0, simulation.backend.precision == "f32"
        free, order = ~simulation.scene.pinned, _Order.of(simulation)
        energy = simulation.energy()
        runs = [_Run(simulation.position[free], energy.total, self._read())]
        try:
            begin("frames of the second run, at half the step")
            again, start = self._second(simulation)
            with again:
                closer = settle_further(again, self._settled, CLOSER)
                if closer:
                    start = replace(start, position=again.position)
                again.resume(start)
                runs.append(self._repeat(again, free, advance))
                if order.needs_third:
                    begin("frames of the third run, at a quarter of the step")
                    with _resumed(again.at_half_step(), start) as once_more:
                        runs.append(self._repeat(once_more, free, advance))
        except UnstableError as error:
            return StepError(half, why=error.reason, rounded=single)
        digit = ROUNDING[simulation.backend.precision]
        steps = max(1.0, (simulation.time - self._start.time) / half * 2.0)  # of the last run, each of which rounds
        offs = [np.linalg.norm(a.place - b.place, axis=1) for a, b in pairwise(runs)]
        place = digit * np.linalg.norm(runs[0].place, axis=1)
        judge = _Judge([rms(off) for off in offs], rms(place) * sqrt(steps), order)
        largest = [float(off.max(initial=0.0)) for off in offs]
        energies = [abs(a.energy - b.energy) for a, b in pairwise(runs)]
        least_energy = digit * float(np.abs(energy[:3]).sum())
        hidden, places = _hidden(simulation), {one.name for one in simulation.scene.probes if one.kind in SLOW}
        probes = {}
        for name in runs[0].probes:
            values = [run.probes[name] for run in runs]
            blind = bool(hidden) and name.split(".")[0] not in places
            probes[name] = _off(values, order, digit, steps, blind, self._tears)
        return StepError(
            half,
            judge.error(judge.differences) + rms(place),
            judge.error(largest) + float(place.max(initial=0.0)),
            _Judge(energies, least_energy * sqrt(steps), order).error(energies) + least_energy,
            probes,
            rounded=single,
            runs=len(runs),
            settled=closer,
            hidden=hidden if any(np.isnan(off[1:]).all() for off in probes.values()) else "",
        )

    def between_readings(self, error: StepError, units: Mapping[str, str]) -> str:
        """Words on the quantities whose extremes may lie between readings, where that is most of their uncertainty; empty where
        it is of none, or all steps are read."""
        if self.every == 1:
            return ""
        wide = []
        for name, run in self._read().items():
            missed = _missed(run, self._tears)
            known = run[~np.isnan(run)]
            least = NOTED * float(known.max(initial=-inf) - known.min(initial=inf))
            off = error.probes.get(name, (nan,) * 3)[1:]
            if any(one > least and 2.0 * one > other for one, other in zip(missed, off)):
                wide.append(f"{name} by {measured(max(missed), unit=units.get(name, ''))}")
        if not wide:
            return ""
        more = f" and {len(wide) - NAMED} more" if len(wide) > NAMED else ""
        return (
            f"extremes may go beyond those read ({', '.join(wide[:NAMED])}{more}): one step in {self.every} is read;"
            " raise --fps"
        )

    def _repeat(self, again: Any, free: NDArray, advance: Callable[[int, float], None]) -> _Run:
        """Run to the end of the first run, and read where it was read."""
        found: list[NDArray] = []
        frames = 0
        for one in self._readings:
            again.step(max(0, round((one.time - again.time) / again.dt)))
            probes = again.probes() if one.is_frame else again.probes_at_moment()
            found.append(np.array([*probes.values()]))
            if one.is_frame:
                frames += 1
                advance(frames, one.time - self._start.time)
        return _Run(again.position[free], again.energy().total, _by_name(self._names, found))

    def _second(self, simulation: Any) -> tuple[Any, Any]:
        """The second run, at the start of the first, and that start."""
        if simulation.backend.precision == "f64":
            again, start = simulation.at_half_step(), self._start
        else:
            scene, half = simulation.scene, float(other_neighbour(simulation.dt / 2.0))
            again = simulation.at_half_step(rounded_otherwise(scene), half)
            given = self._start.position == scene.position.astype(np.float32)  # not so where it has moved before
            start = replace(
                self._start, position=np.where(given, other_neighbour(scene.position), self._start.position)
            )
        return _resumed(again, start), start


def _resumed(simulation: Any, start: Any) -> Any:
    """A simulation put to a start; closed where that fails."""
    try:
        simulation.resume(start)
    except BaseException:
        simulation.close()
        raise
    return simulation


def _by_name(names: Sequence[str], readings: list[NDArray]) -> dict[str, NDArray]:
    """Numbers at all readings, of which there is one at least, by name."""
    return dict(zip(names, np.array(readings).T))


def _missed(run: Sequence[float] | NDArray, tears: bool) -> tuple[float, float]:
    """Bounds of how far a number goes below its least and beyond its largest reading; tears: where springs may tear."""
    if np.isnan(run).all():
        return 0.0, 0.0
    return beyond(run, int(np.nanargmin(run)), tears), beyond(run, int(np.nanargmax(run)), tears)


class _Order(NamedTuple):
    """Order of convergence of a method, at least 1. events: contacts or tearing, which happen somewhere within a step."""

    of_method: float
    events: bool = False

    @classmethod
    def of(cls, simulation: Any) -> "_Order":
        """The order of a simulation in its scene."""
        events = simulation.parts.contacts.active or bool(np.isfinite(simulation.scene.break_strain).any())
        return cls(max(1, simulation.settings.integrator.method.order), events)

    @property
    def needs_third(self) -> bool:
        """True where two runs do not tell the error."""
        return self.of_method == 1 or self.events


class _Judge:
    """Differences of successive runs over all of a quantity, and what they say of its order; rounding: that of the quantity, as a
    walk of so many steps adds it up."""

    def __init__(self, differences: list[float], rounding: float, order: _Order) -> None:
        self.differences, self.order = differences, order
        self.ratio = inf  # rounding alone, or two runs, which the order is believed of
        if len(differences) > 1 and max(differences) > CERTAIN * rounding:
            self.ratio = differences[0] / differences[1] if differences[1] > 0.0 else inf

    def error(self, differences: list[float]) -> float:
        """Error of the first run in one number, from its differences."""
        if len(differences) == 1:
            return error_from(differences[0], self.order.of_method)
        first, second = differences
        of_events = error_of_events(first, second) if self.order.events else 0.0
        of_step = 0.0 if self.order.of_method > 1 else error_of_three(first, second, 1.0, self.ratio)
        return nan if np.isnan(of_step) else max(of_step, of_events)


def _hidden(simulation: Any) -> str:
    """Words on motion of springs that the method takes away within a few steps, so that no run shows it; empty where it keeps
    that."""
    scene, method, h = simulation.scene, simulation.settings.integrator.method, simulation.dt / simulation.substeps
    omega = sqrt(largest_eigenvalue(scene, scene.stiffness)[0])
    step = None if method.conserves or not omega else method.amplification(scene, omega, 0.0, h)
    if step is None or np.abs(np.linalg.eigvals(step)).max() > 1.0 - LOSES:
        return ""
    return (
        f"{method} damps motion of up to {plain_number(omega / (2.0 * np.pi))} Hz of the springs away in all runs alike; take"
        f" verlet, or steps below {plain_number(RESOLVED / omega, 2)} s"
    )


def _off(
    runs: Sequence[Sequence[float] | NDArray],
    order: _Order,
    digit: float,
    steps: float = 1.0,
    blind: bool = False,
    tears: bool = False,
) -> tuple[float, float, float]:
    """Errors of the last, least and largest value of one number; digit: a part of it by which any value is rounded;
    steps: of the last run. blind: to fast motion, so that extremes are known only where the runs agree to rounding. tears: see
    `_missed`.

    Differences that swing, and those of rounding, pass through 0: the last value is as wrong as those before it.
    """
    before = len(runs[0]) - 1 - len(runs[0]) // LAST
    apart = [np.subtract(a, b) for a, b in pairwise(runs)]
    ends_apart = [one[before:] for one in apart]
    near = [float(np.abs(one[~np.isnan(one)]).max(initial=0.0)) for one in ends_apart]
    apart = [one[~np.isnan(one)] for one in apart]
    if not all(len(one) for one in apart):
        return nan, nan, nan
    values = [_summed_up(run) for run in runs]
    judge = _Judge([rms(one) for one in apart], digit * sqrt(steps) * max(map(abs, values[0])), order)
    if blind and judge.ratio < inf:
        return judge.error(near) + digit * abs(values[0][0]), nan, nan
    ends = [near]
    for extreme in (np.nanargmin, np.nanargmax):
        # where runs have their extremes, the runs are as far apart as the extremes at least, and extremes may agree by luck
        at = [int(extreme(run)) for run in runs]
        ends.append([max(abs(x[i] - y[i]) for i in at) for x, y in pairwise(runs)])
    last, least, most = (judge.error(one) + digit * abs(value) for one, value in zip(ends, values[0]))
    low, high = _missed(runs[0], tears)
    return last, least + low, most + high


def _summed_up(values: Sequence[float] | NDArray) -> tuple[float, float, float]:
    """Last, least and largest; what is not known, as means between frames, is left out of the latter."""
    known = np.asarray(values)[~np.isnan(values)]
    return float(values[-1]), float(known.min(initial=inf)), float(known.max(initial=-inf))
