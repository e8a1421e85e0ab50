"""Breathing bubble.

A bubble whose gas keeps p V constant and whose skin has the mass M breathes about a radius R, where inside and outside
pressure P are equal. Its frequency is sqrt(3 P A / (M R)) for small amplitudes, A = dV/dR (Minnaert 1933 with the
exponent 1). An octahedron of gas keeps its shape; at an amplitude of a fifth its radius follows M R'' = (P V0 / V - P)
dV/dR, integrated by SciPy with a tolerance of 1e-12.
"""

import numpy as np
from scipy.integrate import solve_ivp

import taichi_sim as ts
from tests.published.common import crossings, history, refined

RADIUS, PRESSURE, MASS, NARROWER, END = 0.3, 50.0, 0.4, 0.8, 2.0


def scene():
    """Six balls on the axes, at their narrowest."""
    scene = ts.Scene(dim=3)
    x = RADIUS * np.concatenate([np.eye(3), -np.eye(3)])
    balls = scene.add_balls(x * NARROWER, radius=0.01, mass=MASS / 6)
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    scene.add_gas(balls[np.array(faces)], pressure=PRESSURE / NARROWER**3 - PRESSURE, outside=PRESSURE)
    return scene


def reference(time):
    """Radius (n,) of a bubble that starts narrow."""

    def rate(_, y):
        volume = (y[0] / RADIUS) ** 3
        return [y[1], (PRESSURE / volume - PRESSURE) * 4 * y[0] ** 2 / MASS]

    return solve_ivp(
        rate, (0, time[-1]), [NARROWER * RADIUS, 0], method="DOP853", t_eval=time, rtol=1e-12, atol=1e-12
    ).y[0]


def measure():
    """Largest radius and period over 2 s."""
    for row, sim in refined(scene, 4):
        time, radius = history(sim, END, 2e-3, lambda sim: (np.linalg.norm(sim.position, axis=1).mean(),))
        exact = reference(time)
        periods = [np.diff(crossings(time, r - RADIUS)).mean() for r in (exact, radius)]
        yield row("largest radius", "m", exact.max(), radius.max(), 2e-3)
        yield row("period", "s", *periods, 2e-3)
