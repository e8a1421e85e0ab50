"""A process that runs trials in one precision, because Taichi holds one per process.

It is spawned, never forked: a child forked after Taichi has started hangs. Each method is compiled once, its steps are changed.
"""

import hashlib
import multiprocessing
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from copy import copy
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.between_samples import beyond, steps_between
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.richardson import rms
from taichi_sim.common.errors import BackendError, UnstableError
from taichi_sim.reports.speed_error.compared import Compared, distance
from taichi_sim.reports.speed_error.plan import PARTS, Plan, Step
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot

Floats = NDArray[np.float64]
SHORT = 0.25  # s; a shorter run is made again until all together take so long
REPEATS, MOST_REPEATS = 5, 200  # for that
LONG = 4.0 * SHORT  # s; a run of less is made twice at least
UNSTEADY = 0.05  # of a time: a machine's speed varies by that between runs minutes apart, which no repetition shows
AGAIN = 8  # steps that are timed where one alone promises too much
PATIENCE = 3.0  # times what a run may take that its first steps may promise


class Trial(NamedTuple):
    """A run through the whole duration. start: positions (n, dim) [m] other than the scene's. most: seconds that it may take.
    contacts: read them, too, and peaks between the moments. timed: repeat a short run for the least time."""

    method: str
    step: Step
    start: Floats | None = None
    most: float = np.inf
    contacts: bool = False
    timed: bool = False

    def digest(self, precision: str) -> str:
        """Name of what it comes to in this precision."""
        start = "" if self.start is None else hashlib.sha256(np.ascontiguousarray(self.start).tobytes()).hexdigest()
        about = repr((precision, self.method, self.step, self.most, self.contacts, start))
        return hashlib.sha256(about.encode()).hexdigest()[:16]


class Outcome(NamedTuple):
    """Result of a trial; lists have an entry for each part of the duration that was reached."""

    device: str
    position: list[Floats]  # (n, dim) m
    energy: list[tuple[float, float, float, float]]  # J: kinetic, spring, gravity, total
    contacts: list[tuple[int, float]]  # number, and the largest overlap in radii
    seconds: float | None = None  # for the whole duration: of the processor, on other devices of wall time
    passes: float | None = None  # over the forces
    unstable: str = ""  # why it ended early
    left_out: str = ""
    warning: str = ""
    touch: bool = False  # whether contacts can act
    quantity: list[Floats] = []  # noqa: RUF012  # (1,) or (dim,), where the plan asks for one
    begin: Floats | None = None  # the same at the start
    noise: float | None = None  # s, of `seconds`
    peak: list[float] = []  # noqa: RUF012  # the largest motion that was seen in each part, at its ends and between them


