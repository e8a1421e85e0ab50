"""The benchmark's scenes as NumPy arrays: the program and its peers get exactly the same numbers."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.graph import incidence

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class Cloth(NamedTuple):
    """A free sheet of unit masses on undamped springs."""

    position: Floats  # (n, 3) m
    velocity: Floats  # (n, 3) m/s
    pairs: Ints  # (m, 2)
    stiffness: Floats  # (m,) N/m
    rest_length: Floats  # (m,) m
    gravity: tuple[float, float, float]  # m/s^2
    dt: float  # s, below every method's limit


class HalfSprings(NamedTuple):
    """Each spring from both its ends, sorted by ball and then by neighbour: ball i owns start[i] to start[i + 1]."""

    start: Ints  # (n + 1,)
    neighbour: Ints  # (2 m,)
    stiffness: NDArray[np.float32]  # (2 m,) N/m
    rest_length: NDArray[np.float32]  # (2 m,) m


class Balls(NamedTuple):
    """Balls of one radius and unit mass, in empty space or in a box: its floor at y = 0, its walls at 0 and side."""

    position: Floats  # (n, dim) m
    velocity: Floats  # (n, dim) m/s
    radius: float  # m
    restitution: float
    friction: float = 0.0
    side: float = 0.0  # m; 0: no box
    lid: bool = False  # whether the box is closed above
    gravity: float = 0.0  # m/s^2, downward
    dt: float = 1e-3  # s, of the program


def cloth_case(n: int, seed: int = 0) -> Cloth:
    """n x n balls 1 cm apart; structural, shear and bending springs, about 6 per ball (6 281 218 at n = 1024)."""
    a, k = 0.01, 1000.0
    rng = np.random.default_rng(seed)
    index = np.arange(n * n, dtype=np.int32).reshape(n, n)
    i, j = np.divmod(np.arange(n * n), n)
    position = np.stack([a * i, np.zeros(n * n), a * j], axis=1) + rng.uniform(-0.1 * a, 0.1 * a, (n * n, 3))
    families = [
        (index[:-1], index[1:], a),
        (index[:, :-1], index[:, 1:], a),
        (index[:-1, :-1], index[1:, 1:], np.sqrt(2) * a),
        (index[1:, :-1], index[:-1, 1:], np.sqrt(2) * a),
        (index[:-2], index[2:], 2 * a),
        (index[:, :-2], index[:, 2:], 2 * a),
    ]
    pairs = np.concatenate([np.stack([p.ravel(), q.ravel()], axis=1) for p, q, _ in families])
    rest = np.concatenate([np.full(p.size, length) for p, _, length in families])
    order = np.lexsort((pairs.max(axis=1), pairs.min(axis=1)))
    velocity = rng.uniform(-0.01, 0.01, (n * n, 3))
    return Cloth(
        position, velocity, pairs[order], np.full(len(rest), k), rest[order], (0.0, -10.0, 0.0), 0.2 / np.sqrt(24 * k)
    )


def half_springs(cloth: Cloth) -> HalfSprings:
    """The springs of a cloth seen from each ball."""
    start, neighbour, spring = incidence(cloth.pairs, len(cloth.position))
    stiffness, rest_length = (column[spring].astype(np.float32) for column in (cloth.stiffness, cloth.rest_length))
    return HalfSprings(start, neighbour, stiffness, rest_length)


def random_pack(n: int, seed: int = 0, shuffled: bool = True) -> tuple[Floats, float]:
    """n balls on a cubic lattice of spacing 1, jittered, in the lattice's order or in random order, and their radius.

    Volume fraction 0.56, 5 slight overlaps per ball.
    """
    rng = np.random.default_rng(seed)
    side = int(np.ceil(n ** (1 / 3) - 1e-9))
    lattice = np.stack(np.unravel_index(np.arange(n), (side, side, side)), axis=1).astype(np.float64)
    position = lattice + rng.uniform(-0.03, 0.03, (n, 3))
    return rng.permutation(position) if shuffled else position, 0.512


def pack_case(n: int, seed: int = 0, shuffled: bool = True) -> Balls:
    """random_pack with random velocities, restitution 0.5."""
    position, radius = random_pack(n, seed, shuffled)
    velocity = np.random.default_rng(seed + 1).standard_normal((n, 3))
    return Balls(position, velocity, radius, 0.5)


def box_of_discs(n: int = 100, seed: int = 0) -> Balls:
    """n discs that fill 0.6 of a box of side 1 m, on a jittered lattice, speeds about 1 m/s, 1 ms steps."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(n)))
    radius = float(np.sqrt(0.6 / (n * np.pi)))
    i, j = np.divmod(np.arange(n), side)
    gap = 1.0 / side - 2 * radius
    position = (np.stack([i, j], axis=1) + 0.5) / side + rng.uniform(-gap / 2, gap / 2, (n, 2))
    velocity = rng.standard_normal((n, 2))
    return Balls(position, velocity, radius, 0.5, side=1.0, lid=True, gravity=10.0)


def pile_case(n: int, seed: int = 0) -> Balls:
    """Discs in as many columns as rows, 0.12 m apart and jittered by 8 mm; radius 0.05 m, both coefficients 0.3, 240 Hz."""
    columns = int(np.ceil(np.sqrt(n)))
    row, column = np.divmod(np.arange(n), columns)
    jitter = np.random.default_rng(seed).uniform(-0.008, 0.008, (n, 2))
    position = 0.12 * (np.stack([column, row], axis=1) + 0.5) + jitter
    return Balls(position, 0 * position, 0.05, 0.3, 0.3, 0.12 * columns, gravity=10.0, dt=1 / 240)


def granular_case(n: int, seed: int = 0) -> Balls:
    """Close-packed layers, as high as wide, 1.5 % of a radius apart and jittered by 0.5 %: after a short fall they touch."""
    radius = 0.05
    cell = 2.015 * radius * np.sqrt(2.0)  # holds four balls
    count = int(np.ceil((n / 4) ** (1 / 3) - 1e-9))
    corner = np.stack(np.unravel_index(np.arange(count**3), (count,) * 3), axis=1)
    within = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0], [0.0, 0.5, 0.5]])
    position = cell * (corner[:, None] + within).reshape(-1, 3)
    position = position[np.argsort(position[:, 1], kind="stable")][:n] + 1.01 * radius
    position += np.random.default_rng(seed).uniform(-0.005 * radius, 0.005 * radius, position.shape)
    side = (count - 0.5) * cell + 2.02 * radius
    # in a step each layer sinks in by 2.4e-5 of the radius for each layer above it
    return Balls(position, 0 * position, radius, 0.3, 0.3, side, gravity=10.0, dt=1 / 1280)
