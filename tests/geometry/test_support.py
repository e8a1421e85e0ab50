"""Reach of points along directions, against all products."""

import numpy as np
import pytest

from taichi_sim.geometry.support import farthest

pytestmark = pytest.mark.once


@pytest.mark.parametrize(
    "widths", [(1, 1, 1), (3, 1e-3, 2e-3), (2, 5, 0), (0, 0, 0)], ids=["ball", "needle", "flat", "one"]
)
def test_points_reach_as_far_as_the_farthest_of_them(widths):
    rng = np.random.default_rng(8)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = rng.normal(size=(700, 3)) * widths @ turn + 4.0
    points[::7] = points[::-1][::7]
    directions = np.concatenate(
        [rng.normal(size=(300, 3)), turn, -turn, np.zeros((1, 3)), np.eye(3).repeat(80, axis=0)]
    )
    expected = (directions @ points.T).max(axis=1)
    assert farthest(points, directions) == pytest.approx(expected, rel=0, abs=1e-13 * np.abs(expected).max())
    assert farthest(points[:1], directions) == pytest.approx(directions @ points[0], abs=1e-13)
    assert len(farthest(points, np.zeros((0, 3)))) == 0
