"""Restitution 0.5: each bounce reaches a quarter of the height before, here after one to six bounces at the same moment."""

import numpy as np

import taichi_sim as ts

bounces = np.arange(1, 7)
fall = 2.4 / (3 - 3 * 0.5**bounces)  # s until the first bounce; the n-th one is at its highest 2.4 s after the start
height = 5 * fall**2


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 2.4, "size": (1280, 720)}
    scene.add_material("rubber", restitution=0.5)
    scene.add_balls(np.stack([3.0 * bounces, 0.5 + height], axis=1), radius=0.5, material="rubber")
    scene.add_wall((0, 1), material="rubber")
    return scene


def check(sim):
    np.testing.assert_allclose(sim.position[:, 1] - 0.5, 0.25**bounces * height, atol=2e-4)
    np.testing.assert_allclose(sim.velocity, 0, atol=2e-3)
