"""Bounce of a spinning ball (superball, rigid limit).

A sphere hits a floor with the speeds v down and u along, and the spin w. The surface point has u + r w. It sticks where
|u + r w| < 7/2 mu (1 + e) v, which takes 2/7 of u + r w from u. Else friction takes mu (1 + e) v (Garwin, American
Journal of Physics 37, 1969, 88; Foerster et al., Physics of Fluids 6, 1994, 1108, with no tangential restitution). The
spin changes by 5/(2 r) of what u does.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import refined

RADIUS, DOWN, E, MU = 0.1, 2.0, 0.7, 0.15
ALONG = np.array([0.2, 1.0, 1.7, 1.9, 3.0, 6.0])  # m/s; 7/2 mu (1 + e) v is 1.785


def scene():
    """Balls of different speeds along the floor, side by side."""
    scene = ts.Scene(dim=3)
    rubber = scene.add_material("rubber", restitution=E, friction=MU)
    x = np.stack([np.zeros(6), np.full(6, 0.4), np.arange(6)], axis=1)
    v = np.stack([ALONG, np.full(6, -DOWN), np.zeros(6)], axis=1)
    scene.add_balls(x, radius=RADIUS, mass=0.3, velocity=v, material=rubber)
    scene.add_wall((0, 1, 0), 0.0, rubber)
    return scene


def measure():
    """Speeds and spins after the bounce."""
    change = -np.sign(ALONG) * np.minimum(2 / 7 * np.abs(ALONG), MU * (1 + E) * DOWN)
    for row, sim in refined(scene):
        sim.run(0.5)
        v, w = sim.velocity, sim.angular_velocity
        for k, along in enumerate(ALONG):
            yield row(f"speed along, before {along:g} m/s", "m/s", along + change[k], v[k, 0], 1e-4)
            yield row(f"spin, before {along:g} m/s", "1/s", 2.5 * change[k] / RADIUS, w[k, 2], 1e-4)
        yield row("speed up", "m/s", E * DOWN, v[:, 1].mean(), 1e-4)
