"""Edges that pierce triangles, counted by cells and by brute force."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from taichi_sim.geometry.intersections import crossings
from taichi_sim.geometry.mesh import unique_edges

pytestmark = pytest.mark.once


def pierces(p, q, a, b, c):
    """Whether the segment p q meets the triangle a b c inside of both: by solving for where the line meets the plane."""
    matrix = np.stack([q - p, a - b, a - c], axis=1)
    if abs(np.linalg.det(matrix)) < 1e-12:
        return False
    t, u, v = np.linalg.solve(matrix, a - p)
    return 0 < t < 1 and u > 0 and v > 0 and u + v < 1


def test_random_triangles_as_by_brute_force():
    rng = np.random.default_rng(0)
    total = 0
    for size in (0.1, 0.5, 2.0):
        x = rng.uniform(-1, 1, (60, 1, 3)) + rng.uniform(-size, size, (60, 3, 3)) * 10.0 ** -rng.uniform(
            0, 1, (60, 1, 1)
        )
        x = x.reshape(-1, 3) + 5.0
        t = np.concatenate([np.arange(180).reshape(-1, 3), rng.permutation(180)[:6].reshape(-1, 3)])
        edges = unique_edges(t)
        expected = {
            (e, f)
            for e, (i, j) in enumerate(edges)
            for f, three in enumerate(t)
            if not {i, j} & set(three) and pierces(x[i], x[j], *x[three])
        }
        found = crossings(x, t)
        assert len(found) == len({*map(tuple, found)})
        assert {*map(tuple, found)} == expected
        total += len(expected)
    assert total > 100


def test_a_large_triangle_does_not_widen_the_search_among_small_ones(monkeypatch):
    """A ground of two triangles under a fine sheet: some twenty neighbours of an edge each, and the ground."""
    candidates = []

    class Counting(cKDTree):
        def query_ball_point(self, *args, **options):
            found = super().query_ball_point(*args, **options)
            candidates.extend(len(near) for near in found)
            return found

    monkeypatch.setattr("scipy.spatial.cKDTree", Counting)
    n = 30
    across = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 2)
    sheet = np.insert(0.01 * across, 1, 0.02 + 1e-3 * np.cos(across[:, 0]), axis=1)
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[:-1, 1:], k[1:, 1:]))
    ground = np.array([[-5, 0, -5], [5, 0, -5], [-5, 0, 5], [5, 0, 5]], dtype=float)
    t = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1), n * n + np.array([[0, 1, 2], [1, 3, 2]])])
    assert len(crossings(np.concatenate([sheet, ground]), t)) == 0
    edges = len(unique_edges(t))
    assert 10 * edges < sum(candidates) < 40 * edges


def test_what_shares_a_ball_or_only_touches_is_no_crossing():
    x = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 0, 1], [0.2, 1, 0.2], [0.2, -1, 0.2], [0.2, 0, 0.2], [3, 3, 3]], dtype=float
    )
    assert len(crossings(x, [[0, 1, 2], [3, 4, 6]])) == 2  # an edge of either goes through the other
    assert len(crossings(x, [[0, 1, 2], [3, 5, 6]])) == 0  # it ends on the triangle
    assert len(crossings(x, [[0, 1, 2], [0, 3, 4]])) == 1  # the edge from 3 to 4
    assert len(crossings(x, np.zeros((0, 3)))) == 0
