"""Solids in implicit methods: a step solves its equation, and none is limited by stiffness."""

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.integrators import TRBDF2, ImplicitEuler
from tests.forces.test_bricks import downhill
from tests.forces.test_solids import block, mesh

pytestmark = pytest.mark.long  # compiling takes most of it


def residual(scene: ts.Scene, v: np.ndarray, h: float) -> np.ndarray:
    """Residual of m (v - v0) = h F(x + h v) [N s], (n, dim)."""
    return scene.mass[:, None] * (v - scene.velocity) - h * downhill(scene, scene.position + h * v)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_step_of_implicit_euler_solves_its_equation(dim) -> None:
    """Of solids so deformed that some resist with a negative stiffness."""
    scene, h = block(dim, off=0.15), 0.5
    method = ImplicitEuler(tolerance=1e-11 if F64 else 1e-5)
    with simulate(scene, integrator=method, dt=h, contacts="off") as sim:
        sim.step(1)
        found = sim.velocity
    before = np.abs(residual(scene, scene.velocity, h)).max()
    assert np.abs(residual(scene, found, h)).max() < (1e-7 if F64 else 1e-3) * before


@pytest.mark.parametrize("method", [ImplicitEuler, TRBDF2])
def test_no_step_is_limited_by_stiffness(method) -> None:
    """A bar of hard rubber, held at one end and struck, at frames of 1/60 s: its energy never grows."""
    points, corners = mesh((8, 2, 2), 0.2)
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    struck = np.where(points[:, :1] > 7, (0.0, 3.0, 1.0), 0.0)
    scene.add_balls(0.1 * points, radius=0.01, mass=1.0, pinned=points[:, 0] == 0, velocity=struck)
    scene.add_solids(corners, young_modulus=1e7, poisson_ratio=0.49, viscosity=1e3)
    with simulate(scene, integrator=method(), dt=1 / 60, contacts="off") as sim:
        assert sim.substeps == 1
        energies = [sim.energy().total]
        for _ in range(30):
            sim.step(1)
            energies.append(sim.energy().total)
        assert sim.inverted() == 0
    assert (np.diff(energies) < (1e-6 if F64 else 1e-3) * energies[0]).all()
