"""Pendulum at large amplitudes.

A ball on a nearly rigid spring swings from rest at an angle of 30 to 170 degrees. Its period is 4 sqrt(L / g)
K(sin(amplitude / 2)), K the complete elliptic integral of the first kind (Lima and Arun, American Journal of Physics
74, 2006, 892). L is the length of the hanging spring.
"""

import numpy as np
from scipy.special import ellipk

import taichi_sim as ts
from tests.published.common import crossings, history, refined

G, LENGTH, STIFFNESS, MASS = 9.81, 0.7, 2e6, 1.3
AMPLITUDES = (30, 90, 150, 170)  # degrees


def scene():
    """Four pendulums side by side."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    for k, amplitude in enumerate(np.radians(AMPLITUDES)):
        pivot = np.array([3.0 * k, 0.0])
        ball = pivot + LENGTH * np.array([np.sin(amplitude), -np.cos(amplitude)])
        pair = scene.add_balls([pivot, ball], radius=0.02, mass=MASS, pinned=[0])
        scene.add_springs([pair], stiffness=STIFFNESS)
    return scene


def measure():
    """Periods, from passages through the lowest point."""
    for row, sim in refined(scene, 4):
        time, x = history(sim, 13.0, 2e-3, lambda sim: (sim.position,))
        x = x[:, 1::2] - x[:, ::2]
        angle = -np.arctan2(x[..., 0], -x[..., 1])
        for k, amplitude in enumerate(AMPLITUDES):
            through = crossings(time, angle[:, k])
            exact = 4 * np.sqrt(LENGTH / G) * ellipk(np.sin(np.radians(amplitude) / 2) ** 2)
            found = (through[-1] - through[0]) / (len(through) - 1)
            yield row(f"period from {amplitude} degrees", "s", exact, found, 1e-3)
