"""Scenes large enough for every order of sums."""

import numpy as np

import taichi_sim as ts


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
