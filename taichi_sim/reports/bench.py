"""The benchmark: the program beside its peers in one run, taking turns, medians of five, warm-up left out."""

import datetime
import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.reports import cases
from taichi_sim.reports.peers import PeerMissingError, Runner

__all__ = ["CASES", "Entry", "Report", "head_line", "main", "take_turns"]

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


def _invite(
    entries: list[Entry], report: Report, name: str, make: Callable[[], Runner], units: float, steps: int
) -> None:
    """Add a peer, or a line that says why it is absent."""
    try:
        entries.append(Entry(name, make(), units, steps))
    except PeerMissingError as reason:
        report.notes.append(f"{name}: not measured. {reason}")


def _close(entries: list[Entry]) -> None:
    for entry in entries:
        getattr(entry.runner, "close", lambda: None)()


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-300))


def springs(quick: bool) -> Report:
    """A cloth of 1024 x 1024 balls, one symplectic Euler step, f32."""
    from taichi_sim.reports.ours import springs_step

    n = 64 if quick else 1024
    cloth = cases.cloth_case(n)
    half, m = cases.half_springs(cloth), len(cloth.pairs)
    report = Report(f"springs: {n} x {n} cloth, {m} springs, one symplectic Euler step, f32", "spring")
    entries = [Entry("taichi_sim", springs_step(cloth), m, 20)]
    threads = entries[0].runner.simulation.backend.threads  # type: ignore[attr-defined]

    def openmp(count: int, fast_math: bool) -> Callable[[], Runner]:
        def make() -> Runner:
            from taichi_sim.reports.peers.cloth_openmp import ClothOpenMP

            return ClothOpenMP(cloth, half, threads=count, fast_math=fast_math)

        return make

    def warp() -> Runner:
        from taichi_sim.reports.peers.cloth_warp import ClothWarp

        return ClothWarp(cloth, half)

    for count in sorted({1, threads}, reverse=True):
        name = f"C + OpenMP, {count} thread{'s' if count > 1 else ''}"
        _invite(entries, report, name, openmp(count, False), m, 20)
        _invite(entries, report, f"{name}, -ffast-math", openmp(count, True), m, 20)
    report.goals[f"C + OpenMP, {threads} thread{'s' if threads > 1 else ''}"] = ">= 0.9"
    _invite(entries, report, "Warp on the CPU, 1 thread", warp, m, 5)
    report.goals["Warp on the CPU, 1 thread"] = ">= 1.7"
    report.rows = take_turns(entries)
    results = []
    for entry in entries:
        entry.runner.reset()
        entry.runner.step(5)
        results.append((entry.name, entry.runner.result()))
    for name, (x, v) in results[1:]:
        dx, dv = _difference(x, results[0][1][0]), _difference(v, results[0][1][1])
        report.notes.append(
            f"{name}: after 5 steps its state differs from ours by {dx:.1e} (position), {dv:.1e} (velocity)"
        )
    _close(entries)
    return report


def contacts(quick: bool) -> Report:
    """A million balls in 3D, in the lattice's order: search and one pass of impulses, by both rules."""
    return _contacts(quick, shuffled=False)


def shuffled(quick: bool) -> Report:
    """The same in random order: every access to another ball misses the caches."""
    return _contacts(quick, shuffled=True)


def _contacts(quick: bool, shuffled: bool) -> Report:
    from taichi_sim.reports.ours import ContactPass

    n = 8000 if quick else 1_000_000
    pack = cases.pack_case(n, shuffled=shuffled)
    order = "random" if shuffled else "lattice"
    report = Report(f"contacts: {n} balls in 3D in {order} order, search and one pass, f32", "ball-step")
    entries = [
        Entry("taichi_sim, split masses", ContactPass(pack, "jacobi"), n, 3),
        Entry("taichi_sim, plain sum", ContactPass(pack, "sum"), n, 3),
    ]

    def warp(split: str) -> Callable[[], Runner]:
        def make() -> Runner:
            from taichi_sim.reports.peers.contacts_warp import ContactsWarp

            return ContactsWarp(pack, split=split)

        return make

    _invite(entries, report, "Warp hash grid, split masses", warp("count"), n, 2)
    _invite(entries, report, "Warp hash grid, plain sum", warp("none"), n, 2)
    report.goals["Warp hash grid, split masses"] = ">= 6"
    report.rows = take_turns(entries)
    if len(entries) == 4:
        report.notes.append(
            f"plain sum, ours against Warp's: {report.ratio(entries[3].name) / report.ratio(entries[1].name):.2f}"
        )
        for entry in (entries[1], entries[3]):
            entry.runner.reset()
            entry.runner.step(1)
        far = np.abs(entries[1].runner.result()[1] - entries[3].runner.result()[1]).max(axis=1)
        report.notes.append(
            f"plain sum, one pass: {np.mean(far < 0.03):.2%} of the balls get the same velocity (0.03 m/s)"
        )
    _close(entries)
    return report


def small(quick: bool) -> Report:
    """100 discs in a box: the fused driver against the parallel one."""
    from taichi_sim.reports.ours import small_step

    box = cases.box_of_discs(100)
    report = Report("small: 100 discs in a 2D box with contacts, default settings, 1 ms steps, f32")
    entries = [
        Entry("taichi_sim, fused", small_step(box, "fused"), 100, 256 if quick else 2000),
        Entry(
            "taichi_sim, fused, 1 contact pass", small_step(box, "fused", contact_passes=1), 100, 256 if quick else 2000
        ),
        Entry("taichi_sim, parallel", small_step(box, "parallel"), 100, 64 if quick else 500),
    ]
    report.rows = take_turns(entries)
    report.goals = {entries[0].name: "<= 10 us", entries[2].name: ">= 20"}
    _close(entries)
    return report


