"""Balls hit elastic sticks in the middle, at a quarter and at the end: each stick answers with the mass it has just there."""

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.spring_units import spring_from_rates

ALONG = np.array([0.5, 0.25, 0.0])  # where on its stick each ball hits


def scene():
    scene = ts.Scene(dim=2)
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 2.5, "size": (1280, 720)}
    scene.add_material("steel", restitution=1)
    left = np.stack([[0, 1.6, 3.2], np.zeros(3)], axis=1)
    scene.add_balls(left + np.stack([ALONG, np.ones(3)], axis=1), velocity=(0, -1), radius=0.1, material="steel")
    ends = scene.add_balls(np.concatenate([left, left + np.array([1, 0])]), radius=0.06, material="steel")
    scene.add_springs(ends.reshape(2, 3).T, collides=True, **spring_from_rates(10000, 200))
    scene.add_wall((0, 1), offset=-1.5)
    return scene


def check(sim):
    np.testing.assert_allclose(sim.velocity[:3], [[0, 1 / 3], [0, 3 / 13], [0, 0]], atol=1e-4)
    np.testing.assert_allclose(sim.momentum(), [0, -3], atol=1e-4)
