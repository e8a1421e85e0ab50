"""A two-dimensional gas of hard discs in a box, for the tests of statistical mechanics."""

import numpy as np

import taichi_sim as ts

COUNT, SPEED = 400, 0.5  # m/s, of each component
SEEDS = (1, 2)


def box(filled: float, seed: int, restitution: float = 1.0, speed: float = SPEED) -> tuple[ts.Scene, float]:
    """Discs of 1 kg that fill a share of the unit square, with Gaussian velocities of mean 0; the scene and their radius [m]."""
    rng, side = np.random.default_rng(seed), round(COUNT**0.5)
    radius = np.sqrt(filled / (COUNT * np.pi))
    gap = 1 / side - 2 * radius
    x = (np.stack(np.unravel_index(np.arange(COUNT), (side, side)), axis=1) + 0.5) / side
    v = rng.normal(size=(COUNT, 2))
    v -= v.mean(axis=0)
    v *= speed * np.sqrt(2 * COUNT / np.sum(v**2))
    scene = ts.Scene(dim=2)
    ideal, disc = scene.add_material("ideal", restitution=1.0), scene.add_material("disc", restitution=restitution)
    scene.add_balls(x + rng.uniform(-0.4, 0.4, x.shape) * gap, radius=radius, velocity=v, material=disc)
    for k, normal in enumerate(np.eye(2)):
        scene.add_wall(normal, 0.0, ideal)
        scene.add_wall(-normal, -1.0, ideal)
        scene.add_probe(f"p{2 * k}", "impulse", wall=2 * k)
        scene.add_probe(f"p{2 * k + 1}", "impulse", wall=2 * k + 1)
    return scene, radius
