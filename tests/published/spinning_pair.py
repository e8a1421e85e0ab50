"""Spinning pair on a spring.

Two balls of masses m1 and m2 turn about their centre with angular velocity W. Their spring stretches to L / (1 - m W^2
/ k), m the reduced mass. A slightly wider start makes their distance breathe with sqrt(k / m + 3 W^2) (small
oscillations about a circular orbit, Goldstein, "Classical Mechanics", chapter 3).
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import crossings, history, refined

M1, M2, STIFFNESS, REST, RATE = 0.4, 1.6, 40.0, 0.5, 5.0
REDUCED = M1 * M2 / (M1 + M2)
LENGTH = REST / (1 - REDUCED * RATE**2 / STIFFNESS)


def scene():
    """A pair on its circle, and one with the same angular momentum that starts 1 % wider."""
    scene = ts.Scene(dim=2)
    for k, wider in enumerate((1.0, 1.01)):
        at = np.array([-M2, M1]) / (M1 + M2) * LENGTH * wider
        x = np.stack([at, np.full(2, 3.0 * k)], axis=1)
        v = np.stack([np.zeros(2), at * RATE / wider**2], axis=1)
        pair = scene.add_balls(x, radius=0.02, mass=[M1, M2], velocity=v)
        scene.add_springs([pair], stiffness=STIFFNESS, rest_length=REST)
    return scene


def measure():
    """Length of the first pair and frequency of the second over 10 s."""
    for row, sim in refined(scene, 4):
        time, x = history(sim, 10.0, 2e-3, lambda sim: (sim.position,))
        length = np.linalg.norm(x[:, 1::2] - x[:, ::2], axis=2)
        through = crossings(time, length[:, 1] - length[:, 1].mean())
        frequency = 2 * np.pi * (len(through) - 1) / (through[-1] - through[0])
        yield row("length", "m", LENGTH, length[:, 0].mean(), 1e-3)
        yield row("breathing frequency", "1/s", np.sqrt(STIFFNESS / REDUCED + 3 * RATE**2), frequency, 1e-3)
