"""The benchmark's piles of discs: what a step takes, how still and how deep in each other the discs lie, over several seeds."""

import time
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.reports.bench import cases
from taichi_sim.reports.bench.table import Report
from taichi_sim.reports.peers import PeerMissingError

__all__ = ["Lie", "PileReport", "overlaps", "pile_report"]

SEEDS = 6
SETTLE = 4.0  # s, before the clock starts
TIMED = 2.0  # s, in slices that the contestants take in turn
SLICES = 5
RIVAL = "pymunk, 10 iterations"


class Lie(NamedTuple):
    """How a pile lies at one moment."""

    kinetic: float  # m g r a disc
    largest: float  # r, overlap of two discs
    mean: float  # r, over those that overlap
    wall: float  # r, largest overlap with a wall


def overlaps(x: NDArray, radius: float, side: float) -> tuple[float, float, float]:
    """Largest and mean overlap of two discs that overlap, and the largest with a wall, in radii."""
    p = x[np.argsort(x[:, 0])]
    found = []
    for k in range(1, len(p)):
        r = p[k:] - p[:-k]
        if r[:, 0].min() >= 2 * radius:  # so they are for every larger k
            break
        d = np.hypot(r[:, 0], r[:, 1])
        found.append(2 * radius - d[d < 2 * radius])
    depth = np.concatenate(found) if found else np.zeros(0)
    wall = radius - min(x[:, 1].min(), x[:, 0].min(), side - x[:, 0].max())
    return (
        float(depth.max(initial=0.0)) / radius,
        float(depth.sum()) / max(1, len(depth)) / radius,
        max(0.0, wall) / radius,
    )


@dataclass
class PileReport(Report):
    """Rows with one time a seed, and how the piles lay then; shown from the least to the largest."""

    lies: dict[str, list[Lie]] = field(default_factory=dict)

    def ratios_of(self, name: str) -> list[float]:
        """Time of the rival over that of this row, seed by seed; nothing without the rival."""
        times = {row: seconds for row, seconds, _ in self.rows}
        return [theirs / own for theirs, own in zip(times.get(RIVAL, []), times[name])]

    def show(self) -> None:
        """Print it."""
        from rich.console import Console
        from rich.table import Table

        table = Table(title=self.title, title_justify="left")
        columns = ("", "step, ms", f"{RIVAL} / it", "kinetic, m g r", "overlap, r", "mean, r", "walls, r")
        for column in columns:
            table.add_column(column, justify="right" if column else "left", no_wrap=True)
        for name, seconds, _ in self.rows:
            kinetic, largest, mean, wall = zip(*self.lies[name])
            cells = [
                _span([1e3 * s for s in seconds], ".4g"),
                _span(self.ratios_of(name), ".2f"),
                _span(kinetic, ".1e"),
                *(_span(values, ".3f") for values in (largest, mean, wall)),
            ]
            table.add_row(name, *cells)
        console = Console()
        console.width = max(console.width, 160)  # a pipe says 80, which would cut the columns
        console.print(table)
        for name, goal in self.goals.items():
            print(f"  goal, {name}: {goal}")
        for note in self.notes:
            print(f"  {note}")
        print()


def _span(values: Any, form: str) -> str:
    """From the least to the largest value."""
    if not len(values):
        return "-"
    low, high = f"{min(values):{form}}", f"{max(values):{form}}"
    return low if low == high else f"{low} .. {high}"


def _lie(runner: Any, case: cases.Pile) -> Lie:
    simulation = getattr(runner, "simulation", None)
    kinetic = float(runner.kinetic() if simulation is None else simulation.energy().kinetic)
    weight = len(case.position) * -case.gravity[1] * case.radius
    return Lie(kinetic / weight, *overlaps(runner.result()[0], case.radius, case.side))


def _contestants(
    case: cases.Pile, report: PileReport, settings: dict[str, dict[str, Any]], peers: Any
) -> dict[str, Any]:
    """Ours by each of the settings, and pymunk by (name, iterations, hashed), where it is installed."""
    from taichi_sim.reports.bench.ours import pile_step

    runners: dict[str, Any] = {name: pile_step(case, **chosen) for name, chosen in settings.items()}
    for name, iterations, hashed in peers:
        try:
            from taichi_sim.reports.peers.pile_pymunk import PilePymunk

            runners[name] = PilePymunk(case, iterations=iterations, hashed=hashed)
        except PeerMissingError as reason:
            report.notes.append(f"{name}: not measured. {reason}")
    return runners


def _measure(n: int, seeds: int, settle: float, timed: float, report: PileReport, runners: dict[str, Any]) -> None:
    """All seeds: every contestant settles, then all take turns."""
    seconds: dict[str, list[float]] = {name: [] for name in runners}
    report.lies = {name: [] for name in runners}
    for seed in range(seeds):
        case = cases.pile_case(n, seed)
        steps = round(timed / SLICES / case.dt)
        for runner in runners.values():
            runner.start(case)
            runner.step(round(settle / case.dt))
        taken = dict.fromkeys(runners, 0.0)
        for _ in range(SLICES):
            for name, runner in runners.items():
                start = time.perf_counter()
                runner.step(steps)
                taken[name] += time.perf_counter() - start
        for name, runner in runners.items():
            seconds[name].append(taken[name] / (SLICES * steps))
            report.lies[name].append(_lie(runner, case))
    report.rows = [(name, seconds[name], float(n)) for name in runners]


def pile_report(quick: bool, *, few: bool = False) -> PileReport:
    """10 000 discs (few: 100) that have fallen into a box, friction and spin, 240 Hz."""
    n, seeds, settle, timed = 100 if few else 10_000, SEEDS, SETTLE, TIMED
    if quick:
        n, seeds, settle, timed = 100 if few else 400, 2, 0.1, 0.1
    title = f"{n} discs in a box, {seeds} seeds, {timed:g} s from {settle:g} s after the drop on, one 240 Hz step"
    report = PileReport(f"pile: {title}; min .. max over the seeds", samples=seeds)
    settings: dict[str, dict[str, Any]] = {"taichi_sim": {}}
    peers: list[tuple[str, int, bool]] = [(RIVAL, 10, False)]
    if few:
        settings["taichi_sim, 1 substep, 1 pass"] = {"substeps": 1, "contact_iterations": 1}
        peers.append(("pymunk, 4 iterations", 4, False))
        report.goals["time"] = f"a sixth of {RIVAL}"
    else:
        settings["taichi_sim, 2 substeps, 1 pass"] = {"substeps": 2, "contact_iterations": 1}
        peers.append((f"{RIVAL}, spatial hash", 10, True))
        report.goals["time"] = f"a sixth of {RIVAL}"
        report.goals["the pile"] = "kinetic energy within pymunk's spread, overlap 0.10 r, mean 0.033 r, walls likewise"
    runners = _contestants(cases.pile_case(n), report, settings, peers)
    _measure(n, seeds, settle, timed, report, runners)
    for runner in runners.values():
        getattr(runner, "close", lambda: None)()
    return report
