"""What a benchmark finds, as a table, and how contestants take turns."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from taichi_sim.reports.peers import PeerMissingError, Runner

__all__ = ["REPEATS", "Entry", "Report", "close", "difference", "invite", "take_turns"]

REPEATS = 5


class Entry(NamedTuple):
    """One contestant: `units` of work per step (springs, balls, ...), `steps` per timing."""

    name: str
    runner: Runner
    units: float
    steps: int


@dataclass
class Report:
    """A table: what was timed, and lines about what could not be or what was checked."""

    title: str
    unit: str = ""  # of rates, after the million: "spring" makes Mspring/s; "" shows no rate
    ratios: bool = True  # show the rows as multiples of the first
    rows: list[tuple[str, list[float], float]] = field(default_factory=list)  # name, seconds per step, units per step
    goals: dict[str, str] = field(default_factory=dict)  # by row name
    notes: list[str] = field(default_factory=list)
    samples: int = REPEATS  # times in each row

    def ratio(self, name: str) -> float:
        """Median time of this row over that of the first, the program's own: above 1 the program is faster."""
        times = {row: statistics.median(seconds) for row, seconds, _ in self.rows}
        return times[name] / times[self.rows[0][0]]

    def show(self) -> None:
        """Print it."""
        from rich.console import Console
        from rich.table import Table

        table = Table(title=self.title, title_justify="left")
        rate = [f"M{self.unit}/s"] if self.unit else []
        ratio = ["its time / ours"] if self.ratios else []
        for column in ("", "median", "best", *rate, *ratio, "goal"):
            table.add_column(column, justify="left" if column in ("", "goal") else "right", no_wrap=True)
        for name, seconds, units in self.rows:
            middle = statistics.median(seconds)
            rates = [f"{units / middle / 1e6:.4g}"] if rate else []
            ratios = [f"{self.ratio(name):.2f}"] if ratio else []
            cells = (_duration(middle), _duration(min(seconds)), *rates, *ratios)
            table.add_row(name, *cells, self.goals.get(name, ""))
        console = Console()
        console.width = max(console.width, 100)  # a pipe says 80, which would cut the names
        console.print(table)
        for note in self.notes:
            print(f"  {note}")
        print()


def _duration(seconds: float) -> str:
    for scale, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= scale:
            return f"{seconds / scale:.4g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def take_turns(entries: list[Entry], repeats: int = REPEATS) -> list[tuple[str, list[float], float]]:
    """Rows of a Report. Each contestant runs once unrecorded, then all in turn (ABAB...), always from the start."""
    for entry in entries:
        entry.runner.reset()
        entry.runner.step(entry.steps)
    seconds: dict[str, list[float]] = {entry.name: [] for entry in entries}
    for _ in range(repeats):
        for entry in entries:
            entry.runner.reset()
            entry.runner.step(1)  # wakes the threads and fills the caches
            start = time.perf_counter()
            entry.runner.step(entry.steps)
            seconds[entry.name].append((time.perf_counter() - start) / entry.steps)
    return [(entry.name, seconds[entry.name], entry.units) for entry in entries]


def invite(
    entries: list[Entry], report: Report, name: str, make: Callable[[], Runner], units: float, steps: int
) -> None:
    """Add a peer, or a line that says why it is absent."""
    try:
        entries.append(Entry(name, make(), units, steps))
    except PeerMissingError as reason:
        report.notes.append(f"{name}: not measured. {reason}")


def close(entries: list[Entry]) -> None:
    """Free what the contestants hold."""
    for entry in entries:
        getattr(entry.runner, "close", lambda: None)()


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference, as a part of the largest value of `b`."""
    return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-300))
