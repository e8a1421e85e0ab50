"""Chain of elastic collisions.

A heavy ball strikes a row of balls, each lighter than the one before. Each central elastic impact hands on 2 m_i / (m_i
+ m_(i+1)) of the speed (Huygens, "De motu corporum ex percussione", 1656; Kerwin, American Journal of Physics 40, 1972,
1152). With masses in a geometric row the last ball is faster the more balls there are. Seven balls of masses 64 to 1;
with equal masses the row is Newton's cradle.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import refined

COUNT, SPEED, RADIUS, GAP = 7, 1.7, 0.05, 0.02
MASSES = {"64 to 1": 2.0 ** np.arange(COUNT - 1, -1, -1), "equal": np.ones(COUNT)}


def scene():
    """A row of falling masses and one of equal masses, the first ball of each in motion."""
    scene = ts.Scene(dim=2)
    steel = scene.add_material("steel", restitution=1.0)
    for k, mass in enumerate(MASSES.values()):
        x = np.stack([(2 * RADIUS + GAP) * np.arange(COUNT), np.full(COUNT, k)], axis=1)
        v = np.zeros((COUNT, 2))
        v[0, 0] = SPEED
        scene.add_balls(x, radius=RADIUS, mass=mass, velocity=v, material=steel)
    return scene


def measure():
    """Speed of the last ball, and energy."""
    for row, sim in refined(scene, 4):
        energy = sim.energy().total
        sim.run(0.5)
        speed = sim.velocity[:, 0].reshape(len(MASSES), COUNT)
        for k, (name, mass) in enumerate(MASSES.items()):
            exact = SPEED * np.prod(2 * mass[:-1] / (mass[:-1] + mass[1:]))
            yield row(f"speed of the last ball, masses {name}", "m/s", exact, speed[k, -1], 1e-4)
        yield row("energy", "J", energy, sim.energy().total, 1e-4)
