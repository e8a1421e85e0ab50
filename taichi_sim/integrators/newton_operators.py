"""What a stage of an implicit method sums over springs, see kernels.half: its residual, and its matrix times a vector."""

from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.springs import newton_terms as parts
from taichi_sim.kernels.springs import padded_blocks

__all__ = ["Product", "Residual"]


@ti.data_oriented
class Product:
    """sum = A p, both in rows, see kernels.rows."""

    def __init__(self, solver: Any, fields: Fields) -> None:
        self.solver, self.dim = solver, padded_blocks.width(solver.dim)
        self.p = fields.vectors(solver.n, self.dim)
        self.sum = fields.vectors(solver.n, self.dim)

    @ti.func
    def own(self, i):
        """The mass part; a pinned ball has none, and its p is 0."""
        w = self.solver.model.inverse_mass[i]
        return self.p[i] / ti.select(w > 0.0, w, 1.0)

    @ti.func
    def term(self, i, j, e, s):
        """Block of spring e times p."""
        row = self.solver.row[e]
        p = self.p[i] - self.p[j]
        return row.along * padded_blocks.dot(row.r, p, self.solver.dim) * row.r + row.across * p


@ti.data_oriented
class Residual:
    """sum = the residual in rows; notes the blocks of all springs."""

    def __init__(self, solver: Any) -> None:
        self.solver, self.dim, self.sum = solver, solver.product.dim, solver.product.sum

    @ti.func
    def own(self, i):
        """m (q - v); pinned balls keep still."""
        w = self.solver.model.inverse_mass[i]
        m = ti.select(w > 0.0, 1.0 / ti.select(w > 0.0, w, 1.0), 0.0)
        return padded_blocks.pad(m * (self.solver.q[i] - self.solver.base[i].v), self.solver.dim)

    @ti.func
    def term(self, i, j, e, s):
        """Impulse of spring e on ball i."""
        a, b, springs = self.solver.ahead[i], self.solver.ahead[j], self.solver.springs
        f, r, along, across = parts.linearise(a, b, i, j, springs.spring[e], s, self.solver.dim, springs.damped)
        self.solver.row[e].r = r
        self.solver.row[e].along = along
        self.solver.row[e].across = across
        return f
