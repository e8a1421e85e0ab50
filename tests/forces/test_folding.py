"""Membranes that give way to compression: their energy, what a strip bears, coarse cloth on a sphere."""

import numpy as np
import pytest
from physics_support import F64, simulate
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim.scene.membranes import folded_energy


def laws(n, seed):
    """Laws (n, 3, 3), limits (n,) and strains (n, 3) at random; half of the limits are 0."""
    rng = np.random.default_rng(seed)
    one, other, shear = 10.0 ** rng.uniform((0, 0, -1), 3, (n, 3)).T
    law = np.zeros((n, 3, 3))
    law[:, 0, 0], law[:, 1, 1], law[:, 2, 2] = one, other, shear
    law[:, 0, 1] = law[:, 1, 0] = rng.uniform(-0.9, 0.9, n) * np.sqrt(one * other)
    limit = np.where(np.arange(n) % 2, 0.0, 10.0 ** rng.uniform(-3, 1, n))
    return law, limit, 0.1 * rng.normal(size=(n, 3)) * (1.0, 1.0, 2.0)


@pytest.mark.once
def test_folds_take_off_as_much_energy_as_they_can():
    """No second strain does better, sums of three folds at any angles included, and the stress is nowhere below the limit."""
    law, limit, strain = laws(400, 3)
    found = folded_energy(strain, law, limit)
    step = 1e-6 * np.eye(3)
    stress = np.stack(
        [(folded_energy(strain + d, law, limit) - folded_energy(strain - d, law, limit)) / 2e-6 for d in step], axis=1
    )
    scale = np.abs(np.einsum("tij,tj->ti", law, strain)).max(axis=1)
    least = 0.5 * (stress[:, 0] + stress[:, 1]) - np.hypot(0.5 * (stress[:, 0] - stress[:, 1]), stress[:, 2])
    assert (least > -limit - 1e-4 * scale).all()
    flat = 0.5 * np.einsum("ti,tij,tj->t", strain, law, strain)
    assert 0.3 < np.mean(found < flat - 1e-9) < 0.95  # else nothing folds
    rng = np.random.default_rng(4)
    for _ in range(300):
        angle, size = rng.uniform(0, np.pi, (3, len(law))), 0.3 * rng.uniform(0, 1, (3, len(law))) ** 3
        fold = np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2, np.sin(2 * angle)], axis=-1)
        fold = np.sum(size[..., None] * fold, axis=0)
        whole = strain + fold
        other = 0.5 * np.einsum("ti,tij,tj->t", whole, law, whole) + limit * (fold[:, 0] + fold[:, 1])
        assert (other > found - 1e-9 * np.abs(flat)).all()


@pytest.mark.parametrize("angle", [0.0, 90.0])
def test_a_sheet_that_is_pressed_bears_euler_s_load_of_a_triangle(angle):
    """Between two rows of balls that are held nearer than at rest, whose springs would bear four times as much."""
    wide, long, rigidity = 0.5, 0.8, 2e-3
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    fabric = {"warp": 90.0, "weft": 60.0, "shear": 20.0, "warp_angle": angle, "bending_rigidity": rigidity}
    ts.shapes.cloth(scene, (long, wide), (9, 6), folds=True, mass_per_area=0.2, **fabric)
    x = scene.position.copy()
    x[:, 0] *= 0.9
    scene.set_balls(position=x)
    with simulate(scene, integrator="symplectic_euler", dt=1e-6, substeps=1, contacts="off") as sim:
        sim.step(1)
        force = sim.velocity * scene.mass[:, None] / 1e-6
    edge = np.isclose(x[:, 0], 0.0)
    limit = np.pi**2 * rigidity / 0.01  # squares of 10 cm
    shortened = 0.9  # by which the force of a stress per length at rest is smaller
    assert force[edge, 0].sum() == pytest.approx(-limit * wide * shortened, rel=1e-6 if F64 else 1e-3)


def sides(n):
    """Mean height [m] of the middles of the sides of a sheet on a sphere 0.5 m wide, its middle held, after 0.75 s."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    ts.shapes.cloth(
        scene,
        (1, 1),
        (n, n),
        warp=600.0,
        shear=200.0,
        mass_per_area=0.2,
        position=(-0.5, 0.26, -0.5),
        radius=0.005,
        folds=True,
    )
    x = scene.position.copy()
    angle, r = np.arctan2(x[:, 2], x[:, 0]), np.hypot(x[:, 0], x[:, 2])
    x[:, 1] += 0.12 * r**2 * (1.0 + np.cos(4.0 * angle))
    scene.set_balls(position=x)
    scene.set_balls([n * n // 2], pinned=True)
    scene.add_collider(ts.Sphere((0, 0, 0), 0.25))
    with simulate(scene, integrator="implicit_euler", dt=1 / 120, substeps=1) as sim:
        sim.run(0.75)
        y = sim.position[:, 1].reshape(n, n)
    return np.mean([y[0, n // 2], y[-1, n // 2], y[n // 2, 0], y[n // 2, -1]])


@pytest.mark.slow
def test_a_coarse_cloth_drapes_as_a_fine_one():
    """Without folds the sides of 17 and 33 balls are 50 mm apart: flat triangles resist curved folds."""
    coarse, fine = sides(17), sides(33)
    assert coarse < -0.08
    assert abs(coarse - fine) < 0.01


@pytest.mark.once
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"folds": True, "stretch_stiffness": 50.0}, r"cloth.folds: is for a cloth of triangles; give warp"),
        ({"warp": 50.0, "folds": "yes"}, r"cloth.folds"),
        ({"warp": 50.0, "folds": 2}, r"cloth.folds"),
    ],
)
def test_refusals(given, message):
    assert_unchanged(ts.Scene(dim=3), lambda scene: ts.shapes.cloth(scene, **given), message)


@pytest.mark.once
def test_a_limit_below_0_is_refused():
    scene = ts.Scene(dim=3)
    scene.add_balls(np.eye(3), radius=0.01)
    given = {"warp": 1.0, "compression_limit": -0.1}
    assert_unchanged(
        scene, lambda scene: scene.add_membranes([[0, 1, 2]], **given), r"membranes.compression_limit.*-0.1"
    )
