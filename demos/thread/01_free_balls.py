"""Balls without any force fly straight on, through one another, and meet again as a circle."""

import numpy as np

import taichi_sim as ts

TURN = np.radians(130)  # each ball flies along a chord of the unit circle, this far round it
angle = 2 * np.pi * np.arange(36) / 36


def circle(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def scene():
    scene = ts.Scene(dim=2)
    scene.settings = {"dt": 0.001, "contacts": "off"}
    scene.output = {"fps": 60, "duration": 3, "size": (720, 720)}
    scene.add_balls(circle(angle), velocity=(circle(angle + TURN) - circle(angle)) / 3, radius=0.03)
    return scene


def check(sim):
    np.testing.assert_allclose(sim.position, circle(angle + TURN), atol=1e-4)
