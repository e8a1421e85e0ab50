"""Scenes whose bits are compared between drivers, threads and runs; run as a program it prints their hashes."""

import hashlib
import sys

import numpy as np
from reference_bits import surfaces

import taichi_sim as ts
from taichi_sim.simulation import assembly


def cloth(dim):
    """2100 balls in rows of 20: long enough for the order by blocks. Springs with damping, a corner row pinned."""
    rows, columns = 105, 20
    scene = ts.Scene(dim=dim, gravity=(0.3, -9.81, 0.1)[:dim])
    i, j = np.divmod(np.arange(rows * columns), columns)
    x = np.zeros((rows * columns, dim))
    x[:, 0], x[:, 1] = 0.05 * j, -0.05 * i
    if dim == 3:
        x[:, 2] = 0.01 * np.sin(i + 2.0 * j)
    b = scene.add_balls(x, radius=0.01, mass=1.0 + 0.3 * np.sin(np.arange(len(x))), pinned=list(range(columns)))
    down, right = b[i < rows - 1], b[j < columns - 1]
    pairs = np.concatenate([np.stack([down, down + columns], 1), np.stack([right, right + 1], 1)])
    cross = b[(i < rows - 1) & (j < columns - 1)]
    pairs = np.concatenate([pairs, np.stack([cross, cross + columns + 1], 1)])
    scene.add_springs(pairs, stiffness=2000.0, damping=2.0, rest_length=0.049)
    return scene


def pile(dim):
    """300 balls of two kinds in a box, falling and colliding: walls, contacts, restitution, friction."""
    rng = np.random.default_rng(4)
    scene = ts.Scene(dim=dim, gravity=(0.0, -9.81, 0.0)[:dim])
    scene.add_material("rubber", restitution=0.6, friction=0.4)
    scene.add_material("ice", viscous_friction=5.0)
    side = 1.2 if dim == 2 else 0.6
    for axis in np.eye(dim):
        scene.add_wall(axis, 0.0, "rubber")
    for axis in np.eye(dim)[[0, -1] if dim == 3 else [0]]:
        scene.add_wall(-axis, -side, "rubber")
    low = np.full(dim, 0.05)
    for k, material in enumerate(("rubber", "ice")):
        x = rng.uniform(low, side - 0.05, (150, dim))
        scene.add_balls(
            x, radius=0.03 + 0.01 * k, velocity=rng.normal(size=(150, dim)), mass=1.0 + k, material=material
        )
    return scene


def digest(scene, steps, precision, **settings):
    """SHA-256 of position and velocity after so many steps of 1 ms."""
    with ts.Simulation(scene, dt=1e-3, arch="cpu", precision=precision, **settings) as sim:
        sim.step(steps)
        return hashlib.sha256(sim.position.tobytes() + sim.velocity.tobytes()).hexdigest()


if __name__ == "__main__":
    precision, threads = sys.argv[1], int(sys.argv[2])
    runs = [(cloth(2), 50, "off", ""), (cloth(2), 50, "off", "blocks")]
    runs += [(pile(2), 60, "jacobi", ""), (pile(2), 1000, "gauss_seidel", ""), (surfaces()[0], 300, "auto", "")]
    for scene, steps, contacts, order in runs:
        assembly.FUSED_UP_TO = 0 if order == "blocks" else 20_000  # above it springs go in blocks, below in rows
        settings = {
            "driver": "parallel",
            "accumulate": "ordered",
            "threads": threads,
            "contacts": contacts,
            "contact_iterations": 2,
        }
        print(digest(scene, steps, precision, **settings))
