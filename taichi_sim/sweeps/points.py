"""Points of a sweep, what they come to, and the work of one process: points one after another by one simulation, used again."""

import hashlib
import json
import time
import uuid
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from taichi_sim.common import memory
from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.errors import UnstableError, words_of
from taichi_sim.common.signals import ENDED
from taichi_sim.common.version import __version__
from taichi_sim.scene.scene import Scene
from taichi_sim.studies.records import lines_of
from taichi_sim.studies.workers import kept
from taichi_sim.sweeps.measures import Measures
from taichi_sim.sweeps.subject import Subject

__all__ = ["Job", "Point", "Row", "Runner", "batch_file", "run_batch"]

FPS, DURATION = 60.0, 5.0  # where neither the scene nor the user says it
MOST_SAID = 300  # characters of a warning or an error
RELEASE_BYTES = 1 << 30  # of memory in use by a worker, from which on it begins anew


@dataclass(frozen=True)
class Point:
    """Parameters by their paths, and a seed, or None."""

    parameters: Mapping[str, Any]
    seed: int | None = None

    @property
    def key(self) -> str:
        """Key of the point, in every run of the command."""
        text = json.dumps([sorted(self.parameters.items()), self.seed])
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Row:
    """Result of a point. error: why it has no measures, or ""; wall: seconds of work, compiling included; compiled: whether
    kernels were compiled or loaded for it."""

    key: str
    parameters: dict[str, Any]
    seed: int | None
    measures: dict[str, float] = field(default_factory=dict)
    error: str = ""
    warning: str = ""
    version: str = __version__
    wall: float = 0.0
    compiled: bool = False

    @classmethod
    def of(cls, point: Point, **more: Any) -> "Row":
        """Make the row of a point."""
        return cls(point.key, dict(point.parameters), point.seed, **more)


@dataclass(frozen=True)
class Job:
    """Settings with which points are run. duration, fps: None leaves them to the scene; settings: arguments of Simulation
    over the scene's own; folder: where batches of rows go, on all machines; mark: start of their names, which differs
    between sweeps; apart: in a process that does nothing else; shared: by several of these."""

    subject: Subject
    measures: Measures
    settings: Mapping[str, Any]
    duration: float | None = None
    fps: float | None = None
    folder: str | None = None
    apart: bool = True
    mark: str = ""
    shared: bool = False
    known_by: str = field(
        default_factory=lambda: uuid.uuid4().hex
    )  # a worker keeps its simulation from task to task of a job


class Runner:
    """Runs points by one simulation, which is reset from one to the next of the same structure."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self.simulation: Any = None
        self.kind = ""  # of it
        self.made = 0  # times that kernels were compiled or loaded, since the start
        self.waited = 0.0  # s, for what other workers compile

    def run(self, point: Point) -> Row:
        """A point, whatever becomes of it; a signal that ends the process is no matter of the point, and is passed on."""
        start, made, waited = time.perf_counter(), self.made, self.waited
        measures: dict[str, float] = {}
        error = ""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                scene = self.job.subject.scene(point.parameters, point.seed)
                measures = self.measured(scene)
            except UnstableError as unstable:
                error = f"unstable: {unstable}"
            except (Exception, SystemExit) as problem:  # of the user's functions, too
                if isinstance(problem, SystemExit) and problem.code in ENDED:
                    raise
                error = words_of(problem)
        said = "; ".join(dict.fromkeys(str(one.message) for one in caught if issubclass(one.category, UserWarning)))
        return Row.of(
            point,
            measures=measures,
            error=_cut(error),
            warning=_cut(said),
            wall=time.perf_counter() - start - (self.waited - waited),
            compiled=self.made > made,
        )

    def batch(self, points: Sequence[Point]) -> list[Row]:
        """Points one after another, whose rows go into a file of their own where the folder is seen from here."""
        rows = [self.run(point) for point in points]
        if self.job.folder is not None and Path(self.job.folder).is_dir():
            keep_batch(Path(self.job.folder), rows, self.job.mark)
        return rows

    def measured(self, scene: Scene) -> dict[str, float]:
        """Run a scene."""
        simulation = self._simulation(scene)
        duration = self.job.duration or float(scene.output.get("duration", DURATION))
        return self.job.measures.run(simulation, duration, self.job.fps or float(scene.output.get("fps", FPS)))

    def _simulation(self, scene: Scene) -> Any:
        from taichi_sim.device import backend
        from taichi_sim.device.compile_once import compile_once
        from taichi_sim.simulation.simulation import Simulation
        from taichi_sim.simulation.structure import kind_of

        kind = kind_of(scene)
        if self.simulation is not None and kind == self.kind and not self.simulation.closed:
            before = self.simulation.parts.kernels
            self.simulation.reset(scene)
            self.made += not before or self.simulation.parts.kernels != before
            return self.simulation
        self.close()
        if self.job.shared:
            self.waited += compile_once(kind, self.job.known_by, partial(self._rehearse, scene))
        elif self.job.apart and self.kind:  # so that kernels of the next are found in the cache, and no memory is kept
            backend.stop()
        self.simulation, self.kind = Simulation(scene, **self.job.settings), kind
        self.made += 1
        return self.simulation

    def _rehearse(self, scene: Scene) -> None:
        """Run two steps from where the scene is and read what is measured, by numbers alone: functions of the user's may count
        how often they run."""
        from taichi_sim.simulation.simulation import Simulation

        with Simulation(scene, **{**self.job.settings, "settle": None}) as simulation:
            numbers = Measures(self.job.measures.numbers, {}, every_frame=True)
            numbers.run(simulation, 2.0 * simulation.dt, 1.0 / simulation.dt)

    def close(self) -> None:
        """Give the memory back."""
        if self.simulation is not None:
            self.simulation.close()
            self.simulation = None

    def relieve(self) -> None:
        """Begin anew where the process has taken much memory."""
        from taichi_sim.device import backend

        if self.job.apart and memory.used() > RELEASE_BYTES:
            self.close()
            backend.stop()


def _cut(text: str) -> str:
    text = " ".join(text.encode("utf-8", "backslashreplace").decode().split())  # files hold no lone surrogates
    return text if len(text) <= MOST_SAID else f"{text[:MOST_SAID]}..."


def run_batch(job: Job, points: Sequence[Point]) -> list[Row]:
    """A task of a worker, see `Runner.batch`."""
    runner = kept(job.known_by, lambda: Runner(job))
    rows = runner.batch(points)
    runner.relieve()
    return rows


def batch_file(folder: Path, rows: Sequence[Row], mark: str) -> Path:
    """File for rows of the sweep with that mark."""
    return folder / f"{mark}{rows[0].key}_{len(rows)}.jsonl"


def keep_batch(folder: Path, rows: Sequence[Row], mark: str) -> None:
    """Write rows to a file of their own, which appears whole."""
    with replacing(batch_file(folder, rows, mark), swept=True) as file:
        file.write(lines_of(rows))
