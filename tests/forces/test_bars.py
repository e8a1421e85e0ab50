"""Bricks and solids: bars and patches against theory, and how stiff they may be."""

import numpy as np
import pytest
from element_blocks import SIDES, lattice, mesh
from scipy import sparse
from scipy.sparse.linalg import spsolve

import taichi_sim as ts
from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.forces.solids import Pairs
from taichi_sim.scene.bricks import at_rest
from taichi_sim.scene.neo_hookean import STRETCHED, lame
from taichi_sim.scene.solids import averages, operators, shape_gradients

pytestmark = pytest.mark.once


def of_bricks(points, corners, modulus, ratio, viscosity=0.0):
    """Stiffness and damping at rest, (n dim, n dim) sparse, of equal bricks of one material."""
    dim = points.shape[1]
    elastic, loss = at_rest(points[corners[0, -1]] - points[corners[0, 0]], modulus, ratio)
    rows = (dim * corners[:, :, None] + np.arange(dim)).reshape(len(corners), -1)
    at = np.repeat(rows, rows.shape[1], axis=1).ravel(), np.tile(rows, rows.shape[1]).ravel()
    parts = (elastic, viscosity / lame(dim, modulus, ratio)[0] * loss)
    return [sparse.csc_matrix((np.tile(part.ravel(), len(corners)), at)) for part in parts]


def of_solids(points, corners, modulus, ratio, viscosity=0.0):
    """Stiffness and damping at rest, (n dim, n dim) sparse, of solids of one material."""
    each = np.ones(len(corners))
    at = averages(corners, shape_gradients(points[corners])[1], modulus * each, ratio * each, viscosity * each)
    averaged, link, here = operators(points[corners], at)
    dim, mu, lam = points.shape[1], at.mu[0], at.lam[0]
    one = np.eye(dim)
    swap = np.einsum("aj,ib->aibj", one, one).reshape(dim * dim, -1)
    trace = np.outer(one.ravel(), one.ravel())
    averaged, link, here = sparse.kron(averaged, one), sparse.kron(link, one), sparse.diags(here)
    law = mu * (np.eye(dim * dim) + swap) + lam * trace - at.own[0] * np.eye(dim * dim)
    loss = averaged.T @ sparse.kron(here, viscosity * (np.eye(dim * dim) + swap)) @ averaged
    return (averaged.T @ sparse.kron(here, law) @ averaged + link).tocsc(), loss


def test_a_patch_of_bricks_is_exact():
    """The forces of a uniform strain balance at the ball within, to rounding, whatever the sides."""
    points, corners = lattice((2, 2, 2))
    points = points * SIDES
    force = of_bricks(points, corners, 7.0, 0.49)[0] @ (points @ np.random.default_rng(6).normal(size=(3, 3))).ravel()
    middle = int(np.flatnonzero((points == SIDES).all(axis=1))[0])
    assert np.abs(force.reshape(-1, 3)[middle]).max() < 1e-12 * np.abs(force).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_patch_of_solids_is_exact(dim):
    """Averages of a uniform gradient are that gradient, and its forces balance at the balls within, to rounding."""
    points, corners = mesh((3, 4, 3)[:dim], 0.2)
    gradient, volume = shape_gradients(points[corners])
    pairs = Pairs(corners, gradient, volume, np.full(len(points), 3.0))
    given = np.random.default_rng(6).normal(size=(dim, dim))
    apart = (points[pairs.other] - points[pairs.own]) @ given.T
    mean = np.zeros((len(points), dim, dim))
    np.add.at(mean, pairs.own, apart[:, :, None] * pairs.slope[:, None])
    assert mean / pairs.volume[:, None, None] == pytest.approx(np.broadcast_to(given, mean.shape), abs=1e-12)
    force = np.zeros_like(points)
    np.add.at(force, pairs.own, pairs.back @ given.T + pairs.link[:, None] * apart)
    within = ((points > 0) & (points < points.max(axis=0))).all(axis=1)
    assert within.any()
    assert np.abs(force[within]).max() < 1e-12 * np.abs(force).max()


def deflection(whole, points, held, ratio):
    """Deflection of a bar of modulus 1 and 1 m x 1 m across, with one end held and a force across at the other, in parts of
    Timoshenko's. held: which coordinates (n, 3) are."""
    length = points[:, 0].max()
    weight = np.where(points[:, 0] == length, np.prod(np.where(points[:, 1:] % 1 == 0, 0.5, 1.0), axis=1), 0.0)
    load = np.zeros_like(points)
    load[:, 1] = weight / weight.sum()
    free = np.flatnonzero(~held.ravel())
    u = np.zeros(points.size)
    u[free] = spsolve(whole[free][:, free], load.ravel()[free])
    shear = 10 * (1 + ratio) / (12 + 11 * ratio) / (2 * (1 + ratio))
    return float(load.ravel() @ u / (4 * length**3 + length / shear))


