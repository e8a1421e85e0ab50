"""Cells: tetrahedra, in 2D triangles, that keep their volume."""

import numpy as np
import taichi as ti

from taichi_sim.fields import Fields
from taichi_sim.forces.corners import Corners
from taichi_sim.model import Model

__all__ = ["Cells"]

# for each corner, the others in the order in which they, after it, make the same volume
TURNED = {2: ((1, 2), (2, 0), (0, 1)), 3: ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))}


@ti.data_oriented
class Cells(Corners):
    """Forces -K (V / V0 - 1) dV/dx of the energy K V0 (V / V0 - 1)^2 / 2, V with its sign."""

    name = "cells"
    elastic = True

    def __init__(self, model: Model, fields: Fields) -> None:
        scene = model.scene
        self.n, self.dim = model.n, model.dim
        self.share = 1.0 / (model.dim + 1)  # of a cell's energy that each corner counts
        cells, turned = scene.cells, TURNED[model.dim]
        others = np.concatenate([cells[:, list(rest)] for rest in turned])
        real = fields.real
        columns = {"pressure": real, "inverse": real}
        data = {
            "pressure": np.tile(scene.bulk_modulus, len(turned)),
            "inverse": np.tile(1.0 / scene.rest_volume, len(turned)),
        }
        self.gather(model, fields, others, cells.T.ravel(), columns, data)

    @ti.func
    def _volume(self, ball: ti.template(), i, row):
        """Signed volume of a row's cell, and its gradient at ball i."""
        a = ball[row.a].x
        g = ti.Vector.zero(float, self.dim)
        if ti.static(self.dim == 3):
            g = (ball[row.b].x - a).cross(ball[row.c].x - a) / -6.0
        else:
            side = ball[row.b].x - a
            g = 0.5 * ti.Vector([-side[1], side[0]])
        return g.dot(ball[i].x - a), g

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        """Each ball gathers from its cells."""
        for i in range(self.n):
            f = ti.Vector.zero(float, self.dim)
            for e in range(self.start[i], self.start[i + 1]):
                row = self.row[e]
                volume, g = self._volume(ball, i, row)
                if self.holds(e):
                    f -= row.pressure * (volume * row.inverse - 1.0) * g
            impulse[i] = impulse[i] + h * f

    @ti.func
    def stored(self, ball: ti.template(), i, real: ti.template()):
        """Ball i's share of the energy [J]."""
        energy = ti.cast(0.0, real)
        for e in range(self.start[i], self.start[i + 1]):
            row = self.row[e]
            volume, _ = self._volume(ball, i, row)
            part = ti.cast(volume * row.inverse - 1.0, real)
            if self.holds(e):
                energy += self.share * 0.5 * ti.cast(row.pressure / row.inverse, real) * part * part
        return energy
