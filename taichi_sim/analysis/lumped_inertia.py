"""Lumped inertia: bodies of few elements turn too slowly, since their mass lies at their balls. No Taichi.

A box of sides s has the second moments m s^2 / 12 about its middle; its eight corners, with an eighth of its mass each, have m
s^2 / 4. So a cuboid with n boxes along all sides has 1 + 2 / n^2 times its moment of inertia. A simplex with the corners x_k, k =
1 to d + 1, has about its centre m / ((d + 1) (d + 2)) sum x_k x_k^T, its corners have m / (d + 1) sum x_k x_k^T.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.coarse_meshes import in_common, objects_of
from taichi_sim.common.quantities import percent
from taichi_sim.scene.scene import Scene

__all__ = ["excess", "sluggish"]

Floats = NDArray[np.float64]

MUCH = 0.1  # of a moment of inertia, from which it is reported
FLAT = 1e-12  # of a box around all of a body: less may be rounding


def sluggish(scene: Scene) -> Iterator[tuple[str, str]]:
    """Sentence and cure for each body of bricks, solids or cells whose moment of inertia is much too large."""
    of = objects_of(scene)
    for elements in (scene.bricks, scene.solids, scene.cells):
        bodies = in_common(of[elements])
        for k in np.unique(bodies[bodies >= 0]):
            more = excess(scene.position[elements[bodies == k]])
            if more > MUCH:
                yield (
                    f"{scene.objects[k].name} turns as if its moment of inertia were {percent(more)} larger, since its mass lies"
                    f" at its balls: it rocks and twists about its middle in {percent(np.sqrt(1.0 + more) - 1.0)} more time",
                    "take more elements across: with m along each side it is 2 / m^2 larger",
                )


def excess(corners: Floats) -> float:
    """Part by which masses at the corners (e, k, dim) [m] of boxes or simplices of one density raise the moment of inertia, about
    the axis where that is most; 0 where they are flat."""
    k, dim = corners.shape[1:]
    centre = corners.mean(axis=1)
    own = corners - centre[:, None]
    edges = own[:, 1:] - own[:, :1] if k == dim + 1 else own[:, [1 << axis for axis in range(dim)]] - own[:, :1]
    volume = np.abs(np.linalg.det(edges))
    part = 1.0 / (dim + 2) if k == dim + 1 else 1.0 / 3.0  # of the moments of the corners that an element has
    if volume.sum() <= FLAT * float(np.ptp(corners, axis=(0, 1)).max()) ** dim:
        return 0.0
    volume /= volume.sum()
    apart = centre - volume @ centre
    between = np.einsum("e,ea,eb->ab", volume, apart, apart)
    lumped = np.einsum("e,eka,ekb->ab", volume, own, own) / k
    true, more = between + part * lumped, (1.0 - part) * lumped
    if dim == 2:
        return float(np.trace(more) / np.trace(true))
    about, beyond = (np.trace(one) * np.eye(3) - one for one in (true, more))
    return float(np.linalg.eigvals(np.linalg.solve(about, beyond)).real.max())
