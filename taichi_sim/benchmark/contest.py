"""Table of a benchmark's findings, and turns of the contestants."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.benchmark.peers import PeerMissingError, Runner

REPEATS = 5
RATES: dict[str, Callable[[float], str]] = {  # how they are shown, in the order of the columns
    "units_per_second": lambda rate: f"{rate / 1e6:.4g}",
    "bytes_per_second": lambda rate: f"{rate / 1e9:.4g}",
    "part_of_limit": lambda part: f"{100 * part:.0f} %",
}
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
    least_bytes: float = 0.0  # that a step must read and write; 0: not known
    limit: float = 0.0  # bytes/s that the device copies; 0: not measured
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

    def rates(self, seconds: float, units: float) -> dict[str, float]:
        """Rates that follow from a row's time [s]: units and, by the least that a step must move, bytes in a second, and
        that as a part of the device's limit; only what the report has."""
        found = {}
        if self.unit:
            found["units_per_second"] = units / seconds
        if self.least_bytes:
            found["bytes_per_second"] = self.least_bytes / seconds
            if self.limit:
                found["part_of_limit"] = self.least_bytes / seconds / self.limit
        return found

    def records(self) -> list[dict[str, Any]]:
        """The rows as numbers for a file: name, seconds of each timing, goal as it is shown, and `rates` of the median."""
        return [
            {
                "name": name,
                "seconds": [float(value) for value in seconds],
                "units": units,
                "goal": self.goals.get(name),
                **self.rates(statistics.median(seconds), units),
            }
            for name, seconds, units in self.rows
        ]

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
            *["GB/s"] * bool(self.least_bytes),
            *["of the limit"] * bool(self.least_bytes and self.limit),
            *["its time / ours"] * self.ratios,
            "goal",
        ]
        rows = []
        for name, seconds, units in self.rows:
            middle = statistics.median(seconds)
            by_name = self.rates(middle, units)
            rates = [form(by_name[key]) for key, form in RATES.items() if key in by_name]
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


def count_of(number: int, what: str) -> str:
    """`1 thread`, `2 threads`."""
    return f"{number} {what}{'s' * (number > 1)}"


def peer(place: str, *arguments: Any, **options: Any) -> Callable[[], Runner]:
    """Function that makes a peer, a class like "cloth_warp.ClothWarp" of `benchmark.peers`. The packages that a peer needs
    may be missing, so its module is imported only when that function is called."""
    module, name = place.split(".")
    return lambda: getattr(import_module(f"taichi_sim.benchmark.peers.{module}"), name)(*arguments, **options)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference, as a part of the largest value of `b`."""
    return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-300))
