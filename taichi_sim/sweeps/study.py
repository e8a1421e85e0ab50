"""Study: a scene of which points are run and measured, and the rows that a folder keeps of them. Sweeps and fits are studies."""

import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, short, words_of
from taichi_sim.common.version import __version__
from taichi_sim.files.source import checked_output
from taichi_sim.scene.scene import Scene
from taichi_sim.studies.workers import MOST_ENDS, connected, place, require_workers
from taichi_sim.sweeps.design import Axis
from taichi_sim.sweeps.folder import SweepFolder
from taichi_sim.sweeps.measures import Measures, measures_of
from taichi_sim.sweeps.points import Job, Point, Row, Runner, batch_file, keep_batch, run_batch
from taichi_sim.sweeps.subject import Subject, lasting, subject_of

__all__ = ["Study", "open_study"]

BATCH = 20  # points of a task
MOST_TRIED = 200  # values of an axis that are looked at before anything runs
FEW_TASKS = 4  # for each worker, at least: so that all have work until the end


class Study:
    """See `open_study`. rows: by key, all that are known, others than those asked for, too."""

    def __init__(
        self,
        subject: Subject,
        measures: Measures,
        runner: Runner,
        kept: SweepFolder,
        kinds: Mapping[str, Mapping[str, int]],
        connect: Callable[[], Any],
        say: Callable[[str], None],
    ) -> None:
        self.subject, self.measures, self.kept = subject, measures, kept
        self._runner, self._kinds, self._connect, self._say = runner, kinds, connect, say
        self._engine: Any = None

    @property
    def rows(self) -> dict[str, Row]:
        """Rows by key."""
        return self.kept.rows

    def missing(self, points: Sequence[Point]) -> list[Point]:
        """Points without a row, each once, those of one structure after each other."""
        missing = [point for key, point in {point.key: point for point in points}.items() if key not in self.rows]
        kinds = self._kinds
        missing.sort(
            key=lambda point: [kinds[path].get(repr(value), 0) for path, value in sorted(point.parameters.items())]
        )
        return missing

    def run(self, points: Sequence[Point], at_most: int = 0) -> Iterator[list[Row]]:
        """Run those that are missing; their rows, some at a time, as they come in. at_most: how many there may be in all where
        what these come to decides on the next ones."""
        missing = self.missing(points)
        if not missing:
            return
        if self._engine is None:
            self._engine = self._connect()
            already = len({point.key for point in points}) - len(missing)
            more = f", then those that the search asks for, at most {at_most}" if at_most else ""
            self._say(f"{len(missing)} points to run{more}, {already} done before; {self._engine.said}")
        size = max(1, min(BATCH, -(-len(missing) // (FEW_TASKS * self._engine.number))))
        job = replace(self._runner.job, shared=self._engine.number > 1)
        work = partial(run_batch, job) if self._engine.apart else self._runner.batch
        waiting: deque[Sequence[Point]] = deque(missing[k : k + size] for k in range(0, len(missing), size))
        for batch, rows in self._engine.run(work, waiting, "sweep", lambda batch: [[point] for point in batch]):
            if rows is None:
                ended = f"its worker ended {MOST_ENDS} times: killed, or out of memory"
                rows = [Row.of(point, error=ended) for point in batch]
            elif not batch_file(
                self.kept.batches, rows, self.kept.mark
            ).is_file():  # its worker does not see the folder
                keep_batch(self.kept.batches, rows, self.kept.mark)
            self.kept.add(rows)
            yield rows


@contextmanager
def open_study(
    scene: Any,
    axes: Sequence[Axis],
    seeds: Sequence[int | None],
    measure: Any,
    about: Mapping[str, Any],
    *,
    duration: float | None,
    fps: float | None,
    folder: str | PathLike[str] | None,
    workers: int | None,
    scheduler: str | None,
    overwrite: bool,
    retry: bool,
    say: Callable[[str], None],
    allow_outside: bool,
    settings: Mapping[str, Any],
    tabulated: Sequence[Point] = (),
) -> Iterator[Study]:
    """A study of `scene`, see `taichi_sim.sweeps.sweep.sweep` for the arguments. about: plain values that tell it from others,
    besides those that all studies have. tabulated: points of the table that is written at the end. Raises SceneError, ValueError
    or OSError, before anything runs or is written, for what is not allowed."""
    scheduler, workers = place(scheduler, workers)
    for name, value in (("duration", duration), ("fps", fps)):
        if value is not None:
            validation.number(name, value, positive=True)
    with ExitStack() as stack:
        aside = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="taichi_sim_sweep_")))
        subject = (
            lasting(scene) if isinstance(scene, Scene) and folder is None else subject_of(scene, aside, allow_outside)
        )
        apart = workers != 0 or scheduler is not None
        given = {"arch": "cpu", "threads": 1, **settings} if apart else settings
        kinds, first = _tried(subject, axes, seeds, given)
        measures = measures_of(measure, first)
        home = aside / "study" if folder is None else Path(folder)
        kept = SweepFolder(
            home,
            {
                "scene": subject.name,
                "contents": subject.identity(),
                "measures": measures.identity(),
                "duration": duration,
                "fps": fps,
                "settings": {name: str(value) for name, value in settings.items()},
                "version": __version__,
                **about,
            },
            overwrite,
        )
        if not kept.rows and scheduler is not None:
            require_workers(scheduler, workers)  # else it is refused with the first point, and an empty folder there
        stack.callback(kept.close)
        if tabulated:  # before Ctrl-C can come; once no worker writes any more: the last to be entered is left first
            stack.callback(kept.finish, tabulated)
        kept.begin()
        if retry:
            kept.rows = {key: row for key, row in kept.rows.items() if not row.error}
        if isinstance(scene, Scene) and folder is not None:  # from now on the folder is this study's
            subject = subject_of(scene, home)
        runner = Runner(Job(subject, measures, given, duration, fps, str(kept.batches.resolve()), apart, kept.mark))
        stack.callback(runner.close)
        yield Study(
            subject, measures, runner, kept, kinds, lambda: stack.enter_context(connected(scheduler, workers, say)), say
        )


