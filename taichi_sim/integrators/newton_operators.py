"""Sums of an implicit stage over springs, see kernels.springs.edge_blocks: its residual, and its matrix times a vector."""

from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.springs import newton_terms, padded_blocks

__all__ = ["Product", "Residual"]


@ti.data_oriented
class Product:
    """sum = A p, both (n) padded."""

    def __init__(self, solver: Any, fields: Fields) -> None:
        self.solver, self.dim, self.type = solver, padded_blocks.width(solver.dim), fields.real
        self.p = fields.vectors(solver.n, self.dim)
        self.sum = fields.vectors(solver.n, self.dim)

    @ti.func
    def own(self, i):
        """The mass part; a pinned ball has none, and its p is 0."""
        w = self.solver.model.inverse_mass[i]
        own = self.p[i] / ti.select(w > 0.0, w, 1.0)
        if ti.static(self.solver.rubs):
            own *= 1.0 + self.solver.held.friction[i].drag
        return own

    @ti.func
    def term(self, i, j, e, s):
        """Block of spring e times p."""
        block = self.solver.spring_block[e]
        p = self.p[i] - self.p[j]
        return block.along * padded_blocks.dot(block.r, p, self.solver.dim) * block.r + block.across * p


@ti.data_oriented
class Residual:
    """sum (n) = the residual, padded, in double precision where the device has it; notes the blocks of all springs."""

    def __init__(self, solver: Any, fields: Fields) -> None:
        self.solver, self.dim, self.type = solver, solver.product.dim, fields.wide
        self.rounds = fields.widens
        self.sum = fields.vectors(solver.n, self.dim, wide=True) if self.rounds else solver.product.sum

    @ti.func
    def own(self, i):
        """m (q - v); pinned balls keep still."""
        v = self.solver.base[i].v
        change = self.solver.q[i] - v
        if ti.static(self.solver.rubs):
            change += self.solver.held.rub(i, v)
        momentum = self.solver.mass(i) * change
        return ti.cast(padded_blocks.pad(momentum, self.solver.dim), self.type)

    @ti.func
    def term(self, i, j, e, s):
        """Impulse of spring e on ball i, which it joins to ball j."""
        a, b, springs = self.solver.ahead[i], self.solver.ahead[j], self.solver.springs
        f, r, along, across = newton_terms.linearise(
            a, b, i, j, springs.spring[e], s, self.type, self.solver.dim, springs.damped
        )
        writes = True
        if ti.static(springs.order == "ends"):  # one of them
            writes = i == springs.spring[e].one
        if writes:
            self.solver.spring_block[e].r = r
            self.solver.spring_block[e].along = along
            self.solver.spring_block[e].across = across
        return f

    @ti.func
    def round_off(self):
        """Copy the sums to those of the product, which the search for a change reads."""
        if ti.static(self.rounds):
            for i in range(self.solver.n):
                self.solver.product.sum[i] = ti.cast(self.sum[i], float)
