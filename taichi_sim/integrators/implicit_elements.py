"""Elements in an implicit stage: those that give their derivatives, see forces.corners.Corners."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.loops import list_entry
from taichi_sim.kernels.springs import padded_blocks

__all__ = ["StageElements"]


@ti.data_oriented
class StageElements:
    """Elements in a StageSolver: forces where the stage ends, what the matrix has of them, and the potential.

    Fields: `there` (n), for each of the elements, x and v where the rest is worked out, w of the way to where
    the stage begins, p of a product or of a change under test; `step` [s] of the stage; `half_step`, half of it; `time` [s] at
    its end. x is in double precision, but for elements of users: the rounding of places in single precision comes to forces as
    large as those that stiff elements balance.
    """

    def __init__(self, elements: Sequence[Any], model: Model, fields: Fields) -> None:
        self.elements, self.n, self.dim = elements, model.n, model.dim
        self.ties = np.concatenate([one.ties for one in elements])
        vector = ti.types.vector(self.dim, fields.real)
        kinds = [fields.wide if one.refined else fields.real for one in elements]
        members = dict.fromkeys(("x", "v", "w", "p"), vector)
        tables = {k: fields.table({**members, "x": ti.types.vector(self.dim, k)}, self.n) for k in dict.fromkeys(kinds)}
        self.tables, self.there = tuple(tables.values()), [tables[k] for k in kinds]
        self.all_refined = fields.real not in tables
        self.held = [_HeldCorners(one.ties, model.scene.pinned, fields) for one in elements]
        self.step, self.half_step, self.time = fields.reals(1), fields.reals(1), fields.reals(1)
        self.wide = fields.wide
        self.reads_p = any(one.reads_p for one in elements)
        self.has_curvature = any(one.derivatives > 1 for one in elements)
        for one in elements:
            one.staged, one.half_step = True, self.half_step
            one.allocate_derivatives(fields)

    def edges(self) -> NDArray[np.int32]:
        """Pairs of balls (m, 2) that share an element with an energy of strains, once for each of both and each element."""
        found = [np.zeros((0, 2), dtype=np.int32)]
        for one in self.elements:
            if one.derivatives == 1:
                found += [one.members[:, [0, k]] for k in range(1, one.members.shape[1])]
        return np.concatenate(found)

    @ti.func
    def push(self, base: ti.template(), low: ti.template(), total: ti.template(), s):
        """total (n), padded, += s times the forces at base.x + low + s base.v."""
        self.step[0] = s
        self.half_step[0] = 0.5 * s
        for i in range(self.n):
            self.place(i, base[i].x, low[i], base[i].v, s)
        for one, there in ti.static(zip(self.elements, self.there)):
            one.prepare(there)
            one.prepare_blocks(there, s)
        for i in range(self.n):
            force = ti.Vector.zero(self.wide, self.dim)
            for one, there in ti.static(zip(self.elements, self.there)):
                force += one.force_on(there, i, self.time[0])
            for a in ti.static(range(self.dim)):
                total[i][a] = total[i][a] + ti.cast(s, self.wide) * force[a]

    @ti.func
    def multiply(self, p: ti.template(), total: ti.template()):
        """total (n) += the elements' part of the matrix times p (n), all padded."""
        if ti.static(self.reads_p):
            for i in range(self.n):
                for table in ti.static(self.tables):
                    table[i].p = padded_blocks.cut(p[i], self.dim)
        for one, there in ti.static(zip(self.elements, self.there)):
            one.prepare_product(there, self.step[0])
            one.add_products(p, there, total, self.step[0])

    @ti.func
    def block(self, i, curves: ti.template()):
        """Part that elements with energies of curvatures, or those without, have in the block of the matrix at ball i [kg]."""
        block = ti.Matrix.zero(float, self.dim, self.dim)
        for one, there in ti.static(zip(self.elements, self.there)):
            if ti.static((one.derivatives > 1) == curves):
                block += one.block_at(there, i, self.step[0])
        return block

    @ti.func
    def place(self, i, x, low, v, s):
        """Set `there` of ball i at x + low to where the stage ends at the velocity v."""
        way = ti.cast(low, self.wide) + ti.cast(s, self.wide) * ti.cast(v, self.wide)
        for table in ti.static(self.tables):
            table[i].x = ti.cast(ti.cast(x, self.wide) + way, table.x.dtype)
            table[i].v = v

    @ti.func
    def note_past(self, i, w):
        """Note the velocity w of the way that led ball i to where the stage begins [m/s], see forces.corners.Corners."""
        for table in ti.static(self.tables):
            table[i].w = w

    @ti.func
    def note_change(self, i, way):
        """Note the way [m] that the change under test made ball i go."""
        for table in ti.static(self.tables):
            table[i].p = way

    @ti.func
    def potential(self, i, s):
        """Share of ball i, which is not pinned, and of its held corners in the elements' potential [J]."""
        energy = ti.cast(0.0, self.wide)
        for one, there, held in ti.static(zip(self.elements, self.there, self.held)):
            own = one.start[i + 1] - one.start[i]
            for k in range(own + held.start[i + 1] - held.start[i]):
                j, t = i, k
                if k >= own:
                    corner = held.corner[held.start[i] + k - own]
                    j, t = corner.ball, corner.entry
                e = list_entry(one, j, t)
                if one.is_whole(e):
                    energy += one.corner_potential(there, j, one.row[e], s, self.wide)
        return energy


class _HeldCorners:
    """Corners of elements that are pinned, listed for a free ball of their element: a pinned ball may belong to several bodies,
    and its share in the potential of an element counts in that of the element's body.

    Fields: `corner`, those of ball i from start[i] to start[i + 1]: `entry` of the list of `ball`."""

    def __init__(self, ties: NDArray, pinned: NDArray[np.bool_], fields: Fields) -> None:
        row = np.flatnonzero(pinned[ties[:, 0]] & ~pinned[ties[:, 1]])
        row = row[np.argsort(ties[row, 1], kind="stable")]
        ball, n = ties[row, 0], len(pinned)
        data = {"ball": ball, "entry": row - np.searchsorted(ties[:, 0], ball)}
        self.corner = fields.table(dict.fromkeys(data, ti.i32), len(row), data)
        self.start = fields.integers(np.append(0, np.cumsum(np.bincount(ties[row, 1], minlength=n))))
