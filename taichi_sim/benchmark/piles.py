"""The benchmark's piles of discs: what a step takes, how still and how deep in each other the discs lie, over several seeds."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from taichi_sim.benchmark import cases
from taichi_sim.benchmark.contest import Report, count_of, elapsed, peer
from taichi_sim.benchmark.ours import ball_step

SEEDS = 6
SETTLE = 4.0  # s, before the clock starts
TIMED = 2.0  # s, in slices that the contestants take in turn
SLICES = 5
RIVAL = "pymunk, 10 iterations"


class Lie(NamedTuple):
    """State of a pile at one moment."""

    kinetic: float  # m g r a disc
    largest: float  # r, overlap of two discs
    mean: float  # r, over those that overlap
    wall: float  # r, largest overlap with a wall


def overlaps(x: NDArray, radius: float, side: float) -> tuple[float, float, float]:
    """Largest and mean overlap of two discs that overlap, and the largest with a wall, in radii."""
    i, j = cKDTree(x).query_pairs(2 * radius, output_type="ndarray").T
    depth = 2 * radius - np.linalg.norm(x[i] - x[j], axis=1)
    wall = max(0.0, radius - min(x[:, 1].min(), x[:, 0].min(), side - x[:, 0].max()))
    mean = float(depth.sum()) / max(1, len(depth))
    return float(depth.max(initial=0.0)) / radius, mean / radius, wall / radius


@dataclass
class PileReport(Report):
    """Rows with one time a seed, and how the piles lay then; shown from the least to the largest."""

    lies: dict[str, list[Lie]] = field(default_factory=dict)

    def ratios_of(self, name: str) -> list[float]:
        """Time of the rival over that of this row, seed by seed; nothing without the rival."""
        times = {row: seconds for row, seconds, _ in self.rows}
        return [theirs / own for theirs, own in zip(times.get(RIVAL, []), times[name])]

    def cells(self) -> tuple[Sequence[str], list[list[str]]]:
        """Times, ratios and how the piles lay, over the seeds."""
        head = ("", "step, ms", f"{RIVAL} / it", "kinetic, m g r", "overlap, r", "mean, r", "walls, r")
        rows = []
        for name, seconds, _ in self.rows:
            kinetic, *depths = zip(*self.lies[name])
            times, ratios = _span([1e3 * s for s in seconds], ".4g"), _span(self.ratios_of(name), ".2f")
            rows.append([name, times, ratios, _span(kinetic, ".1e"), *(_span(values, ".3f") for values in depths)])
        return head, rows

    def records(self) -> list[dict[str, Any]]:
        """Rows with the states of the pile of each seed."""
        return [row | {"lies": [lie._asdict() for lie in self.lies[row["name"]]]} for row in super().records()]


def _span(values: Sequence[float], form: str) -> str:
    """Range from the least to the largest value, in words."""
    if not values:
        return "-"
    low, high = f"{min(values):{form}}", f"{max(values):{form}}"
    return low if low == high else f"{low} .. {high}"


def _lie(runner: Any, case: cases.Balls) -> Lie:
    simulation = getattr(runner, "simulation", None)
    kinetic = float(runner.kinetic() if simulation is None else simulation.energy().kinetic)
    weight = len(case.position) * case.gravity * case.radius
    return Lie(kinetic / weight, *overlaps(runner.result()[0], case.radius, case.side))


def _measure(n: int, settle: float, timed: float, report: PileReport) -> None:
    """All seeds: every contestant settles, then all take turns."""
    report.rows = [(entry.name, [], float(n)) for entry in report.entries]
    report.lies = {entry.name: [] for entry in report.entries}
    for seed in range(report.samples):
        case = cases.pile_case(n, seed)
        steps = round(timed / SLICES / case.dt)
        for entry in report.entries:
            entry.runner.start(case)
            entry.runner.step(round(settle / case.dt))
        taken = np.array([[elapsed(entry.runner.step, steps) for entry in report.entries] for _ in range(SLICES)])
        for (name, seconds, _), mean, entry in zip(report.rows, taken.mean(axis=0) / steps, report.entries):
            seconds.append(float(mean))
            report.lies[name].append(_lie(entry.runner, case))


def pile_report(quick: bool, *, few: bool = False) -> PileReport:
    """10 000 discs (few: 100) that have fallen into a box, friction and spin, 240 Hz."""
    n, seeds, settle, timed = 100 if few else 10_000, SEEDS, SETTLE, TIMED
    if quick:
        n, seeds, settle, timed = 100 if few else 400, 2, 0.1, 0.1
    title = f"{n} discs in a box, {seeds} seeds, {timed:g} s from {settle:g} s after the drop on, one 240 Hz step"
    report = PileReport(f"pile: {title}; min .. max over the seeds", samples=seeds)
    case, substeps = cases.pile_case(n), 1 if few else 2
    report.enter("taichi_sim", partial(ball_step, case))
    name = f"taichi_sim, {count_of(substeps, 'substep')}, 1 iteration"
    report.enter(name, partial(ball_step, case, substeps=substeps, contact_iterations=1))
    pymunk = partial(peer, "pile_pymunk.PilePymunk", case)
    report.enter(RIVAL, pymunk(iterations=10, hashed=False))
    if few:
        report.enter("pymunk, 4 iterations", pymunk(iterations=4, hashed=False))
    else:
        report.enter(f"{RIVAL}, spatial hash", pymunk(iterations=10, hashed=True))
    if not quick:
        report.notes.append(f"goal, time: a sixth of {RIVAL}")
    if not quick and not few:
        report.notes.append(
            "goal, the pile: kinetic energy within pymunk's spread, overlap 0.10 r, mean 0.033 r, walls likewise"
        )
    _measure(n, settle, timed, report)
    report.close()
    return report
