"""Walls: impacts at their exact time while a ball moves, resting contact as rows of the contact solve."""

import numpy as np
import taichi as ti

from taichi_sim.fields import Fields
from taichi_sim.kernels import contact_law, impact
from taichi_sim.kernels.direction import cross, lever
from taichi_sim.kernels.groups import meets
from taichi_sim.kernels.sweeps import zero_turn
from taichi_sim.model import Model
from taichi_sim.state import FAR, State

__all__ = ["Walls"]

TOUCH = 1e-5  # of the radius: a ball this close that hardly approaches rests on the wall
OUT, RESTING, NEAR = range(3)
SLOP = 0.01  # of the radius: depth that position correction leaves


@ti.data_oriented
class Walls:
    """All walls of a scene; each ball asks each wall."""

    def __init__(self, model: Model, state: State, fields: Fields, threshold: float, crowds: bool) -> None:
        self.model, self.state = model, state
        self.threshold = threshold
        self.rounding = 4.0 * float(np.finfo(np.float64 if fields.real == ti.f64 else np.float32).eps)
        walls = model.scene.walls
        self.count = len(walls)
        vector = ti.types.vector(model.dim, fields.real)
        columns = {"normal": vector, "offset": fields.real, "surface": ti.i32}
        values = {
            "normal": np.array([w.normal for w in walls]),
            "offset": np.array([w.offset for w in walls]),
            "surface": np.array([w.material for w in walls]),
        }
        if model.has_groups:
            columns |= {"group": ti.i32, "mask": ti.i32}
            values |= {"group": np.array([w.group for w in walls]), "mask": np.array([w.mask for w in walls])}
        self.wall = fields.table(columns, self.count, values)

        columns = {"impulse": fields.real, "target": fields.real, "active": ti.i32}
        if model.has_friction:
            columns["slide"] = vector
        self.contact = fields.table(columns, model.n * self.count)
        self.crowds = crowds
        if crowds:
            self.crowded = fields.integers(model.n)
        self.share = fields.reals(model.n)  # into how many parts a ball splits its mass between its walls
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
        """Distance from the surface of ball i to wall k [m]; negative inside. Walls that it does not collide with are far."""
        gap = self.wall[k].normal.dot(x) - self.wall[k].offset - self.model.radius[i]
        if ti.static(self.model.has_groups):
            if not meets(self.model.group[i], self.model.mask[i], self.wall[k].group, self.wall[k].mask):
                gap = 2.0 * FAR
        return gap

    @ti.func
    def move(self, i, x, v, a, h):
        """Displacement over h and drift velocity of ball i; see kernels.impact."""
        return impact.move(self, i, x, v, a, h, self.threshold)

    @ti.func
    def reach(self, x, i, crowded):
        """Gap [m] up to which ball i minds a wall. One among others may be pushed there by them in this very step."""
        return ti.select(crowded, self.model.radius[i], self.tolerance(x, i))

    @ti.func
    def _role(self, gap, u, x, i, crowded):
        """Part that a wall plays for ball i: OUT of the solve, RESTING in it, or NEAR."""
        role = ti.select(ti.abs(u) <= self.threshold or gap < -self.tolerance(x, i), RESTING, OUT)
        if crowded:
            role = ti.select(gap <= self.tolerance(x, i), RESTING, NEAR)
        return role

    @ti.func
    def measure(self, ball: ti.template(), i, crowded):
        """Which walls ball i touches, or minds; one that it left holds no impulse. crowded: it touches other balls."""
        count = 0
        T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        solving = 0
        reach = self.reach(ball[i].x, i, crowded)
        for k in range(self.count):
            c = i * self.count + k
            gap = self.gap(ball[i].x, i, k)
            if gap <= reach:
                count += 1
                role = self._role(gap, self.wall[k].normal.dot(ball[i].v), ball[i].x, i, crowded)
                self.contact[c].active = role
                if role != OUT:
                    n = self.wall[k].normal
                    T += n.outer_product(n)
                    solving += 1
            else:
                self._forget(c)
                self.contact[c].active = 0
        self.touched[i] = count
        self.share[i] = contact_law.share(T, solving, not self.model.has_friction)
        if ti.static(self.crowds):
            self.crowded[i] = ti.select(crowded, 1, 0)

    @ti.func
    def shares(self, ball: ti.template(), i):
        """Sum of n n^T over the walls that ball i touches, and their number."""
        T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        for k in range(ti.select(self.touched[i] > 0, self.count, 0)):
            if self.contact[i * self.count + k].active != OUT:
                n = self.wall[k].normal
                T += n.outer_product(n)
        return T, self.touched[i]

    @ti.func
    def _forget(self, c):
        """Contact c holds nothing from before."""
        self.contact[c].impulse = 0.0
        if ti.static(self.model.has_friction):
            self.contact[c].slide = ti.Vector.zero(float, self.model.dim)

    @ti.func
    def begin(self, ball: ti.template(), solver: ti.template(), i, impacts: ti.template()):
        """Apply what the walls of ball i hold from before. A ball that arrives fast at a wall is left to `move`."""
        v = ball[i].v
        crowded = False
        if ti.static(self.crowds):
            crowded = self.crowded[i] == 1
        reach = self.reach(ball[i].x, i, crowded)
        for k in range(ti.select(self.touched[i] > 0, self.count, 0)):
            c = i * self.count + k
            gap = self.gap(ball[i].x, i, k)
            if gap <= reach:
                n = self.wall[k].normal
                u = n.dot(v)
                self.contact[c].active = self._role(gap, u, ball[i].x, i, crowded)
                if (ti.abs(u) > self.threshold and not crowded) or ti.static(not solver.warm):
                    self._forget(c)
                target = contact_law.target_speed(u, self.law(i, k).restitution, self.threshold, impacts)
                if ti.static(self.crowds):
                    if crowded and gap > self.tolerance(ball[i].x, i):
                        soon = target > 0.0 and gap + u * solver.h[0] < 0.0
                        if not soon:  # it may come to the wall, but not go on
                            target = -gap / solver.h[0]
                self.contact[c].target = target
                p = self.contact[c].impulse * n
                if ti.static(self.model.has_friction):
                    p += self.contact[c].slide
                solver.apply(i, p, -cross(n, p))

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i, time):
        """Further impulse and twist on ball i from the walls it rests on or is inside of. Fast arrivals are left to `move`."""
        total, twist = ti.Vector.zero(float, self.model.dim), zero_turn(solver)
        v, turn = ball[i].v, zero_turn(solver)
        if ti.static(solver.spins):
            turn = solver.state.turn[i]
        w = self.model.inverse_mass[i]
        for k in range(ti.select(self.touched[i] > 0 and w > 0.0, self.count, 0)):
            c = i * self.count + k
            contact = self.contact[c]
            if contact.active != OUT:
                n = self.wall[k].normal
                mass = 1.0 / (w * self.share[i])
                if ti.static(solver.split):
                    mass = 1.0 / solver.lightness[i]
                if ti.static(solver.rule == "sum"):
                    mass = 1.0 / w
                held = contact.impulse
                now = contact_law.normal_impulse(v.dot(n), contact.target, mass, held)
                p = (now - held) * n
                self.contact[c].impulse = now
                if ti.static(self.model.has_friction):
                    law = self.law(i, k)
                    slip = contact_law.viscous_share(self.model, law, now, mass, self.threshold, time)
                    u = v
                    if ti.static(solver.spins):
                        u -= lever(turn, n)
                        mass *= solver.tangential
                    change, slide = contact_law.sliding_impulse(u, n, mass, contact.slide, law.friction * now, slip)
                    self.contact[c].slide = slide
                    p += change
                t = -cross(n, p)
                total += p
                twist += t
        return total, twist

    @ti.func
    def offset(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] beyond the slop that its own motion and other contacts will not undo."""
        d = ti.Vector.zero(float, self.model.dim)
        w = self.model.inverse_mass[i]
        for k in range(ti.select(self.touched[i] > 0 and w > 0.0, self.count, 0)):
            n = self.wall[k].normal
            depth = -self.gap(ball[i].x, i, k) - SLOP * self.model.radius[i] - h * ti.max(0.0, n.dot(ball[i].v))
            share = 1.0 / self.share[i]
            if ti.static(solver.in_turn):
                depth -= n.dot(solver.offset[i])
            if ti.static(solver.split):
                share = w / solver.lightness[i]
            if depth > 0.0:
                d += solver.push_out * depth * share * n
        return d
