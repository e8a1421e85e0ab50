"""StepTurns: the angular momentum of bodies that nothing holds, over a step of TR-BDF2."""

from typing import Any

from taichi_sim.analysis.methods import MOST_TURNED_BACK
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields

__all__ = ["StepTurns"]


@ti.data_oriented
class StepTurns:
    """Kicks that turn each free body, so that the forces inside it do not change its angular momentum in a step.

    They have no torque at the places x where they act, but a step adds up forces at several places: sum m x * v changes by
    h / 4 sum m (x1 - x0) * (a0 - a1) in the trapezoidal rule. That is h^3 where the step resolves the motion, and h where it does
    not. The kick w * x, with I w = -(this change), moves nothing, and so strains nothing.

    Fields: `kick` (n) [m/s]; `turn` [1/s] and `centre` [m] of each body, from its first ball, at the end of the step; in 2D
    with a third axis."""

    def __init__(self, method: Any, fields: Fields) -> None:
        """method: a TRBDF2, whose `mean(i)` and `pushed(i)` are the mean velocity of ball i in the step and what kicks from
        outside add to its velocity [m/s]."""
        self.method, self.state, self.turns = method, method.state, method.solver.turns
        self.bodies, self.free, self.wide = method.solver.bodies, method.solver.free, fields.wide
        vector = ti.types.vector(3, fields.wide)
        columns = dict.fromkeys(("gain", "end", "way", "speed"), vector)
        self.part = self.bodies.columns(columns | {"inertia": ti.types.matrix(3, 3, fields.wide)})
        self.turn, self.centre = (fields.vectors(self.bodies.count, 3) for _ in range(2))
        self.kick = fields.vectors(method.model.n, method.model.dim)

    @ti.func
    def find(self, h):
        """Find the kicks at the end of a step of h seconds, from its start and what its stages came to."""
        if ti.static(self.free.some):
            self.bodies.each_part(self._collect, (h,))
            self.bodies.join((self.part.gain, self.part.end, self.part.way, self.part.speed, self.part.inertia))
            ti.loop_config(serialize=ti.static(self.bodies.few))
            for b in range(self.bodies.count):
                self._find_turn(b, h)
            for i in range(self.method.model.n):
                b = self.bodies.of(i)
                if self.free.mass[b] > 0.0 and self.method.model.inverse_mass[i] > 0.0:
                    first = self.bodies.ball(self.bodies.first_part(b), 0)
                    arm = ti.cast(self._arm(i, first) + self._way(i, first, h), float) - self.centre[b]
                    self.kick[i] = self.turns.short(self.turn[b].cross(arm))

    @ti.func
    def _arm(self, i, first):
        """Place of ball i from the first one of its body at the start."""
        arm = self._apart(self.state.ball[i].x, self.state.ball[first].x)
        if ti.static(self.state.compensated):
            arm += self._apart(self.state.low[i].x, self.state.low[first].x)
        return arm

    @ti.func
    def _way(self, i, first, h):
        """Way of ball i in the step from the first one of its body."""
        return ti.cast(h, self.wide) * self._apart(self.method.mean(i), self.method.mean(first))

    @ti.func
    def _apart(self, a, b):
        return self.turns.long(a) - self.turns.long(b)

    @ti.func
    def _collect(self, c, h):
        """Part c of what its body gained: with the change d of v by forces inside, of which sum m d = 0, and the push k from
        outside, sum m (x' * v' - x * v - (x + x') / 2 * k) is sum m (x * d + (x' - x) * (v' - k / 2))."""
        gain, end, ways = ti.Vector.zero(self.wide, 3), ti.Vector.zero(self.wide, 3), ti.Vector.zero(self.wide, 3)
        speeds, inertia, b = ti.Vector.zero(self.wide, 3), ti.Matrix.zero(self.wide, 3, 3), self.bodies.part[c].body
        if self.free.mass[b] > 0.0:
            first = self.bodies.ball(self.bodies.first_part(b), 0)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                w = ti.cast(self.method.model.inverse_mass[i], self.wide)
                if w > 0.0:
                    arm, way, v = self._arm(i, first), self._way(i, first, h), self.method.solver.base[i].v
                    pushed = self.method.pushed(i)
                    change = self.turns.long(v) - self.turns.long(self.state.ball[i].v) - self.turns.long(pushed)
                    speed = self._apart(v, self.method.solver.base[first].v) - 0.5 * self.turns.long(pushed)
                    gain += (arm.cross(change) + way.cross(speed)) / w
                    end += (arm + way) / w
                    ways += way / w
                    speeds += speed / w
                    inertia += self.turns.inertia(arm + way, 1.0 / w)
        self.part[c].gain, self.part[c].end, self.part[c].way = gain, end, ways
        self.part[c].speed, self.part[c].inertia = speeds, inertia

    @ti.func
    def _find_turn(self, b, h):
        self.turn[b] = ti.Vector.zero(float, 3)
        if self.free.mass[b] > 0.0 and self.turns.held[b] == 0:
            mass = ti.cast(self.free.mass[b], self.wide)
            gain = self.bodies.total(self.part.gain, b)
            gain -= self.bodies.total(self.part.way, b).cross(self.bodies.total(self.part.speed, b)) / mass
            turn, centre = self.turns.against(
                gain, self.bodies.total(self.part.end, b), self.bodies.total(self.part.inertia, b), mass
            )
            angle = h * turn.norm()
            self.turn[b], self.centre[b] = turn * (MOST_TURNED_BACK / ti.max(angle, MOST_TURNED_BACK)), centre
