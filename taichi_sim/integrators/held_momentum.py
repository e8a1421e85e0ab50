"""The momentum that surfaces take from bodies beside what an implicit stage finds, and what probes are told of it."""

from typing import Any

from taichi_sim.device.engine import ti

__all__ = ["HeldMomentum"]


@ti.data_oriented
class HeldMomentum:
    """The part of HeldBalls that knows bodies as a whole, see there for its fields."""

    model: Any
    walls: Any
    contact: Any
    friction: Any
    normals: Any
    bodies: Any
    part: Any
    pushes: Any
    last_pushing: Any
    firm: float
    dim: int
    wide: Any
    rubs: bool
    holds: Any

    @ti.func
    def restrict(self, free: ti.template()):
        """Leave of the velocity free.shift that each body lacks what surfaces and friction allow all of it to have: they would
        stop their balls alone, which would strain the body. What they stop is an error of the stage, see `tell_probes`."""
        self.bodies.each_part(self._sum_stops, ())
        self.bodies.join((self.part.stops, self.part.drags, self.part.mass))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            mass = self.bodies.total(self.part.mass, b)
            if mass > 0.0 and free.mass[b] > 0.0:
                resists = ti.Matrix.identity(self.wide, self.dim)
                resists += self.bodies.total(self.part.drags, b) / ti.cast(free.mass[b], self.wide)
                resists += (self.firm / mass) * self.bodies.total(self.part.stops, b)
                free.shift[b] = ti.cast(resists.inverse(), float) @ free.shift[b]

    @ti.func
    def _sum_stops(self, c):
        """Part c of the directions in which balls are held, of their drag, and of their masses."""
        stops, drags = ti.Matrix.zero(self.wide, self.dim, self.dim), ti.Matrix.zero(self.wide, self.dim, self.dim)
        mass = ti.cast(0.0, self.wide)
        for k in range(self.bodies.part[c].count):
            i = self.bodies.ball(c, k)
            if self.holds(i):
                m = 1.0 / ti.cast(self.model.inverse_mass[i], self.wide)
                normals = ti.cast(self.normals[i], self.wide)
                # a projection up to rounding of `wide`: `firm` times that of singles would undo what resists along the surface
                normals = normals @ normals @ (3.0 * ti.Matrix.identity(self.wide, self.dim) - 2.0 * normals)
                stops += m * normals
                mass += m
                if ti.static(self.rubs):
                    drag = m * ti.cast(self.friction[i].drag, self.wide)
                    drags += drag * (ti.Matrix.identity(self.wide, self.dim) - normals)
        self.part[c].stops = stops
        self.part[c].drags = drags
        self.part[c].mass = mass

    @ti.func
    def tell_probes(self, free: ti.template(), part):
        """Tell probes of `part` of the momentum that each body lacks by free.shift: its surfaces took it, by their pushes at the
        end of the stage. Where none pushes any more, the last one did."""
        self.bodies.each_part(self._sum_pushes, ())
        self.bodies.join((self.pushes.total,))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.bodies.total(self.pushes.total, b) > 0.0:
                self.last_pushing[b] = -1.0
        for i in range(self.model.n):
            b = self.bodies.of(i)
            given, pushes = -part * free.mass[b] * free.shift[b], self.bodies.total(self.pushes.total, b)
            if free.mass[b] > 0.0 and pushes > 0.0:
                for k in range(self.walls.count):
                    push = self._pushes(i, k)
                    if push > 0.0:
                        self.walls.record(i, k, ti.cast(push / pushes, float) * given)
                        ti.atomic_max(self.last_pushing[b], ti.cast(self.walls.receiver(i, k), float))
            elif free.mass[b] > 0.0 and i == self.bodies.ball(self.bodies.first_part(b), 0):
                self.walls.received.add(i, ti.cast(self.last_pushing[b], ti.i32), given)

    @ti.func
    def _sum_pushes(self, c):
        total = ti.cast(0.0, self.wide)
        for j in range(self.bodies.part[c].count):
            for k in range(self.walls.count):
                total += self._pushes(self.bodies.ball(c, j), k)
        self.pushes[c].total = total

    @ti.func
    def _pushes(self, i, k):
        """Impulse by which surface k pushes ball i in the stage [N s], 0 where it does not hold it."""
        push = ti.cast(0.0, self.wide)
        if self.contact[i * self.walls.count + k].holds == 1:
            push = ti.cast(self.contact[i * self.walls.count + k].push, self.wide)
            push /= ti.cast(self.model.inverse_mass[i], self.wide)
        return push
