"""Implicit methods gain no energy, however stiff springs are and however coarse their solutions."""

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f32")


def hanging(pendulum: float, rope: float) -> ts.Scene:
    """A pendulum and a rope that start level; their stiffness [N/m]."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    scene.add_balls([[-2.0, 0.0], [-1.75, 0.0]], radius=0.01, mass=2.0, pinned=[0])
    scene.add_springs([[0, 1]], stiffness=pendulum)
    x = np.linspace(0.0, 0.8, 9)
    scene.add_balls(np.stack([x, 0.0 * x], axis=1), radius=0.01, mass=0.05, pinned=[0])
    scene.add_springs([[i, i + 1] for i in range(2, 10)], stiffness=rope)
    return scene


@pytest.mark.slow_where(method="tr_bdf2")
@pytest.mark.parametrize(("method", "stiffer"), [("implicit_euler", 1.0), ("tr_bdf2", 10.0)])
def test_implicit_methods_gain_no_energy(method, stiffer):
    """With what the tolerance left, the springs gave them several times the energy of their fall."""
    for k in (3e5 * stiffer, 3e6 * stiffer) if F64 else (3e4, 3e5):  # single precision cannot solve more, and says so
        scene = hanging(100.0 * k, k)
        with simulate(scene, integrator=method, dt=1 / 50, substeps=1, contacts="off") as sim:
            energy = [sim.energy().total]
            for _ in range(150):
                sim.step()
                energy.append(sim.energy().total)
            found = sim.solver()
        fall = 9.81 * (2.0 * 0.25 + 8 * 0.05 * 0.4)  # J, all masses from their start to below their pins
        assert (
            np.diff(energy).max() < (5e-3 if method == "implicit_euler" else 5e-2) * fall
        )  # what TR-BDF2 itself swings
        assert max(energy) < energy[0] + 1e-3 * fall
        assert found.misses == 0
        assert found.passes < 100 * found.stages
