"""A wheel turns for ever about its one pinned ball, a little wider than at rest because its springs carry the turning."""

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.spring_units import spring_from_rates

SPOKES, RADIUS, SPIN = 16, 1.0, 8.0  # SPIN in rad/s
rod = spring_from_rates(10000, 200)


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 5, "size": (720, 720)}
    shape = {"stiffness": rod["stiffness"], "damping": rod["damping"], "mass": SPOKES + 1, "ball_radius": 0.07}
    wheel = ts.shapes.wheel(scene, (0, 0), RADIUS, SPOKES, pinned=[0], **shape)
    scene.set_balls(wheel.balls, velocity=SPIN * scene.position[wheel.balls][:, ::-1] * [-1, 1])
    return scene


def check(sim):
    arm, angular = np.linalg.norm(sim.position[1:], axis=1), sim.angular_momentum()
    np.testing.assert_allclose(angular, SPOKES * SPIN * RADIUS**2, rtol=0.02)  # gravity flexes it, damping takes 1 %
    spin = angular / np.sum(arm**2)
    pull = rod["stiffness"] * (1 + 4 * np.sin(np.pi / SPOKES) ** 2)  # of one spoke and two rim springs, N/m
    np.testing.assert_allclose(arm.mean(), RADIUS / (1 - spin**2 / pull), rtol=1e-4)
