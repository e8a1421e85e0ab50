"""Closed meshes from functions of place."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.geometry.level_set import level_set
from taichi_sim.geometry.mesh import volume

pytestmark = pytest.mark.once


def ball(p):
    return np.linalg.norm(p - (0.1, 0.0, -0.2), axis=-1) - 0.5


def test_a_sphere_is_closed_turned_outward_and_as_large_as_it_should_be():
    surface = level_set(ball, (-0.6, -0.6, -0.9), (0.8, 0.7, 0.5), 0.05)
    t = surface.triangles
    sides = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    forth = {tuple(side) for side in sides.tolist()}
    assert len(forth) == len(sides)
    assert all((b, a) in forth for a, b in forth)
    assert volume(surface) == pytest.approx(4 / 3 * np.pi * 0.125, rel=0.02)  # positive: outward
    assert np.abs(ball(surface.vertices)).max() < 0.01


def test_finer_lattices_come_nearer():
    exact = 4 / 3 * np.pi * 0.125
    meshes = [level_set(ball, (-0.6, -0.7, -0.9), (0.8, 0.7, 0.5), step) for step in (0.2, 0.1, 0.05)]
    errors = [abs(volume(mesh) / exact - 1) for mesh in meshes]
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


@pytest.mark.parametrize("spacing", [0.09, 0.083, 0.061])
def test_no_edge_has_more_than_two_triangles(spacing):
    """Though the lattice cuts two crossed tori in squares of which two opposite corners are inside."""

    def tori(p):
        (x, y, z), (u, v, w) = np.moveaxis(p, -1, 0), np.moveaxis(p[..., [1, 2, 0]] - (0.1, 0.2, 0.3), -1, 0)
        ring = [np.hypot(np.hypot(a, b) - 0.7, c) - 0.17 for a, b, c in ((x, y, z), (u, v, w))]
        return np.minimum(*ring)

    surface = level_set(tori, (-1.3, -1.3, -1.3), (1.4, 1.4, 1.4), spacing)
    t = surface.triangles
    sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    assert np.all(np.unique(sides, axis=0, return_counts=True)[1] == 2)
    assert np.abs(tori(surface.vertices)).max() < 0.6 * spacing  # rounded where they meet


@pytest.mark.parametrize(
    ("low", "high", "spacing", "words"),
    [
        ((-0.3, -0.6, -0.9), (0.8, 0.7, 0.5), 0.05, "leaves the box"),
        ((1.0, 1.0, 1.0), (2.0, 2.0, 2.0), 0.1, "nowhere negative"),
        ((0.0, 0.0, 0.0), (0.1, 1.0, 1.0), 0.1, "two spacings"),
        ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.0, "level_set.spacing"),
        ((0.0, 0.0), (1.0, 1.0, 1.0), 0.1, "level_set.low"),
    ],
)
def test_boxes_that_do_not_fit_are_named(low, high, spacing, words):
    with pytest.raises(ts.SceneError, match=words):
        level_set(ball, low, high, spacing)
