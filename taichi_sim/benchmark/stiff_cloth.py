"""The benchmark's stiff cloth: wall time against error of the program's methods and of its peers, in the same run."""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.contest import REPEATS, Report, elapsed, peer
from taichi_sim.benchmark.ours import Ours
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes import cloth

Floats = NDArray[np.float64]

SIDE, T = 16, 0.5  # balls along an edge; s
MASS = 0.3  # kg


class Task(NamedTuple):
    """Task of the contest, and the number of steps with which each contestant just does it (found by trying)."""

    stiffness: float  # N/m
    error: float  # m
    steps: dict[str, int]
    reference: int  # steps of the reference


OURS = {
    "taichi_sim, Verlet": "verlet",
    "taichi_sim, TR-BDF2": "tr_bdf2",
    "taichi_sim, implicit Euler": "implicit_euler",
}
TASKS = (
    Task(
        1e3,
        1e-3,
        dict.fromkeys(
            ("taichi_sim, Verlet", "Verlet in numba", "symplectic Euler in numba", "Newton, semi-implicit"), 800
        ),
        4000,
    ),
    Task(1e3, 3e-5, {"taichi_sim, Verlet": 1280, "Verlet in numba": 1400}, 4000),
    Task(
        1e5,
        1e-2,
        {"taichi_sim, TR-BDF2": 40, "taichi_sim, implicit Euler": 160}
        | dict.fromkeys(("Verlet in numba", "Newton, semi-implicit"), 8000),
        16_000,
    ),
)


def stiff_scene(stiffness: float) -> Scene:
    """A sheet of 1 m and 0.3 kg, 1378 springs of one stiffness [N/m], damped by a hundredth of sqrt(k m), one edge pinned.

    Springs between balls two apart take the place of bending elements: its peers and the reference know springs alone. Each
    square has both of its diagonals.
    """
    scene = Scene(dim=3, gravity=(0, -10, 0))
    edge = range(SIDE)
    cloth(scene, size=(1, 1), resolution=(SIDE, SIDE), mass=MASS, stiffness=stiffness, bending_stiffness=0, pinned=edge)
    ball = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    present = {frozenset(pair) for pair in scene.pairs.tolist()}
    for one, other in ((ball[:-1, :-1], ball[1:, 1:]), (ball[1:, :-1], ball[:-1, 1:])):
        across = np.stack([one.ravel(), other.ravel()], axis=1).tolist()
        scene.add_springs([pair for pair in across if frozenset(pair) not in present], stiffness=stiffness)
    for lines in (ball, ball.T):
        scene.add_springs(np.stack([lines[:, :-2].ravel(), lines[:, 2:].ravel()], axis=1), stiffness=stiffness)
    scene.set_springs(stiffness=stiffness)
    scene.set_springs(damping=0.01 * np.sqrt(stiffness * MASS / SIDE**2))
    return scene


def converged(scene: Scene, steps: int) -> Floats:
    """Positions (n, 3) at T, in double precision by RK4 in NumPy."""
    i, j = scene.pairs.T
    ends, w = np.concatenate([i, j]), np.where(scene.pinned, 0.0, 1.0 / scene.mass)

    def rate(x: Floats, v: Floats) -> Floats:
        r, u = x[j] - x[i], v[j] - v[i]
        d = np.sqrt(np.sum(r * r, axis=1))
        pull = scene.stiffness * (d - scene.rest_length) + scene.damping * np.sum(u * r, axis=1) / d
        force = (pull / d)[:, None] * r
        both = np.concatenate([force, -force])
        total = np.stack([np.bincount(ends, both[:, a], len(x)) for a in range(3)], axis=1)
        result: Floats = w[:, None] * total + scene.gravity * (w > 0)[:, None]
        return result

    x, v, h = scene.position.copy(), scene.velocity.copy(), T / steps
    for _ in range(steps):
        a1 = rate(x, v)
        v2 = v + h / 2 * a1
        a2 = rate(x + h / 2 * v, v2)
        v3 = v + h / 2 * a2
        a3 = rate(x + h / 2 * v2, v3)
        v4 = v + h * a3
        a4 = rate(x + h * v3, v4)
        x, v = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return x


@dataclass
class StiffReport(Report):
    """Times are seconds per simulated second."""

    details: list[tuple[Task, int, float]] = field(default_factory=list)  # task, steps and error [m] of each row

    def cells(self) -> tuple[Sequence[str], list[list[str]]]:
        """Times beside what was asked and how far each is off."""
        head = ("k, N/m", "asked, m", "", "steps", "error, m", "s per simulated s", "its time / our best")
        rows = []
        for (name, seconds, _), (task, steps, error) in zip(self.rows, self.details):
            middle = statistics.median(seconds)
            cells = [f"{steps}", f"{error:.2g}", f"{middle:.4f}", f"{middle / self.best(task):.2f}"]
            rows.append([f"{task.stiffness:g}", f"{task.error:g}", name, *cells])
        return head, rows

    def records(self) -> list[dict[str, Any]]:
        """Rows with what was asked, the error [m] and how many steps; seconds are per simulated second."""
        return [
            {**row, "stiffness": task.stiffness, "asked": task.error, "steps": steps, "error": error}
            for row, (task, steps, error) in zip(super().records(), self.details)
        ]

    def best(self, task: Task) -> float:
        """Our shortest median time for a task."""
        rows = zip(self.rows, self.details)
        return min(statistics.median(seconds) for (name, seconds, _), of in rows if of[0] == task and name in OURS)


def _contestant(name: str, scene: Scene, steps: int, arch: str) -> Callable[[], Any]:
    if name in OURS:
        return partial(Ours, scene, arch=arch, integrator=OURS[name], dt=T / steps, contacts="off")
    if name.startswith("Newton"):
        return peer("stiff_newton.StiffNewton", scene, T / steps)
    return peer("stiff_numba.StiffNumba", scene, T / steps, verlet=name.startswith("Verlet"))


def stiff_report(quick: bool, arch: str = "cpu") -> StiffReport:
    """All tasks; each contestant is warm, then all take turns. On a device without the peers, which run on the CPU."""
    report = StiffReport(
        f"stiff: a cloth of {SIDE} x {SIDE} balls and 1378 springs hung at one edge, let go flat, after {T:g} s; ours in f32",
        samples=1 if quick else REPEATS,
    )
    if arch != "cpu":
        report.notes.append("peers that run on the CPU only are left out")
    for task in TASKS[:1] if quick else TASKS:
        scene = stiff_scene(task.stiffness)
        exact = converged(scene, task.reference)
        report.entries = []
        for name, steps in task.steps.items():
            if name in OURS or arch == "cpu":
                report.enter(name, _contestant(name, scene, steps, arch), scene.n_springs, steps)
        rows: list[tuple[str, list[float], float]] = [(entry.name, [], entry.units) for entry in report.entries]
        for turn in range(1 + report.samples):
            for entry, (_, seconds, _) in zip(report.entries, rows):
                entry.runner.reset()
                taken = elapsed(entry.runner.step, entry.steps) / T
                if turn:  # the first compiles
                    seconds.append(taken)
        report.rows += rows
        for entry in report.entries:
            off = entry.runner.result()[0] - exact
            report.details.append((task, entry.steps, float(np.sqrt(np.mean(np.sum(off**2, axis=1))))))
        report.close()
    return report