@pytest.mark.parametrize(("across", "within"), [(1, 0.03), (2, 0.003), (4, 0.001)])
def test_bars_of_bricks_bend_as_theory_says_at_every_ratio(across, within):
    """The cross-section may change its size at the held end, as theory has it."""
    points, corners = lattice((10 * across, across, across))
    points /= across
    end = points[:, 0] == 0.0
    held = np.stack([end, *(end & ((points[:, a] == 0.5) | (across % 2 == 1)) for a in (1, 2))], axis=1)
    for ratio in (0.25, 0.45, 0.49, 0.4999):
        found = deflection(of_bricks(points, corners, 1.0, ratio)[0], points, held, ratio)
        assert found == pytest.approx(1.0, abs=within), ratio


def torsion_constant(width, depth):
    """Saint-Venant's torsion constant [m^4] of a rectangle (Timoshenko and Goodier, Theory of Elasticity)."""
    low, high = sorted((width, depth))
    odd = np.arange(1, 40, 2)
    series = np.sum(np.tanh(0.5 * np.pi * odd * high / low) / odd**5)
    return high * low**3 * (1 / 3 - 64 * low / (np.pi**5 * high) * series)


@pytest.mark.parametrize(
    ("bricks", "sides", "within"),
    [((1, 1), (0.7, 0.7), 1e-3), ((1, 1), (0.7, 2.1), 0.02), ((1, 3), (0.7, 2.1), 0.06), ((2, 2), (0.7, 0.7), 0.15)],
)
def test_bars_of_bricks_twist_as_theory_says(bricks, sides, within):
    """Both ends turn as plates whose points may leave their planes."""
    points, corners = lattice((12, *bricks))
    points = points * [0.7, *np.divide(sides, bricks)] - [0.0, *np.divide(sides, 2)]
    length, ratio = points[:, 0].max(), 0.4
    whole = of_bricks(points, corners, 5.0, ratio)[0]
    end = (points[:, 0] == 0.0) | (points[:, 0] == length)
    given = np.stack([np.arange(len(points)) == 0, end, end], axis=1).ravel()
    u = (points[:, :1] / length * np.cross([1.0, 0.0, 0.0], points)).ravel()
    u[~given] = spsolve(whole[~given][:, ~given], -whole[~given][:, given] @ u[given])
    exact = 5.0 / (2 * (1 + ratio)) * torsion_constant(*sides) / length
    assert u @ whole @ u == pytest.approx(exact, rel=within)


@pytest.mark.parametrize(
    ("across", "within", "ratios"), [(2, 0.12, (0.25, 0.45, 0.49)), (4, 0.05, (0.25, 0.45, 0.49, 0.4999))]
)
def test_bars_of_solids_bend_as_theory_says(across, within, ratios):
    """Two across are too few for a bar that cannot change its volume: 0.69 at a ratio of 0.4999."""
    points, corners = mesh((10 * across, across, across), 0.1)
    points = points / across
    held = np.repeat(points[:, :1] == 0.0, 3, axis=1)
    for ratio in ratios:
        found = deflection(of_solids(points, corners, 1.0, ratio)[0], points, held, ratio)
        assert found == pytest.approx(1.0, abs=within), ratio


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(("kind", "matrices", "most"), [("bricks", of_bricks, 2.0), ("solids", of_solids, 1.05)])
def test_largest_rate_is_a_bound_that_is_near(kind, matrices, most, dim):
    number = (4, 3, 3)[:dim]
    points, corners = lattice(number) if kind == "bricks" else mesh(number, 0.2)
    points = points * (SIDES[:dim] if kind == "bricks" else 1.0)
    scene = ts.Scene(dim=dim)
    mass = np.bincount(corners.ravel()) if kind == "bricks" else np.random.default_rng(2).uniform(1, 2, len(points))
    scene.add_balls(points, radius=0.1, mass=mass)
    getattr(scene, f"add_{kind}")(corners, young_modulus=7.0, poisson_ratio=0.45, viscosity=0.3)
    root = sparse.diags(np.repeat(scene.mass, dim) ** -0.5)
    parts = matrices(points, corners, 7.0, 0.45, 0.3)
    exact = [np.linalg.eigvalsh((root @ part @ root).toarray())[-1] for part in parts]
    rates = element_rates(scene)
    for found, rate in zip((rates.elastic, rates.damping), exact):
        assert rate * (1 - 1e-9) < found / STRETCHED < most * rate


def test_viscous_solids_that_cannot_move_have_no_loss():
    points, corners = mesh((1, 1))
    scene = ts.Scene(dim=2)
    for viscosity in (2.0, 0.0):
        first = scene.n_balls
        scene.add_balls(points + np.array([first, 0.0]), radius=0.01, pinned=viscosity > 0.0)
        scene.add_solids(corners + first, young_modulus=50.0, poisson_ratio=0.1, viscosity=viscosity)
    rates = element_rates(scene)
    assert rates.damping == 0.0 < rates.elastic
