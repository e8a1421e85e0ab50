"""Small steps in single precision: xpbd takes velocities as variables, not from differences of positions, and loses nothing."""

import numpy as np
import pytest
from physics_support import PRECISION, simulate

import taichi_sim as ts

SIDE, T = 16, 0.5


def hanging_cloth():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    ts.shapes.cloth(
        scene, size=(1, 1), resolution=(SIDE, SIDE), mass=1.0, stiffness=1e3, damping=0.05, pinned=range(SIDE)
    )
    return scene


def converged(scene, steps):
    """Positions (n, 3) at T, in double precision by RK4 in NumPy."""
    i, j = scene.pairs.T
    ends, w = np.concatenate([i, j]), np.where(scene.pinned, 0.0, 1.0 / scene.mass)

    def rate(x, v):
        r, u = x[j] - x[i], v[j] - v[i]
        d = np.sqrt(np.sum(r * r, axis=1))
        pull = scene.stiffness * (d - scene.rest_length) + scene.damping * np.sum(u * r, axis=1) / d
        force = (pull / d)[:, None] * r
        both = np.concatenate([force, -force])
        total = np.stack([np.bincount(ends, both[:, a], len(x)) for a in range(3)], axis=1)
        return w[:, None] * total + scene.gravity * (w > 0)[:, None]

    x, v, h = scene.position.copy(), scene.velocity.copy(), T / steps
    for _ in range(steps):
        a1 = rate(x, v)
        v2 = v + h / 2 * a1
        a2 = rate(x + h / 2 * v, v2)
        v3 = v + h / 2 * a2
        a3 = rate(x + h / 2 * v2, v3)
        v4 = v + h * a3
        a4 = rate(x + h * v3, v4)
        x, v = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return x


@pytest.mark.slow
def test_ten_times_smaller_steps_are_ten_times_better():
    """A cloth of 1378 springs, half a second in 300, 3000 and 30 000 steps: order 1 down to the smallest."""
    scene = hanging_cloth()
    assert scene.n_springs == 1378
    exact, error = converged(scene, 4000), []
    for n in (300, 3000, 30_000):
        with simulate(scene, integrator="xpbd", dt=T / n, contacts="off") as sim:
            sim.step(n)
            error.append(float(np.sqrt(np.mean((sim.position - exact) ** 2))))
    print(f"xpbd, {PRECISION}: RMS error {error} m")
    assert error[2] < 1e-4
    assert error[2] < 0.12 * error[1]
    assert error[1] < 0.12 * error[0]
