"""The same throw with symplectic Euler, which moves with the new velocity: the balls come down g t h / 2 too low."""

import numpy as np

import taichi_sim as ts

across = np.linspace(-4, 4, 9)  # m/s


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings = {"dt": 0.001, "integrator": "symplectic_euler", "contacts": "off"}
    scene.output = {"fps": 60, "duration": 2, "size": (1280, 720)}
    up = np.full(9, 10.0)
    scene.add_balls(np.zeros((9, 2)), velocity=np.stack([across, up], axis=1), radius=0.25)
    marks = np.concatenate([np.stack([across, up / 2], axis=1), np.stack([2 * across, 0 * up], axis=1)])
    scene.add_balls(marks, radius=0.12, pinned=True, colour=(0.7, 0.72, 0.75))
    return scene


def check(sim):
    above = -10 * 2 * 0.001 / 2
    np.testing.assert_allclose(sim.position[:9], np.stack([2 * across, 0 * across + above], axis=1), atol=6e-4)
    np.testing.assert_allclose(sim.velocity[:9, 1], -10, rtol=1e-4)
