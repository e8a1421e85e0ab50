"""Cells: tetrahedra, in 2D triangles, that keep their volume."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.corners import Corners
from taichi_sim.scene.cells import CRUSHED

__all__ = ["Cells"]

# for each corner, the others in the order in which they, after it, make the same volume
OTHER_CORNERS = {2: ((1, 2), (2, 0), (0, 1)), 3: ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))}


@ti.data_oriented
class Cells(Corners):
    """Forces -(K (V / V0 - 1) + C min(V / V0 - CRUSHED, 0)) dV/dx of the energy K V0 (V / V0 - 1)^2 / 2 + C V0 min(V / V0 -
    CRUSHED, 0)^2 / 2, V with its sign.

    Of cells that act together V and V0 are sums, K the mean (mean dilatation, Nagtegaal et al. 1974): `first` and `member`, the
    rows of the first corners of a group's cells, `pressure` [Pa] of each group. Implicit methods get the part of the second
    derivative by dV/dx twice; that by d2V/dx2, which has either sign, is left out.
    """

    name = "cells"
    elastic = True

    def __init__(self, model: Model, fields: Fields) -> None:
        scene = model.scene
        self.share = 1.0 / (model.dim + 1)  # of a cell's energy that each corner counts
        cells, others_of = scene.cells, OTHER_CORNERS[model.dim]
        others = np.concatenate([cells[:, list(rest)] for rest in others_of])
        real = fields.real
        columns = {"modulus": real, "crush": real, "inverse": real}
        data = {
            "modulus": np.tile(scene.bulk_modulus, len(others_of)),
            "crush": np.tile(scene.crush_modulus, len(others_of)),
            "inverse": np.tile(1.0 / scene.rest_volume, len(others_of)),
        }
        own = cells.T.ravel()
        self.shared = bool(np.any(scene.cells_together >= 0))
        if self.shared:
            number = len(cells)
            alone = scene.cells_together < 0
            _, one = np.unique(np.where(alone, np.arange(number), number + scene.cells_together), return_inverse=True)
            one = one.ravel()
            columns["group"] = ti.i32
            data["group"] = np.tile(one, len(others_of))
            at = np.empty(len(own), dtype=np.int64)
            at[np.argsort(own, kind="stable")] = np.arange(len(own))
            self.groups = int(one.max()) + 1
            self.member = fields.table(
                {"row": ti.i32, "ball": ti.i32},
                number,
                {"row": at[:number][np.argsort(one, kind="stable")], "ball": cells[np.argsort(one, kind="stable"), 0]},
            )
            self.first = fields.integers(np.append(0, np.cumsum(np.bincount(one))))
            self.pressure = fields.reals(self.groups)
        self.gather(model, fields, others, own, columns, data)
        if self.shared:  # groups join balls that no cell joins
            free = np.where(model.scene.pinned[cells], model.n, cells).min(axis=1)
            lowest = np.full(self.groups, model.n)
            np.minimum.at(lowest, one, free)
            tie = lowest[np.tile(one, len(others_of))[np.argsort(own, kind="stable")]]
            self.ties[:, 1] = np.where(tie < model.n, tie, self.ties[:, 0])

    @ti.func
    def _volume(self, ball: ti.template(), i, row):
        """Signed volume of a row's cell, and its gradient at ball i."""
        a = ball[row.a].x
        g = ti.Vector.zero(ball.x.dtype, self.dim)
        if ti.static(self.dim == 3):
            g = (ball[row.b].x - a).cross(ball[row.c].x - a) / -6.0
        else:
            side = ball[row.b].x - a
            g = 0.5 * ti.Vector([-side[1], side[0]])
        return g.dot(ball[i].x - a), g

    @ti.func
    def _together(self, ball: ti.template(), g):
        """Volume of group g in parts of that at rest, its moduli, and the volume at rest."""
        volume, rest, strength, crush = (
            ti.cast(0.0, ball.x.dtype),
            ti.cast(0.0, float),
            ti.cast(0.0, float),
            ti.cast(0.0, float),
        )
        for k in range(self.first[g], self.first[g + 1]):
            member = self.member[k]
            row = self.row[member.row]
            if self.is_whole(member.row):
                own, _ = self._volume(ball, member.ball, row)
                volume += own
                rest += 1.0 / row.inverse
                strength += row.modulus / row.inverse
                crush += row.crush / row.inverse
        part = ti.cast(1.0, ball.x.dtype)
        if rest > 0.0:
            part = volume / rest
            strength /= rest
            crush /= rest
        return part, strength, crush, rest

    @ti.func
    def prepare(self, ball: ti.template()):
        """Pressures of groups."""
        if ti.static(self.shared):
            for g in range(self.groups):
                part, modulus, crush, _ = self._together(ball, g)
                self.pressure[g] = ti.cast(
                    modulus * (part - 1.0) + crush * min(part - CRUSHED, 0.0), self.pressure.dtype
                )

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """Force on corner i [N] by the pressure of the cell or of its group."""
        volume, g = self._volume(ball, i, row)
        part = volume * row.inverse
        pressure = row.modulus * (part - 1.0) + row.crush * min(part - CRUSHED, 0.0)
        if ti.static(self.shared):
            pressure = self.pressure[row.group]
        return -pressure * g

    @ti.func
    def corner_energy(self, ball: ti.template(), i, row, real: ti.template()):
        """Share of corner i of the cell's energy [J]: equal for all corners."""
        volume, _ = self._volume(ball, i, row)
        part, modulus, crush = volume * row.inverse, row.modulus, row.crush
        if ti.static(self.shared):
            part, modulus, crush, _ = self._together(ball, row.group)
        strain, crushed = ti.cast(part - 1.0, real), ti.cast(min(part - CRUSHED, 0.0), real)
        stored = ti.cast(modulus, real) * strain * strain + ti.cast(crush, real) * crushed * crushed
        return self.share * 0.5 * stored / ti.cast(row.inverse, real)

    # The derivatives, for implicit methods

    def allocate_derivatives(self, fields: Fields) -> None:
        """Declare the stiffness of each group by its volume [Pa/m^dim], the change of its pressure in a product, and its
        pressure in the precision of places."""
        if self.shared:
            self.slope, self.change = fields.reals(self.groups), fields.reals(self.groups)
            if fields.widens:
                self.pressure = fields.doubles(self.groups)

    @ti.func
    def prepare_blocks(self, ball: ti.template(), s):
        """Stiffness of groups."""
        if ti.static(self.shared):
            for g in range(self.groups):
                part, modulus, crush, rest = self._together(ball, g)
                self.slope[g] = ti.select(
                    rest > 0.0, _modulus(part, modulus, crush) / ti.select(rest > 0.0, rest, 1.0), 0.0
                )

    @ti.func
    def _slope(self, ball: ti.template(), i, row):
        """Stiffness [Pa/m^dim] of a row's cell, or of its group, by its volume, and the gradient of that at ball i."""
        volume, g = self._volume(ball, i, row)
        slope = _modulus(volume * row.inverse, row.modulus, row.crush) * row.inverse
        if ti.static(self.shared):
            slope = self.slope[row.group]
        return slope, g

    @ti.func
    def _swelling(self, ball: ti.template(), i, row):
        """Change of the volume of a row's cell by ball[j].p."""
        a, p = ball[row.a].x, ball[row.a].p
        x, q, swelling = ball[i].x - a, ball[i].p - p, ti.cast(0.0, ball.x.dtype)
        if ti.static(self.dim == 3):
            b, c = ball[row.b].x - a, ball[row.c].x - a
            turned = (ball[row.b].p - p).cross(c) + b.cross(ball[row.c].p - p)
            swelling = (b.cross(c).dot(q) + turned.dot(x)) / -6.0
        else:
            b, turned = ball[row.b].x - a, ball[row.b].p - p
            swelling = 0.5 * (b[0] * q[1] - b[1] * q[0] + turned[0] * x[1] - turned[1] * x[0])
        return ti.cast(swelling, float)

    @ti.func
    def prepare_product(self, ball: ti.template(), s):
        """Changes of the pressures of groups."""
        if ti.static(self.shared):
            for g in range(self.groups):
                swelling = ti.cast(0.0, float)
                for k in range(self.first[g], self.first[g + 1]):
                    member = self.member[k]
                    if self.is_whole(member.row):
                        swelling += self._swelling(ball, member.ball, self.row[member.row])
                self.change[g] = self.slope[g] * swelling

    @ti.func
    def corner_product(self, ball: ti.template(), i, row, s):
        """Rows of ball i of the product."""
        slope, g = self._slope(ball, i, row)
        change = slope * self._swelling(ball, i, row)
        if ti.static(self.shared):
            change = self.change[row.group]
        return s * s * change * g

    @ti.func
    def corner_block(self, ball: ti.template(), i, row, s):
        """Block that joins ball i to itself; of cells that act together, without what their others give."""
        slope, g = self._slope(ball, i, row)
        return s * s * slope * g.outer_product(g)


@ti.func
def _modulus(part, modulus, crush):
    """Modulus of a cell, or a group, whose volume is that part of the volume at rest."""
    return modulus + ti.select(part < CRUSHED, crush, 0.0 * crush)
