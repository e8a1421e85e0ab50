"""Cells in implicit methods: a step solves its equation, and none is limited by stiffness."""

import numpy as np
import pytest
from element_blocks import downhill
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import stability
from taichi_sim.integrators import TRBDF2, ImplicitEuler
from taichi_sim.shapes.jelly_material import box_cells


def block(dim: int, number: int, bulk: float, off: float = 0.0, velocity=np.zeros_like) -> ts.Scene:
    """A lattice of balls with soft springs along its edges and diagonals, and cells that resist with `bulk` [Pa]; balls are `off`
    [m] their places, with velocities that depend on those."""
    scene = ts.Scene(dim=dim, gravity=np.zeros(dim))
    points = np.stack(np.meshgrid(*[np.arange(number)] * dim, indexing="ij"), axis=-1).reshape(-1, dim) * 0.1
    start = points + np.random.default_rng(5).uniform(-off, off, points.shape)
    scene.add_balls(start, radius=0.01, mass=0.02, velocity=velocity(start))
    near = np.linalg.norm(points[:, None] - points[None], axis=2)
    pairs = np.argwhere(np.triu((near > 0.0) & (near < 0.1 * (dim + 0.01) ** 0.5)))
    scene.add_springs(pairs, stiffness=40.0, rest_length=near[tuple(pairs.T)])
    corners, volume, _, together = box_cells(np.ones([number - 1] * dim, dtype=bool), np.full(dim, 0.1))
    scene.add_cells(corners, bulk_modulus=bulk, crush_modulus=3.0 * bulk, rest_volume=volume, together=together)
    return scene


def struck(x: np.ndarray) -> np.ndarray:
    """Velocities of a block that turns, and one side of which is struck."""
    arm = x - x.mean(axis=0)
    return 2.0 * np.cross([0.0, 0.0, 1.0], arm) + np.where(arm[:, :1] > 0.09, (0.0, 0.0, 1.0), 0.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_step_of_implicit_euler_solves_its_equation(dim) -> None:
    """Of cells some of which are crushed or turned inside out; in 2D they act together in fours."""
    scene, h = block(dim, 3, 2e3, off=0.07), 0.05
    method = ImplicitEuler(tolerance=1e-11 if F64 else 1e-5)
    with simulate(scene, integrator=method, dt=h, contacts="off") as sim:
        assert sim.stability().dt_any_shape == np.inf
        sim.step(1)
        found = sim.velocity
    residual = scene.mass[:, None] * found - h * downhill(scene, scene.position + h * found)
    before = np.abs(h * downhill(scene, scene.position)).max()
    assert np.abs(residual).max() < (1e-7 if F64 else 1e-3) * before


@pytest.mark.slow
@pytest.mark.parametrize(("method", "turns"), [(ImplicitEuler, False), (TRBDF2, True)])
def test_no_step_is_limited_by_stiffness(method, turns) -> None:
    """A stiff block that is struck, at frames and shorter steps: its energy never grows, and it keeps its rotation."""
    scene = block(3, 3, 1e6, velocity=struck)
    with simulate(scene, integrator=method(), contacts="off") as sim:
        for h in (1 / 30, 1 / 240, 1 / 1000):
            scene = block(3, 3, 1e6, velocity=struck)
            scene.settings["dt"] = h
            sim.reset(scene)
            energies, first = [sim.energy().total], sim.angular_momentum()
            for _ in range(24):
                sim.step(1)
                energies.append(sim.energy().total)
            before = np.full(24, energies[0]) if turns else energies[:-1]  # TR-BDF2 is not monotone
            assert (np.subtract(energies[1:], before) < (1e-5 if F64 else 1e-3) * energies[0]).all(), h
            if turns and h < 1 / 200:
                assert np.abs(sim.angular_momentum() - first).max() < 1e-4 * np.linalg.norm(first)


@pytest.mark.once
def test_methods_that_solve_for_cells_have_no_longest_step() -> None:
    scene = block(3, 3, 1e6)
    longest = [stability(scene, named(name)).dt_any_shape for name in ("implicit_euler", "tr_bdf2", "xpbd", "verlet")]
    assert longest[:3] == [np.inf] * 3
    assert longest[3] < 1e-3
