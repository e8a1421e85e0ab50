"""Walls: impacts at their exact time while a ball moves, resting contact as rows of the contact solve."""

import numpy as np
import taichi as ti

from taichi_sim.fields import Fields
from taichi_sim.kernels import contact_law, impact
from taichi_sim.model import Model

__all__ = ["Walls"]

TOUCH = 1e-5  # of the radius: a ball this close that hardly approaches rests on the wall
SLOP = 0.01  # of the radius: depth that position correction leaves


@ti.data_oriented
class Walls:
    """All walls of a scene; each ball asks each wall."""

    def __init__(self, model: Model, fields: Fields, threshold: float) -> None:
        self.model = model
        self.threshold = threshold
        self.rounding = 4.0 * float(np.finfo(np.float64 if fields.real == ti.f64 else np.float32).eps)
        walls = model.scene.walls
        self.count = len(walls)
        vector = ti.types.vector(model.dim, fields.real)
        self.wall = fields.table(
            {"normal": vector, "offset": fields.real, "surface": ti.i32},
            self.count,
            {
                "normal": np.array([w.normal for w in walls]),
                "offset": np.array([w.offset for w in walls]),
                "surface": np.array([w.material for w in walls]),
            },
        )

        columns = {"impulse": fields.real, "target": fields.real, "active": ti.i32}
        if model.has_friction:
            columns["slide"] = vector
        self.contact = fields.table(columns, model.n * self.count)
        self.touched = fields.integers(model.n)  # walls that a ball touches: most touch none and are passed over

    def names(self) -> list[str]:
        """What is compiled in, for `Simulation.kernels()`."""
        return ["walls.impact", "walls.resting"]

    @ti.func
    def tolerance(self, x, i):
        """Gap [m] below which ball i at x touches; never finer than its coordinates are."""
        return TOUCH * self.model.radius[i] + self.rounding * ti.abs(x).max()

    @ti.func
    def law(self, i, k):
        """Pair law of ball i and wall k."""
        return self.model.laws[self.model.surface[i] * self.model.surfaces + self.wall[k].surface]

    @ti.func
    def gap(self, x, i, k):
        """Distance from the surface of ball i to wall k [m]; negative inside."""
        return self.wall[k].normal.dot(x) - self.wall[k].offset - self.model.radius[i]

    @ti.func
    def move(self, i, x, v, a, h):
        """Displacement over h and drift velocity of ball i; see kernels.impact."""
        return impact.move(self, i, x, v, a, h, self.threshold)

    @ti.func
    def measure(self, ball: ti.template(), i):
        """Sum of n n^T over the walls that ball i touches, and their number; a wall that it left holds no impulse."""
        T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        count = 0
        for k in range(self.count):
            if self.gap(ball[i].x, i, k) <= self.tolerance(ball[i].x, i):
                n = self.wall[k].normal
                T += n.outer_product(n)
                count += 1
                slow = ti.abs(n.dot(ball[i].v)) <= self.threshold
                self.contact[i * self.count + k].active = slow or self.gap(ball[i].x, i, k) < -self.tolerance(
                    ball[i].x, i
                )
            else:
                self.contact[i * self.count + k].impulse = 0.0
                self.contact[i * self.count + k].active = 0
        self.touched[i] = count
        return T, count

    @ti.func
    def begin(self, ball: ti.template(), solver: ti.template(), i, impacts: ti.template()):
        """Impulse on ball i that its walls hold from before. A ball that arrives fast at a wall is left to `move`."""
        p = ti.Vector.zero(float, self.model.dim)
        if self.touched[i] > 0:
            for k in range(self.count):
                c = i * self.count + k
                gap = self.gap(ball[i].x, i, k)
                if gap <= self.tolerance(ball[i].x, i):
                    n = self.wall[k].normal
                    u = n.dot(ball[i].v)
                    rests = ti.abs(u) <= self.threshold
                    self.contact[c].active = rests or gap < -self.tolerance(ball[i].x, i)
                    if not rests or ti.static(not solver.warm):
                        self.contact[c].impulse = 0.0
                    restitution = self.law(i, k).restitution
                    self.contact[c].target = contact_law.target_speed(u, restitution, self.threshold, impacts)
                    if ti.static(self.model.has_friction):
                        self.contact[c].slide = 0.0 * n
                    p += self.contact[c].impulse * n
        return p

    @ti.func
    def first_pass(self, ball: ti.template(), solver: ti.template(), i, time, impacts: ti.template()):
        """`begin` and `gather` in one, where nothing is held from before."""
        return self.begin(ball, solver, i, impacts) + self.gather(ball, solver, i, time)

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i, time):
        """Further impulse on ball i from the walls it rests on or is inside of. Fast arrivals are left to `move`."""
        p = ti.Vector.zero(float, self.model.dim)
        for k in range(ti.select(self.touched[i] > 0 and self.model.inverse_mass[i] > 0.0, self.count, 0)):
            c = i * self.count + k
            contact = self.contact[c]
            if contact.active:
                n = self.wall[k].normal
                mass = 1.0 / solver.lightness[i]
                total = contact_law.normal_impulse(ball[i].v, n, contact.target, mass, contact.impulse)
                p += (total - contact.impulse) * n
                self.contact[c].impulse = total
                if ti.static(self.model.has_friction):
                    if contact_law.presses(total, mass, self.threshold):
                        law = self.law(i, k)
                        slip = contact_law.decayed(law.viscous_friction * time)
                        bound = law.friction * total
                        change, slide = contact_law.sliding_impulse(ball[i].v, n, mass, contact.slide, bound, slip)
                        self.contact[c].slide = slide
                        p += change
        return p

    @ti.func
    def offset(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] beyond the slop that its own motion will not undo."""
        d = ti.Vector.zero(float, self.model.dim)
        for k in range(ti.select(self.touched[i] > 0, self.count, 0)):
            n = self.wall[k].normal
            depth = -self.gap(ball[i].x, i, k) - SLOP * self.model.radius[i] - h * ti.max(0.0, n.dot(ball[i].v))
            if depth > 0.0 and self.model.inverse_mass[i] > 0.0:
                d += solver.push_out * depth * self.model.inverse_mass[i] / solver.lightness[i] * n
        return d
