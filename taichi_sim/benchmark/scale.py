"""The benchmark's large cloth and jelly: what building, a step and a frame take, and a cloth that meets a ball and itself."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim import shapes
from taichi_sim.benchmark.contest import REPEATS, Report, count_of, elapsed
from taichi_sim.common.errors import BackendError
from taichi_sim.outputs import export, open_output
from taichi_sim.reports.memory import breakdown
from taichi_sim.scene.collider_shapes import Sphere
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.simulation import Simulation

STEPS = 5  # in each timing
FPS = 60.0
BALL_CENTRE, BALL_RADIUS = (0.0, 0.5, 0.0), 0.4  # m, what the cloth falls on
CLOTH_SIDE, DROP_HEIGHT, TOUCHING = 2.0, 1.0, 0.92  # m, the heights of the cloth where it begins
MEETING = 0.12  # s until it lies on the ball's top
CHECK_INTERVAL = 0.1  # s of simulated time between two searches for what has gone through


def _peak() -> float:
    """Largest memory of this process so far [GB]; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def _steps(title: str, unit: str, units: int, add: Callable[[Scene], object], arch: str) -> Report:
    """Time of a step of a scene, and notes of what it takes to build, to store and to make a frame of."""
    report = Report(f"{title}, one step, f32", unit, ratios=False)
    start = time.perf_counter()
    scene = Scene(dim=3, gravity=(0, -10, 0))
    add(scene)
    described = time.perf_counter() - start
    simulation = Simulation(scene, arch=arch, precision="f32")
    built = time.perf_counter() - start
    simulation.step(1)
    ready = time.perf_counter() - start
    seconds = [elapsed(simulation.step, STEPS) / STEPS for _ in range(REPEATS)]
    report.rows = [("taichi_sim", seconds, float(units))]
    frame = float(np.median(seconds)) / (FPS * simulation.dt)
    size = sum(breakdown(simulation).values())
    report.notes += [
        f"{scene.n_balls} balls, {scene.n_springs} springs, {scene.n_volumes()} cells, bricks and solids:"
        f" shape {described:.1f} s, simulation {built - described:.1f} s, first step with compiling {ready - built:.1f} s",
        f"a step is {simulation.dt:.3g} s, so a frame of 1/{FPS:g} s takes {frame:.3g} s",
        f"fields {size / 1e9:.2f} GB; the process at most {_peak():.2f} GB so far, goal < 12",
    ]
    simulation.close()
    return report


def _hung(n: int, scene: Scene) -> None:
    """A cotton cloth of n x n balls that hangs from its upper edge."""
    cotton: dict[str, Any] = {
        "mass_per_area": 0.2,
        "stretch_stiffness": 100.0,
        "bending_rigidity": 1e-5,
        "damping": 0.01,
    }
    hung: dict[str, Any] = {"size": (1, 1), "pinned": np.arange(n) * n, "rotation": (90, 0, 0)}
    shapes.cloth(scene, resolution=(n, n), **hung, **cotton)


def hanging_report(quick: bool, arch: str = "cpu") -> Report:
    """A cotton cloth of 1024 x 1024 balls that hangs from its upper edge."""
    n = 32 if quick else 1024
    return _steps(f"hanging: {n} x {n} cloth of a material", "ball-step", n * n, partial(_hung, n), arch)


def real_time_report(quick: bool, arch: str = "cpu") -> Report:
    """Report of a hanging cotton cloth for 1/60 s, the time of a frame, by its explicit steps and by implicit ones."""
    n = 32 if quick else 1024
    report = Report(f"real time: {n} x {n} cloth of a material, a frame of 1/{FPS:g} s, f32", ratios=False, samples=2)
    for integrator in ("verlet", "implicit_euler"):
        scene = Scene(dim=3, gravity=(0, -10, 0))
        _hung(n, scene)
        settings: dict[str, Any] = {} if integrator == "verlet" else {"dt": 1.0 / FPS}
        with Simulation(
            scene, arch=arch, precision="f32", contacts="off", integrator=integrator, **settings
        ) as simulation:
            steps = max(1, round(1.0 / (FPS * simulation.dt)))
            simulation.step(steps)
            name = f"{integrator}, {count_of(steps, 'step')}"
            report.rows.append((name, [elapsed(simulation.step, steps) for _ in range(report.samples)], float(n * n)))
            report.goals[name] = "<= 16.7 ms"
    return report


def jelly_report(quick: bool, arch: str = "cpu") -> Report:
    """A cube of jelly of half a million bricks on the floor."""
    n = 6 if quick else 81  # balls along a side

    def add(scene: Scene) -> None:
        material: dict[str, Any] = {"density": 1000.0, "young_modulus": 1e5, "poisson_ratio": 0.4}
        shapes.jelly(scene, size=(1, 1, 1), resolution=(n, n, n), position=(0, 0.01, 0), **material)
        scene.add_wall((0, 1, 0))

    bricks = (n - 1) ** 3
    return _steps(f"jelly: {bricks} bricks in a cube", "brick-step", bricks, add, arch)


def _falling_cloth(side: float, height: float, n: int, **options: Any) -> Scene:
    """A square cloth of n x n balls of some height above the floor, with friction."""
    scene = Scene(dim=3, gravity=(0, -10, 0))
    scene.add_material("cloth", friction=0.4)
    place: dict[str, Any] = {"size": (side, side), "resolution": (n, n), "position": (-side / 2, height, -side / 2)}
    shapes.cloth(scene, material="cloth", **place, **options)
    scene.add_wall((0, 1, 0), material="cloth")
    return scene