class TrialProcesses:
    """Processes that run trials, one at a time: that of a precision is started when it is asked for, and the one before ends
    then. Use it as a context; leaving it ends the process."""

    def __init__(self, scene: Scene, plan: Plan, step_done: Callable[[str], None]) -> None:
        self._scene, self._plan, self._step_done = copy(scene), plan, step_done
        # the trial says these; user-defined objects among them could not be sent
        own = scene.settings.items()
        self._scene.settings = {key: value for key, value in own if key not in ("integrator", "dt")}
        self._precision = ""  # of the process that there is

    def run(self, precision: str, trial: Trial) -> Outcome:
        """Raises BackendError where the process cannot go on; a trial that fails by itself says so in its outcome."""
        if precision != self._precision:
            self.__exit__(None)
            context = multiprocessing.get_context("spawn")
            self._pipe, other = context.Pipe()
            arguments = (other, self._scene, self._plan, precision)
            self._process = context.Process(target=_serve, args=arguments, daemon=True)
            self._process.start()
            other.close()
            self._precision = precision
        self._step_done(f"{trial.method} in {precision} at {trial.step.seconds:.3g} s")
        try:
            self._pipe.send(trial)
            answer = self._pipe.recv()
        except (EOFError, OSError):
            self._process.join(5.0)
            raise BackendError(
                f"report: the {precision} process ended with status {self._process.exitcode} in {trial.method} at"
                f" {trial.step.seconds:.4g} s"
            ) from None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def __enter__(self) -> "TrialProcesses":
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if not self._precision:
            return
        self._precision = ""
        self._pipe.close()
        if kind is not None:
            self._process.terminate()
        self._process.join(10.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _serve(pipe: Connection, scene: Scene, plan: Plan, precision: str) -> None:
    """The child: trials in, outcomes out, until the parent closes the pipe or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's business
    track: Track | None = None
    while True:
        try:
            trial = pipe.recv()
        except EOFError:
            return
        try:
            track = track or Track(scene, plan, precision)
            answer: Any = track.run(trial)
        except BackendError as error:
            answer = error
        except Exception as error:  # to be raised by the parent, with the place that the pipe would lose
            answer = BackendError(f"report: {trial.method}: {error}\n{traceback.format_exc()}")
        try:
            pipe.send(answer)
        except OSError:
            return


class Track:
    """The simulation of one method after the other, each compiled once."""

    def __init__(self, scene: Scene, plan: Plan, precision: str) -> None:
        from taichi_sim.device import backend

        self.scene, self.duration = scene, plan.duration
        given = scene.settings
        runs = backend.start(
            given.get("arch") if plan.arch is None else plan.arch,
            precision,
            given.get("threads") if plan.threads is None else plan.threads,
        )
        self.device = runs.arch if runs.arch != "cpu" else f"cpu, {runs.threads} threads"
        # time of the processor does not count what other programs do meanwhile
        self._clock = time.process_time if runs.arch == "cpu" else time.perf_counter
        self.settings: dict[str, Any] = {"arch": runs.arch, "precision": precision, "threads": None, "substeps": 1}
        self.method = ""
        self.compared = Compared(scene, plan)
        self.sim: Any = None

    def run(self, trial: Trial) -> Outcome:
        """One trial from the start of the scene."""
        outcome = Outcome(self.device, [], [], [], quantity=[], peak=[])
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                self._prepare(trial)
                outcome = self._measure(trial, outcome)
            except UnstableError as error:
                outcome = outcome._replace(unstable=error.reason)
            except ValueError as error:  # a scene that this method, step or precision cannot take
                outcome = outcome._replace(left_out=str(error))
        return outcome._replace(warning="; ".join(dict.fromkeys(str(one.message) for one in said)))

    def _prepare(self, trial: Trial) -> None:
        """The compiled simulation of the trial's method with its step."""
        from taichi_sim.simulation.simulation import Simulation

        if self.sim is None or self.method != trial.method:
            if self.sim is not None:
                self.sim.close()
            self.sim = None
            self.sim = Simulation(self.scene, **{**self.settings, "integrator": trial.method, "dt": trial.step.seconds})
            self.method = trial.method
            self._begin(trial)
            self.sim.step(1)  # the parallel driver compiles with its first step
            if trial.contacts:
                self.sim.contacts()
        else:
            self.sim.set_dt(trial.step.seconds)

    def _begin(self, trial: Trial) -> None:
        """Back to the start."""
        start = self.scene.position if trial.start is None else trial.start
        self.sim.resume(Snapshot(start, self.scene.velocity))
        self.sim.step(0)

    def _measure(self, trial: Trial, outcome: Outcome) -> Outcome:
        outcome = outcome._replace(touch=any(name.startswith("contacts.") for name in self.sim.kernels()))
        self._begin(trial)
        # what is compiled or called once hides what a step costs in a short run, which is repeated for its least time
        most = max(trial.most, SHORT)
        promised = self._time(1) * trial.step.number * PARTS
        if promised > PATIENCE * most:  # one step alone may have been held up
            promised = self._time(AGAIN) / AGAIN * trial.step.number * PARTS
        if promised > PATIENCE * most:
            return outcome._replace(left_out=_too_long(promised, trial.most))
        self._begin(trial)
        outcome = outcome._replace(begin=self._value())
        peaks = _Peaks(self.sim, self.compared, outcome.begin)
        before, times = self._passes(), []
        for part in range(PARTS):
            try:
                with peaks.watched(self.duration) if trial.contacts else nullcontext():
                    times.append(self._time(trial.step.number))
            except UnstableError as error:
                return outcome._replace(seconds=promised, unstable=error.reason)
            outcome.position.append(self.sim.position)
            outcome.energy.append(tuple(self.sim.energy()))
            if peaks.sizes:
                outcome.peak.append(peaks.taken())
            value = self._value()
            if value is not None:
                outcome.quantity.append(value)
            if trial.contacts:
                contacts = self.sim.contacts()
                outcome.contacts.append((contacts.number, contacts.relative_penetration))
            if sum(times) > most and part + 1 < PARTS:
                return outcome._replace(left_out=_too_long(PARTS * float(np.mean(times)), trial.most))
        passes = self._passes()
        seconds, noise = self._timing(trial, times)
        if passes is None:
            declared = named(trial.method).passes(self.scene, trial.step.seconds)
            before, passes = 0.0, float(declared * trial.step.number * PARTS)
        return outcome._replace(seconds=seconds, noise=noise, passes=passes - (before or 0.0))

    def _value(self) -> Floats | None:
        quantity = self.compared.quantity
        return None if quantity is None else quantity.value(self.sim.probes())

    def _timing(self, trial: Trial, times: list[float]) -> tuple[float, float]:
        """Seconds that the run takes, and to what they are known. The run is repeated, and each part counts with its least time:
        whatever else the machine does only makes a part take longer."""
        runs = [times]
        most = REPEATS if sum(times) < SHORT else 2 if sum(times) < LONG else 1
        while trial.timed and len(runs) < MOST_REPEATS and (len(runs) < most or (most > 1 and np.sum(runs) < SHORT)):
            self._begin(trial)
            runs.append([self._time(trial.step.number) for _ in range(PARTS)])
        seconds = float(np.sum(np.min(runs, axis=0)))
        noise = float(np.median(np.sum(runs, axis=1))) - seconds
        return seconds, max(noise, UNSTEADY * seconds)

    def _time(self, steps: int) -> float:
        begin = self._clock()
        self.sim.step(steps)  # ends with a search for balls that are not finite, so it is done
        return self._clock() - begin

    def _passes(self) -> float | None:
        """Number of passes that an implicit method has counted so far; None for others."""
        solved = self.sim.solver()
        return None if solved is None else float(solved.passes)


class _Peaks:
    """Sizes of the quantity at steps between the moments compared, as those of `Compared.motion`, since `taken`; none of
    energies, which have one size. begin: the quantity at the start."""

    def __init__(self, sim: Any, compared: Compared, begin: Floats | None) -> None:
        self.sim, self.compared = sim, compared
        has_zero = compared.quantity is None or not compared.quantity.from_start
        self.begin = 0.0 if has_zero or begin is None else begin
        self.sizes: list[float] = []

    @contextmanager
    def watched(self, duration: float) -> Iterator[None]:
        """Read at the steps made in the block, of a run of `duration` [s]."""
        quantity = self.compared.quantity
        if quantity is not None and quantity.of_energy:
            yield
            return
        with self.sim.pausing(steps_between(self.sim, duration, 1), self._read):
            yield

    def _read(self) -> None:
        quantity = self.compared.quantity
        if quantity is None:
            self.sizes.append(rms(distance(self.compared.scene, self.sim.position, self.compared.scene.position)))
            return
        value = quantity.value(self.sim.probes_at_moment())
        self.sizes.append(float(np.linalg.norm(value - self.begin)))

    def taken(self) -> float:
        """The largest since then, which may lie between two readings; nan of means."""
        sizes, self.sizes = self.sizes, self.sizes[-1:]
        if np.isnan(sizes).all():
            return float("nan")
        at = int(np.nanargmax(sizes))
        return sizes[at] + beyond(sizes, at)


def _too_long(seconds: float, most: float) -> str:
    return f"would take about {seconds:.3g} s, more than the {most:.3g} s that one run may take (--limit)"
