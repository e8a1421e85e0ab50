"""Elastic walls: all balls bounce at the same rate, since they fall alike, and come back to their first height for ever."""

import numpy as np

import taichi_sim as ts

across = np.linspace(-2, 2, 9)  # m/s
HEIGHT = 1.25  # m of fall: half a second down, half a second up


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 6, "size": (1280, 720)}
    scene.add_material("elastic", restitution=1)
    start = np.stack([across / 2, np.full(9, 0.1 + HEIGHT)], axis=1)
    velocity = np.stack([across, 0 * across], axis=1)
    scene.add_balls(start, velocity=velocity, radius=0.1, material="elastic", body=scene.new_body())
    for normal, offset in (((0, 1), 0), ((1, 0), -1.6), ((-1, 0), -1.6)):
        scene.add_wall(normal, offset, "elastic")
    return scene


def check(sim):
    x, y = sim.position.T
    path = across / 2 + across * 6 + 1.5  # unfolded at the walls, which centres meet at -1.5 and 1.5
    np.testing.assert_allclose(x, 1.5 - np.abs(path % 6 - 3), atol=1e-3)
    np.testing.assert_allclose(y, 0.1 + HEIGHT, atol=1e-3)
