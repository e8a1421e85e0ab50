"""Rope around a capstan.

Two weights hang on a light rope over a fixed round bar. Without friction they move with (m1 - m2) / (m1 + m2) g (Atwood
1784). With friction the pulls differ by the factor e^(mu pi) while the rope slides (Euler 1769, Eytelwein 1808). So
they move with (m1 - m2 e^(mu pi)) / (m1 + m2 e^(mu pi)) g, and stay where m1 < m2 e^(mu pi).
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import refined

G, BAR, MU, HEAVY, LIGHT = 9.81, 0.25, 0.2, 2.0, 0.8
COUNT, RADIUS, STIFFNESS, LENGTH = 81, 0.004, 4e4, 2.4  # balls of the rope, m, N/m, m


def acceleration(friction, light):
    """Downward acceleration of the heavy weight [m/s^2]."""
    pull = np.exp(friction * np.pi)
    return max(0.0, (HEAVY - light * pull) / (HEAVY + light * pull) * G)


def scene(friction, light):
    """A rope over a disc with a weight at each end, stretched by the pulls of the reference."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    material = scene.add_material("rope", friction=friction)
    reach, piece = BAR + RADIUS, LENGTH / (COUNT - 1)
    way = piece * np.arange(COUNT) - 0.5  # along the rope from where it touches the bar
    turn = np.clip(way / reach, 0, np.pi)
    x = np.stack([-reach * np.cos(turn), reach * np.sin(turn)], axis=1)
    x[:, 1] += np.where(way < 0, way, 0) - np.where(way > np.pi * reach, way - np.pi * reach, 0)
    mass = np.full(COUNT, 1e-4)
    mass[0], mass[-1] = HEAVY, light
    rope = scene.add_balls(x, radius=RADIUS, mass=mass, material=material, body=scene.new_body())
    a = acceleration(friction, light)
    ends = HEAVY * (G - a), light * (G + a)
    tension = ends[0] * (ends[1] / ends[0]) ** (0.5 * (turn[:-1] + turn[1:]) / np.pi)
    length = np.linalg.norm(np.diff(x, axis=0), axis=1) / (1 + tension / (STIFFNESS * piece))
    scene.add_springs(np.stack([rope[:-1], rope[1:]], 1), stiffness=STIFFNESS, damping=0.5, rest_length=length)
    scene.add_collider(ts.Sphere((0, 0), BAR, material=material))
    return scene


def measure():
    """Acceleration, the mean of both weights' over 0.3 s."""
    for name, friction, light in (("smooth", 0.0, LIGHT), ("rough", MU, LIGHT), ("held", MU, 1.2)):
        wanted = acceleration(friction, light)
        for row, sim in refined(lambda friction=friction, light=light: scene(friction, light), 4):
            sim.run(0.3)
            found = np.mean(sim.velocity[[0, -1], 1] / 0.3 * [-1, 1])
            yield row(f"acceleration, {name}", "m/s^2", wanted, found, 0.02, scale=wanted or G)
