"""The benchmark's settled pile: a million balls with friction, beside LAMMPS's granular pair style."""

import tempfile
import time
from pathlib import Path
from typing import Any

from taichi_sim.reports.bench import cases
from taichi_sim.reports.bench.table import REPEATS, Report
from taichi_sim.reports.memory import breakdown
from taichi_sim.reports.peers import PeerMissingError

__all__ = ["granular_report"]

SETTLE = 300  # steps before anyone is timed; LAMMPS starts from where ours have come to
STEPS = 10  # in each timing; LAMMPS's are shorter in simulated time
SHOWN = 8  # fields of which the memory is listed
PASSES = (1, 4)
RANKS = (2, 1)


class _OnTheClock:
    """Times our own steps, from where the simulation is."""

    def __init__(self, runner: Any) -> None:
        self.runner = runner

    def timed(self, steps: int) -> float:
        """Seconds that `steps` steps took."""
        start = time.perf_counter()
        self.runner.step(steps)
        return time.perf_counter() - start


def _memory(simulation: Any, n: int) -> list[str]:
    """Bytes a ball, and the fields that take most of them."""
    parts = breakdown(simulation)
    largest = ", ".join(f"{name} {size / n:.0f}" for name, size in list(parts.items())[:SHOWN])
    return [f"memory of ours: {sum(parts.values()) / n:.0f} bytes a ball, goal < 400", f"  of these {largest}"]


def granular_report(quick: bool) -> Report:
    """Balls that lie in a box, friction and spin: the time of a step, one substep of 1 and of 4 passes."""
    from taichi_sim.reports.bench.ours import granular_step
    from taichi_sim.reports.peers.granular_lammps import GranularLammps, time_step, write_data

    n, settle = (2000, 100) if quick else (1_000_000, SETTLE)
    case = cases.granular_case(n)
    report = Report(f"granular: {n} balls at rest in a 3D box, friction and spin, one step, f32", "ball-step")
    names = {passes: f"taichi_sim, {passes} pass{'es' if passes > 1 else ''}" for passes in PASSES}
    ours = {passes: granular_step(case, passes) for passes in PASSES}
    for runner in ours.values():  # each by itself: what contacts hold from before carries the pile
        runner.step(settle)
    packing = ours[PASSES[-1]].simulation.position
    contestants: dict[str, Any] = {names[passes]: _OnTheClock(runner) for passes, runner in ours.items()}
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder, "balls.data")
        for ranks in RANKS:
            name = f"LAMMPS gran/hooke, {ranks} rank{'s' if ranks > 1 else ''}"
            try:
                peer = GranularLammps(case, data, ranks=ranks)
                if not data.exists():
                    write_data(data, case, packing)
                peer.timed(1)
                contestants[name] = peer
            except PeerMissingError as reason:
                report.notes.append(f"{name}: not measured. {reason}")
        seconds: dict[str, list[float]] = {name: [] for name in contestants}
        for _ in range(REPEATS):
            for name, contestant in contestants.items():
                seconds[name].append(contestant.timed(STEPS) / STEPS)
    report.rows = [(name, seconds[name], float(n)) for name in contestants]
    peers = [name for name in contestants if name.startswith("LAMMPS")]
    if peers:
        report.goals[peers[0]] = ">= 2"
        ratio = report.ratio(peers[0]) / report.ratio(names[4])
        report.notes.append(f"4 passes against {peers[0]}: {ratio:.2f}" + ("" if quick else ", goal >= 1"))
        report.notes.append(f"a step of ours is {case.dt:.3g} s, one of LAMMPS {time_step(case):.3g} s")
    for passes, runner in ours.items():
        now, energy = runner.simulation.contacts(), runner.simulation.energy().kinetic
        report.notes.append(
            f"{names[passes]}: {now.number / n:.2f} contacts a ball, overlap at most {now.relative_penetration:.3f} r, mean"
            f" {now.mean_relative_penetration:.4f} r, kinetic energy {energy / (n * case.gravity * case.radius):.1e} m g r"
            f" a ball, {now.searches} searches in {settle + REPEATS * STEPS} steps"
        )
    for name in peers:
        peer = contestants[name]
        report.notes.append(
            f"{name}: {peer.neighbours:.2f} pairs a ball listed, {peer.searches} searches in {STEPS} steps,"
            f" {peer.bytes / n:.0f} bytes a ball"
        )
    report.notes.extend(_memory(ours[1].simulation, n))
    for runner in ours.values():
        runner.close()
    return report
