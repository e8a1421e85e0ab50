"""A truss of stiff springs holds its shape: it tumbles, lands without a bounce and ends flat on the frictionless floor."""

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.spring_units import spring_from_rates

BAYS = 7


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 4, "size": (1280, 720)}
    flat = 0.4 * np.stack([np.repeat(np.arange(BAYS + 1), 2), np.tile([0, 1], BAYS + 1)], axis=1)
    arm = (flat - flat.mean(axis=0)) @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    velocity = 2.0 * arm[:, ::-1] * [-1, 1]
    balls = scene.add_balls(arm + np.array([0, 2]), velocity=velocity, radius=0.06, body=scene.new_body())
    low, high = balls[::2], balls[1::2]
    rods = [(low[:-1], low[1:]), (high[:-1], high[1:]), (low, high), (low[:-1], high[1:]), (high[:-1], low[1:])]
    scene.add_springs(np.concatenate([np.stack(r, axis=1) for r in rods]), **spring_from_rates(10000, 200))
    for normal, offset in (((0, 1), 0), ((1, 0), -2.5), ((-1, 0), -2.5)):
        scene.add_wall(normal, offset)
    return scene


def check(sim):
    np.testing.assert_allclose(sim.position.mean(axis=0), [0, 0.06 + 0.2], atol=2e-3)  # no force along the floor
    np.testing.assert_allclose(np.sort(sim.position[:, 1])[: BAYS + 1], 0.06, atol=1e-3)
    assert np.abs(sim.frame().strain).max() < 0.005
    np.testing.assert_allclose(sim.velocity, 0, atol=2e-3)
