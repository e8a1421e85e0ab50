"""The benchmark of many short runs: one simulation that is reset to another scene, against a new one for each."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from taichi_sim.benchmark.contest import Report
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes import cloth
from taichi_sim.simulation.simulation import Simulation

SECONDS = 1.0  # simulated in each run, in steps of 1 ms
SETTINGS: dict[str, Any] = {"dt": 1e-3, "precision": "f32", "arch": "cpu"}


def discs(number: int) -> Scene:
    """A hundred discs that fall onto each other between three walls, number by number with another restitution and start."""
    scene = Scene(dim=2, gravity=(0.0, -10.0))
    scene.add_material("rubber", restitution=0.1 + 0.005 * (number % 100), friction=0.3)
    x = np.stack(np.meshgrid(0.12 * np.arange(10), 0.06 + 0.12 * np.arange(10)), axis=-1).reshape(-1, 2)
    x += np.random.default_rng(number).uniform(-0.005, 0.005, x.shape)
    scene.add_balls(x, radius=0.05, material="rubber")
    for normal, offset in (((0, 1), 0.0), ((1, 0), -0.3), ((-1, 0), -1.5)):
        scene.add_wall(normal, offset, "rubber")
    return scene


def sheet(number: int) -> Scene:
    """A cloth of 16 x 16 that swings down from an edge, with another gravity each."""
    scene = Scene(dim=3, gravity=(0.0, -10.0 - 0.05 * (number % 100), 0.0))
    cloth(scene, size=(1.0, 1.0), resolution=(16, 16), mass=0.2, stiffness=300.0, damping=0.03, pinned="left")
    return scene


class Runs:
    """A Runner whose steps are whole runs."""

    def __init__(self, make: Callable[[int], Scene], seconds: float, *, again: bool) -> None:
        self.make, self.seconds, self.again, self.number = make, seconds, again, 0
        self.simulation = Simulation(make(0), **SETTINGS)
        self.simulation.run(seconds)

    def reset(self) -> None:
        self.number = 0

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self.number += 1
            scene = self.make(self.number)
            if self.again:
                self.simulation.reset(scene)
            else:
                self.simulation.close()
                self.simulation = Simulation(scene, **SETTINGS)
            self.simulation.run(self.seconds)

    def close(self) -> None:
        self.simulation.close()


def runs_report(quick: bool) -> Report:
    """Runs of a second: 100 discs, and a cloth of 16 x 16."""
    seconds, steps = (0.05, 2) if quick else (SECONDS, 20)
    report = Report(f"runs: {seconds:g} s simulated in 1 ms steps, scene and start included, f32", ratios=False)
    for name, make, goal in (("100 discs", discs, "<= 25 ms"), ("16 x 16 cloth", sheet, None)):
        report.enter(f"{name}, one simulation, reset", partial(Runs, make, seconds, again=True), 1, steps, goal)
        report.enter(f"{name}, a new simulation each", partial(Runs, make, seconds, again=False), 1, steps)
    report.take_turns()
    report.close()
    return report
