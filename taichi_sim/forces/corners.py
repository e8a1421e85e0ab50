"""Corners: elements of several balls, listed for each ball, so that each sums its own forces, without atomics."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.slices import Slices
from taichi_sim.kernels.loops import list_entry
from taichi_sim.kernels.springs import padded_blocks

__all__ = ["CORNER_NAMES", "Corners"]

CORNER_NAMES = "abcdefgh"  # of the balls in a row


@ti.data_oriented
class Corners:
    """Base of a force of elements: `start` (n + 1) and `row`, those of ball i from start[i] to start[i + 1], in the order of
    the elements. may_slice: true where only the methods below read `start` and `row`, which a device may then have in slices,
    see kernels.loops.list_entry. staged: true in an implicit stage. derivatives: 1 where the energy is of strains, 2 where it
    is of curvatures. refined: in an implicit stage ball[j].x has double precision, and forces are added in it. `gone` (r), where
    springs can tear: rows whose element has lost a side, see forces.tearing.

    Elements that give `corner_product`, `corner_block` and `corner_energy` are implicit in implicit methods: a stage of s seconds
    that ends at places x = p + s v minimises sum m |q - v|^2 / 2 + W(x) + s R(x, v), W the energy and R half of the power that
    damping takes. Of its matrix M + s^2 K + s D these functions give s^2 K + s D, which must be positive semidefinite and
    symmetric: an element leaves out, or clamps, what is negative. They read ball[j].x and ball[j].v, which are those of the end
    of the stage, and ball[j].p, the vector that is multiplied, or the way [m] that the change under test made.

    Damping is by the rate of strain that the method has for the strain as for a place: (E(x) - E0) / s, with E0 of the places
    that the stage starts from. So what turns is not strained, and damping has the potential s / 2 times its power. With
    ball[j].w the velocity of the way that made x - s v of a place, E being of second order in places, that is x . v + s (w . w
    - v . v) / 2. Work that corners share is done once for each element in `prepare`, `prepare_blocks` and `prepare_product`,
    which run before."""

    may_slice = staged = False
    half_step: Any  # s: field of one, where staged
    refined = True
    derivatives = 1
    reads_p = True  # products read ball[j].p, not only the vector that is passed to `add_products`

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
        what else a row has, name to Taichi type and (r,) values.
        """
        order = np.argsort(own, kind="stable")
        start = np.zeros(model.n + 1, dtype=np.int32)
        np.cumsum(np.bincount(own, minlength=model.n), out=start[1:])
        names = CORNER_NAMES[: others.shape[1]]
        typed = {**dict.fromkeys(names, ti.i32), **columns}
        values = {name: others[order, k] for k, name in enumerate(names)}
        values |= {name: value[order] for name, value in data.items()}
        self.n, self.dim = model.n, model.dim
        # (r, k + 1) the ball of each row, and the others of its element
        self.members = members = np.concatenate([own[order, None], others[order]], axis=1, dtype=np.int32)
        # (r, 2) the ball of each row, and the lowest free one of its element, or itself where all are pinned: balls joined
        lowest = np.where(model.scene.pinned[members], model.n, members).min(axis=1)
        self.ties = np.stack([members[:, 0], np.where(lowest < model.n, lowest, members[:, 0])], axis=1)
        self.start = fields.integers(start)
        self.tears = bool(np.isfinite(model.scene.break_strain).any())
        slices = Slices.of(start) if self.may_slice and not self.tears else None
        self.sliced = slices is not None
        if slices is not None:
            self.slice_start = fields.integers(slices.start)
            values = {name: slices.spread(value) for name, value in values.items()}
        self.row = fields.table(typed, len(values["a"]), values, by_column=self.sliced)
        self.others = tuple(self.row.get_member_field(name) for name in names)
        if self.tears:
            self.gone = fields.integers(len(own))

    @property
    def implicit(self) -> bool:
        """True if implicit methods solve for its forces, as it gives their derivatives."""
        return type(self).corner_product is not Corners.corner_product

    def allocate_places(self, fields: Fields, real: Any) -> None:
        """Declare copies of places, if any; real: the type of those that `accumulate` is handed."""

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
            impulse[i] = impulse[i] + h * ti.cast(self.force_on(ball, i, time), float)

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

    # The derivatives, for implicit methods

    def allocate_derivatives(self, fields: Fields) -> None:
        """Declare fields for what `prepare_blocks` finds; called where the method is implicit."""

    @ti.func
    def prepare_blocks(self, ball: ti.template(), s):
        """Compute what blocks and products have in common, at the places of the last `prepare`."""

    @ti.func
    def prepare_product(self, ball: ti.template(), s):
        """Compute what the products with ball[j].p have in common."""

    @ti.func
    def corner_product(self, ball: ti.template(), i, row, s):
        """Rows of ball i of (s^2 K + s D) p [kg times p] of the element of a row, p from ball[j].p."""
        return ti.Vector.zero(float, self.dim)

    @ti.func
    def corner_block(self, ball: ti.template(), i, row, s):
        """Block (dim, dim) of s^2 K + s D [kg] that joins ball i to itself, of the element of a row."""
        return ti.Matrix.zero(float, self.dim, self.dim)

    @ti.func
    def corner_loss(self, ball: ti.template(), i, row, real: ti.template()):
        """Ball i's share of half of the power [W] that the damping of the element of a row takes. Damping that acts
        along a direction where the stage ends has no potential: it counts along that at the places x - p, before a change."""
        return ti.cast(0.0, real)

    @ti.func
    def force_on(self, ball: ti.template(), i, time):
        """Force on ball i [N], in the precision of places; after `prepare`."""
        f = ti.Vector.zero(ball.x.dtype, self.dim)
        for t in range(self.start[i + 1] - self.start[i]):
            e = list_entry(self, i, t)
            if self.is_whole(e):
                f += ti.cast(self.corner_force(ball, i, self.row[e], time), ball.x.dtype)
        return f

    @ti.func
    def product_at(self, ball: ti.template(), i, s):
        """Rows of ball i of (s^2 K + s D) p; after `prepare_product`."""
        f = ti.Vector.zero(float, self.dim)
        for t in range(self.start[i + 1] - self.start[i]):
            e = list_entry(self, i, t)
            if self.is_whole(e):
                f += ti.cast(self.corner_product(ball, i, self.row[e], s), float)
        return f

    @ti.func
    def add_products(self, p: ti.template(), ball: ti.template(), total: ti.template(), s):
        """total (n) += (s^2 K + s D) p, of padded vectors; p is that of the balls, too."""
        for i in range(self.n):
            total[i] = total[i] + padded_blocks.pad(self.product_at(ball, i, s), self.dim)

    @ti.func
    def block_at(self, ball: ti.template(), i, s):
        """Block of ball i of s^2 K + s D [kg]; after `prepare_blocks`."""
        block = ti.Matrix.zero(float, self.dim, self.dim)
        for t in range(self.start[i + 1] - self.start[i]):
            e = list_entry(self, i, t)
            if self.is_whole(e):
                block += ti.cast(self.corner_block(ball, i, self.row[e], s), float)
        return block

    @ti.func
    def corner_potential(self, ball: ti.template(), i, row, s, real: ti.template()):
        """Ball i's share of W + s R of the element of a row [J]."""
        return self.corner_energy(ball, i, row, real) + ti.cast(s, real) * self.corner_loss(ball, i, row, real)
