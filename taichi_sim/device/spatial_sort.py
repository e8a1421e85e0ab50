"""The order in which balls are stored: neighbours in space near each other in memory, whatever order the scene has."""

from copy import copy

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.scene import Scene

__all__ = ["in_order", "spatial_order"]

FEWEST_SORTED = 20_000  # balls; smaller scenes lie in the caches in any order


def spatial_order(scene: Scene) -> NDArray[np.int64] | None:
    """The scene's balls (n,) sorted by rows of cells along x, or None to store them as they come.

    A contact iteration over a million balls in random order takes three times as long as in this one. Springs are summed in the
    order of their balls, which a mesh or a lattice has good already: scenes with springs, or with anything else that names
    balls, are left alone.
    """
    if (
        scene.n_balls < FEWEST_SORTED
        or scene.n_springs
        or scene.has_elements()
        or scene.moving_pins
        or scene.solid.any()
    ):
        return None
    width = 2.0 * float(np.median(scene.radius))
    cells = np.floor(scene.position / width)
    return np.lexsort(cells.T)


def in_order(scene: Scene, order: NDArray[np.int64]) -> Scene:
    """A copy of a scene without springs or triangles, its balls in this order."""
    balls = scene.tables["balls"].copy()
    balls.replace(slice(None), **{name: balls[name][order] for name in balls.names})
    made = copy(scene)
    made.tables = Scene(scene.dim).tables | {"balls": balls}
    made.objects, made.embedded_surfaces = [], []
    return made
