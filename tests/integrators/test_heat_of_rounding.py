"""Energy that rounding adds to stiff elements that nothing damps, in explicit methods."""

import warnings

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.analysis.outcome import of_energy
from taichi_sim.analysis.rounding_heat import CURE, MARGIN, heat_of_rounding


def plate(scene):
    """A plate held by its border, struck by 0.05 m/s."""
    args = {"young_modulus": 1e8, "poisson_ratio": 0.2, "thickness": 0.03, "mass_per_area": 12.0, "damping": 0.0}
    ts.shapes.cloth(scene, (1.2, 0.9), (15, 12), pinned="border", velocity=(0.0, 0.05, 0.0), **args)


def bar(scene):
    """A nearly incompressible bar, held by one end, bent by some 0.1 mm. It is damped a little, as by air."""
    args = {"young_modulus": 3e5, "poisson_ratio": 0.48, "density": 1100.0, "damping": 1e-6}
    ts.shapes.jelly(scene, (1.5, 0.1, 0.1), (25, 3, 3), pinned="left", **args)
    scene.set_balls(velocity=0.002 * scene.position[:, :1] * [0.0, 1.0, 0.0])


def solid(scene):
    """Bar of undamped triangles in a plane, pinned at one end."""
    x = np.stack(np.meshgrid(np.linspace(0.0, 1.5, 31), np.linspace(0.0, 0.1, 3), indexing="ij"), axis=2).reshape(-1, 2)
    grid = scene.add_balls(x, mass=0.5, radius=0.01, pinned=np.arange(3)).reshape(31, 3)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    scene.add_solids(np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3), young_modulus=3e5, poisson_ratio=0.48)
    scene.set_balls(velocity=0.002 * scene.position[:, :1] * [0.0, 1.0])


@pytest.mark.parametrize(("body", "driver"), [(plate, "fused"), (bar, "parallel"), (solid, "fused")])
def test_stiff_elements_that_are_hardly_damped_keep_their_energy(body, driver):
    """Their forces were those of places rounded to single precision, which kicked them at random: in 5000 steps the energies rose
    by 0.17, 0.05 and 0.13."""
    dim = 2 if body is solid else 3
    scene = ts.Scene(dim=dim, gravity=(0.0,) * dim)
    body(scene)
    with simulate(scene, ("auto", driver), contacts="off") as sim:
        energy = [sim.energy().total]
        for _ in range(20):
            sim.step(250)
            energy.append(sim.energy().total)
    assert max(energy) < (1.0 + 1e-3) * energy[0]
    assert energy[-1] > (1.0 - 1e-3) * energy[0]


@pytest.mark.skipif(F64, reason="single precision rounds so much")
@pytest.mark.parametrize("method", ["verlet", "symplectic_euler"])
def test_heat_of_rounding_is_told_and_steps_are_not_halved(monkeypatch, method):
    """As on a device without double precision. It was taken for a step too long: the run began anew with halved steps, up to a
    sixteenth, and gained hardly less; a gain below what methods swing by was good."""
    monkeypatch.setattr("taichi_sim.forces.sum.keep_energy", lambda _: False)
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    plate(scene)
    scene.set_balls(velocity=0.1 * scene.velocity)
    with simulate(scene, integrator=method, contacts="off") as sim, warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        start, substeps = sim.energy().total, sim.substeps
        sim.step(150)
        little, early = sim.energy().total, sim._stepper.checks.scales()
        while sim.energy().total < 40.0 * start:
            sim.step(500)
        late, end = sim._stepper.checks.scales(), sim.energy().total
        expected = heat_of_rounding(scene, sim.dt / sim.substeps, elements=True) * sim.time
        assert sim.substeps == substeps
    told = [str(one.message) for one in said]
    assert any(CURE in one for one in told)
    assert not any("repeated" in one for one in told)
    assert 0.3 * expected < end - start < MARGIN * expected
    for energy, scales in ((little, early), (end, late)):
        verdict = of_energy(start, energy, scales)
        assert "wrong" in verdict
        assert CURE in verdict
