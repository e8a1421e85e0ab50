"""PinSlopes: what springs to moving pins do at the start of a step, where their paths turn a corner."""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.forces.springs import Springs
from taichi_sim.kernels.vectors import unit

__all__ = ["PinSlopes"]


@ti.data_oriented
class PinSlopes:
    """A pin has one velocity through a step and another through the next. Accelerations that the first left at its end have
    damping by it; the next step needs that by the second: w c (n . du) n more for each damped spring from a free ball to a pin
    whose velocity changes by du. Without that the error is of first order in the step, at corners and where pins speed up."""

    def __init__(self, model: Model, state: State, pins: Any, springs: Springs, fields: Fields) -> None:
        scene = model.scene
        self.model, self.state, self.pins, self.springs = model, state, pins, springs
        number = np.full(scene.n_balls, -1, dtype=np.int64)
        number[np.concatenate([moving.balls for moving in scene.moving_pins])] = np.arange(pins.m)
        rows = []  # ball, pin, spring in the scene
        for own, far in (scene.pairs.T, scene.pairs.T[::-1]):
            e = np.flatnonzero((scene.damping > 0) & ~scene.pinned[own] & (number[far] >= 0))
            rows.append(np.stack([own[e], far[e], number[far[e]], e], axis=1))
        table = np.concatenate(rows)
        table = table[np.lexsort((table[:, 3], table[:, 0]))]
        place = np.full(scene.n_springs, -1, dtype=np.int64)
        stored = np.flatnonzero(springs.number >= 0)
        place[springs.number[stored]] = stored
        balls, first = np.unique(table[:, 0], return_index=True)
        self.m = len(balls)
        self.ball = fields.integers(balls)
        self.first = fields.integers(np.append(first, len(table)))
        columns = {"far": ti.i32, "pin": ti.i32, "place": ti.i32}
        data = {"far": table[:, 1], "pin": table[:, 2], "place": place[table[:, 3]]}
        self.row = fields.table(columns, len(table), data)

    @ti.func
    def renew(self, slope: ti.template()):
        """At the end of a step: from the velocities of pins in this step to those in the next, in slope (n) [m/s^2]."""
        for b in range(self.m):
            i = self.ball[b]
            change = 0.0 * slope[i]
            for k in range(self.first[b], self.first[b + 1]):
                row = self.row[k]
                x, far = self.state.ball[i].x, self.state.ball[row.far]
                n, _ = unit(far.x - x, i, row.far)
                du = self.pins.ahead(row.pin) - far.v
                change += self.springs.spring[row.place].damping * du.dot(n) * n
            slope[i] = slope[i] + self.model.inverse_mass[i] * change
