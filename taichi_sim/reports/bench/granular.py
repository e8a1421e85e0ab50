"""The benchmark's settled pile: a million balls with friction, beside LAMMPS's granular pair style."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from taichi_sim.reports.bench import cases
from taichi_sim.reports.bench.ours import granular_step
from taichi_sim.reports.bench.table import REPEATS, Report, elapsed
from taichi_sim.reports.memory import breakdown
from taichi_sim.reports.peers import PeerMissingError
from taichi_sim.reports.peers.granular_lammps import GranularLammps, time_step, write_data

__all__ = ["granular_report"]

SETTLE = 300  # steps before anyone is timed; LAMMPS starts from where ours have come to
STEPS = 10  # in each timing; LAMMPS's are shorter in simulated time
SHOWN = 8  # fields of which the memory is listed
PASSES = (1, 4)
RANKS = (2, 1)


def _memory(simulation: Any, n: int) -> list[str]:
    """Bytes a ball, and the fields that take most of them."""
    parts = breakdown(simulation)
    largest = ", ".join(f"{name} {size / n:.0f}" for name, size in list(parts.items())[:SHOWN])
    return [f"memory of ours: {sum(parts.values()) / n:.0f} bytes a ball, goal < 400", f"  of these {largest}"]


def granular_report(quick: bool) -> Report:
    """Balls that lie in a box, friction and spin: the time of a step, one substep of 1 and of 4 passes."""
    n, settle = (2000, 100) if quick else (1_000_000, SETTLE)
    case = cases.granular_case(n)
    report = Report(f"granular: {n} balls at rest in a 3D box, friction and spin, one step, f32", "ball-step")
    names = {passes: f"taichi_sim, {passes} pass{'es' if passes > 1 else ''}" for passes in PASSES}
    ours = {passes: granular_step(case, passes) for passes in PASSES}
    for runner in ours.values():  # each by itself: what contacts hold from before carries the pile
        runner.step(settle)
    packing = ours[PASSES[-1]].simulation.position
    timed: dict[str, Callable[[int], float]] = {
        names[passes]: partial(elapsed, runner.step) for passes, runner in ours.items()
    }
    peers: dict[str, GranularLammps] = {}
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder, "balls.data")
        for ranks in RANKS:
            name = f"LAMMPS gran/hooke, {ranks} rank{'s' if ranks > 1 else ''}"
            try:
                peer = GranularLammps(case, data, ranks=ranks)
                if not data.exists():
                    write_data(data, case, packing)
                peer.timed(1)
                peers[name], timed[name] = peer, peer.timed
            except PeerMissingError as reason:
                report.notes.append(f"{name}: not measured. {reason}")
        report.rows = [(name, [], float(n)) for name in timed]
        for _ in range(REPEATS):
            for name, seconds, _ in report.rows:
                seconds.append(timed[name](STEPS) / STEPS)
    if peers:
        first = next(iter(peers))
        report.goals[first] = ">= 2"
        ratio = report.ratio(first) / report.ratio(names[4])
        report.notes.append(f"4 passes against {first}: {ratio:.2f}" + ("" if quick else ", goal >= 1"))
        report.notes.append(f"a step of ours is {case.dt:.3g} s, one of LAMMPS {time_step(case):.3g} s")
    for passes, runner in ours.items():
        now, energy = runner.simulation.contacts(), runner.simulation.energy().kinetic
        report.notes.append(
            f"{names[passes]}: {now.number / n:.2f} contacts a ball, overlap at most {now.relative_penetration:.3f} r, mean"
            f" {now.mean_relative_penetration:.4f} r, kinetic energy {energy / (n * case.gravity * case.radius):.1e} m g r"
            f" a ball, {now.searches} searches in {settle + REPEATS * STEPS} steps"
        )
    for name, peer in peers.items():
        report.notes.append(
            f"{name}: {peer.neighbours:.2f} pairs a ball listed, {peer.searches} searches in {STEPS} steps,"
            f" {peer.bytes / n:.0f} bytes a ball"
        )
    report.notes.extend(_memory(ours[1].simulation, n))
    for runner in ours.values():
        runner.close()
    return report
