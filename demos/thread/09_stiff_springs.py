"""Stiff springs, K = 10000 and C = 200, are rods: thrown into a corner they land, slide and lie still at their length."""

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.spring_units import spring_from_rates


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 4, "size": (1280, 720)}
    scene.add_material("floor", restitution=0.5)
    body = scene.new_body()
    for k, spin in enumerate((3, -4, 6)):
        angle = np.radians(35 + 50 * k)
        half = 0.5 * np.array([np.cos(angle), np.sin(angle)])
        turn = spin * np.array([-half[1], half[0]])
        velocity = np.stack([1 - turn, 1 + turn])
        pair = scene.add_balls(
            np.stack([-half, half]) + np.array([1.3 * k, 1.5]), velocity=velocity, radius=0.08, body=body
        )
        scene.add_springs(pair, **spring_from_rates(10000, 200))
    for normal, offset in (((0, 1), 0), ((1, 0), -0.8), ((-1, 0), -4)):
        scene.add_wall(normal, offset, "floor")
    return scene


def check(sim):
    ends = sim.position.reshape(-1, 2, 2)
    np.testing.assert_allclose(ends[:, :, 1], 0.08, atol=1e-3)
    np.testing.assert_allclose(np.ptp(ends[:, :, 0], axis=1), 1, atol=1e-3)
    np.testing.assert_allclose(sim.velocity[:, 1], 0, atol=1e-3)
