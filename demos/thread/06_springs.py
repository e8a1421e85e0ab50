"""Springs with K = 100 swing ten radians a second, whatever their masses, and never tire: ten periods end at the start."""

import math

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.spring_units import spring_from_rates

STRETCH = 1.5  # of the rest length, at the start


def scene():
    scene = ts.Scene(dim=2)
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 6.283, "size": (1280, 720)}
    for row, mass in enumerate((1, 2, 4, math.inf)):
        pinned = [0] if mass == math.inf else False
        ends = [[0, -0.4 * row], [STRETCH, -0.4 * row]]
        radius = [0.08 * min(mass, 6) ** 0.5, 0.08]
        pair = scene.add_balls(ends, mass=[1 if pinned else mass, 1], radius=radius, pinned=pinned)
        scene.add_springs(pair, rest_length=1.0, **spring_from_rates(100, mass_a=mass))
    return scene


def check(sim):
    length = np.ptp(sim.position[:, 0].reshape(-1, 2), axis=1)
    np.testing.assert_allclose(length, STRETCH, rtol=2e-5)
    np.testing.assert_allclose(sim.energy().total, sim.scene.stiffness.sum() * 0.5**2 / 2, rtol=1e-4)
