"""FreeTurns: the angular momentum of bodies that nothing holds, in an implicit stage."""

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.integrators.bodies import Bodies, FreeBodies

__all__ = ["FreeTurns"]

SMALLEST_INERTIA = 1e-6  # of the trace, added about each axis: balls on a line have none about it


@ti.data_oriented
class FreeTurns:
    """Turns the velocities v of each free body as a whole, so that what its stage left unsolved gives it no angular momentum.

    Springs and elements give none at the places x where they act: sum x * m (v - q) = 0 of a solution. What that sum is of a
    solution that is not exact, the rotation w with I w = -sum x * m (v - q) takes away. It turns these places by the angle s w,
    on circles, and so deforms nothing: on tangents, w * x, it gave a cube of steel half its energy in a step.

    Fields: `step` [s] of the stage; `turn` [1/s] and `centre` [m] of each body, from its first ball; in 2D with a third axis."""

    def __init__(self, model: Model, bodies: Bodies, free: FreeBodies, fields: Fields) -> None:
        self.bodies, self.dim, self.n, self.some = bodies, model.dim, model.n, free.some
        self.mass, self.inverse_mass, self.wide = free.mass, model.inverse_mass, fields.wide
        vector = ti.types.vector(3, self.wide)
        self.part = bodies.columns({"moment": vector, "torque": vector, "inertia": ti.types.matrix(3, 3, self.wide)})
        self.turn, self.centre = (fields.vectors(bodies.count, 3) for _ in range(2))
        self.step = fields.reals(1)
        self.held = fields.integers(bodies.count)  # 1: surfaces hold balls of this body, and may give it a torque

    @ti.func
    def long(self, vector):
        """A vector, padded or not, with three components in double precision."""
        long = ti.Vector.zero(self.wide, 3)
        for a in ti.static(range(self.dim)):
            long[a] = ti.cast(vector[a], self.wide)
        return long

    @ti.func
    def _arm(self, i, b, ahead: ti.template()):
        """Place of ball i where the elements of body b act, from the first ball of that."""
        first = self.bodies.ball(self.bodies.first_part(b), 0)
        s = ti.cast(self.step[0], self.wide)
        return self.long(ahead[i].x - ahead[first].x) + s * self.long(ahead[i].v - ahead[first].v)

    @ti.func
    def correct(self, ahead: ti.template(), table: ti.template(), target: ti.template()):
        """Turn the velocities table.v (n), which have the momentum of the velocities `target` (n). ahead (n): x and v, padded,
        with which elements were asked last."""
        if ti.static(self.some):
            self.bodies.each_part(self._collect_part, (ahead, table, target))
            self.bodies.join((self.part.moment, self.part.torque, self.part.inertia))
            ti.loop_config(serialize=ti.static(self.bodies.few))
            for b in range(self.bodies.count):
                self._find_turn(b)
            for i in range(self.n):
                b = self.bodies.of(i)
                if self.inverse_mass[i] > 0.0 and self.mass[b] > 0.0:
                    arm = ti.cast(self._arm(i, b, ahead), float) - self.centre[b]
                    table[i].v = table[i].v + self.short(self._along_circle(self.turn[b], arm))

    @ti.func
    def _along_circle(self, turn, arm):
        """Mean velocity over the step with which the end of an arm turns about its start, by Cayley's rotation."""
        half = 0.5 * self.step[0] * turn
        tangent = turn.cross(arm)
        return (tangent + half.cross(tangent)) / (1.0 + half.dot(half))

    @ti.func
    def short(self, vector):
        """The components of a vector that the scene has."""
        short = ti.Vector.zero(float, self.dim)
        for a in ti.static(range(self.dim)):
            short[a] = vector[a]
        return short

    @ti.func
    def _collect_part(self, c, ahead: ti.template(), table: ti.template(), target: ti.template()):
        moment, torque = ti.Vector.zero(self.wide, 3), ti.Vector.zero(self.wide, 3)
        inertia, b = ti.Matrix.zero(self.wide, 3, 3), self.bodies.part[c].body
        if self.mass[b] > 0.0:
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                w = ti.cast(self.inverse_mass[i], self.wide)
                if w > 0.0:
                    arm = self._arm(i, b, ahead)
                    moment += arm / w
                    torque += arm.cross(self.long(table[i].v) - self.long(target[i])) / w
                    inertia += self.inertia(arm, 1.0 / w)
        self.part[c].moment, self.part[c].torque, self.part[c].inertia = moment, torque, inertia

    @ti.func
    def inertia(self, arm, mass):
        """Inertia (3, 3) of a mass at an arm (3,)."""
        return mass * (arm.dot(arm) * ti.Matrix.identity(self.wide, 3) - arm.outer_product(arm))

    @ti.func
    def _find_turn(self, b):
        self.turn[b] = ti.Vector.zero(float, 3)
        if self.mass[b] > 0.0 and self.held[b] == 0:
            moment, torque = self.bodies.total(self.part.moment, b), self.bodies.total(self.part.torque, b)
            self.turn[b], self.centre[b] = self.against(
                torque, moment, self.bodies.total(self.part.inertia, b), ti.cast(self.mass[b], self.wide)
            )

    @ti.func
    def against(self, momentum, moment, inertia, mass):
        """Turn [1/s] that takes an angular momentum from a body of this mass, and its centre: sums of m x and of the inertia."""
        centre = moment / mass
        own = inertia - self.inertia(centre, mass)
        size, turn = own.trace(), ti.Vector.zero(self.wide, 3)
        if size > 0.0:
            one = SMALLEST_INERTIA * ti.Matrix.identity(self.wide, 3)
            turn = -(own / size + one).inverse() @ momentum / size
        return ti.cast(turn, float), ti.cast(centre, float)
