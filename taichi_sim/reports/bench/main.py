"""The benchmark: the program beside its peers in one run, taking turns, medians of five, warm-up left out."""

import datetime
import os
import platform
from collections.abc import Callable
from typing import Any

import numpy as np

from taichi_sim.reports.bench import cases
from taichi_sim.reports.bench.table import Entry, Report, close, difference, invite, take_turns
from taichi_sim.reports.peers import PeerMissingError, Runner

__all__ = ["CASES", "head_line", "main"]


def springs(quick: bool) -> Report:
    """A cloth of 1024 x 1024 balls, one symplectic Euler step, f32."""
    from taichi_sim.reports.bench.ours import springs_step

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
        invite(entries, report, name, openmp(count, False), m, 20)
        invite(entries, report, f"{name}, -ffast-math", openmp(count, True), m, 20)
    report.goals[f"C + OpenMP, {threads} thread{'s' if threads > 1 else ''}"] = ">= 0.9"
    invite(entries, report, "Warp on the CPU, 1 thread", warp, m, 5)
    report.goals["Warp on the CPU, 1 thread"] = ">= 1.7"
    report.rows = take_turns(entries)
    results = []
    for entry in entries:
        entry.runner.reset()
        entry.runner.step(5)
        results.append((entry.name, entry.runner.result()))
    for name, (x, v) in results[1:]:
        dx, dv = difference(x, results[0][1][0]), difference(v, results[0][1][1])
        report.notes.append(
            f"{name}: after 5 steps its state differs from ours by {dx:.1e} (position), {dv:.1e} (velocity)"
        )
    close(entries)
    return report


def contacts(quick: bool) -> Report:
    """A million balls in 3D, in the lattice's order: search and one pass of impulses, by both rules."""
    return _contacts(quick, shuffled=False)


def shuffled(quick: bool) -> Report:
    """The same in random order: every access to another ball misses the caches."""
    return _contacts(quick, shuffled=True)


def _contacts(quick: bool, shuffled: bool) -> Report:
    from taichi_sim.reports.bench.ours import ContactPass

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

    invite(entries, report, "Warp hash grid, split masses", warp("count"), n, 2)
    invite(entries, report, "Warp hash grid, plain sum", warp("none"), n, 2)
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
    close(entries)
    return report


def small(quick: bool) -> Report:
    """100 discs in a box: the fused driver against the parallel one."""
    from taichi_sim.reports.bench.ours import small_step

    box = cases.box_of_discs(100)
    report = Report("small: 100 discs in a 2D box with contacts, default settings, 1 ms steps, f32")
    entries = [
        Entry("taichi_sim, fused", small_step(box, "fused"), 100, 256 if quick else 2000),
        Entry(
            "taichi_sim, fused, 1 contact pass",
            small_step(box, "fused", contact_iterations=1),
            100,
            256 if quick else 2000,
        ),
        Entry("taichi_sim, parallel", small_step(box, "parallel"), 100, 64 if quick else 500),
    ]
    report.rows = take_turns(entries)
    report.goals = {entries[0].name: "<= 10 us", entries[2].name: ">= 20"}
    close(entries)
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
    from taichi_sim.analysis.frame import Frame
    from taichi_sim.device import backend

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
    close(entries)
    return report


def pile(quick: bool) -> Report:
    """10 000 discs that have fallen into a box, friction and spin, 240 Hz, six seeds."""
    from taichi_sim.reports.bench.piles import pile_report

    return pile_report(quick)


def small_pile(quick: bool) -> Report:
    """The same with 100 discs."""
    from taichi_sim.reports.bench.piles import pile_report

    return pile_report(quick, few=True)


def granular(quick: bool) -> Report:
    """A million balls at rest in a box, friction and spin, beside LAMMPS."""
    from taichi_sim.reports.bench.granular import granular_report

    return granular_report(quick)


def stiff(quick: bool) -> Report:
    """A stiff cloth: wall time against error, beside numba and Newton."""
    from taichi_sim.reports.bench.stiff_cloth import stiff_report

    return stiff_report(quick)


def hanging(quick: bool) -> Report:
    """A large cloth of a material."""
    from taichi_sim.reports.bench.scale import hanging_report

    return hanging_report(quick)


def jelly(quick: bool) -> Report:
    """A million tetrahedra."""
    from taichi_sim.reports.bench.scale import jelly_report

    return jelly_report(quick)


def video(quick: bool) -> Report:
    """A cloth from the scene to an MP4."""
    from taichi_sim.reports.bench.scale import video_report

    return video_report(quick)


def drape(quick: bool) -> Report:
    """A cloth of 100 000 balls on a ball and on itself."""
    from taichi_sim.reports.bench.scale import drape_report

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
