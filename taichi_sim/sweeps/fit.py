"""Fit: parameters by which a scene measures what was measured elsewhere, and how well these tell them."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.scene import Scene
from taichi_sim.sweeps.design import MOST_LUCK, Axis, Design, axes_of, seeded
from taichi_sim.sweeps.points import Point
from taichi_sim.sweeps.study import Study, open_study
from taichi_sim.sweeps.subject import Subject
from taichi_sim.sweeps.sweep import seeds_of

__all__ = ["METHODS", "Fit", "fit"]

METHODS = ("nelder-mead", "evolution")
SCAN = 8  # points for each parameter, from which the search starts; with evolution its population
RESOLUTION = 1e-4  # of a range, to which parameters are found
PROBE = 0.01  # of a range: how far to each side sensitivities look
EDGE = 1e-3  # of a range: so near its end, a parameter is there
FLAT = 1e-3  # of the largest: targets tell nothing of combinations of parameters to which they are less sensitive
FAILED = 1e30  # misfit of a point without measures
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """Result of a fit. parameters, measured: of the best point; target: what was asked; misfit: root of the mean square of
    (measured - target) / target; allowed: up to which misfit the target is reached.

    sensitivity: for each parameter and measure the percent of the target by which the measure changes where the parameter grows
    by one. spread: the standard deviation of each parameter, in percent, where each target is known to one percent; inf where
    the targets do not tell it. at_end: parameters at an end of their range. seen: the least and largest of each measure in all
    runs.
    """

    parameters: dict[str, float]
    measured: dict[str, float]
    target: dict[str, float]
    misfit: float
    allowed: float
    runs: int
    sensitivity: dict[str, dict[str, float]]
    spread: dict[str, float]
    at_end: tuple[str, ...]
    seen: dict[str, tuple[float, float]]
    subject: Subject
    settings: Mapping[str, Any]

    @property
    def reached(self) -> bool:
        """True if the scene measures the target."""
        return self.misfit <= self.allowed

    def scene(self) -> Scene:
        """The scene with these parameters."""
        return self.subject.scene(self.parameters)

    def open(self) -> Any:
        """The Simulation of it, at its start."""
        from taichi_sim.simulation.simulation import Simulation

        return Simulation(self.scene(), **self.settings)

    def lines(self) -> list[str]:
        """Lines of the result, in words."""
        verdict = "found" if self.reached else "NOT reached, nearest"
        said = [
            f"{'' if k else verdict:12} {name} = {value:.6g}" for k, (name, value) in enumerate(self.parameters.items())
        ]
        for name, value in self.measured.items():
            least, most = self.seen[name]
            said.append(
                f"measured     {name} = {value:.6g}, asked {self.target[name]:.6g}; {least:.6g} to {most:.6g} in {self.runs} runs"
            )
        zero = any(value == 0.0 for value in self.target.values())
        said.append(
            f"misfit       {self.misfit:.2g} of the target{', or in SI units where it is 0' * zero}, allowed {self.allowed:g}"
        )
        for path in self.at_end:
            said.append(f"at the end   {path} lies at an end of its range; widen it")
        for path, changes in self.sensitivity.items():
            by = ", ".join(
                f"{name} by {change:+.3g} % of its size" if self.target[name] else f"{name} by {0.01 * change:+.3g}"
                for name, change in changes.items()
            )
            said.append(f"sensitivity  1 % more of {path} changes {by}")
        for path, spread in self.spread.items():
            if math.isfinite(spread):
                known = f"known to 1 %{', or .01 where they are 0,' * zero}"
                said.append(f"accuracy     targets that are {known} tell {path} to {spread:.2g} %")
            else:
                said.append(f"accuracy     these targets do not tell {path}: what it changes, others make up for")
        return said


def fit(
    scene: Any,
    vary: Mapping[str, str] | Sequence[str],
    target: Mapping[str, float],
    *,
    method: str = "nelder-mead",
    misfit: float = 1e-3,
    runs: int = 100,
    seeds: int | Sequence[int] | None = None,
    luck: int = 0,
    duration: float | None = None,
    fps: float | None = None,
    folder: str | PathLike[str] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    overwrite: bool = False,
    say: Callable[[str], None] = lambda line: None,
    allow_outside: bool = False,
    **settings: Any,
) -> Fit:
    """Find the parameters by which a scene measures given values.

    The ranges are scanned, and the best point improved: by "nelder-mead", a simplex, until the target is met and the parameters
    are known to 1e-4 of their ranges; or by "evolution" (differential evolution) first, for what has several optima, and whose
    points run in batches. Two runs for each parameter at the end tell the sensitivities.

    Args:
        scene, seeds, luck, duration, fps, folder, workers, scheduler, overwrite, say, settings: as of `ts.sweep`. Measures are
            means over the seeds. With a folder, the same call goes on where it was interrupted.
        vary: paths to ranges, {"cloth[0].stiffness": "1e2:1e4:log"}.
        target: measures, see `taichi_sim.sweeps.measures.measures_of`, and the values that they should have.
        method: "nelder-mead" or "evolution".
        misfit: root of the mean square of (measured - target) / target, up to which the target is reached.
        runs: most points that are run.

    Raises SceneError, ValueError or OSError, before anything runs, for what is not allowed.
    """
    from scipy import optimize

    axes = axes_of(vary)
    if not axes:
        raise SceneError("vary", says="nothing is varied; give a range, like stiffness=1e2:1e4:log")
    for axis in axes:
        if axis.values:
            raise SceneError(
                (axis.path,), says="must be a range, like 0.1:0.9 or 1e2:1e4:log, in which a fit may look anywhere"
            )
    if method not in METHODS:
        raise SceneError("method", method, f"one of {', '.join(METHODS)}")
    if not isinstance(target, Mapping) or not target:
        raise SceneError("target", says="there is none; give measures and their values, like probes.tip.y=-0.12")
    goal = {name: validation.number(f"target.{name}", value) for name, value in target.items()}
    validation.whole("luck", luck, 0, MOST_LUCK)
    validation.number("misfit", misfit, positive=True)
    least = len(axes) * (SCAN + 3)
    runs = validation.whole("runs", runs, least, 1_000_000)
    numbers = seeds_of(seeds)
    with open_study(
        scene, axes, numbers, list(goal), {"fit": [axis.path for axis in axes]}, duration=duration, fps=fps, folder=folder,
        workers=workers, scheduler=scheduler, overwrite=overwrite, retry=False, say=say, allow_outside=allow_outside,
        settings=settings,
    ) as study:  # fmt: skip
        search = _Search(study, axes, numbers, goal, misfit, runs - 2 * len(axes))
        start = _scan(axes, luck)
        found = search.misfits(start)
        if float(found.min()) >= FAILED:
            first = next(iter(study.rows.values()))
            error = (
                first.error
                or f"it measured {', '.join(f'{name} = {value:g}' for name, value in first.measures.items())}"
            )
            raise SceneError("vary", says=f"no run within the ranges gave a measure; the first failed: {error}")
        box = [(0.0, 1.0)] * len(axes)
        if method == "evolution":
            optimize.differential_evolution(
                lambda u: search.misfits(np.atleast_2d(u.T)), box, init=start, vectorized=True, updating="deferred",
                maxiter=max(0, search.left // len(start) - 1), callback=lambda *_, **__: search.least <= misfit, polish=False,
                **seeded(optimize.differential_evolution, luck),
            )  # fmt: skip
        simplex = _simplex(search.best, 0.5 / SCAN if method == METHODS[0] else PROBE)
        optimize.minimize(
            lambda u: float(search.misfits(u[None])[0]), search.best, method="Nelder-Mead", bounds=box,
            options={"initial_simplex": simplex, "xatol": RESOLUTION, "fatol": 0.1 * misfit, "maxfev": search.left},
        )  # fmt: skip
        return search.outcome(goal, settings)


class _Search:
    """Points in the unit cube, (k, parameters), and how far what they measure is from the target. most: runs that may be made."""

    def __init__(
        self,
        study: Study,
        axes: Sequence[Axis],
        seeds: Sequence[int | None],
        goal: Mapping[str, float],
        allowed: float,
        most: int,
    ) -> None:
        self.study, self.axes, self.seeds, self.allowed, self.most = study, axes, seeds, allowed, most
        self.names = [name.rpartition(":")[2] for name in goal]  # as rows have them
        self.goal = np.array(list(goal.values()))
        self.unit = np.where(self.goal == 0.0, 1.0, np.abs(self.goal))
        self.tried: dict[tuple[float, ...], Floats] = {}  # what was measured, by place
        self.best: Floats = np.zeros(len(axes))
        self.least = np.inf

    @property
    def left(self) -> int:
        """Runs."""
        return max(0, self.most - len(self.tried))

    def measured(self, places: Floats) -> Floats:
        """(k, targets), nan where a run failed, or none is left."""
        places = np.clip(places, 0.0, 1.0)
        new = [place for place in dict.fromkeys(map(tuple, places.tolist())) if place not in self.tried][: self.left]
        points = {place: [Point(self.parameters(place), seed) for seed in self.seeds] for place in new}
        at_most = (self.most + 2 * len(self.axes)) * len(self.seeds)
        for _ in self.study.run([point for group in points.values() for point in group], at_most):
            pass
        for place, group in points.items():
            rows = [self.study.rows[point.key] for point in group]
            values = [[row.measures.get(name, np.nan) for name in self.names] for row in rows]
            complete = bool(np.isfinite(values).all())
            self.tried[place] = np.mean(values, axis=0) if complete else np.full(len(self.goal), np.nan)
        unknown = np.full(len(self.goal), np.nan)
        return np.array([self.tried.get(place, unknown) for place in map(tuple, places.tolist())])

    def parameters(self, place: Iterable[float]) -> dict[str, float]:
        """Parameters by path at a place, of which each number is a part of its range, from 0 to 1."""
        return {axis.path: axis.at(float(u)) for axis, u in zip(self.axes, place)}

    def misfits(self, places: Floats) -> Floats:
        """(k,), FAILED where there is none."""
        off = (self.measured(places) - self.goal) / self.unit
        found = np.nan_to_num(np.sqrt(np.mean(off**2, axis=1)), nan=FAILED, posinf=FAILED)
        k = int(found.argmin())
        if found[k] < self.least:
            self.least, self.best = float(found[k]), np.clip(places[k], 0.0, 1.0)
        return found

    def outcome(self, goal: Mapping[str, float], settings: Mapping[str, Any]) -> Fit:
        """The best, and its sensitivities by central differences."""
        d, best = len(self.axes), self.best
        self.most += 2 * d
        low, high = (np.clip(best + side * PROBE * np.eye(d), 0.0, 1.0) for side in (-1.0, 1.0))
        both = self.measured(np.concatenate([low, high]))
        measured = self.tried[tuple(best.tolist())]
        parameters = self.parameters(best)
        at = np.array(list(parameters.values()))
        ends = [
            np.diag([[axis.at(float(u)) for axis, u in zip(self.axes, row)] for row in side]) for side in (low, high)
        ]
        # percent of a target for each percent of a parameter, (targets, parameters)
        slope = ((both[d:] - both[:d]) / (ends[1] - ends[0])[:, None] * at[:, None]).T / self.unit[:, None]
        known = np.array(list(self.tried.values()))
        return Fit(
            parameters,
            dict(zip(goal, measured.tolist())),
            dict(goal),
            self.least,
            self.allowed,
            len(self.tried),
            {path: dict(zip(goal, slope[:, k].tolist())) for k, path in enumerate(parameters)},
            dict(zip(parameters, _spread(slope).tolist())),
            tuple(path for path, u in zip(parameters, best) if min(u, 1.0 - u) < EDGE),
            {name: (float(np.nanmin(known[:, k])), float(np.nanmax(known[:, k]))) for k, name in enumerate(goal)},
            self.study.subject,
            settings,
        )


def _spread(slope: Floats) -> Floats:
    """Percent of each parameter, for independent errors of a percent of each target: the root of the diagonal of (J^T J)^-1, inf
    where a combination of parameters changes no target."""
    if not np.all(np.isfinite(slope)):
        return np.full(slope.shape[1], np.inf)
    _, size, directions = np.linalg.svd(slope, full_matrices=True)
    size = np.pad(size, (0, slope.shape[1] - len(size)))
    told = size > FLAT * max(float(size.max(initial=0.0)), 1e-12)
    lost = np.abs(directions[~told]).max(axis=0, initial=0.0) > FLAT
    spread = np.sqrt(((directions[told] / size[told, None]) ** 2).sum(axis=0))
    return np.where(lost, np.inf, spread)


def _scan(axes: Sequence[Axis], luck: int) -> Floats:
    """Places from which a search starts: evenly along one parameter, a Latin hypercube of several."""
    d = len(axes)
    if d == 1:
        return np.linspace(0.0, 1.0, SCAN)[:, None]
    return Design(tuple(Axis(str(k), (), 0.0, 1.0) for k in range(d)), "latin", SCAN * d, luck).units()


def _simplex(start: Floats, size: float) -> Floats:
    """(parameters + 1, parameters): corners at a start and beside it, each towards the middle of the range."""
    step = np.where(start > 0.5, -size, size)
    return np.concatenate([start[None], start + np.diag(step)])
