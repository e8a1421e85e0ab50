"""Slow references for the damping of networks."""

import numpy as np
from reference import Array, Network, acceleration


def run_weakly_split(net: Network, x: Array, v: Array, h: float, steps: int) -> tuple[Array, Array]:
    """Verlet as the program runs it where the damping of a network is moderate: each half takes the damping at its beginning, and
    the one before a drift adds by how much that has changed since the one after the last drift began."""
    x, v = np.array(x, dtype=np.float64), np.array(v, dtype=np.float64)

    def damping(x: Array, v: Array) -> Array:
        return acceleration(net, x, v) - acceleration(net, x, v, damping=False)

    last = damping(x, v)
    for _ in range(steps):
        now = damping(x, v)
        v = v + h / 2 * (acceleration(net, x, v, damping=False) + 2 * now - last)
        x = x + h * v
        last = damping(x, v)
        v = v + h / 2 * acceleration(net, x, v)
    return x, v


def legendre_left(s: int, z: Array) -> Array:
    """R of the Runge-Kutta-Legendre method of order 2 with s > 2 stages: a + b P_s(1 - 4 z / (s^2 + s - 2))."""
    b = (s * s + s - 2.0) / (2.0 * s * (s + 1.0))
    series = np.polynomial.legendre.Legendre.basis(s)
    return 1.0 - b + b * series(1.0 - 4.0 * z / (s * s + s - 2.0))
