"""A throw by symplectic Euler: it moves with the new velocity, and the balls end g t h / 2 below Verlet, in grey."""

from importlib import import_module

import numpy as np

before = import_module("taichi_sim.demos.thread.02_explicit_euler")


def scene(dt=0.05):
    return before.scene(dt, "symplectic_euler")


def check(sim):
    below = before.G * before.DURATION * sim.dt / 2
    np.testing.assert_allclose(sim.position[:9, 1], -below, atol=6e-4)
    np.testing.assert_allclose(sim.position[9:18], sim.position[18:], atol=1e-5)
    np.testing.assert_allclose(sim.velocity[:9, 1], -before.UP, rtol=1e-4)