def _tried(
    subject: Subject, axes: Sequence[Axis], seeds: Sequence[int | None], given: Mapping[str, Any]
) -> tuple[dict[str, dict[str, int]], Any]:
    """Make scenes with each value in turn, the others as they come first. For each axis the kind of structure of each value, by
    which points are sorted; and the first scene. Raises SceneError for paths and values that are not allowed."""
    from taichi_sim.simulation.settings import Settings
    from taichi_sim.simulation.structure import kind_of

    base = {axis.path: axis.tried[0] for axis in axes}
    first = _made(subject, base, seeds[-1])
    checked_output(first)
    with first.in_file(dict(given)):
        Settings.resolve(first, dict(given))
    kinds: dict[str, dict[str, int]] = {}
    for axis in axes:
        values = axis.tried[:MOST_TRIED]
        known: dict[str, int] = {}
        kinds[axis.path] = {}
        for value in values:
            made = _made(subject, base | {axis.path: value}, seeds[0])
            kinds[axis.path][repr(value)] = known.setdefault(kind_of(made), len(known))
    return kinds, first


def _made(subject: Subject, parameters: Mapping[str, Any], seed: int | None) -> Any:
    """The scene of some parameters. Raises SceneError, which names them where a user's function ends with another error."""
    try:
        return subject.scene(parameters, seed)
    except (SceneError, OSError):
        raise
    except Exception as error:
        given = ", ".join(f"{name} = {short(value)}" for name, value in parameters.items()) or "its defaults"
        raise SceneError("scene", says=f"cannot be made with {given}; {words_of(error)}") from error
