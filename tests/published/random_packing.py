"""Random packing of discs.

Discs of two sizes, 1 and 1.4, equal in number and without friction, jam at the share 0.841 of the area (O'Hern,
Silbert, Liu and Nagel, Physical Review E 68, 2003, 011306). Dropped into a box they settle to it, apart from the walls;
the share is that of the middle of the heap, from the area of discs cut by the window's border. Mean over four starts.
"""

import numpy as np
from scipy.spatial import cKDTree

import taichi_sim as ts
from tests.published.common import DEFAULTS, Row

CHAOTIC = True

G, RADIUS, COLUMNS, ROWS = 9.81, 0.01, 24, 24
WIDTH = COLUMNS * 2.2 * 1.4 * RADIUS


def scene(seed):
    """Discs of both sizes at random places of a lattice above a floor."""
    rng = np.random.default_rng(seed)
    scene = ts.Scene(dim=2, gravity=(0, -G))
    smooth = scene.add_material("smooth", restitution=0.2)
    x = np.stack(np.unravel_index(np.arange(COLUMNS * ROWS), (COLUMNS, ROWS)), axis=1) + 0.5
    x = x * 2.2 * 1.4 * RADIUS + rng.uniform(-0.05, 0.05, x.shape) * RADIUS
    radius = RADIUS * rng.permutation(np.where(np.arange(len(x)) % 2, 1.0, 1.4))
    scene.add_balls(x, radius=radius, mass=(radius / RADIUS) ** 2 * 0.01, material=smooth)
    scene.add_wall((0, 1), 0.0, smooth)
    scene.add_wall((1, 0), 0.0, smooth)
    scene.add_wall((-1, 0), -WIDTH, smooth)
    return scene


def share(x, radius, low, high):
    """Part of a window covered by discs, on a grid of points a twentieth of a radius apart."""
    axes = [np.arange(a, b, RADIUS / 20) for a, b in zip(low, high)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    covered = np.zeros(len(points), bool)
    for size in np.unique(radius):
        covered |= cKDTree(x[radius == size]).query(points, distance_upper_bound=size)[0] < size
    return covered.mean()


def measure():
    """Share of the area that discs cover in the middle, and the largest overlap."""
    shares, overlaps = [], []
    for seed in range(4):
        with ts.Simulation(scene(seed)) as sim:
            sim.run(2.5)
            x = sim.position
            top = np.quantile(x[:, 1], 0.97)
            low, high = (0.15 * WIDTH, 0.15 * top), (0.85 * WIDTH, 0.8 * top)
            shares.append(share(x, sim.scene.radius, low, high))
            overlaps.append(sim.penetration() / RADIUS)
    return [
        Row("share of the area", "", 0.841, np.mean(shares), 0.02, settings=DEFAULTS),
        Row("largest overlap, in radii", "", 0.0, np.max(overlaps), 0.05, scale=1.0, settings=DEFAULTS),
    ]
