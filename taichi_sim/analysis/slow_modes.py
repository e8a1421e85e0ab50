"""Damping of the slowest motions of a scene by a method, worked out before anything runs.

A mode of small motion obeys q'' + d q' + omega^2 q = 0, with omega and its shape from the springs and bending elements at
present and d from their damping of that shape. A step of h seconds takes it on by a small matrix, whose eigenvalues tell the
decay that will be seen.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.analysis.methods import Method
from taichi_sim.geometry.graph import components
from taichi_sim.scene.bending import BENDING
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.part import Quadratic
from taichi_sim.scene.scene import Scene

__all__ = ["Decay", "not_worked_out", "slow_decays"]

Floats = NDArray[np.float64]

MOST = 900  # free coordinates, for which a dense eigenvalue problem takes a second
SLOW = 3.0  # times the slowest frequency, up to which motions count as slow
STILL = 1e-6  # of the fastest mode's omega: motion that nothing resists
CARRIED = 0.05  # part of the load that may be carried by nothing near a place of rest
SMALL = 0.1  # strain up to which springs stretch in proportion to their load
ONE_MOTION = 0.5  # sum of squares over orthonormal modes, above which one of them at least is there
BLUR = 8.0  # times the rounding of places: what that may make of a stretch


class Decay(NamedTuple):
    """`frequency` [Hz] of a mode without damping; rates [1/s] at which it decays, as the scene says and with the step. hangs: the
    scene also has motions that no spring resists and gravity does, such as the swing of a net, which are slower."""

    frequency: float
    exact: float
    found: float
    hangs: bool = False
    swings: bool = True


def not_worked_out(scene: Scene) -> str:
    """Why the modes of a scene with springs are not worked out; empty where they are."""
    free = int(np.count_nonzero(~scene.pinned))
    if not scene.n_springs or not free:
        return ""
    if any(element_rates(scene, solved=(BENDING,))):
        names = [one.words for one in ELEMENTS if one.acts(scene) and one is not BENDING]
        return f"the slowest motions are found for springs and bending alone; this scene also has {', '.join(names)}"
    return f"{free} free balls are more than the {MOST // scene.dim} analysed" if free * scene.dim > MOST else ""


def slow_decays(scene: Scene, method: Method, h: float, position: Floats) -> list[Decay]:
    """The slowest modes at `position` (n, dim) [m] with steps of h seconds, the slowest first; none of a scene that
    `not_worked_out` gives a reason for, without springs or free balls, and of a method that declares no amplification."""
    free = np.flatnonzero(~scene.pinned)
    if not scene.n_springs or not len(free) or not_worked_out(scene):
        return []
    position, digit = _as_given(scene, position)
    along, tense = _directions(scene, position, digit)
    omega2, shape = _modes(scene, free, along, tense)
    loaded = tense + _loaded(scene, free, position, tense, omega2, shape)
    if np.any(loaded != tense):
        omega2, shape = _modes(scene, free, along, loaded)
    hangs = _hangs(scene, free, shape[:, omega2 <= STILL**2 * omega2[-1]])
    slow = np.flatnonzero(omega2 > STILL**2 * omega2[-1])
    slow = slow[omega2[slow] <= SLOW**2 * omega2[slow[:1]]]
    dampings = (scene.damping, method.spring_damping(scene, h))
    bends = BENDING.damping(scene)
    D, of_method = (_assembled(scene, free, c[:, None, None] * along, bends) for c in dampings)
    decays = []
    for mode in slow:
        q, omega = shape[:, mode], float(np.sqrt(omega2[mode]))
        d, taken = float(q @ D @ q), float(q @ of_method @ q)
        exact = np.roots([1.0, d, omega**2]).astype(complex)
        exact = exact[np.argmax(exact.real)]
        step = method.amplification(scene, omega, taken, h)
        if step is None:
            return []
        values = np.linalg.eigvals(step).astype(complex)
        rates = np.log(np.where(values == 0, 1e-300, values)) / h
        near = rates[np.argmin(np.abs(rates.real - exact.real) + np.abs(np.abs(rates.imag) - abs(exact.imag)))]
        decays.append(Decay(omega / (2.0 * np.pi), -float(exact.real), -float(near.real), hangs, d < 2.0 * omega))
    return decays


def _hangs(scene: Scene, free: NDArray[np.int64], still: Floats) -> bool:
    """True if motions (free coordinates, k) that nothing resists move a body which is held somewhere, under gravity. A free body
    has such motions, too: it falls and turns."""
    if not np.any(scene.gravity):
        return False
    body = components(scene.n_balls, scene.pairs)
    held = np.repeat(np.isin(body[free], body[scene.pinned]), scene.dim)
    return bool(np.sum(still[held] ** 2) > ONE_MOTION)


def _modes(scene: Scene, free: NDArray[np.int64], along: Floats, tense: Floats) -> tuple[Floats, Floats]:
    """Squares of omega [1/s^2] and shapes of all modes, in coordinates times the roots of masses. What is pressed resists no
    motion across, and is taken not to help it."""
    across = scene.stiffness * np.maximum(tense, 0.0)
    block = (scene.stiffness - across)[:, None, None] * along + across[:, None, None] * np.eye(scene.dim)
    omega2, shape = np.linalg.eigh(_assembled(scene, free, block, BENDING.stiffness(scene)))
    return omega2, shape


def _loaded(
    scene: Scene, free: NDArray[np.int64], position: Floats, tense: Floats, omega2: Floats, shape: Floats
) -> Floats:
    """Tension (m,) over stiffness times length that springs get where the scene comes to rest under its weight: a rope that hangs
    unstretched at the start, say. 0 where that is not near, as what nothing resists carries part of the weight."""
    force = scene.mass[:, None] * scene.gravity
    r = position[scene.pairs[:, 1]] - position[scene.pairs[:, 0]]
    length = np.maximum(np.linalg.norm(r, axis=1), 1e-300)
    pull = (scene.stiffness * tense)[:, None] * r
    np.add.at(force, scene.pairs[:, 0], pull)
    np.add.at(force, scene.pairs[:, 1], -pull)
    for corners, gradient, strength in BENDING.stiffness(scene):
        bent = np.einsum("bk,bki->bi", gradient[:, :, 0], position[corners]) * strength[:, None]
        np.add.at(force, corners, -gradient * bent[:, None])
    root = np.sqrt(scene.mass[free])[:, None]
    part = shape.T @ (force[free] / root).ravel()
    still = omega2 <= STILL**2 * omega2[-1]
    if np.linalg.norm(part[still]) > CARRIED * np.linalg.norm(part):
        return np.zeros_like(length)
    moved = np.zeros_like(position)
    moved[free] = (shape[:, ~still] @ (part[~still] / omega2[~still])).reshape(len(free), -1) / root
    stretch = np.einsum("mi,mi->m", moved[scene.pairs[:, 1]] - moved[scene.pairs[:, 0]], r) / length**2
    return stretch if np.abs(stretch).max() < SMALL else np.zeros_like(length)


def _as_given(scene: Scene, position: Floats) -> tuple[Floats, float]:
    """Positions (n, dim) [m], those of the scene where a run holds them but rounded, and the rounding of their digits."""
    exact = np.where(position == scene.position.astype(np.float32), scene.position, position)
    moved = np.any(exact != scene.position)
    single = moved and np.array_equal(position, position.astype(np.float32))
    return exact, 2.0**-24 if single else 2.0**-53


def _directions(scene: Scene, position: Floats, digit: float) -> tuple[Floats, Floats]:
    """Projections (m, dim, dim) along the springs, and their tension (m,) over stiffness times length; 0 where it is no more than
    rounding of digits makes of places, which else would seem to resist what nothing does."""
    r = position[scene.pairs[:, 1]] - position[scene.pairs[:, 0]]
    length = np.linalg.norm(r, axis=1)
    whole = np.where(length > 0, length, 1.0)
    n = r / whole[:, None]
    tense = np.where(length > 0, 1.0 - scene.rest_length / whole, 1.0)
    blur = BLUR * digit * np.abs(position).max() / whole
    return n[:, :, None] * n[:, None, :], np.where(np.abs(tense) < blur, 0.0, tense)


def _assembled(scene: Scene, free: NDArray[np.int64], block: Floats, bends: list[Quadratic]) -> Floats:
    """M^-1/2 sum M^-1/2 of the free balls, over blocks (m, dim, dim) of springs and over bends."""
    n, dim = scene.n_balls, scene.dim
    A = np.zeros((n, n, dim, dim))
    i, j = scene.pairs.T
    np.add.at(A, (i, i), block)
    np.add.at(A, (j, j), block)
    np.add.at(A, (i, j), -block)
    np.add.at(A, (j, i), -block)
    for corners, gradient, strength in bends:
        both = strength[:, None, None] * gradient * gradient[:, None, :, 0]
        np.add.at(A, (corners[:, :, None], corners[:, None, :]), both[..., None, None] * np.eye(dim))
    root = 1.0 / np.sqrt(scene.mass[free])
    A = A[np.ix_(free, free)] * (root[:, None] * root)[:, :, None, None]
    return A.transpose(0, 2, 1, 3).reshape(len(free) * dim, -1)
