"""DrivenPins: pinned balls that are led along paths."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.scene.keyframes import TICKS, moments

__all__ = ["DrivenPins"]


@ti.data_oriented
class DrivenPins:
    """Puts moving pins where they belong at the start of each substep, with the velocity that leads to where they belong next.

    Motions are worked out on the host in float64, for up to TICKS substeps at a time: `row`, of which `tick` is the present one.
    A pin at `arm` from the centre of its path lies at x + turn arm and moves with v + turning arm, both exact differences of
    rigid poses: positions do not drift, and velocities carry no rounding of positions.
    """

    def __init__(self, model: Model, state: State, fields: Fields) -> None:
        scene, dim = model.scene, model.dim
        self.state, self.dim = state, dim
        self.paths = [pins.motion for pins in scene.moving_pins]
        balls = np.concatenate([pins.balls for pins in scene.moving_pins])
        path = np.repeat(np.arange(len(self.paths)), [len(pins.balls) for pins in scene.moving_pins])
        starts = np.array([motion.at(0.0)[0][0] for motion in self.paths])
        turns = np.array([motion.at(0.0)[1][0] for motion in self.paths])
        arm = np.einsum("kij,ki->kj", turns[path], scene.position[balls] - starts[path])
        vector = ti.types.vector(dim, fields.real)
        matrix = ti.types.matrix(dim, dim, fields.real)
        self.m, self.count = len(balls), len(self.paths)
        self.pin = fields.table(
            {"ball": ti.i32, "path": ti.i32, "arm": vector}, self.m, {"ball": balls, "path": path, "arm": arm}
        )
        self.width = 2 * dim + 2 * dim * dim
        columns = {"x": vector, "v": vector, "turn": matrix, "turning": matrix}
        self.row = fields.table(columns, (TICKS + 1) * self.count)
        self.tick = fields.integers(1)

    def load(self, time: float, h: float, steps: int) -> None:
        """Work out the motion for `steps` substeps of h from `time` on, at most TICKS."""
        table = np.empty((steps + 1, self.count, self.width))
        t = moments(time, h, steps + 1)
        for k, motion in enumerate(self.paths):
            x, turn = motion.at(t)
            rows = x[:-1], np.diff(x, axis=0) / h, turn[:-1], np.diff(turn, axis=0) / h
            table[:, k] = np.concatenate([part.reshape(steps + 1, -1) for part in rows], axis=1)
        real = np.float64 if self.row.x.dtype == ti.f64 else np.float32
        self._load(np.ascontiguousarray(table.reshape(-1, self.width), dtype=real))

    @ti.kernel
    def _load(self, table: ti.types.ndarray()):
        d = ti.static(self.dim)
        self.tick[0] = 0
        for r in range(table.shape[0]):
            for a in ti.static(range(d)):
                self.row[r].x[a] = table[r, a]
                self.row[r].v[a] = table[r, d + a]
                for b in ti.static(range(d)):
                    self.row[r].turn[a, b] = table[r, 2 * d + a * d + b]
                    self.row[r].turning[a, b] = table[r, 2 * d + d * d + a * d + b]

    @ti.func
    def ahead(self, k):
        """Velocity of the k-th pin in the next substep, in this one after `lead` [m/s]."""
        row = self.row[self.tick[0] * self.count + self.pin[k].path]
        return row.v + row.turning @ self.pin[k].arm

    @ti.func
    def face(self, both: ti.template()):
        """Give pins the mean of their velocities in this substep and the next, or that in this one, after `lead`."""
        for k in range(self.m):
            pin = self.pin[k]
            row = self.row[(self.tick[0] - 1) * self.count + pin.path]
            v = row.v + row.turning @ pin.arm
            if ti.static(both):
                v = 0.5 * (v + self.ahead(k))
            self.state.ball[pin.ball].v = v

    @ti.func
    def lead(self, forth: ti.template()):
        """Set places and velocities for the present substep; forth: and go on to the next."""
        for k in range(self.m):
            pin = self.pin[k]
            row = self.row[self.tick[0] * self.count + pin.path]
            self.state.ball[pin.ball].x = row.x + row.turn @ pin.arm
            self.state.ball[pin.ball].v = row.v + row.turning @ pin.arm
            if ti.static(self.state.compensated):
                self.state.low[pin.ball].x = 0.0 * row.x
                self.state.low[pin.ball].v = 0.0 * row.x
        if ti.static(forth):
            ti.loop_config(serialize=True)
            for _ in range(1):
                self.tick[0] = self.tick[0] + 1
