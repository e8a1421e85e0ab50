"""Corners: elements of several balls, listed for each ball, so that each sums its own forces, without atomics."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.slices import Slices
from taichi_sim.kernels.loops import list_entry

__all__ = ["CORNER_NAMES", "Corners"]

CORNER_NAMES = "abcdefgh"  # of the balls in a row


@ti.data_oriented
class Corners:
    """Base of a force of elements: `start` (n + 1) and `row`, those of ball i from start[i] to start[i + 1], in the order of
    the elements. may_slice: true where only the methods below read `start` and `row`, which a device may then have in slices,
    see kernels.loops.list_entry. `gone` (r), where springs can tear: rows whose element has lost a side, see forces.tearing."""

    may_slice = False

    def gather(
        self,
        model: Model,
        fields: Fields,
        others: NDArray,
        own: NDArray,
        columns: dict[str, Any],
        data: dict[str, NDArray],
        holds_others: bool = True,
    ) -> None:
        """Declare the fields.

        own: (r,) the ball of each row; others: (r, k) the further balls of its element, as members "a", "b", ...; columns, data:
        what else a row has, name to Taichi type and (r,) values. holds_others: rows have the further balls.
        """
        order = np.argsort(own, kind="stable")
        start = np.zeros(model.n + 1, dtype=np.int32)
        np.cumsum(np.bincount(own, minlength=model.n), out=start[1:])
        names = CORNER_NAMES[: others.shape[1] if holds_others else 0]
        typed = {**dict.fromkeys(names, ti.i32), **columns}
        values = {name: others[order, k] for k, name in enumerate(names)}
        values |= {name: value[order] for name, value in data.items()}
        self.n, self.dim = model.n, model.dim
        self.start = fields.integers(start)
        self.tears = bool(np.isfinite(model.scene.break_strain).any())
        slices = Slices.of(start) if self.may_slice and not self.tears else None
        self.sliced = slices is not None
        if slices is not None:
            self.slice_start = fields.integers(slices.start)
            values = {name: slices.spread(value) for name, value in values.items()}
        rows = len(own) if slices is None else slices.room
        self.row = fields.table(typed, rows, values, by_column=self.sliced)
        if self.tears:
            self.gone = fields.integers(len(own))
            self.members = np.concatenate([own[order, None], others[order]], axis=1)

    @ti.func
    def is_whole(self, e):
        """True if the element of row e is whole."""
        whole = True
        if ti.static(self.tears):
            whole = self.gone[e] == 0
        return whole

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        """Each ball gathers from its elements."""
        self.prepare(ball)
        for i in range(self.n):
            f = ti.Vector.zero(float, self.dim)
            for t in range(self.start[i + 1] - self.start[i]):
                e = list_entry(self, i, t)
                if self.is_whole(e):
                    f += self.corner_force(ball, i, self.row[e], time)
            impulse[i] = impulse[i] + h * f

    @ti.func
    def prepare(self, ball: ti.template()):
        """Compute what elements have in common, before forces are asked for."""

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """Force of the element of a row on ball i [N]; a force of elements overrides it."""
        return ti.Vector.zero(float, self.dim)

    @ti.func
    def stored(self, ball: ti.template(), i, real: ti.template()):
        """Ball i's share of the energy [J]."""
        energy = ti.cast(0.0, real)
        for t in range(self.start[i + 1] - self.start[i]):
            e = list_entry(self, i, t)
            if self.is_whole(e):
                energy += self.corner_energy(ball, i, self.row[e], real)
        return energy

    @ti.func
    def corner_energy(self, ball: ti.template(), i, row, real: ti.template()):
        """Ball i's share of the energy of the element of a row [J], where it holds some."""
        return ti.cast(0.0, real)
