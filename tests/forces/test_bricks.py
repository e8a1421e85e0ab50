"""Bricks: bars and patches against theory, and how stiff they may be."""

import numpy as np
import pytest
from element_blocks import SIDES, block, lattice
from scipy import sparse
from scipy.sparse.linalg import spsolve

from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.scene.bricks import at_rest
from taichi_sim.scene.neo_hookean import STRETCHED, lame


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
        scene = block("bricks", dim, off=0.0, damping=0.3)
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
