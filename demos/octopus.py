"""An octopus of 33 000 bricks hangs by its head and lets its arms fall, in steps as long as a frame."""

import numpy as np

import taichi_sim as ts
from taichi_sim.geometry.level_set import level_set

ARMS, REACH, SPACING, HEIGHT = 8, 0.85, 0.0125, 0.75  # m
HEAD, THICK, THIN = 0.2, 0.05, 0.022  # m, radii: of the head, of an arm at its root and at its end
MELTED = 0.02  # m, over which they flow into each other


def body(p):
    """Negative inside: a head, and arms that lie in the plane below it and rise towards their ends."""
    flat, turn, part = np.hypot(p[..., 0], p[..., 2]), np.arctan2(p[..., 2], p[..., 0]), 2 * np.pi / ARMS
    aside, along = flat * np.sin((turn + part / 2) % part - part / 2), np.minimum(flat, REACH)
    rise = 0.13 * np.maximum(0.0, (along - 0.5) / (REACH - 0.5)) ** 2
    middle = np.stack([aside, p[..., 1] - rise, flat - along])
    arm = np.linalg.norm(middle, axis=0) - THICK - (THIN - THICK) * along / REACH
    head = HEAD * (np.hypot(flat / HEAD, (p[..., 1] - 0.2) / (1.25 * HEAD)) - 1.0)
    return -MELTED * np.log(np.exp(-arm / MELTED) + np.exp(-head / MELTED))


def scene(spacing=SPACING, young_modulus=1e6, poisson_ratio=0.45, dt=1 / 60):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.settings = {"integrator": "implicit_euler", "dt": dt}
    scene.output = {"fps": 60, "duration": 3, "size": (1280, 720)}
    octopus = ts.shapes.jelly(
        scene,
        mesh=level_set(body, (-0.99, -0.12, -0.98), (1.0, 0.52, 1.01), 0.0137),
        spacing=spacing,
        density=1100,
        young_modulus=young_modulus,
        poisson_ratio=poisson_ratio,
        position=(0, HEIGHT, 0),
        colour=(0.86, 0.33, 0.25),
    )
    height = scene.position[octopus.balls, 1]
    scene.set_balls(octopus.balls[height > height.max() - 0.06], pinned=True)
    scene.add_wall((0, 1, 0))
    return scene


def check(sim):
    x, start = sim.position, sim.scene.position
    free = ~sim.scene.pinned
    assert sim.inverted() == 0
    assert sim.energy().total < 10 * np.sum(sim.scene.mass[free] * start[free, 1])  # none came from nowhere
    tips = np.hypot(start[:, 0], start[:, 2]) > 0.95 * REACH
    assert x[tips, 1].mean() < start[tips, 1].mean() - 0.05  # they have not come up as high again
    assert x[:, 1].min() > 0.05
    root = np.argmin(np.linalg.norm(start, axis=1))  # the lowest in the middle
    long = np.linalg.norm(x[tips] - x[root], axis=1) / np.linalg.norm(start[tips] - start[root], axis=1)
    assert np.all((long > 0.7) & (long < 1.1))
