"""Small steps in single precision: xpbd takes velocities as variables, not from differences of positions, and loses nothing."""

import numpy as np
import pytest
from physics_support import PRECISION, simulate

import taichi_sim as ts
from taichi_sim.benchmark.stiff_cloth import SIDE, T, converged


def hanging_cloth():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    ts.shapes.cloth(
        scene, size=(1, 1), resolution=(SIDE, SIDE), mass=1.0, stiffness=1e3, damping=0.05, pinned=range(SIDE)
    )
    return scene


@pytest.mark.long
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
