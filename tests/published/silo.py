"""Silo (Janssen's law).

Walls with friction carry part of a filling once it slides down along them. The floor carries W (l / h) (1 - exp(-h /
l)) of the weight W at a height h (Janssen 1895; Vanel and Clement, European Physical Journal B 11, 1999, 525). The slow
sinking sets the direction of friction. The length l is fitted to three heights; the law is their shape. The floor sinks
at 10 mm/s; mean over three fillings.
"""

import numpy as np
from scipy.optimize import least_squares

import taichi_sim as ts
from tests.published.common import Row

CHAOTIC = True

G, RADIUS, COLUMNS, FRICTION = 9.81, 0.01, 10, 0.5
WIDTH = COLUMNS * 2.2 * RADIUS
LAYERS, SEEDS = (12, 30, 60), (3, 4, 5)


def scene(layers, seed):
    """Discs between two walls, above a floor that waits and then sinks."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    grain = scene.add_material("grain", restitution=0.2, friction=FRICTION)
    start = (-WIDTH / 2 + 1.1 * RADIUS, 1.1 * RADIUS)
    ts.shapes.pile(
        scene,
        (COLUMNS, layers),
        RADIUS,
        smallest_radius=0.8 * RADIUS,
        mass=0.1,
        material=grain,
        position=start,
        seed=seed,
    )
    scene.add_wall((1, 0), -WIDTH / 2, grain)
    scene.add_wall((-1, 0), -WIDTH / 2, grain)
    settled = 1.2 + 0.01 * layers
    path = [(0.0, (0, 0)), (settled, (0, 0)), (settled + 1.2, (0, -0.012))]
    scene.add_collider(ts.Box((0, -0.5), (3 * WIDTH, 1.0), material=grain, path=path))
    scene.add_probe("floor", "force", collider=0)
    return scene, settled


def measure():
    """Floor's force over the weight at three heights, beside the law with one fitted length."""
    heights, parts = [], []
    for layers in LAYERS:
        height, part = [], []
        for seed in SEEDS:
            made, settled = scene(layers, seed)
            with ts.Simulation(made) as sim:
                sim.run(settled + 0.6)
                sim.probes()
                sim.run(0.6)
                part.append(-sim.probes()["floor.y"] / (made.mass.sum() * G))
                height.append(sim.position[:, 1].max() + 0.012)
        heights.append(np.mean(height) / WIDTH)
        parts.append(np.mean(part))

    def law(length):
        h = np.array(heights) / length
        return (1 - np.exp(-h)) / h

    length = least_squares(lambda length: law(length) - parts, [1.0]).x[0]
    return [
        Row(f"floor's part of the weight, height {h:.1f} widths", "", exact, found, 0.05, scale=1.0)
        for h, exact, found in zip(heights, law(length), parts)
    ]
