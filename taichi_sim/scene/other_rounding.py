"""Other rounding: the numbers of a scene, rounded to another neighbour in single precision than they usually are."""

from copy import copy

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.scene.columns import sealed
from taichi_sim.scene.scene import Scene

__all__ = ["other_neighbour", "rounded_otherwise"]

# how far; rest lengths by another distance than places, or both would often cancel in the stretch of a spring
ROUNDED = {
    "balls": {"mass": 1, "radius": 1},
    "springs": {"stiffness": 1, "damping": 1, "rest_length": 3},
}


def other_neighbour(values: ArrayLike, times: int = 1) -> NDArray[np.float64]:
    """The farther of the two numbers of single precision around each value, or one so many times as far from the nearer one. A
    value that is such a number itself stays."""
    exact = np.asarray(values, dtype=np.float64)
    with np.errstate(over="ignore", under="ignore"):
        near = exact.astype(np.float32)
        farther = np.nextafter(near, np.where(near > exact, -np.inf, np.inf).astype(np.float32)).astype(np.float64)
    rounded = near.astype(np.float64)
    moves = (rounded != exact) & np.isfinite(farther)
    return rounded + times * np.subtract(farther, rounded, out=np.zeros_like(exact), where=moves)


def rounded_otherwise(scene: Scene) -> Scene:
    """A frozen copy with gravity, masses, radii, stiffness, damping and rest lengths rounded so. Where they have gone into
    something else, as shapes at rest into cells, that stays."""
    made = copy(scene.frozen())
    made._gravity = sealed(other_neighbour(scene.gravity))
    for name, columns in ROUNDED.items():
        table = made._tables()[name].copy()
        table.replace(slice(None), **{key: other_neighbour(table[key], times) for key, times in columns.items()})
        setattr(made, f"_{name}", table)
    return made
