"""A sweep from end to end: what is varied is checked, points are run, and what they come to is a table."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.progress import Counted, showing
from taichi_sim.sweeps.design import MOST_POINTS, Axis, Design, axes_of
from taichi_sim.sweeps.effects import grouped, parameters_in_words
from taichi_sim.sweeps.folder import columns_of
from taichi_sim.sweeps.measures import Measures
from taichi_sim.sweeps.points import Point, Row
from taichi_sim.sweeps.study import Study, open_study
from taichi_sim.sweeps.subject import Subject

__all__ = ["Sweep", "sweep"]

TABLE_EVERY = 5.0  # s


class Sweep:
    """Result of a sweep. rows: by point, in order; those of an interrupted one are fewer than `points`. folder: where all of
    it is, or None."""

    def __init__(
        self,
        subject: Subject,
        axes: Sequence[Axis],
        design: Design,
        points: Sequence[Point],
        rows: Mapping[str, Row],
        settings: Mapping[str, Any],
        measures: Measures,
        folder: Path | None,
    ) -> None:
        self._subject, self._settings, self._measures = subject, dict(settings), measures
        self.with_unit = measures.with_unit  # of a measure's name
        self.axes, self.design, self.points, self.folder = tuple(axes), design, list(points), folder
        self.rows = [rows[key] for key in dict.fromkeys(point.key for point in points) if key in rows]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        failed = len(self.failed)
        return f"<Sweep of {self._subject.name}: {len(self.rows)} of {len(self.points)} points done, {failed} failed>"

    @property
    def failed(self) -> list[Row]:
        """Rows without measures, each with its error."""
        return [row for row in self.rows if row.error]

    @property
    def measures(self) -> list[str]:
        """Names of what was measured."""
        return list(dict.fromkeys(name for row in self.rows for name in row.measures))

    def table(self) -> dict[str, Any]:
        """Columns as arrays: parameters, seed, measures (nan where a row has none), error, warning, version, wall [s]; a
        DataFrame of pandas takes it."""
        names = set(self.measures)
        return {
            name: np.array([np.nan if v is None else v for v in values], dtype=float)
            if name in names
            else np.array(values)
            for name, values in columns_of(self.rows).items()
        }

    def lines(self, most: int = 20) -> Iterator[str]:
        """Yield what was measured, a line for each combination of parameters and each measure: the mean over seeds with the
        interval in which it lies with 95 % confidence, or the value of one run. most: combinations that are shown."""
        for measure in self.measures:
            groups = [group for group in grouped(self.rows, measure) if len(group.values)]
            for group in groups[:most]:
                at = ", ".join(
                    f"{name} {words}" for name, words in zip(group.parameters, parameters_in_words(group.parameters))
                )
                yield f"{measure:12} {group.in_words(self._measures.unit(measure))}{f' at {at}' if at else ''}"
            if len(groups) > most:
                yield f"{measure:12} and {len(groups) - most} combinations more, see the table"

    def scene(self, row: int | Row) -> Any:
        """The Scene of a point."""
        one = self.rows[row] if isinstance(row, int) else row
        return self._subject.scene(one.parameters, one.seed)

    def open(self, row: int | Row) -> Any:
        """The Simulation of a point at its start, as it was run: `sweep.open(3).run(1.0)` repeats it to the last bit."""
        from taichi_sim.simulation.simulation import Simulation

        return Simulation(self.scene(row), **self._settings)

    def report(self) -> Path:
        """Write report.html into the folder, and return its path."""
        from taichi_sim.sweeps.page import write_page

        if self.folder is None:
            raise ValueError("report: this sweep has no folder; give one to sweep(..., folder=...)")
        return write_page(self, self._subject.name)


def sweep(
    scene: Any,
    vary: Mapping[str, Any] | Sequence[str] = (),
    *,
    seeds: int | Sequence[int] | None = None,
    measure: Any = None,
    design: str = "product",
    points: int | None = None,
    luck: int = 0,
    duration: float | None = None,
    fps: float | None = None,
    folder: str | PathLike[str] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    overwrite: bool = False,
    retry: bool = False,
    yes: bool = False,
    progress: bool = False,
    say: Callable[[str], None] = lambda line: None,
    allow_outside: bool = False,
    **settings: Any,
) -> Sweep:
    """Run a scene many times, with other parameters and seeds, and measure.

    Args:
        scene: a Scene, the name of a scene file, a Python file or a demo, or a function with a name in a module that takes
            parameters and returns a Scene.
        vary: paths to values, `{"materials.rubber.restitution": [0.1, 0.5], "cloth[0].stiffness": "1e2:1e4:5:log"}`: in the
            words of the scene file, or arguments of the function. Values are a list, or a text: `1,2,5`, `0.1:0.9:9` (nine of
            them), `1e2:1e4:5:log`, or a range to sample, `0.1:0.9`, `1e2:1e4:log`.
        seeds: how often each point is run, from seed 0 on, or a list of seeds. A seed is the argument `seed` of a function, and
            added to the seeds of piles in a scene file; without either, each loose ball starts up to a thousandth of its radius
            away.
        measure: names, functions, or one of them; see `taichi_sim.sweeps.measures.measures_of`.
        design: "product" of all values; "random", "latin" (hypercube) with so many `points`; "sobol": points x (parameters +
            2), for Sobol's indices. luck: seed of the sample.
        duration [s], fps [1/s] of readings: the scene's own, else 5 s, 60 a second.
        folder: rows are kept there as they come in, and the same call goes on where it was interrupted; None: nowhere.
        workers: processes on this machine, one for each core by default; 0: this process. scheduler: address of Dask's, instead.
        overwrite: replace another sweep in the folder. retry: run points that failed once more.
        yes: allow more than 100 000 points. progress: a bar on standard error. say: what is told on the way.
        settings: arguments of Simulation over the scene's own: dt, integrator, precision, ...

    Raises SceneError, ValueError or OSError, before anything runs, for what is not allowed. A point that fails, an unstable one
    for instance, is a row with its error.
    """
    axes = axes_of(vary)
    plan = Design(axes, design, points, luck)
    plan.check()
    numbers = seeds_of(seeds)
    if plan.count * len(numbers) > MOST_POINTS and not yes:
        says = f"are {plan.count * len(numbers)}, more than {MOST_POINTS}; say yes to that (--yes), or take fewer"
        raise SceneError("points", says=says)
    every = [Point(parameters, seed) for parameters in plan for seed in numbers]
    with open_study(
        scene, axes, numbers, measure, {"parameters": [axis.path for axis in axes]}, duration=duration, fps=fps, folder=folder,
        workers=workers, scheduler=scheduler, overwrite=overwrite, retry=retry, say=say, allow_outside=allow_outside,
        settings=settings, tabulated=every,
    ) as study:  # fmt: skip
        _run(study, every, progress)
        lasting = None if folder is None else Path(folder)
        done = Sweep(study.subject, axes, plan, every, study.rows, settings, study.measures, lasting)
        if lasting is not None and done.rows:
            done.report()
        return done


def _run(study: Study, points: Sequence[Point], progress: bool) -> None:
    """All that is missing; the table every few seconds."""
    missing, total = len(study.missing(points)), len({point.key for point in points})
    written = time.monotonic()
    work = Counted(total, "points", total - missing)
    with showing(work, progress):
        for rows in study.run(points):
            work.done += len(rows)
            work.failed += sum(bool(row.error) for row in rows)
            if time.monotonic() - written > TABLE_EVERY:
                study.kept.finish(points)
                written = time.monotonic()


def seeds_of(seeds: int | Sequence[int] | None) -> list[int | None]:
    if seeds is None:
        return [None]
    if isinstance(seeds, (int, np.integer)):
        return list(range(validation.whole("seeds", int(seeds), 1, 10_000_000)))
    found = [validation.whole("seeds", seed, 0) for seed in seeds]
    if not found:
        raise SceneError("seeds", says="are none; give a number of them")
    return list(dict.fromkeys(found))
