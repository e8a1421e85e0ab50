"""Heat of rounding: the energy that explicit methods add where single precision rounds places. Plain numbers; no Taichi."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.part import Quadratic
from taichi_sim.scene.scene import Scene

__all__ = ["CURE", "MARGIN", "WHY", "heat_of_rounding"]

MARGIN = 5.0  # times the estimate: plates and nets of springs gain 2.3 to 3 times that by methods of order 1 and 2
CURE = 'take precision "f64"'

WHY = "single precision rounds places, and forces at these kick what is stiff at random"
ALIKE = 1e-30  # m; ends of a spring that are nearer to each other have no direction


def heat_of_rounding(scene: Scene, h: float, elements: bool) -> float:
    """Power [W] that steps of h seconds add. elements: those read rounded places, too, and not springs alone.

    Places are off by ulp / sqrt(12), which changes from step to step. A force that is off by dF kicks a ball by h dF / m. It adds
    (h dF)^2 / (2 m) in each step. It grows with the step, and where damping takes it again, it is an upper bound.
    """
    off = np.spacing(np.abs(scene.position).astype(np.float32)).astype(np.float64) ** 2 / 12.0  # (n, dim) m^2
    square = np.zeros(scene.n_balls)  # of forces, N^2
    for kind in _stiff(scene, elements):
        size = np.sum(kind.gradient**2, axis=2)  # of forces on each corner
        if kind.gradient.shape[2] == 1:  # in each direction alike
            kicks = np.einsum("ek,ekd->e", size, off[kind.corners])
        else:
            kicks = np.einsum("ekd,ekd->e", kind.gradient**2, off[kind.corners])
        np.add.at(square, kind.corners, size * (kind.strength**2 * kicks)[:, None])
    free = ~scene.pinned
    return 0.5 * h * float(np.sum(square[free] / scene.mass[free]))


def _stiff(scene: Scene, elements: bool) -> Iterator[Quadratic]:
    """Springs and elements as they are at the start."""
    if scene.n_springs:
        along = scene.position[scene.pairs[:, 1]] - scene.position[scene.pairs[:, 0]]
        n: NDArray[np.float64] = along / np.maximum(np.linalg.norm(along, axis=1), ALIKE)[:, None]
        yield Quadratic(scene.pairs, np.stack([-n, n], axis=1), scene.stiffness)
    for one in ELEMENTS if elements else ():
        if one.count(scene):
            yield from one.stiffness(scene)
