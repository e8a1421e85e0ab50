"""Binding: vertices that follow balls, each at a weighted mean of them, as sparse rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.render.subdivision import Rows, compose, subdivide
from taichi_sim.scene.embedded_surfaces import EmbeddedSurface

__all__ = ["Binding"]


@dataclass(frozen=True, slots=True, eq=False)
class Binding:
    """Row k, entries start[k] to start[k + 1]: the balls `entry` that vertex k follows and their `weight`, 1 in sum.

    tint (s, 3): sRGB of the vertices that have a colour of their own, nan for those that take that of their balls.
    """

    start: NDArray[np.int32]  # (s + 1,)
    entry: NDArray[np.int32]  # (e,)
    weight: NDArray[np.float64]  # (e,)
    tint: NDArray[np.float64]

    @classmethod
    def finer(
        cls, surfaces: Sequence[EmbeddedSurface], triangles: NDArray, n: int, times: int
    ) -> "tuple[NDArray, Binding]":
        """The same for surfaces subdivided so many times; then all triangles are of vertices that follow balls."""
        faces, base = cls.of(surfaces, triangles, n)
        if not times or not len(faces):
            return faces, base
        used, compact = np.unique(faces, return_inverse=True)
        faces = compact.reshape(-1, 3)
        own = np.repeat(np.arange(len(base)) + n, np.diff(base.start))
        rows: Rows = (
            np.concatenate([np.arange(n), own]),
            np.concatenate([np.arange(n), base.entry]).astype(np.int64),
            np.concatenate([np.ones(n), base.weight]),
        )
        rows = compose((np.arange(len(used)), used.astype(np.int64), np.ones(len(used))), rows, n)
        tint = np.concatenate([np.full((n, 3), np.nan), base.tint])[used]
        for _ in range(times):
            faces, weights = subdivide(faces, len(tint))
            rows = compose(weights, rows, n)
            tint = tint[
                weights[1][np.searchsorted(weights[0], np.arange(weights[0][-1] + 1))]
            ]  # one tint to each surface
        start = np.searchsorted(rows[0], np.arange(len(tint) + 1))
        return faces + n, cls(start.astype(np.int32), rows[1].astype(np.int32), rows[2], tint)

    def __len__(self) -> int:
        return len(self.tint)

    @classmethod
    def of(cls, surfaces: Sequence[EmbeddedSurface], triangles: NDArray, n: int) -> "tuple[NDArray, Binding]":
        """Triangles (t, 3) of n balls and those of surfaces together, with vertices counted from n on; their binding."""
        counts = [np.count_nonzero(skin.weights, axis=1) for skin in surfaces]
        first = n + np.cumsum([0, *(len(skin.corners) for skin in surfaces)])
        none = np.full(3, np.nan)
        return np.concatenate([triangles, *(skin.triangles + k for skin, k in zip(surfaces, first))]), cls(
            np.cumsum(np.concatenate([[0], *counts])).astype(np.int32),
            np.concatenate([np.zeros(0, np.int32), *(skin.corners[skin.weights != 0] for skin in surfaces)]),
            np.concatenate([np.zeros(0), *(skin.weights[skin.weights != 0] for skin in surfaces)]),
            np.concatenate(
                [
                    np.zeros((0, 3)),
                    *(np.tile(skin.colour or none, (len(skin.corners), 1)) for skin in surfaces),
                ]
            ),
        )

    def apply(self, values: NDArray) -> NDArray[np.float64]:
        """The weighted means (s, width) of values (n, width) of the balls."""
        if not len(self):
            return np.zeros((0, values.shape[1]))
        return np.add.reduceat(self.weight[:, None] * values[self.entry], self.start[:-1])

    def colours(self, colour: NDArray) -> NDArray[np.float64]:
        """sRGB (s, 3) of the vertices, from that of the balls (n, 3)."""
        return np.where(np.isnan(self.tint), np.clip(self.apply(colour), 0.0, 1.0), self.tint)
