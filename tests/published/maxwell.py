"""Maxwell's distribution of speeds.

Elastic discs that all start with the same speed reach Maxwell's distribution by collisions: <v^4> / <v^2>^2 = 2 and a
mean of v of sqrt(pi k T / (2 m)) in two dimensions (Maxwell 1860). Mean over two starts and 100 moments between 2 and
12 s; energy stays.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import Row
from tests.published.gas import COUNT, SEEDS, SPEED, box

CHAOTIC = True


def measure():
    """Moments of the speed, and the energy."""
    fourth, mean, energy = [], [], []
    for seed in SEEDS:
        scene, _ = box(0.2, seed)
        scene.set_balls(velocity=np.sqrt(2) * SPEED * scene.velocity / np.linalg.norm(scene.velocity, axis=1)[:, None])
        with ts.Simulation(scene) as sim:
            sim.run(2.0)
            for _ in range(100):
                sim.run(0.1)
                speed = np.linalg.norm(sim.velocity, axis=1)
                fourth.append(np.mean(speed**4) / np.mean(speed**2) ** 2)
                mean.append(np.mean(speed) / np.sqrt(np.mean(speed**2)))
            energy.append(sim.energy().total / (COUNT * SPEED**2))
    return [
        Row("<v^4> / <v^2>^2", "", 2.0, np.mean(fourth), 0.03),
        Row("mean of v / sqrt(<v^2>)", "", np.sqrt(np.pi / 4), np.mean(mean), 0.01),
        Row("energy, in that of the start", "", 1.0, np.mean(energy), 2e-3),
    ]
