"""Bricks: their forces against their energy, what they conserve, bars and patches against theory, and how stiff they may be."""

import itertools

import numpy as np
import pytest
from physics_support import EPS, F64, simulate
from scene_files import assert_unchanged
from scipy import sparse
from scipy.sparse.linalg import spsolve

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.scene.bricks import at_rest
from taichi_sim.scene.neo_hookean import STRETCHED, lame

SIDES = np.array([0.3, 0.5, 0.7])


def lattice(number) -> tuple[np.ndarray, np.ndarray]:
    """Whole-numbered points (n, dim) and corners (b, 2^dim) of so many bricks along each axis."""
    dim = len(number)
    points = np.array(list(itertools.product(*(range(n + 1) for n in number))), dtype=float)
    index = np.arange(len(points)).reshape([n + 1 for n in number])
    corners = [
        index[tuple(slice(o, o + n) for o, n in zip(offset, number))].ravel()
        for offset in itertools.product((0, 1), repeat=dim)
    ]
    return points, np.stack(corners, axis=1)


def block(dim: int, off: float = 0.05, viscosity: float = 0.0) -> ts.Scene:
    """A few bricks of two materials, deformed and in motion."""
    rng = np.random.default_rng(3 + dim)
    points, corners = lattice((2, 1, 2)[:dim])
    scene = ts.Scene(dim=dim, gravity=(0.0,) * dim)
    x = points * SIDES[:dim]
    scene.add_balls(x, radius=0.01, mass=rng.uniform(0.5, 2.0, len(x)), velocity=rng.normal(size=x.shape))
    ratio = np.where(np.arange(len(corners)) % 2, 0.45, 0.2)
    scene.add_bricks(corners, young_modulus=30.0, poisson_ratio=ratio, viscosity=viscosity)
    scene.set_balls(position=x + off * rng.normal(size=x.shape))
    return scene


def forces(scene: ts.Scene) -> np.ndarray:
    """Forces (n, dim) [N], by the change of velocities in a short step."""
    h = 1e-6 if F64 else 1e-3
    with simulate(scene, integrator="symplectic_euler", dt=h, substeps=1, contacts="off") as sim:
        sim.step(1)
        return (sim.velocity - scene.velocity) / h * scene.mass[:, None]


def downhill(scene: ts.Scene, at: np.ndarray | None = None, torn: np.ndarray | None = None) -> np.ndarray:
    """Less the derivative (n, dim) of the energy by the places [N]."""
    at = scene.position if at is None else at
    gradient = np.zeros_like(at)
    for k in np.ndindex(*gradient.shape):
        there = at[None] + np.zeros((2, 1, 1))
        there[0][k] += 1e-6
        there[1][k] -= 1e-6
        stored = (diagnostics.energy(scene, x, scene.velocity, torn=torn).spring for x in there)
        gradient[k] = np.subtract(*stored) / 2e-6
    return -gradient


@pytest.mark.parametrize("dim", [2, 3])
def test_forces_are_downhill(dim) -> None:
    scene = block(dim)
    found, expected = forces(scene), downhill(scene)
    scale = np.abs(expected).max()
    assert np.abs(found - expected).max() < (1e-6 if F64 else 1e-3) * scale
    if F64:
        assert np.abs(found.sum(axis=0)).max() < 1e-8 * scale


@pytest.mark.parametrize("dim", [2, 3])
def test_viscosity_takes_energy_and_keeps_momenta(dim) -> None:
    scene = block(dim, viscosity=0.4)
    scene.tables["bricks"].replace(slice(1), viscosity=0.0)
    with simulate(scene, integrator="symplectic_euler", dt=1e-4, contacts="off") as sim:
        energies, momenta = [], []
        for _ in range(5):
            energies.append(sim.energy().total)
            momenta.append(np.append(sim.momentum(), sim.angular_momentum()))
            sim.step(60)
    assert (np.diff(energies) < -1e-3 * energies[0]).all()
    assert np.ptp(momenta, axis=0).max() < 300 * EPS * np.abs(momenta).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_viscosity_does_not_resist_rotation(dim) -> None:
    """Also of bricks that are not linear in their shape."""
    scene = block(dim, viscosity=20.0)
    spin = np.zeros((dim, dim))
    spin[0, 1], spin[1, 0] = -1.0, 1.0
    scene.set_balls(velocity=scene.position @ spin.T)
    expected = downhill(scene)
    assert np.abs(forces(scene) - expected).max() < (1e-5 if F64 else 3e-3) * np.abs(expected).max()


