"""Corners: elements of several balls, listed for each ball, so that each sums its own forces, without atomics."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model

__all__ = ["CORNER_NAMES", "Corners"]

CORNER_NAMES = "abcdefgh"  # of the balls in a row


@ti.data_oriented
class Corners:
    """What a force of elements is made of: `start` (n + 1) and `row`, those of ball i from start[i] to start[i + 1], in the order
    of the elements. `gone` (r), where springs can tear: rows whose element has lost a side, see forces.tearing.
    """

    def gather(
        self,
        model: Model,
        fields: Fields,
        others: NDArray,
        own: NDArray,
        columns: dict[str, Any],
        data: dict[str, NDArray],
    ) -> None:
        """Declare the fields.

        own: (r,) the ball of each row; others: (r, k) the further balls of its element, as members "a", "b", ...; columns, data:
        what else a row is_whole, name to Taichi type and (r,) values.
        """
        order = np.argsort(own, kind="stable")
        start = np.zeros(model.n + 1, dtype=np.int32)
        np.cumsum(np.bincount(own, minlength=model.n), out=start[1:])
        names = CORNER_NAMES[: others.shape[1]]
        typed = {**dict.fromkeys(names, ti.i32), **columns}
        values = {name: others[order, k] for k, name in enumerate(names)}
        values |= {name: value[order] for name, value in data.items()}
        self.start, self.row = fields.integers(start), fields.table(typed, len(own), values)
        self.tears = bool(np.isfinite(model.scene.break_strain).any())
        if self.tears:
            self.gone = fields.integers(len(own))
            self.members = np.concatenate([own[order, None], others[order]], axis=1)

    @ti.func
    def is_whole(self, e):
        """Whether the element of row e is whole."""
        whole = True
        if ti.static(self.tears):
            whole = self.gone[e] == 0
        return whole
