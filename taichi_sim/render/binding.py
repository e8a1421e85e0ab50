"""Binding: vertices that follow balls, each at a weighted mean of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, identity, vstack

from taichi_sim.render.subdivision import subdivide
from taichi_sim.scene.embedded_surfaces import EmbeddedSurface

__all__ = ["Binding"]


@dataclass(frozen=True, slots=True, eq=False)
class Binding:
    """weights (s, n): of the n balls for each of s vertices, 1 in sum. tint (s, 3): sRGB of the vertices that have a colour of
    their own, nan for those that take that of their balls."""

    weights: csr_array
    tint: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.tint)

    @classmethod
    def of(cls, surfaces: Sequence[EmbeddedSurface], triangles: NDArray, n: int) -> "tuple[NDArray, Binding]":
        """Triangles (t, 3) of n balls and those of surfaces together, with vertices counted from n on; their binding."""
        first = n + np.cumsum([0, *(len(surface.corners) for surface in surfaces)])
        none, used = np.full(3, np.nan), [surface.weights != 0 for surface in surfaces]
        start = np.cumsum(np.concatenate([[0], *(np.count_nonzero(entries, axis=1) for entries in used)]))
        ball = np.concatenate([np.zeros(0, np.int32), *(s.corners[entries] for s, entries in zip(surfaces, used))])
        weight = np.concatenate([np.zeros(0), *(s.weights[entries] for s, entries in zip(surfaces, used))])
        tints = (np.tile(surface.colour or none, (len(surface.corners), 1)) for surface in surfaces)
        return np.concatenate([triangles, *(surface.triangles + k for surface, k in zip(surfaces, first))]), cls(
            csr_array((weight, ball, start.astype(np.int32)), shape=(len(start) - 1, n)),
            np.concatenate([np.zeros((0, 3)), *tints]),
        )

    @classmethod
    def finer(
        cls, surfaces: Sequence[EmbeddedSurface], triangles: NDArray, n: int, times: int
    ) -> "tuple[NDArray, Binding]":
        """Triangles and binding, as `of` gives them, of surfaces that are subdivided `times` times. All triangles are then
        of vertices that follow balls."""
        faces, base = cls.of(surfaces, triangles, n)
        if not times or not len(faces):
            return faces, base
        used, compact = np.unique(faces, return_inverse=True)
        faces = compact.reshape(-1, 3)
        weights = csr_array(vstack([identity(n), base.weights]))[used]
        tint = np.concatenate([np.full((n, 3), np.nan), base.tint])[used]
        for _ in range(times):
            faces, shares = subdivide(faces, len(tint))
            weights = shares @ weights
            tint = tint[shares.indices[shares.indptr[:-1]]]  # one to each surface
        weights.sort_indices()
        return faces + n, cls(weights, tint)

    def apply(self, values: NDArray) -> NDArray[np.float64]:
        """The weighted means (s, width) of values (n, width) of the balls."""
        means: NDArray[np.float64] = self.weights @ values
        return means

    def colours(self, colour: NDArray) -> NDArray[np.float64]:
        """sRGB (s, 3) of the vertices, from that of the balls (n, 3)."""
        return np.where(np.isnan(self.tint), np.clip(self.apply(colour), 0.0, 1.0), self.tint)
