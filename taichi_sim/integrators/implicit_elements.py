"""Elements in an implicit stage: those that give their derivatives, see forces.incidence.Corners."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.springs import padded_blocks

__all__ = ["StageElements"]


@ti.data_oriented
class StageElements:
    """Elements in a StageSolver: forces where the stage ends, what the matrix has of them, and the potential.

    Fields: `there` (n), x and v where the rest was worked out, p of a product; `back` (n), x and v with a part of the change
    taken back; `step` [s] of the stage; `time` [s] at its end.
    """

    def __init__(self, elements: Sequence[Any], n: int, dim: int, fields: Fields) -> None:
        self.elements, self.n, self.dim = elements, n, dim
        self.ties = np.concatenate([one.ties for one in elements])
        vector = ti.types.vector(dim, fields.real)
        self.there = fields.table(dict.fromkeys(("x", "v", "p"), vector), n)
        self.back = fields.table(dict.fromkeys(("x", "v"), vector), n)
        self.step, self.time = fields.reals(1), fields.reals(1)
        self.wide = fields.wide
        for one in elements:
            one.allocate_derivatives(fields)

    @ti.func
    def push(self, base: ti.template(), total: ti.template(), s):
        """total (n), padded, += s times the forces at base.x + s base.v."""
        self.step[0] = s
        for i in range(self.n):
            self.there[i].x = base[i].x + s * base[i].v
            self.there[i].v = base[i].v
        for one in ti.static(self.elements):
            one.prepare(self.there)
            one.prepare_blocks(self.there, s)
            for i in range(self.n):
                total[i] = total[i] + padded_blocks.pad(s * one.force_on(self.there, i, self.time[0]), self.dim)

    @ti.func
    def multiply(self, p: ti.template(), total: ti.template()):
        """total (n) += the elements' part of the matrix times p (n), all padded."""
        for i in range(self.n):
            self.there[i].p = padded_blocks.cut(p[i], self.dim)
        for one in ti.static(self.elements):
            one.prepare_product(self.there, self.step[0])
            for i in range(self.n):
                total[i] = total[i] + padded_blocks.pad(one.product_at(self.there, i, self.step[0]), self.dim)

    @ti.func
    def block(self, i):
        """Block of the matrix at ball i [kg], without its mass."""
        block = ti.Matrix.zero(float, self.dim, self.dim)
        for one in ti.static(self.elements):
            block += one.block_at(self.there, i, self.step[0])
        return block

    @ti.func
    def take_back(self, base: ti.template(), dv: ti.template(), s, part):
        """Set `back` to where the stage would end with `part` of dv taken back."""
        for i in range(self.n):
            v = base[i].v - part * dv[i]
            self.back[i].x = base[i].x + s * v
            self.back[i].v = v

    @ti.func
    def potential(self, ball: ti.template(), i, s):
        """Ball i's share of the elements' potential [J] at `there` or `back`."""
        energy = ti.cast(0.0, self.wide)
        for one in ti.static(self.elements):
            energy += one.potential_at(ball, i, s, self.wide)
        return energy
