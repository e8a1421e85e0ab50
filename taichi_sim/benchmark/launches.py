"""The benchmark's count of launches: loops that a substep starts on the device, those on one thread, and waits of the host.

    TI_KERNEL_PROFILER=1 python -m taichi_sim.benchmark.launches cuda full

prints one line of JSON, a list of `Row`s. The benchmark runs it so, since the engine's profiler slows all that a process does.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from taichi_sim.benchmark import cases
from taichi_sim.benchmark.contest import Report
from taichi_sim.benchmark.launch_counts import PROFILED, Counts, count
from taichi_sim.benchmark.ours import Ours, ball_step, cloth_step
from taichi_sim.benchmark.scale import surfaces_scene
from taichi_sim.benchmark.stiff_cloth import OURS, TASKS, T, stiff_scene
from taichi_sim.common.errors import BackendError
from taichi_sim.device.engine import ENGINE

STEPS = 64  # counted after as many; the run looks at the state once in them
ITERATIONS = 4  # of contacts in the pile


class Row(NamedTuple):
    """Numbers of one substep of a scene, and the memory of its fields."""

    scene: str
    substeps: int  # counted
    launches: float
    one_thread: float
    waits: float
    bytes_a_ball: float

    @classmethod
    def of(cls, scene: str, substeps: int, counts: Counts, bytes_a_ball: float) -> "Row":
        launches, one_thread, waits = (number / substeps for number in counts)
        return cls(scene, substeps, launches, one_thread, waits, bytes_a_ball)


def scenes(arch: str, quick: bool) -> dict[str, Callable[[], Ours]]:
    """Runs that are counted, by name, with the contacts of a device on the CPU, too. Springs are summed there as on the CPU,
    and implicit methods ask after every part of a solution."""
    balls, side, around = (1000, 24, 16) if quick else (100_000, 1024, 316)
    device = {"arch": arch, "driver": "parallel"}
    pile = cases.granular_case(balls)
    contacts = {"contacts": "jacobi", "accumulate": "gather"}
    few = {"contact_iterations": ITERATIONS, "substeps": 1}
    found: dict[str, Callable[[], Ours]] = {
        f"pile of {balls} balls, friction, {ITERATIONS} iterations": lambda: ball_step(
            pile, **few, **contacts, **device
        ),
        f"{side} x {side} cloth of springs": lambda: cloth_step(cases.cloth_case(side), arch),
        f"{around} x {around} cloth, colliding surfaces": lambda: Ours(
            surfaces_scene(around), spin=False, **contacts, **device
        ),
    }
    stiff = TASKS[-1]
    for name in ("taichi_sim, implicit Euler", "taichi_sim, TR-BDF2"):
        scene = stiff_scene(stiff.stiffness)
        settings = {"integrator": OURS[name], "dt": T / stiff.steps[name], "contacts": "off", **device}
        found[f"stiff cloth, {OURS[name]}"] = lambda scene=scene, settings=settings: Ours(scene, **settings)  # type: ignore[misc]
    return found


def measured(name: str, make: Callable[[], Ours], steps: int) -> Row:
    """Count `steps` steps of a scene, after as many."""
    with closing(make()) as runner:
        simulation = runner.simulation
        runner.step(steps)
        counts = count(lambda: runner.step(steps))
        return Row.of(
            name, steps * simulation.substeps, counts, simulation.parts.fields.bytes / simulation.scene.n_balls
        )


@dataclass
class LaunchReport(Report):
    """A table of counts in place of times."""

    counts: list[Row] = field(default_factory=list)

    def cells(self) -> tuple[Sequence[str], list[list[str]]]:
        """Counts of a substep."""
        head = ("", "launches", "of these on one thread", "host waits", "bytes a ball")
        rows = [
            [r.scene, *(f"{x:.2f}" for x in (r.launches, r.one_thread, r.waits)), f"{r.bytes_a_ball:.0f}"]
            for r in self.counts
        ]
        return head, rows

    def records(self) -> list[dict[str, Any]]:
        return [row._asdict() for row in self.counts]


def launch_report(quick: bool, arch: str = "cpu") -> LaunchReport:
    """Counts of all scenes, made in a process of their own. Raises BackendError with its last words where it fails."""
    if ENGINE != "taichi":
        raise BackendError(f"launches: {ENGINE} has no profiler that counts them; leave TAICHI_SIM_ENGINE out")
    steps = STEPS // 4 if quick else STEPS
    command = [sys.executable, "-m", __name__, arch, "quick" if quick else "full"]
    done = subprocess.run(command, env=os.environ | PROFILED, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise BackendError(f"launches: counting ended with status {done.returncode}: {last}")
    report = LaunchReport(f"launches on {arch}, per substep; the state looked at once in {steps} steps", ratios=False)
    report.counts = [Row(*row) for row in json.loads(done.stdout.splitlines()[-1])]
    return report


if __name__ == "__main__":
    asked, size = sys.argv[1:]
    tiny = size == "quick"
    print(
        json.dumps([measured(name, make, STEPS // 4 if tiny else STEPS) for name, make in scenes(asked, tiny).items()])
    )
