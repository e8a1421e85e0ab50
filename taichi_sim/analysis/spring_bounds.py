"""Bounds on the fastest motion of a spring network, for every shape it can take and for the one it has.

Both cost a pass over the springs and are never below the exact eigenvalue of the linearised motion. With the matrices
A_e of the springs, lambda_max(M^-1 K) <= max_i lambda_max(sum_e (1 + x_j / x_i) A_e) / m_i for any positive x (0 for a pinned
ball): Young's inequality for each spring, then the rows of blocks. For the present shape A_e is
k (n n^T + max(0, 1 - l/d) (I - n n^T)), and x is improved in a few rounds, which comes to nine tenths of the exact limit on
cloth; for every shape A_e is at most k I.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.element_rates import Rates
from taichi_sim.scene.scene import Scene

__all__ = ["Network", "largest_eigenvalue", "over", "present_eigenvalue"]

PRESENT_ROUNDS = 3  # that improve the weights of the present bound

Floats = NDArray[np.float64]
Bound = Callable[[Floats, Floats], tuple[float, int]]  # of (m,) stiffness and damping: lambda [1/s^2], and a spring


@dataclass(frozen=True)
class Network:
    """Springs of stiffness and damping (m,), whose eigenvalues `bound` limits, and the rates of all else that is explicit, which
    add to what the bound says: lambda(A + B) <= lambda(A) + lambda(B)."""

    scene: Scene
    stiffness: Floats
    damping: Floats
    rates: Rates
    bound: Bound

    def largest(self, elastic: float, damping: float) -> tuple[float, int]:
        """lambda of `elastic` times all stiffness plus `damping` times all damping, and the spring that sets it."""
        value, spring = self.bound(elastic * self.stiffness, damping * self.damping)
        return value + elastic * self.rates.elastic + damping * self.rates.damping, spring


def over(a: float, b: float) -> float:
    """a / b, infinite where b is 0."""
    return a / b if b > 0 else np.inf


def largest_eigenvalue(scene: Scene, weight: Floats) -> tuple[float, int]:
    """Bound on lambda_max(M^-1 A) for A assembled from spring weights (m,), in every shape; and the spring that
    gives most to it.

    lambda <= max over springs of S_i / m_i + S_j / m_j with S_i the sum of weights at ball i; pinned ends give 0. The spring
    with the largest sum may itself be weak, where others hold its balls: the strongest one of its busier ball is named.
    """
    if not len(weight):
        return 0.0, 0
    sums = np.bincount(scene.pairs.ravel(), np.repeat(weight, 2), scene.n_balls)
    rate = np.where(scene.pinned, 0.0, sums / scene.mass)
    bound = rate[scene.pairs].sum(axis=1) * (weight > 0)
    worst = int(np.argmax(bound))
    ball = scene.pairs[worst, np.argmax(rate[scene.pairs[worst]])]
    return float(bound[worst]), int(np.argmax(weight * np.any(scene.pairs == ball, axis=1)))


def present_eigenvalue(scene: Scene, stiffness: Floats, damping: Floats, position: Floats) -> tuple[float, int]:
    """Bound on lambda_max(M^-1 A) at `position` (n, dim) [m], and a spring at the ball that sets it. A is K of `stiffness`
    (m,), the tension of its springs included, plus a damping matrix of `damping` (m,)."""
    pairs, dim = scene.pairs, scene.dim
    if not len(pairs):
        return 0.0, 0
    r = position[pairs[:, 1]] - position[pairs[:, 0]]
    d = np.linalg.norm(r, axis=1)
    n = r / np.where(d > 0, d, 1.0)[:, None]
    tense = np.where(d > 0, np.maximum(0.0, 1.0 - scene.rest_length / np.where(d > 0, d, 1.0)), 1.0)
    across = stiffness * tense
    along = (stiffness + damping - across)[:, None, None] * (n[:, :, None] * n[:, None, :])
    block = along + across[:, None, None] * np.eye(dim)
    block[d == 0] = (stiffness + damping)[d == 0, None, None] * np.eye(dim)
    x = np.where(scene.pinned, 0.0, 1.0)
    least, worst = np.inf, 0
    for _ in range(PRESENT_ROUNDS + 1):
        row = np.zeros((scene.n_balls, dim, dim))
        for here, there in ((0, 1), (1, 0)):
            i, j = pairs[:, here], pairs[:, there]
            share = 1.0 + x[j] / np.where(x[i] > 0, x[i], 1.0)
            for a in range(dim):
                for b in range(dim):
                    row[:, a, b] += np.bincount(i, share * block[:, a, b], scene.n_balls)
        rate = np.where(scene.pinned, 0.0, np.linalg.eigvalsh(row)[:, -1] / scene.mass)
        top = float(rate.max())
        if top < least:
            least, ball = top, int(np.argmax(rate))
            load = (stiffness + damping) * np.any(pairs == ball, axis=1)
            worst = int(np.argmax(load))
        if top <= 0.0:
            break
        x = np.where(scene.pinned, 0.0, np.maximum(x * np.sqrt(np.maximum(rate, 1e-12 * top) / top), 1e-12))
    return least, worst