@pytest.mark.once
@pytest.mark.parametrize("dim", [2, 3])
def test_small_strains_have_the_given_moduli(dim) -> None:
    """Any uniform strain, of bricks in any orientation, stores what Hooke's law says: the patch test."""
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    scene = block(dim, off=0.0)
    x, e = scene.position, rng.normal(size=(dim, dim))
    e = 1e-5 * (e + e.T)
    stored = diagnostics.energy(scene, (x + x @ e) @ turn.T, 0.0 * x).spring
    mu, lam = lame(dim, scene.brick_modulus, scene.brick_ratio)
    expected = (mu * np.sum(e * e) + 0.5 * lam * np.trace(e) ** 2) @ scene.brick_size.prod(axis=1)
    assert stored == pytest.approx(expected, rel=1e-3)


@pytest.mark.once
def test_a_patch_is_exact() -> None:
    """The forces of a uniform strain balance at the ball within, to rounding, whatever the sides."""
    points, corners = lattice((2, 2, 2))
    stiff = at_rest(SIDES, 7.0, 0.49)[0]
    u = (points * SIDES) @ np.random.default_rng(6).normal(size=(3, 3))
    force = np.zeros_like(points)
    np.add.at(force, corners.ravel(), (u[corners].reshape(len(corners), -1) @ stiff).reshape(-1, 3))
    middle = int(np.flatnonzero((points == 1).all(axis=1))[0])
    assert np.abs(force[middle]).max() < 1e-12 * np.abs(force).max()


def bar(across: int, ratio: float, length: float = 10.0) -> float:
    """Deflection of a bar with one end held and a force across at the other, in parts of Timoshenko's. Its cross-section may
    change its size at the held end, as theory has it."""
    number = (int(length * across), across, across)
    points, corners = lattice(number)
    points /= across
    dofs = (3 * corners[:, :, None] + np.arange(3)).reshape(len(corners), -1)
    stiff = at_rest(np.full(3, 1 / across), 1.0, ratio)[0]
    values = np.broadcast_to(stiff, (len(corners), *stiff.shape)).ravel()
    whole = sparse.csc_matrix((values, (np.repeat(dofs, 24, axis=1).ravel(), np.tile(dofs, 24).ravel())))
    held = np.stack([points[:, 0] == 0.0, *((points[:, 0] == 0.0) & (points[:, a] == 0.5) for a in (1, 2))], axis=1)
    if across % 2:
        held[points[:, 0] == 0.0] = True
    weight = np.where(points[:, 0] == length, np.prod(np.where(points[:, 1:] % 1 == 0, 0.5, 1.0), axis=1), 0.0)
    load = np.zeros_like(points)
    load[:, 1] = weight / weight.sum()
    free = np.flatnonzero(~held.ravel())
    u = np.zeros(points.size)
    u[free] = spsolve(whole[free][:, free], load.ravel()[free])
    shear = 10 * (1 + ratio) / (12 + 11 * ratio) / (2 * (1 + ratio))
    return float(load.ravel() @ u / (4 * length**3 + length / shear))


@pytest.mark.once
@pytest.mark.parametrize(("across", "within"), [(1, 0.03), (2, 0.003), (4, 0.001)])
def test_bars_bend_as_theory_says_at_every_ratio(across, within) -> None:
    for ratio in (0.25, 0.45, 0.49, 0.4999):
        assert bar(across, ratio) == pytest.approx(1.0, abs=within), ratio


