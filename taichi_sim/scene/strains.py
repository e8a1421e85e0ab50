"""Strains of triangles, bricks and solids, and which elements tearing springs leave whole."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.elements import ELEMENTS

__all__ = ["STRAINED", "cut", "element_strains"]

Floats = NDArray[np.float64]
STRAINED = tuple(element for element in ELEMENTS if hasattr(element, "gradients"))


def element_strains(scene: Any, x: Floats, torn: NDArray[np.bool_] | None) -> list[tuple[NDArray, Floats]]:
    """Balls (e, k) and strains (e,) [1] of the triangles, bricks and solids of a scene at x (n, dim) [m]. torn: springs (m,).

    The strain is the principal one that is the largest in amount, with its sign; that of a brick at its centre.
    """
    found = []
    for element in STRAINED:
        corners = element.corners(scene)
        if torn is not None and torn.any():
            whole = ~cut(corners, scene.pairs[torn], scene.n_balls)
        else:
            whole = np.ones(len(corners), dtype=bool)
        if whole.any():
            found.append((corners[whole], _largest(element.gradients(scene, x)[whole])))
    return found


def _largest(gradient: Floats) -> Floats:
    """The principal strain (e,) that is largest in amount, of deformation gradients (e, dim, dim or 2)."""
    stretch = np.linalg.svd(gradient, compute_uv=False)
    if gradient.shape[1] == gradient.shape[2]:  # what is turned inside out is shorter than nothing
        stretch[:, -1] *= np.sign(np.linalg.det(gradient))
    strain = stretch - 1.0
    return np.asarray(strain[np.arange(len(strain)), np.abs(strain).argmax(axis=1)])


def cut(triangles: NDArray, torn: NDArray, n: int) -> NDArray[np.bool_]:
    """Mask (t,) of the triangles (t, 3), or elements (t, more), of n balls that hold both balls of one of the pairs (k, 2)."""
    k = triangles.shape[1]
    sides = np.sort(triangles[:, [[a, b] for b in range(k) for a in range(b)]].astype(np.int64), axis=2)
    pairs = np.sort(torn.astype(np.int64), axis=1)
    gone = np.isin(sides[..., 0] * n + sides[..., 1], pairs[:, 0] * n + pairs[:, 1])
    return np.asarray(gone.any(axis=1))
