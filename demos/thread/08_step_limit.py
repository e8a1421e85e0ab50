"""The step limit: steps of 20 ms, one a frame, make stiff springs jump from end to end; at 2 / sqrt(K) they would explode."""

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.spring_units import spring_from_rates

STEP = 0.02  # s
share = np.array([0.05, 0.3, 0.6, 0.98])  # of the largest safe step
rate = (2 * share / STEP) ** 2  # K


def scene():
    scene = ts.Scene(dim=2)
    scene.settings = {"dt": STEP, "contacts": "off"}
    scene.output = {"fps": 50, "duration": 4, "size": (1280, 720)}
    for row, K in enumerate(rate):
        pair = scene.add_balls([[0, -0.3 * row], [1.2, -0.3 * row]], radius=0.08)
        scene.add_springs(pair, rest_length=1.0, **spring_from_rates(K))
    return scene


def check(sim):
    np.testing.assert_allclose(sim.stability().dt_present, STEP / share[-1], rtol=1e-6)
    stretch = np.ptp(sim.position[:, 0].reshape(-1, 2), axis=1) - 1
    speed = np.diff(sim.velocity[:, 0].reshape(-1, 2), axis=1)[:, 0]
    kept = speed**2 + rate * stretch**2 * (1 - share**2)  # what velocity Verlet keeps
    np.testing.assert_allclose(kept, rate * 0.2**2 * (1 - share**2), rtol=1e-3)
