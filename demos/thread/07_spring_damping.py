"""Damping C = 10 ends the vibration along the springs, but not the flight nor the turning."""

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.spring_units import spring_from_rates

spin = np.array([3.0, -2, 5])  # rad/s at the start, at 1.4 m
drift = np.array([0.3, -0.2, -0.3])  # m/s


def scene():
    scene = ts.Scene(dim=2)
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 5, "size": (1280, 720)}
    body = scene.new_body()
    for k in range(3):
        ends = np.array([[-0.7, 0], [0.7, 0]])
        velocity = spin[k] * ends[:, ::-1] * [-1, 1] + [drift[k], 0]
        pair = scene.add_balls(ends + np.array([2.0 * k - 2, 0]), velocity=velocity, radius=0.1, body=body)
        scene.add_springs(pair, rest_length=1.0, **spring_from_rates(100, 10))
    for normal, offset in (((0, 1), -1.6), ((0, -1), -1.6), ((1, 0), -2.9), ((-1, 0), -2.9)):
        scene.add_wall(normal, offset)
    return scene


def check(sim):
    (x0, x1), (v0, v1) = (a.reshape(-1, 2, 2).transpose(1, 0, 2) for a in (sim.position, sim.velocity))
    r, u = x1 - x0, v1 - v0
    length = np.linalg.norm(r, axis=1)
    turn = (r[:, 0] * u[:, 1] - r[:, 1] * u[:, 0]) / length**2
    np.testing.assert_allclose(turn * length**2, spin * 1.4**2, rtol=2e-4)
    np.testing.assert_allclose(length, 1 / (1 - turn**2 / 100), rtol=2e-4)  # the spring holds against the turning
    np.testing.assert_allclose((v0 + v1)[:, 0] / 2, drift, atol=1e-4)
