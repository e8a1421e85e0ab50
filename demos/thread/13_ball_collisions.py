"""Balls collide: a heavy one breaks a rack of fifteen on an elastic table, and the energy stays."""

import numpy as np

import taichi_sim as ts

row, place = np.tril_indices(5)
rack = np.stack([0.19 * row, 0.215 * (place - row / 2)], axis=1)


def scene():
    scene = ts.Scene(dim=2)
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 5, "size": (1280, 720)}
    scene.add_material("ivory", restitution=1)
    scene.add_balls(rack, radius=0.1, material="ivory")
    scene.add_balls([-1.5, 0.03], velocity=(4, 0), radius=0.15, mass=2, material="ivory")
    for normal, offset in (((0, 1), -1.1), ((0, -1), -1.1), ((1, 0), -2), ((-1, 0), -2)):
        scene.add_wall(normal, offset, "ivory")
    return scene


def check(sim):
    np.testing.assert_allclose(sim.energy().total, 2 * 4**2 / 2, rtol=2e-3)
    assert np.all(np.linalg.norm(sim.velocity, axis=1) > 0)
    assert sim.penetration() < 0.01
