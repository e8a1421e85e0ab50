"""Slices: lists of balls stored so that neighbouring threads of a device read neighbouring memory."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import on_device
from taichi_sim.geometry.graph import sliced
from taichi_sim.kernels.loops import SLICE

__all__ = ["Slices"]

# places for each entry: with more, balls that have many entries would waste the memory of those beside them
SPARSEST = 1.5


class Slices(NamedTuple):
    """Layout of the lists that kernels.loops.list_entry reads. start (slices): the first place of each slice; place (entries):
    that of each entry; room: all places, of which some are idle."""

    start: NDArray[np.int32]
    place: NDArray[np.int64]
    room: int

    @classmethod
    def of(cls, start: NDArray[np.int32]) -> "Slices | None":
        """Slices of lists that lie one behind the other from start (n + 1) on; None on a CPU, and where lists differ so much in
        length that they had better stay so."""
        if not on_device() or start[-1] == 0:
            return None
        slices = cls(*sliced(start, SLICE))
        return slices if slices.room <= SPARSEST * start[-1] else None

    def spread(self, values: NDArray, idle: int = 0) -> NDArray:
        """A value, or a row of them, for each place, from one for each entry."""
        spread = np.full((self.room, *values.shape[1:]), idle, dtype=values.dtype)
        spread[self.place] = values
        return spread
