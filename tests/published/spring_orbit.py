"""Orbit on a spring.

A ball circles a pinned one on a spring with a rest length. Its distance swings between two turning points r1 and r2 and
its orbit precesses. The angle from one farthest point to the next is 2 times the integral of L / (r^2 p) dr from r1 to
r2, where p is the radial momentum (Landau and Lifshitz, "Mechanics", section 14). SciPy's quad gives the reference.
"""

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

import taichi_sim as ts
from tests.published.common import crossings, history, refined

MASS, REST, STIFFNESS = 0.5, 0.4, 20.0
FAR, SPEED = 1.0, 1.5  # m, m/s at the farthest point, across


def scene():
    """One ball on a spring, at its farthest point."""
    scene = ts.Scene(dim=2)
    pair = scene.add_balls([[0, 0], [FAR, 0]], radius=0.01, mass=MASS, velocity=[[0, 0], [0, SPEED]], pinned=[0])
    scene.add_springs([pair], stiffness=STIFFNESS, rest_length=REST)
    return scene


def reference():
    """Nearest distance [m], angle [rad] and time [s] from one farthest point to the next."""
    momentum, energy = MASS * FAR * SPEED, MASS * SPEED**2 / 2 + STIFFNESS * (FAR - REST) ** 2 / 2

    def squared(r):  # of the radial speed
        return 2 / MASS * (energy - STIFFNESS * (r - REST) ** 2 / 2) - (momentum / (MASS * r)) ** 2

    near = brentq(squared, 0.05, 0.95 * FAR)
    middle, half = (FAR + near) / 2, (FAR - near) / 2

    def over(weight):  # integral of weight / radial speed, the ends' roots taken out by r = middle - half cos u
        def at(u):
            r = middle - half * np.cos(u)
            return weight(r) * half * np.sin(u) / np.sqrt(squared(r))

        return 2 * quad(at, 1e-6, np.pi - 1e-6)[0]

    return near, over(lambda r: momentum / (MASS * r * r)), over(lambda r: 1.0)


def measure():
    """Nearest distance, apsidal angle and period, the mean over the orbits of 20 s."""
    near, angle, period = reference()
    for row, sim in refined(scene, 4):
        time, x, v = history(sim, 20.0, 2e-3, lambda sim: (sim.position[1], sim.velocity[1]))
        times = crossings(time, np.sum(x * v, axis=1), rising=False)
        angles = np.interp(times, time, np.unwrap(np.arctan2(x[:, 1], x[:, 0])))
        yield row("nearest distance", "m", near, np.linalg.norm(x, axis=1).min(), 1e-3)
        yield row("period", "s", period, np.diff(times).mean(), 1e-3)
        yield row("apsidal angle", "rad", angle, np.diff(angles).mean(), 1e-3)
