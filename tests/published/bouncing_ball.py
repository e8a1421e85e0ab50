"""Ball that bounces to rest.

A ball dropped from a height h bounces with restitution e infinitely often and rests after sqrt(2 h / g) (1 + e) / (1 -
e) (Bernstein, American Journal of Physics 45, 1977, 41). Its n-th bounce rises to h e^(2 n).
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import history, refined

G, RADIUS, HEIGHT, RESTITUTION = 9.81, 0.05, 0.8, 0.75


def scene():
    """One ball above a floor."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    rubber = scene.add_material("rubber", restitution=RESTITUTION)
    scene.add_balls([[0.0, RADIUS + HEIGHT]], radius=RADIUS, material=rubber)
    scene.add_wall((0, 1), 0.0, rubber)
    return scene


def measure():
    """Heights of the first, fifth and tenth bounce, and the time of rest."""
    for row, sim in refined(scene, 4):
        time, height, speed = history(sim, 3.0, 0, lambda sim: (sim.position[0, 1] - RADIUS, sim.velocity[0, 1]))
        tops = height[1:][(speed[:-1] > 0) & (speed[1:] <= 0)]
        for n in (1, 5, 10):
            name = f"height of bounce {n}"
            yield row(name, "m", HEIGHT * RESTITUTION ** (2 * n), tops[n - 1], 0.01)
        last = time[np.flatnonzero(height > 1e-6)[-1] + 1]
        rest = np.sqrt(2 * HEIGHT / G) * (1 + RESTITUTION) / (1 - RESTITUTION)
        yield row("time of rest", "s", rest, last, 0.01)