@pytest.mark.once
def test_largest_rate_is_a_bound_that_is_near() -> None:
    for dim in (2, 3):
        scene = block(dim, off=0.0, viscosity=0.3)
        scene.set_balls(mass=5.0 * np.bincount(scene.bricks.ravel()))
        whole = np.zeros((2, scene.position.size, scene.position.size))
        for corners, size, modulus, ratio in zip(
            scene.bricks, scene.brick_size, scene.brick_modulus, scene.brick_ratio
        ):
            at = (dim * corners[:, None] + np.arange(dim)).ravel()
            elastic, loss = at_rest(size, modulus, ratio)
            whole[np.ix_([0, 1], at, at)] += np.stack([elastic, 0.3 / lame(dim, modulus, ratio)[0] * loss])
        root = np.repeat(scene.mass, dim) ** -0.5
        exact = [np.linalg.eigvalsh(root[:, None] * part * root)[-1] for part in whole]
        rates = element_rates(scene)
        for found, rate in zip((rates.elastic, rates.damping), exact):
            assert rate * (1 - 1e-9) < found / STRETCHED < 2 * rate


@pytest.mark.once
def test_bricks_come_back_from_a_file(tmp_path) -> None:
    scene = block(3, viscosity=0.4)
    scene.save(tmp_path / "bricks.toml")
    again = ts.load_scene(tmp_path / "bricks.toml")
    for name in ("bricks", "brick_modulus", "brick_ratio", "brick_viscosity", "brick_size"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scene, name))


def test_a_brick_that_is_turned_inside_out_comes_back() -> None:
    """Flat, inside out and scrambled at the start; none of them at rest."""
    points, corners = lattice((3, 3, 3))
    rng = np.random.default_rng(8)
    starts = [points * (1, 0, 1), points * (1, -0.5, 1), points + rng.uniform(-1, 1, points.shape)]
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    for k, start in enumerate(starts):
        aside = np.array([10.0 * k, 0.0, 0.0])
        balls = scene.add_balls(points + aside, radius=0.1, body=scene.new_body())
        scene.add_bricks(balls[corners], young_modulus=50.0, poisson_ratio=0.4, viscosity=10.0)
        scene.set_balls(balls, position=start + 1e-3 * rng.normal(size=points.shape) + aside)
    with simulate(scene, dt="auto", contacts="off") as sim:
        assert sim.inverted() > 60
        sim.run(20.0)
        assert sim.inverted() == 0
        assert sim.energy().total < 1e-4 * 50 * 81


@pytest.mark.once
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"corners": [[0, 1, 2, 2]]}, r"bricks.corners\[0\].*twice"),
        ({"corners": [[0, 1, 3, 2]]}, r"bricks.corners\[0\].*no box.*order"),
        ({"poisson_ratio": 0.9999}, r"bricks.poisson_ratio.*0.9996"),
        ({"young_modulus": 0.0}, r"bricks.young_modulus.*greater than 0"),
        ({"rest_size": [1.0, -1.0]}, r"bricks.rest_size"),
        ({"rest_size": 2.0}, r"bricks.rest_size: shape \(\) does not fit; it must be \(2,\) or \(1, 2\)"),
        ({"rest_size": [1.0, 2.0, 3.0]}, r"bricks.rest_size: shape \(3,\) does not fit; it must be"),
        ({"rest_size": [True, 1.0]}, r"bricks.rest_size: .* is not a list of 2-vectors"),
        ({"viscosity": -1.0}, r"bricks.viscosity"),
    ],
)
def test_refusals(arguments, message) -> None:
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [0, 1], [1, 0], [1, 1]], radius=0.1)
    given = {"corners": [[0, 1, 2, 3]], "young_modulus": 1.0, "poisson_ratio": 0.3} | arguments
    assert_unchanged(scene, lambda scene: scene.add_bricks(**given), message)
