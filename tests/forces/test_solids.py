"""Solids: bars and patches against theory, and how stiff they may be."""

import numpy as np
import pytest
from element_blocks import mesh
from scipy import sparse
from scipy.sparse.linalg import spsolve

import taichi_sim as ts
from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.forces.solids import Pairs
from taichi_sim.scene.neo_hookean import STRETCHED
from taichi_sim.scene.solids import averages, operators, shape_gradients


@pytest.mark.once
@pytest.mark.parametrize("dim", [2, 3])
def test_a_patch_is_exact(dim) -> None:
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


def stiffness(points, corners, modulus, ratio, viscosity=0.0):
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
    return averaged.T @ sparse.kron(here, law) @ averaged + link, loss


def bar(across: int, ratio: float, length: float = 10.0) -> float:
    """Deflection of a bar with one end held and a force across at the other, in parts of Timoshenko's."""
    points, corners = mesh((int(length * across), across, across), 0.1)
    points = points / across
    matrix = stiffness(points, corners, 1.0, ratio)[0].tocsc()
    load = np.zeros_like(points)
    ends = points[:, 0] == length
    faces = np.prod(np.where(points[:, 1:] % 1 == 0, 0.5, 1.0), axis=1)
    load[ends, 1] = faces[ends] / faces[ends].sum()
    free = np.flatnonzero(np.repeat(points[:, 0] > 0, 3))
    u = np.zeros(points.size)
    u[free] = spsolve(matrix[free][:, free], load.ravel()[free])
    shear = 10 * (1 + ratio) / (12 + 11 * ratio) / (2 * (1 + ratio))
    return float(load.ravel() @ u / (4 * length**3 + length / shear))


@pytest.mark.once
@pytest.mark.parametrize(
    ("across", "within", "ratios"), [(2, 0.12, (0.25, 0.45, 0.49)), (4, 0.05, (0.25, 0.45, 0.49, 0.4999))]
)
def test_bars_bend_as_theory_says(across, within, ratios) -> None:
    """Two across are too few for a bar that cannot change its volume: 0.69 at a ratio of 0.4999."""
    for ratio in ratios:
        assert bar(across, ratio) == pytest.approx(1.0, abs=within), ratio


@pytest.mark.once
@pytest.mark.parametrize("dim", [2, 3])
def test_largest_rate_is_that_of_the_whole(dim) -> None:
    points, corners = mesh((4, 3, 3)[:dim], 0.2)
    scene = ts.Scene(dim=dim)
    mass = np.random.default_rng(2).uniform(1.0, 2.0, len(points))
    scene.add_balls(points, radius=0.1, mass=mass)
    scene.add_solids(corners, young_modulus=7.0, poisson_ratio=0.45, viscosity=0.3)
    root = sparse.diags(np.repeat(mass, dim) ** -0.5)
    parts = stiffness(points, corners, 7.0, 0.45, 0.3)
    exact = [np.linalg.eigvalsh((root @ part @ root).toarray())[-1] for part in parts]
    rates = element_rates(scene)
    for found, rate in zip((rates.elastic, rates.damping), exact):
        assert rate * (1 - 1e-9) < found / STRETCHED < 1.05 * rate


@pytest.mark.once
def test_viscous_solids_that_cannot_move_have_no_loss() -> None:
    points, corners = mesh((1, 1))
    scene = ts.Scene(dim=2)
    for viscosity in (2.0, 0.0):
        first = scene.n_balls
        scene.add_balls(points + np.array([first, 0.0]), radius=0.01, pinned=viscosity > 0.0)
        scene.add_solids(corners + first, young_modulus=50.0, poisson_ratio=0.1, viscosity=viscosity)
    rates = element_rates(scene)
    assert rates.damping == 0.0 < rates.elastic
