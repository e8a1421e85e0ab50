"""Energy, momentum and overlap of a scene in a given state, in float64 NumPy: slow, plain, and independent of the kernels."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.groups import meet
from taichi_sim.scene import Scene

__all__ = ["Energy", "angular_momentum", "energy", "inertia", "momentum", "strain", "wall_overlap"]

Floats = NDArray[np.float64]


class Energy(NamedTuple):
    """Joule. Gravity's is 0 at the origin."""

    kinetic: float
    spring: float
    gravity: float
    total: float


def _moving(scene: Scene) -> Floats:
    """Masses (n,) [kg], 0 for pinned balls: they count in no momentum or energy."""
    return np.where(scene.pinned, 0.0, scene.mass)


def energy(scene: Scene, x: Floats, v: Floats, spin: Floats | None = None) -> Energy:
    """Energy of positions x and velocities v, both (n, dim), and of angular velocities (n, 1 or 3) [1/s]."""
    m = _moving(scene)
    kinetic = 0.5 * float(np.sum(m * np.sum(v * v, axis=1)))
    if spin is not None:
        kinetic += 0.5 * float(np.sum(inertia(scene) * np.sum(spin * spin, axis=1)))
    r = x[scene.pairs[:, 1]] - x[scene.pairs[:, 0]]
    stretch = np.linalg.norm(r, axis=1) - scene.rest_length
    spring = 0.5 * float(np.sum(scene.stiffness * stretch**2))
    gravity = 0.0 - float(np.sum(m * (x @ scene.gravity)))
    return Energy(kinetic, spring, gravity, kinetic + spring + gravity)


def momentum(scene: Scene, v: Floats) -> Floats:
    """Sum of m v, (dim,) kg m/s."""
    return _moving(scene) @ v


def inertia(scene: Scene) -> Floats:
    """Moments of inertia (n,) [kg m^2]: discs in 2D, solid spheres in 3D; 0 for pinned balls."""
    return _moving(scene) * scene.radius**2 * (0.5 if scene.dim == 2 else 0.4)


def angular_momentum(scene: Scene, x: Floats, v: Floats, spin: Floats | None = None) -> Any:
    """Sum of m x cross v + I spin about the origin [kg m^2/s]: a float in 2D, (3,) in 3D."""
    m = _moving(scene)
    own = inertia(scene) @ (np.zeros((len(m), 1 if scene.dim == 2 else 3)) if spin is None else spin)
    if scene.dim == 2:
        return float(np.sum(m * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])) + own[0])
    return np.sum(m[:, None] * np.cross(x, v), axis=0) + own


def strain(scene: Scene, x: Floats) -> Floats:
    """Relative stretch (m,) of each spring: (length - rest) / rest, 0 where the rest length is 0."""
    length = np.linalg.norm(x[scene.pairs[:, 1]] - x[scene.pairs[:, 0]], axis=1)
    rest = scene.rest_length
    return np.divide(length - rest, rest, out=np.zeros_like(rest), where=rest > 0)


def wall_overlap(scene: Scene, x: Floats) -> float:
    """Largest overlap [m] of a ball that can move with a wall; 0 with none."""
    free = ~scene.pinned
    deepest = 0.0
    for wall in scene.walls:
        depth = wall.offset + scene.radius - x @ np.array(wall.normal)
        minded = free & meet(scene.group, scene.mask, wall.group, wall.mask)
        deepest = max(deepest, float(np.max(depth[minded], initial=0.0)))
    return deepest
