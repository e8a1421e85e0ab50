"""The benchmark's piles: how long a second takes, and how still and how deep in each other the discs lie."""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.reports import cases
from taichi_sim.reports.bench import REPEATS, Entry, Report
from taichi_sim.reports.peers import PeerMissingError, Runner

__all__ = ["overlaps", "pile_report"]

SETTLE = 4.0  # s, before the clock starts
TIMED = 0.4  # s, for each of the repeats


def overlaps(x: NDArray, radius: float, side: float) -> tuple[float, float, float]:
    """Largest and mean overlap of two discs that overlap, and the largest with a wall, in radii."""
    found = []
    for first in range(0, len(x), 500):
        d = np.linalg.norm(x[first : first + 500, None] - x[None], axis=2)
        i, j = np.nonzero(d < 2 * radius)
        later = j > i + first
        found.append(2 * radius - d[i[later], j[later]])
    depth = np.concatenate(found)
    wall = radius - min(x[:, 1].min(), x[:, 0].min(), side - x[:, 0].max())
    return float(depth.max(initial=0.0)) / radius, float(depth.mean()) / radius, max(0.0, float(wall)) / radius


def _kinetic(runner: Any) -> float:
    simulation = getattr(runner, "simulation", None)
    return float(runner.kinetic() if simulation is None else simulation.energy().kinetic)


def pile_report(quick: bool) -> Report:
    """10 000 discs that have fallen into a box, friction and spin, 240 Hz."""
    from taichi_sim.reports.ours import pile_step

    n = 400 if quick else 10_000
    case = cases.pile_case(n)
    settle, timed = (0.2, 0.05) if quick else (SETTLE, TIMED)
    report = Report(f"pile: {n} discs in a box, {settle:g} s after the drop, one 240 Hz step")
    entries = [
        Entry("taichi_sim", pile_step(case), n, round(timed / case.dt)),
        Entry(
            "taichi_sim, 2 substeps, 1 pass", pile_step(case, substeps=2, contact_passes=1), n, round(timed / case.dt)
        ),
    ]

    def peer(name: str, iterations: int, hashed: bool) -> None:
        try:
            from taichi_sim.reports.peers.pile_pymunk import PilePymunk

            runner: Runner = PilePymunk(case, iterations=iterations, hashed=hashed)
            entries.append(Entry(name, runner, n, round(timed / case.dt)))
        except PeerMissingError as reason:
            report.notes.append(f"{name}: not measured. {reason}")

    peer("pymunk, 10 iterations", 10, False)
    peer("pymunk, 10 iterations, spatial hash", 10, True)
    report.goals["pymunk, 10 iterations"] = ">= 6"
    seconds: dict[str, list[float]] = {entry.name: [] for entry in entries}
    for entry in entries:
        entry.runner.reset()
        entry.runner.step(round(settle / case.dt))
    for _ in range(REPEATS):
        for entry in entries:
            start = time.perf_counter()
            entry.runner.step(entry.steps)
            seconds[entry.name].append((time.perf_counter() - start) / entry.steps)
    report.rows = [(entry.name, seconds[entry.name], entry.units) for entry in entries]
    weight = n * -case.gravity[1] * case.radius
    for entry in entries:
        largest, mean, wall = overlaps(entry.runner.result()[0], case.radius, case.side)
        report.notes.append(
            f"{entry.name}: kinetic energy {_kinetic(entry.runner) / weight:.1e} m g r a disc;"
            f" overlap at most {largest:.3f} r, mean {mean:.3f} r, with walls {wall:.3f} r"
        )
        getattr(entry.runner, "close", lambda: None)()
    return report
