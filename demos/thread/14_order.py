"""Impulses are summed from old values and applied together: a struck rack opens evenly, though numbered from left to right."""

import numpy as np

import taichi_sim as ts

row, place = np.tril_indices(6)
rack = np.stack([0.205 * (place - row / 2), 0.178 * row], axis=1)
rack = rack[np.lexsort(rack.T[::-1])]  # by x, then y
mirror = np.lexsort((rack[:, 1], -rack[:, 0].round(6)))


def scene():
    scene = ts.Scene(dim=2)
    scene.settings = {"dt": 0.001, "contacts": "jacobi"}
    scene.output = {"fps": 60, "duration": 1.5, "size": (1280, 720)}
    scene.add_material("clay", restitution=0.5)
    scene.add_balls(rack, radius=0.1, material="clay")
    scene.add_balls([0, -1], velocity=(0, 4), mass=4, radius=0.2, material="clay")
    for normal, offset in (((0, 1), -1.3), ((0, -1), -2.5), ((1, 0), -2.5), ((-1, 0), -2.5)):
        scene.add_wall(normal, offset, "clay")
    return scene


def check(sim):
    np.testing.assert_allclose(sim.position[:-1] * [-1, 1], sim.position[mirror], atol=1e-3)
    np.testing.assert_allclose(sim.position[-1, 0], 0, atol=1e-3)
