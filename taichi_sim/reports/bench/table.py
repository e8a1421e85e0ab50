"""What a benchmark finds, as a table, and how contestants take turns."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.reports.peers import PeerMissingError, Runner

REPEATS = 5
LEAST_WIDTH = 160  # a pipe says 80, which would cut the columns


class Entry(NamedTuple):
    """One contestant: `units` of work per step (springs, balls, ...), `steps` per timing."""

    name: str
    runner: Any
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
    entries: list[Entry] = field(default_factory=list)  # the contestants

    def enter(
        self, name: str, make: Callable[[], Any], units: float = 0.0, steps: int = 1, goal: str | None = None
    ) -> None:
        """Add a contestant, or a line that says why it is absent."""
        if goal is not None:
            self.goals[name] = goal
        try:
            self.entries.append(Entry(name, make(), units, steps))
        except PeerMissingError as reason:
            self.notes.append(f"{name}: not measured. {reason}")

    def take_turns(self) -> None:
        """Fill the rows. Each contestant runs once unrecorded, then all in turn (ABAB...), always from the start."""
        for entry in self.entries:
            entry.runner.reset()
            entry.runner.step(entry.steps)
        self.rows = [(entry.name, [], entry.units) for entry in self.entries]
        for _ in range(self.samples):
            for entry, (_, seconds, _) in zip(self.entries, self.rows):
                entry.runner.reset()
                entry.runner.step(1)  # wakes the threads and fills the caches
                seconds.append(elapsed(entry.runner.step, entry.steps) / entry.steps)

    def close(self) -> None:
        """Free what the contestants hold."""
        for entry in self.entries:
            getattr(entry.runner, "close", lambda: None)()

    def ratio(self, name: str) -> float:
        """Median time of this row over that of the first, the program's own: above 1 the program is faster."""
        times = {row: statistics.median(seconds) for row, seconds, _ in self.rows}
        return times[name] / times[self.rows[0][0]]

    def cells(self) -> tuple[Sequence[str], list[list[str]]]:
        """Heads of the columns, and the rows; what has no head or is a goal is words."""
        head = [
            "",
            "median",
            "best",
            *[f"M{self.unit}/s"] * bool(self.unit),
            *["its time / ours"] * self.ratios,
            "goal",
        ]
        rows = []
        for name, seconds, units in self.rows:
            middle = statistics.median(seconds)
            rates = [f"{units / middle / 1e6:.4g}"] if self.unit else []
            ratios = [f"{self.ratio(name):.2f}"] if self.ratios else []
            rows.append([name, _duration(middle), _duration(min(seconds)), *rates, *ratios, self.goals.get(name, "")])
        return head, rows

    def show(self) -> None:
        """Print it."""
        from rich.console import Console
        from rich.table import Table

        head, rows = self.cells()
        table = Table(title=self.title, title_justify="left")
        for column in head:
            table.add_column(column, justify="left" if column in ("", "goal") else "right", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        console = Console()
        console.width = max(console.width, LEAST_WIDTH)
        console.print(table)
        print("".join(f"  {note}\n" for note in self.notes))


def _duration(seconds: float) -> str:
    for scale, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= scale:
            return f"{seconds / scale:.4g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def elapsed(work: Callable[..., object], *arguments: Any) -> float:
    """Seconds that a call takes."""
    start = time.perf_counter()
    work(*arguments)
    return time.perf_counter() - start


def count_of(number: int, what: str, ending: str = "s") -> str:
    """`1 thread`, `2 threads`."""
    return f"{number} {what}{ending if number > 1 else ''}"


def peer(place: str, *arguments: Any, **options: Any) -> Callable[[], Runner]:
    """What makes a peer, a class like "cloth_warp.ClothWarp" of `reports.peers`; what it needs may be missing, so its module is
    imported only then."""
    module, name = place.split(".")
    return lambda: getattr(import_module(f"taichi_sim.reports.peers.{module}"), name)(*arguments, **options)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference, as a part of the largest value of `b`."""
    return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-300))