class _Pictures:
    """A Runner that draws one frame again and again."""

    def __init__(self, frame: Any) -> None:
        from taichi_sim.render import Renderer

        self._frame, self._renderer = frame, Renderer(frame, (1280, 720))

    def reset(self) -> None:
        """Nothing to do."""

    def step(self, steps: int) -> None:
        """Draw `steps` pictures."""
        for _ in range(steps):
            self._picture = self._renderer.render(self._frame)

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """The picture, twice."""
        return self._picture, self._picture

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()


def renderer(quick: bool) -> Report:
    """Pictures of 1280 x 720: a million spheres, and a cloth of 256 x 256 with its shadow."""
    from taichi_sim import backend
    from taichi_sim.frame import Frame

    backend.start("cpu", "f32")
    n, side = (1000, 32) if quick else (1_000_000, 256)
    position, radius = cases.random_pack(n)
    spheres = Frame(0.0, position, np.zeros_like(position), np.full(n, radius))
    sheet = cases.cloth_case(side)
    corner = np.arange(side * side, dtype=np.int32).reshape(side, side)
    a, b, c, d = (q.ravel() for q in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    count = side * side
    cloth = Frame(0.0, sheet.position, sheet.velocity, np.full(count, 1e-3), triangles=triangles)
    report = Report("renderer: one picture of 1280 x 720, two scenes", ratios=False)
    entries = [
        Entry(f"{n} spheres", _Pictures(spheres), n, 1),
        Entry(f"{side} x {side} cloth with shadow", _Pictures(cloth), count, 1),
    ]
    report.rows = take_turns(entries)
    report.goals = {entries[0].name: "<= 0.35 s", entries[1].name: "<= 0.2 s"}
    _close(entries)
    return report


def pile(quick: bool) -> Report:
    """10 000 discs that have fallen into a box, friction and spin, 240 Hz, six seeds."""
    from taichi_sim.reports.piles import pile_report

    return pile_report(quick)


def small_pile(quick: bool) -> Report:
    """The same with 100 discs."""
    from taichi_sim.reports.piles import pile_report

    return pile_report(quick, few=True)


def granular(quick: bool) -> Report:
    """A million balls at rest in a box, friction and spin, beside LAMMPS."""
    from taichi_sim.reports.granular import granular_report

    return granular_report(quick)


def stiff(quick: bool) -> Report:
    """A stiff cloth: wall time against error, beside numba and Newton."""
    from taichi_sim.reports.stiff_cloth import stiff_report

    return stiff_report(quick)


def hanging(quick: bool) -> Report:
    """A large cloth of a material."""
    from taichi_sim.reports.scale import hanging_report

    return hanging_report(quick)


def jelly(quick: bool) -> Report:
    """A million tetrahedra."""
    from taichi_sim.reports.scale import jelly_report

    return jelly_report(quick)


def video(quick: bool) -> Report:
    """A cloth from the scene to an MP4."""
    from taichi_sim.reports.scale import video_report

    return video_report(quick)


def drape(quick: bool) -> Report:
    """A cloth of 100 000 balls on a ball and on itself."""
    from taichi_sim.reports.scale import drape_report

    return drape_report(quick)


CASES: dict[str, Callable[[bool], Report]] = {
    "springs": springs,
    "contacts": contacts,
    "shuffled": shuffled,
    "small": small,
    "pile": pile,
    "small_pile": small_pile,
    "granular": granular,
    "stiff": stiff,
    "renderer": renderer,
    "hanging": hanging,
    "jelly": jelly,
    "video": video,
    "drape": drape,
}
LONG = ("drape",)  # only where they are named


def processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def head_line() -> str:
    """Device, versions and date."""
    from importlib.metadata import PackageNotFoundError, version

    def of(package: str) -> str:
        try:
            return f"{package} {version(package)}"
        except PackageNotFoundError:
            return f"no {package}"

    try:
        from taichi_sim.reports.peers.cloth_openmp import compiler

        cc = compiler()
    except PeerMissingError:
        cc = "no C compiler"
    packages = ", ".join(
        of(name) for name in ("taichi-sim", "taichi", "numpy", "warp-lang", "pymunk", "lammps", "numba", "newton")
    )
    load = f", load before {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    day = datetime.date.today().isoformat()
    return f"{processor()}, {os.cpu_count()} CPUs{load} | Python {platform.python_version()}, {packages}, {cc} | {day}"


def main(names: list[str], *, quick: bool = False) -> int:
    """Run the named cases, by default all but the long ones, and print a table each. quick: tiny sizes, to try it out.

    Raises ValueError for a name that does not exist.
    """
    for name in names:
        if name not in CASES:
            raise ValueError(f"bench: {name!r} is not a case; there are {', '.join(CASES)}")
    print(head_line(), end="\n\n")
    for name in names or [name for name in CASES if name not in LONG]:
        report = CASES[name](quick)
        if quick:
            report.goals.clear()  # they belong to the full sizes
        report.show()
    return 0
