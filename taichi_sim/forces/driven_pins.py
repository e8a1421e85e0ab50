"""DrivenPins: pinned balls that are driven along paths, and what their paths' corners do to damped springs."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import NUMPY_TYPES, Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.forces.springs import Springs
from taichi_sim.kernels.vectors import unit
from taichi_sim.scene.motion import TICKS, moments

__all__ = ["DrivenPinSlopes", "DrivenPins"]


@ti.data_oriented
class DrivenPins:
    """Puts moving pins where they belong at the start of each substep, with the velocity that takes them to where they
    belong next.

    Motions are worked out on the host in float64, for TICKS substeps at a time: `pose` (substeps, paths), of which `tick`
    is the present substep. A pin at `arm` from the centre of its path lies at x + rotation arm and moves with v + change arm,
    both exact differences of rigid poses: positions do not drift, and velocities carry no rounding of positions.
    """

    def __init__(self, model: Model, state: State, fields: Fields) -> None:
        scene, dim = model.scene, model.dim
        self.state, self.dim = state, dim
        self.paths = [pins.motion for pins in scene.moving_pins]
        balls = np.concatenate([pins.balls for pins in scene.moving_pins])
        path = np.repeat(np.arange(len(self.paths)), [len(pins.balls) for pins in scene.moving_pins])
        starts = np.array([motion.at(0.0)[0][0] for motion in self.paths])
        rotations = np.array([motion.at(0.0)[1][0] for motion in self.paths])
        arm = np.einsum("kij,ki->kj", rotations[path], scene.position[balls] - starts[path])
        vector = ti.types.vector(dim, fields.real)
        matrix = ti.types.matrix(dim, dim, fields.real)
        self.m, self.count = len(balls), len(self.paths)
        self.pin = fields.table(
            {"ball": ti.i32, "path": ti.i32, "arm": vector}, self.m, {"ball": balls, "path": path, "arm": arm}
        )
        self.width = 2 * dim + 2 * dim * dim
        columns = {"x": vector, "v": vector, "rotation": matrix, "change": matrix}
        self.pose = fields.table(columns, (TICKS + 1) * self.count)
        self.tick = fields.integers(1)

    def load(self, time: float, h: float, first: int) -> None:
        """Work out the motion for TICKS substeps of h, from number `first` of those from `time` on."""
        table = np.empty((TICKS + 1, self.count, self.width))
        t = moments(time, h, first, TICKS + 1)
        for k, motion in enumerate(self.paths):
            x, rotation = motion.at(t)
            columns = x[:-1], np.diff(x, axis=0) / h, rotation[:-1], np.diff(rotation, axis=0) / h
            table[:, k] = np.concatenate([part.reshape(TICKS + 1, -1) for part in columns], axis=1)
        self._load(np.ascontiguousarray(table.reshape(-1, self.width), dtype=NUMPY_TYPES[self.pose.x.dtype]))

    @ti.kernel
    def _load(self, table: ti.types.ndarray()):
        d = ti.static(self.dim)
        self.tick[0] = 0
        for r in range(table.shape[0]):
            for a in ti.static(range(d)):
                self.pose[r].x[a] = table[r, a]
                self.pose[r].v[a] = table[r, d + a]
                for b in ti.static(range(d)):
                    self.pose[r].rotation[a, b] = table[r, 2 * d + a * d + b]
                    self.pose[r].change[a, b] = table[r, 2 * d + d * d + a * d + b]

    @ti.func
    def ahead(self, k):
        """Velocity of the k-th pin in the present substep [m/s]; after `drive`, in the next one."""
        return self._velocity(self.pin[k], self.tick[0])

    @ti.func
    def _velocity(self, pin, tick):
        pose = self.pose[tick * self.count + pin.path]
        return pose.v + pose.change @ pin.arm

    @ti.func
    def set_velocities(self, mean: ti.template()):
        """Give pins the mean of their velocities in this substep and the next, or that in this one, after `drive`."""
        for k in range(self.m):
            pin = self.pin[k]
            v = self._velocity(pin, self.tick[0] - 1)
            if ti.static(mean):
                v = 0.5 * (v + self.ahead(k))
            self.state.ball[pin.ball].v = v

    @ti.func
    def look_ahead(self):
        """Give pins their velocities in the next substep, after `drive`."""
        for k in range(self.m):
            self.state.ball[self.pin[k].ball].v = self.ahead(k)

    @ti.func
    def drive(self, forth: ti.template()):
        """Set places and velocities for the present substep; forth: and go on to the next."""
        for k in range(self.m):
            pin = self.pin[k]
            pose = self.pose[self.tick[0] * self.count + pin.path]
            self.state.ball[pin.ball].x = pose.x + pose.rotation @ pin.arm
            self.state.ball[pin.ball].v = self._velocity(pin, self.tick[0])
            if ti.static(self.state.compensated):
                self.state.low[pin.ball].x = ti.Vector.zero(float, self.dim)
                self.state.low[pin.ball].v = ti.Vector.zero(float, self.dim)
        if ti.static(forth):
            ti.loop_config(serialize=True)
            for _ in range(1):
                self.tick[0] = self.tick[0] + 1


@ti.data_oriented
class DrivenPinSlopes:
    """Accelerations by springs to driven pins at the start of a step. A pin has one velocity through a step and another through
    the next. Accelerations that the first left at its end have damping by it; the next step needs that by the second: more by w
    c (n . du) n for each damped spring from a free ball to a pin whose velocity changes by du. Without that the error is of
    first order in the step, at corners and where pins speed up."""

    def __init__(self, model: Model, state: State, pins: DrivenPins, springs: Springs, fields: Fields) -> None:
        scene = model.scene
        self.model, self.state, self.pins, self.springs = model, state, pins, springs
        number = np.full(scene.n_balls, -1, dtype=np.int64)
        number[np.concatenate([moving.balls for moving in scene.moving_pins])] = np.arange(pins.m)
        found = []  # ball, pin, spring in the scene
        for own, far in (scene.pairs.T, scene.pairs.T[::-1]):
            e = np.flatnonzero((scene.damping > 0) & ~scene.pinned[own] & (number[far] >= 0))
            found.append(np.stack([own[e], far[e], number[far[e]], e], axis=1))
        table = np.concatenate(found)
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
        self.damper = fields.table(columns, len(table), data)

    @ti.func
    def renew(self, slope: ti.template()):
        """Change slope (n) [m/s^2], at the end of a step, from the velocities of pins in this step to those in the next."""
        for b in range(self.m):
            i = self.ball[b]
            change = ti.Vector.zero(float, self.model.dim)
            for k in range(self.first[b], self.first[b + 1]):
                damper = self.damper[k]
                x, far = self.state.ball[i].x, self.state.ball[damper.far]
                n, _ = unit(far.x - x, i, damper.far)
                du = self.pins.ahead(damper.pin) - far.v
                change += self.springs.spring[damper.place].damping * du.dot(n) * n
            slope[i] = slope[i] + self.model.inverse_mass[i] * change
