"""What a method makes of the damping of the slowest motions of a scene, worked out before anything runs.

A mode of small motion obeys q'' + d q' + omega^2 q = 0, with omega and its shape from the springs at present and d from their
damping of that shape. A step of h seconds takes it on by a small matrix, whose eigenvalues tell the decay that will be seen.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.damping import decay, lone, softened, stages
from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.analysis.stability import predicts_damping
from taichi_sim.scene.scene import Scene

__all__ = ["Decay", "slow_decays", "step_matrix"]

Floats = NDArray[np.float64]

MOST = 900  # free coordinates, for which a dense eigenvalue problem takes a second
SLOW = 3.0  # times the slowest frequency, up to which motions count as slow
STILL = 1e-6  # of the fastest mode's omega: motion that no spring resists
BLUR = 4.0 * 2.0**-23  # of places: what single precision may make of a stretch
GAMMA = 2.0 - float(np.sqrt(2.0))  # of TR-BDF2


class Decay(NamedTuple):
    """`frequency` [Hz] of a mode without damping; rates [1/s] at which it decays, as the springs say and with the step."""

    frequency: float
    exact: float
    found: float


def slow_decays(scene: Scene, method: str, h: float, position: Floats) -> list[Decay]:
    """The slowest modes at `position` (n, dim) [m] with steps of h seconds; none where the scene is too large to work them out,
    has cells, bending or gas, which are left out here, or no springs."""
    free = np.flatnonzero(~scene.pinned)
    if not scene.n_springs or any(element_rates(scene)) or not 0 < len(free) * scene.dim <= MOST:
        return []
    k, dim = scene.stiffness, scene.dim
    r = position[scene.pairs[:, 1]] - position[scene.pairs[:, 0]]
    length = np.linalg.norm(r, axis=1)
    n = r / np.where(length > 0, length, 1.0)[:, None]
    along = n[:, :, None] * n[:, None, :]
    whole = np.where(length > 0, length, 1.0)
    tense = np.where(length > 0, np.maximum(0.0, 1.0 - scene.rest_length / whole), 1.0)
    tense[tense < BLUR * np.abs(position).max() / whole] = (
        0.0  # else what no spring resists would seem to be the slowest
    )
    block = (k * (1.0 - tense))[:, None, None] * along + (k * tense)[:, None, None] * np.eye(dim)
    omega2, shape = np.linalg.eigh(_assembled(scene, free, block))
    slow = np.flatnonzero(omega2 > STILL**2 * omega2[-1])
    slow = slow[omega2[slow] <= SLOW**2 * omega2[slow[:1]]]
    used = scene.damping
    if method == "verlet" and not predicts_damping(scene):
        used = np.where(lone(scene), used, softened(scene, 0.5 * h))
    D, of_method = (_assembled(scene, free, c[:, None, None] * along) for c in (scene.damping, used))
    decays = []
    for mode in slow:
        q, omega = shape[:, mode], float(np.sqrt(omega2[mode]))
        d, taken = float(q @ D @ q), float(q @ of_method @ q)
        exact = np.roots([1.0, d, omega**2]).astype(complex)
        exact = exact[np.argmax(exact.real)]
        values = np.linalg.eigvals(step_matrix(scene, method, omega, taken, h)).astype(complex)
        rates = np.log(np.where(values == 0, 1e-300, values)) / h
        near = rates[np.argmin(np.abs(rates.real - exact.real) + np.abs(np.abs(rates.imag) - abs(exact.imag)))]
        decays.append(Decay(omega / (2.0 * np.pi), -float(exact.real), -float(near.real)))
    return decays


def step_matrix(scene: Scene, method: str, omega: float, d: float, h: float) -> Floats:
    """What a step makes of place and velocity of q'' + d q' + omega^2 q = 0. xpbd: as implicit Euler, which it is where springs
    are soft enough for a single pass. verlet at predicted velocities: and of the acceleration of the step before."""
    k = omega**2
    A = np.array([[0.0, 1.0], [-k, -d]])
    one = np.eye(2)
    if method == "explicit_euler":
        return one + h * A
    if method == "symplectic_euler":
        return np.array([[1.0 - h * h * k, h * (1.0 - h * d)], [-h * k, 1.0 - h * d]])
    if method == "rk4":
        return one + h * A @ (one + h * A @ (one + h * A @ (one + h * A / 4.0) / 3.0) / 2.0)
    if method in ("implicit_euler", "xpbd"):
        return np.asarray(np.linalg.inv(one - h * A), dtype=np.float64)
    if method == "tr_bdf2":
        part = 0.5 * GAMMA * h
        middle = np.linalg.solve(one - part * A, one + part * A)
        weight = float(1.0 / (GAMMA * (2.0 - GAMMA)))
        end = np.linalg.solve(one - part * A, weight * middle + (1.0 - weight) * one)
        return np.asarray(end, dtype=np.float64)
    if predicts_damping(scene):
        drift = np.array([[1.0, h, 0.5 * h * h], [0.0, 1.0, 0.5 * h]])  # the place, the velocity in the middle
        pull = -k * drift[0] - d * np.array([0.0, 1.0, h])
        return np.array([drift[0], drift[1] + 0.5 * h * pull, pull])
    if d == 0.0:
        left, gone = 1.0, h  # the part that both halves leave, and (1 - R) / d
    else:
        z = np.array([0.5 * h * d])
        alone = not np.any((scene.damping > 0) & ~lone(scene))
        left = float(np.exp(-2.0 * z[0]) if alone else decay(stages(scene, 0.5 * h), z)[0])
        gone = (1.0 - left) / d
    return np.array([[1.0 - h * k * gone, h * left], [-k * gone, left]])  # the kick between two drifts, and a drift


def _assembled(scene: Scene, free: NDArray[np.int64], block: Floats) -> Floats:
    """M^-1/2 sum of blocks (m, dim, dim) M^-1/2 of the free balls."""
    n, dim = scene.n_balls, scene.dim
    A = np.zeros((n, n, dim, dim))
    i, j = scene.pairs.T
    np.add.at(A, (i, i), block)
    np.add.at(A, (j, j), block)
    np.add.at(A, (i, j), -block)
    np.add.at(A, (j, i), -block)
    root = 1.0 / np.sqrt(scene.mass[free])
    A = A[np.ix_(free, free)] * (root[:, None] * root)[:, :, None, None]
    return A.transpose(0, 2, 1, 3).reshape(len(free) * dim, -1)
