"""The benchmark's large cloth and jelly: what building, a step and a frame take, and a cloth that meets a ball and itself."""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim import shapes
from taichi_sim.outputs import export, open_output
from taichi_sim.reports.bench.table import REPEATS, Report, elapsed
from taichi_sim.reports.memory import breakdown
from taichi_sim.scene.colliders import Sphere
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.simulation import Simulation

__all__ = ["drape_report", "hanging_report", "jelly_report", "video_report"]

STEPS = 5  # in each timing
FPS = 60.0
BALL_CENTRE, BALL_RADIUS = (0.0, 0.5, 0.0), 0.4  # m, what the cloth falls on
CLOTH_SIDE, DROP_HEIGHT = 2.0, 1.0  # m
CHECK_INTERVAL = 0.1  # s of simulated time between two looks at what has gone through


def _peak() -> float:
    """Largest memory of this process so far [GB]; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def _steps(title: str, name: str, scene_of: Any, unit: str, units: int) -> Report:
    """Time of a step of a scene, and notes of what it takes to build, to store and to make a frame of."""
    report = Report(title, unit, ratios=False)
    start = time.perf_counter()
    scene = scene_of()
    described = time.perf_counter() - start
    simulation = Simulation(scene, arch="cpu", precision="f32")
    built = time.perf_counter() - start
    simulation.step(1)
    ready = time.perf_counter() - start
    seconds = []
    for _ in range(REPEATS):
        seconds.append(elapsed(simulation.step, STEPS) / STEPS)
    report.rows = [(name, seconds, float(units))]
    frame = float(np.median(seconds)) / (FPS * simulation.dt)
    size = sum(breakdown(simulation).values())
    report.notes += [
        f"{scene.n_balls} balls, {scene.n_springs} springs, {len(scene.cells)} cells: shape {described:.1f} s, simulation"
        f" {built - described:.1f} s, first step with compiling {ready - built:.1f} s",
        f"a step is {simulation.dt:.3g} s, so a frame of 1/{FPS:g} s takes {frame:.3g} s",
        f"fields {size / 1e9:.2f} GB; the process at most {_peak():.2f} GB so far, goal < 12",
    ]
    simulation.close()
    return report


def hanging_report(quick: bool) -> Report:
    """A cotton cloth of 1024 x 1024 balls that hangs from its upper edge."""
    n = 32 if quick else 1024

    def scene() -> Scene:
        out = Scene(dim=3, gravity=(0, -10, 0))
        pinned = np.arange(n) * n
        shapes.cloth(
            out,
            size=(1, 1),
            resolution=(n, n),
            mass_per_area=0.2,
            stretch_stiffness=100.0,
            bending_rigidity=1e-5,
            damping=0.01,
            pinned=pinned,
            rotation=(90, 0, 0),
        )
        return out

    return _steps(f"hanging: {n} x {n} cloth of a material, one step, f32", "taichi_sim", scene, "ball-step", n * n)


def jelly_report(quick: bool) -> Report:
    """A cube of jelly of a million tetrahedra on the floor."""
    n = 6 if quick else 81  # balls along a side; two cells in each box

    def scene() -> Scene:
        out = Scene(dim=3, gravity=(0, -10, 0))
        shapes.jelly(
            out,
            size=(1, 1, 1),
            resolution=(n, n, n),
            density=1000.0,
            young_modulus=1e5,
            poisson_ratio=0.4,
            position=(0, 0.01, 0),
        )
        out.add_wall((0, 1, 0))
        return out

    cells = 2 * (n - 1) ** 3
    return _steps(f"jelly: {cells} tetrahedra in a cube, one step, f32", "taichi_sim", scene, "cell-step", cells)


def video_report(quick: bool) -> Report:
    """A cloth of 256 x 256 balls that falls and folds on the floor, end to end into an MP4 of 300 frames, 1280 x 720."""

    n, frames, size = (24, 6, (320, 180)) if quick else (256, 300, (1280, 720))
    report = Report(f"video: {n} x {n} cloth, {frames} frames, {size[0]} x {size[1]}, MP4", ratios=False, samples=1)
    for collides, name in ((False, "a frame, compiling included"), (True, "the same, where its balls collide")):
        scene = Scene(dim=3, gravity=(0, -10, 0))
        scene.add_material("cloth", friction=0.4)
        shapes.cloth(
            scene,
            size=(1.2, 1.2),
            resolution=(n, n),
            mass=0.3,
            material="cloth",
            position=(-0.6, 1.2, -0.6),
            rotation=(60, 0, 0),
            colour=(0.2, 0.45, 0.71),
            self_collision=collides,
        )
        scene.add_wall((0, 1, 0), material="cloth")
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
    report.goals[report.rows[0][0]] = "333 ms, 90 %"
    return report


def drape_report(quick: bool) -> Report:
    """A cloth of 100 000 balls with surfaces that collide: 5 s on a ball, the floor and itself. Half an hour."""
    n, duration = (16, 0.2) if quick else (316, 5.0)
    scene = Scene(dim=3, gravity=(0, -10, 0))
    scene.add_material("cloth", friction=0.4)
    shapes.cloth(
        scene,
        size=(CLOTH_SIDE, CLOTH_SIDE),
        resolution=(n, n),
        stiffness=11.0,
        damping=5e-4,
        material="cloth",
        surface_collision=True,
        position=(-CLOTH_SIDE / 2, DROP_HEIGHT, -CLOTH_SIDE / 2),
    )
    scene.add_collider(Sphere(BALL_CENTRE, BALL_RADIUS, material="cloth"))
    scene.add_wall((0, 1, 0), material="cloth")
    simulation = Simulation(scene, arch="cpu", precision="f32", spin=False)
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
        f"looked at every {CHECK_INTERVAL:g} s: at most {crossings} edges through triangles, goal 0; the centre of no ball"
        f" nearer than {clearance:.3g} m to the sphere or the floor, goal > 0",
    ]
    simulation.close()
    return report
