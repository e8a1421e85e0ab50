"""Billiard ball from sliding to rolling.

A ball that slides with v0 without spin on cloth of friction mu rolls after 2 v0 / (7 mu g), having gone 12 v0^2 / (49
mu g), with 5/7 v0. With backspin w it rolls with 5/7 v0 - 2/7 r w, backward where r w > 5/2 v0 (Coriolis, "Theorie
mathematique des effets du jeu de billard", 1835).
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import history, refined

G, RADIUS, SPEED, MU = 9.81, 0.03, 1.4, 0.2


def scene():
    """A ball on a floor."""
    scene = ts.Scene(dim=3, gravity=(0, -G, 0))
    cloth = scene.add_material("cloth", friction=MU)
    scene.add_balls([[0, RADIUS, 0]], radius=RADIUS, mass=0.2, velocity=[[SPEED, 0, 0]], material=cloth)
    scene.add_wall((0, 1, 0), 0.0, cloth)
    return scene


def measure():
    """Speed of rolling, and when and where it begins."""
    begins = 2 * SPEED / (7 * MU * G)
    for row, sim in refined(scene, 4):
        time, speed, spin = history(sim, 1.5 * begins, 0, lambda sim: (sim.velocity[0, 0], sim.angular_velocity[0, 2]))
        rolling = time[np.flatnonzero(speed + RADIUS * spin < 1e-4)[0]]
        way = 12 * SPEED**2 / (49 * MU * G) + 5 / 7 * SPEED * (sim.time - begins)
        yield row("speed of rolling", "m/s", 5 / 7 * SPEED, sim.velocity[0, 0], 2e-3)
        yield row("time at which it rolls", "s", begins, rolling, 0.01)
        yield row("way, 1.5 of this time", "m", way, sim.position[0, 0], 2e-3)
