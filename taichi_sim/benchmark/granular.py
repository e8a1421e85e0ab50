"""The benchmark's settled pile: a million balls with friction, beside LAMMPS's granular pair style."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from taichi_sim.benchmark import cases
from taichi_sim.benchmark.contest import REPEATS, Report, count_of, elapsed
from taichi_sim.benchmark.ours import ball_step
from taichi_sim.benchmark.peers import PeerMissingError
from taichi_sim.benchmark.peers.granular_lammps import GranularLammps, time_step, write_data
from taichi_sim.reports.memory import breakdown

SETTLE = 300  # steps before anyone is timed; LAMMPS starts from where ours have come to
STEPS = 10  # in each timing; LAMMPS's are shorter in simulated time
FIELDS_SHOWN = 8  # of which the memory is listed
ITERATIONS = (1, 4)
RANKS = (2, 1)


def granular_report(quick: bool, arch: str = "cpu") -> Report:
    """Balls that lie in a box, friction and spin: the time of a step, one substep of 1 and of 4 iterations."""
    n, settle = (2000, 100) if quick else (1_000_000, SETTLE)
    if quick and arch != "cpu":  # which software may compute
        n, settle = 300, 10
    case = cases.granular_case(n)
    report = Report(f"granular: {n} balls at rest in a 3D box, friction and spin, one step, f32", "ball-step")
    ours = {
        f"taichi_sim, {count_of(many, 'iteration')}": ball_step(case, arch=arch, substeps=1, contact_iterations=many)
        for many in ITERATIONS
    }
    for runner in ours.values():  # each by itself: the impulses that contacts have accumulated carry the pile
        runner.step(settle)
    name_of_4, runner_of_4 = list(ours.items())[-1]
    timed: dict[str, Callable[[int], float]] = {name: partial(elapsed, runner.step) for name, runner in ours.items()}
    peers: dict[str, GranularLammps] = {}
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder, "balls.data")
        for ranks in RANKS if arch == "cpu" else ():
            name = f"LAMMPS gran/hooke, {count_of(ranks, 'rank')}"
            try:
                peer = GranularLammps(case, data, ranks=ranks)
                if not data.exists():
                    write_data(data, case, runner_of_4.simulation.position)
                peer.timed(1)
                peers[name], timed[name] = peer, peer.timed
            except PeerMissingError as reason:
                report.notes.append(f"{name}: not measured. {reason}")
        report.rows = [(name, [], float(n)) for name in timed]
        for _ in range(REPEATS):
            for name, seconds, _ in report.rows:
                seconds.append(timed[name](STEPS) / STEPS)
    if arch != "cpu":
        report.goals[name_of_4] = "< 4 ms"
        report.notes.append("LAMMPS runs on the CPU and is left out")
    if peers:
        first = next(iter(peers))
        report.goals[first] = ">= 2"
        ratio = report.ratio(first) / report.ratio(name_of_4)
        report.notes += [
            f"4 iterations against {first}: {ratio:.2f}" + ("" if quick else ", goal >= 1"),
            f"a step of ours is {case.dt:.3g} s, one of LAMMPS {time_step(case):.3g} s",
        ]
    for name, runner in ours.items():
        now, energy = runner.simulation.contacts(), runner.simulation.energy().kinetic
        report.notes.append(
            f"{name}: {now.number / n:.2f} contacts a ball, overlap at most {now.relative_penetration:.3f} r, mean"
            f" {now.mean_relative_penetration:.4f} r, kinetic energy {energy / (n * case.gravity * case.radius):.1e} m g r"
            f" a ball, {now.searches} searches in {settle + REPEATS * STEPS} steps"
        )
    for name, peer in peers.items():
        report.notes.append(
            f"{name}: {peer.neighbours:.2f} pairs a ball listed, {peer.searches} searches in {STEPS} steps,"
            f" {peer.bytes / n:.0f} bytes a ball"
        )
    fields = breakdown(next(iter(ours.values())).simulation)
    largest = ", ".join(f"{name} {size / n:.0f}" for name, size in list(fields.items())[:FIELDS_SHOWN])
    report.notes += [
        f"memory of ours: {sum(fields.values()) / n:.0f} bytes a ball, goal < 400",
        f"  of these {largest}",
    ]
    for runner in ours.values():
        runner.close()
    return report
