"""Binding: vertices that follow balls, each at a weighted mean of them, as sparse rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.skins import Skin

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

    def __len__(self) -> int:
        return len(self.tint)

    @classmethod
    def of(cls, skins: Sequence[Skin], triangles: NDArray, n: int) -> "tuple[NDArray, Binding]":
        """Triangles (t, 3) of n balls and those of skins together, the vertices of skins counted from n on; their binding."""
        counts = [np.count_nonzero(skin.weights, axis=1) for skin in skins]
        first = n + np.cumsum([0, *(len(skin.corners) for skin in skins)])
        none = np.full(3, np.nan)
        return np.concatenate([triangles, *(skin.triangles + k for skin, k in zip(skins, first))]), cls(
            np.cumsum(np.concatenate([[0], *counts])).astype(np.int32),
            np.concatenate([np.zeros(0, np.int32), *(skin.corners[skin.weights != 0] for skin in skins)]),
            np.concatenate([np.zeros(0), *(skin.weights[skin.weights != 0] for skin in skins)]),
            np.concatenate(
                [np.zeros((0, 3)), *(np.tile(skin.colour or none, (len(skin.corners), 1)) for skin in skins)]
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
