"""Plate that falls in air.

A flat plate of mass m and area A falls face down in still air of density rho. Its speed is v tanh(g t / v) with v =
sqrt(2 m g / (rho A C)), C the drag coefficient (quadratic drag; Timmerman and van der Weele, American Journal of
Physics 67, 1999, 538). The plate is a hexagon of six triangles whose masses are shared as the drag is, so that it stays
flat.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import refined

G, MASS, SIDE, DENSITY, DRAG = 9.81, 0.12, 0.4, 1.2, 1.17
AREA = 1.5 * np.sqrt(3) * SIDE**2
TERMINAL = np.sqrt(2 * MASS * G / (DENSITY * AREA * DRAG))


def scene():
    """A hexagon in still air."""
    scene = ts.Scene(dim=3, gravity=(0, -G, 0))
    angle = np.pi / 3 * np.arange(6)
    rim = SIDE * np.stack([np.cos(angle), np.zeros(6), np.sin(angle)], axis=1)
    ball = scene.add_balls([[0, 0, 0], *rim], radius=0.01, mass=MASS * np.array([1 / 3, *[1 / 9] * 6]))
    outer, following = ball[1:], np.roll(ball[1:], -1)
    scene.add_springs([*np.stack([outer, following], 1), *[(ball[0], b) for b in outer]], stiffness=500.0, damping=0.5)
    scene.add_triangles(np.stack([np.full(6, ball[0]), following, outer], axis=1))
    scene.add_wind((0, 0, 0), density=DENSITY, drag=DRAG)
    return scene


def measure():
    """Speed of fall after a quarter, one and five of the times v / g."""
    for row, sim in refined(scene, 4):
        for name, part in (("v / (4 g)", 0.25), ("v / g", 1.0), ("5 v / g", 5.0)):
            sim.run(part * TERMINAL / G - sim.time)
            exact = TERMINAL * np.tanh(G * sim.time / TERMINAL)
            found = -sim.momentum()[1] / MASS
            yield row(f"speed after {name}", "m/s", exact, found, 2e-3)