def video_report(quick: bool) -> Report:
    """A cloth of 256 x 256 balls that falls and folds on the floor, end to end into an MP4 of 300 frames, 1280 x 720."""
    n, frames, size = (24, 6, (320, 180)) if quick else (256, 300, (1280, 720))
    report = Report(f"video: {n} x {n} cloth, {frames} frames, {size[0]} x {size[1]}, MP4", ratios=False, samples=1)
    report.goals["a frame, compiling included"] = "333 ms, 90 %"
    look: dict[str, Any] = {"rotation": (60, 0, 0), "colour": (0.2, 0.45, 0.71)}
    for collides, name in ((False, "a frame, compiling included"), (True, "the same, where its balls collide")):
        scene = _falling_cloth(1.2, 1.2, n, mass=0.3, self_collision=collides, **look)
        start = time.perf_counter()
        simulation = Simulation(scene, arch="cpu", precision="f32")
        with tempfile.TemporaryDirectory() as folder:
            output = open_output(str(Path(folder, "cloth.mp4")), fps=FPS)
            summary = export(simulation, output, fps=FPS, duration=frames / FPS, size=size)
        simulation.close()
        wall = time.perf_counter() - start
        report.rows.append((name, [wall / frames], 0.0))
        own = (summary.simulating + summary.drawing) / summary.wall
        report.notes.append(
            f"{name}: {frames / wall:.2f} frames/s; simulation {summary.simulating:.1f} s, pictures {summary.drawing:.1f} s,"
            f" writing {summary.writing:.1f} s: {100 * own:.0f} % simulation and pictures"
        )
    return report


def surfaces_scene(n: int, height: float = TOUCHING) -> Scene:
    """A cloth of n x n balls with surfaces that collide, above a ball on the floor; by default it touches soon."""
    scene = _falling_cloth(CLOTH_SIDE, height, n, stiffness=11.0, damping=5e-4, surface_collision=True)
    scene.add_collider(Sphere(BALL_CENTRE, BALL_RADIUS, material="cloth"))
    return scene


def surfaces_report(quick: bool, arch: str = "cpu") -> Report:
    """A step of a cloth of 100 000 balls with surfaces that collide, on a ball; on a device beside the CPU."""
    n = 16 if quick else 316
    report = Report(f"surfaces: {n} x {n} cloth with colliding surfaces on a ball, one step, f32", "ball-step")
    with Simulation(surfaces_scene(n), arch=arch, precision="f32", spin=False) as simulation:
        simulation.step(1 if quick else round(MEETING / simulation.dt))
        seconds = [elapsed(simulation.step, STEPS) / STEPS for _ in range(REPEATS)]
        report.rows = [("taichi_sim", seconds, float(n * n))]
        now = simulation.contacts()
        report.notes.append(f"{now.number} contacts; overlap at most {now.relative_penetration:.3f} r")
    if arch != "cpu":
        name = f"taichi_sim on the CPU, {count_of(os.cpu_count() or 1, 'thread')}"
        report.rows.append((name, _on_cpu("surfaces", quick), float(n * n)))
        report.goals[name] = ">= 20"
    return report


def _on_cpu(case: str, quick: bool) -> list[float]:
    """Seconds of the first row of a case on the CPU, by another process, as a process has one device."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "cpu.json")
        command = [sys.executable, "-m", "taichi_sim", "bench", case, "--json", str(file), *["--quick"] * quick]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise BackendError(f"{case}: the run on the CPU ended with status {done.returncode}: {last}")
        seconds: list[float] = json.loads(file.read_bytes())["tables"][0]["rows"][0]["seconds"]
        return seconds


def drape_report(quick: bool) -> Report:
    """A cloth of 100 000 balls with surfaces that collide: 5 s on a ball, the floor and itself. Half an hour."""
    n, duration = (16, 0.2) if quick else (316, 5.0)
    simulation = Simulation(surfaces_scene(n, DROP_HEIGHT), arch="cpu", precision="f32", spin=False)
    simulation.step(1)
    steps = max(1, round(CHECK_INTERVAL / simulation.dt))
    report = Report(f"drape: {n} x {n} cloth with colliding surfaces, {duration:g} s", "ball-step", ratios=False)
    seconds, crossings, clearance = [], 0, np.inf
    while simulation.time < duration:
        seconds.append(elapsed(simulation.step, steps) / steps)
        x = simulation.position
        crossings = max(crossings, simulation.crossings())
        outside = float(np.linalg.norm(x - BALL_CENTRE, axis=1).min()) - BALL_RADIUS
        clearance = min(clearance, outside, float(x[:, 1].min()))
    report.rows, report.samples = [("taichi_sim", seconds, float(n * n))], len(seconds)
    report.notes += [
        f"{sum(seconds) * steps:.0f} s for {duration:g} s in steps of {simulation.dt:.3g} s; a step at most {max(seconds):.3g} s",
        f"searched every {CHECK_INTERVAL:g} s: at most {crossings} edges through triangles, goal 0; the centre of no ball"
        f" nearer than {clearance:.3g} m to the sphere or the floor, goal > 0",
    ]
    simulation.close()
    return report
