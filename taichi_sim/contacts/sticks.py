"""Sticks: springs that balls bounce off."""

import numpy as np
import taichi as ti

from taichi_sim.contacts.pairs import Pairs
from taichi_sim.contacts.walls import SLOP
from taichi_sim.fields import Fields
from taichi_sim.kernels import contact_law, held, survey
from taichi_sim.kernels import sticks as loops
from taichi_sim.kernels.direction import cross, lever
from taichi_sim.kernels.sweeps import zero_turn
from taichi_sim.model import Model

__all__ = ["Sticks"]

MINIMUM_CAPACITY = 1 << 16  # rows
MOST = 1 << 29  # rows; each has three entries


@ti.data_oriented
class Sticks:
    """Ball-stick contacts: the stick is its two end balls, each taking part by how near the hit is. room: rows known to be
    needed.

    `row` holds a pair, its target speed [m/s] and what it holds, from step to step where that is `warm`: see kernels.held. `push`
    [N s]: what is to be applied to its ball; the ends get their parts of the reverse.
    """

    what = "balls that touch sticks"
    places = 3
    most = MOST

    def __init__(self, model: Model, fields: Fields, pairs: Pairs, room: int = 0) -> None:
        scene = model.scene
        ends = scene.pairs[scene.collides]
        self.model, self.pairs, self.grid = model, pairs, pairs.grid
        self.m = len(ends)
        self.one, self.two = fields.integers(ends[:, 0]), fields.integers(ends[:, 1])
        usual = max(MINIMUM_CAPACITY if model.n > 64 else self.m * model.n, 4 * (model.n + self.m))
        self.capacity = max(room, usual)
        before = fields.bytes
        self.warm = pairs.warm
        real, vector = fields.real, ti.types.vector(model.dim, fields.real)
        holds = {"impulse": real, **({"slide": vector} if model.has_friction else {})}
        seen = dict.fromkeys(("start", "gained", "speed"), real) if self.warm else {}
        self.row = fields.table({"ball": ti.i32, "stick": ti.i32, "target": real, **holds, **seen}, self.capacity)
        if self.warm:
            self.old = fields.table({"other": ti.i32, **holds}, self.capacity)
            self.begin, self.length = fields.integers(self.m), fields.integers(self.m)
        self.push = fields.vectors(self.capacity, model.dim)
        self.entry = fields.integers(3 * self.capacity)
        self.bytes_each = (fields.bytes - before) / self.capacity
        self.first, self.number = fields.integers(model.n), fields.integers(model.n)
        self.used, self.entries, self.overflow = (fields.integers(1) for _ in range(3))

    def names(self) -> list[str]:
        """What is compiled in, for `Simulation.kernels()`."""
        return ["sticks"]

    def forget(self) -> None:
        """Nothing is held from before, once sticks are looked at again."""
        if self.warm:
            self.length.fill(0)

    @ti.func
    def detect(self, ball: ti.template()):
        """Find all touching ball-stick pairs; the grid is built already."""
        loops.detect(self, ball)

    @ti.func
    def ball_of(self, entry):
        """The ball of an entry, see kernels.entries: of its row the ball, or an end of the stick."""
        row = self.row[entry // 3]
        which = entry % 3
        return ti.select(which == 0, row.ball, ti.select(which == 1, self.one[row.stick], self.two[row.stick]))

    @ti.func
    def comes_after(self, entry, other):
        """Whether an entry comes after another: by stick, then by place in that stick's rows."""
        a, b = self.row[entry // 3].stick, self.row[other // 3].stick
        return a > b or (a == b and entry > other)

    @ti.func
    def shares(self, ball: ti.template(), i):
        """Sum of n n^T over the rows of ball i, and their number."""
        T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            _, n, _ = loops.geometry(self, ball, self.row[self.entry[e] // 3])
            T += n.outer_product(n)
        return T, self.number[i]

    @ti.func
    def inverse_mass(self, solver: ti.template(), row, g):
        """sum w_i g_i^2 s_i over the three balls."""
        one, two = self.one[row.stick], self.two[row.stick]
        return solver.lightness[row.ball] + solver.lightness[one] * g[1] * g[1] + solver.lightness[two] * g[2] * g[2]

    @ti.func
    def begin_rows(self, ball: ti.template(), solver: ti.template(), impacts: ti.template()):
        """Fix the target speed of every row, and what it starts with."""
        for c in range(ti.min(self.used[0], self.capacity)):
            g, n, _ = loops.geometry(self, ball, self.row[c])
            u = self.relative_velocity(ball, self.row[c], g).dot(n)
            law = self.law(self.row[c])
            self.row[c].target = contact_law.target_speed(u, law.restitution, solver.threshold[0], impacts)
            held.start(self, solver, c, u, n)

    @ti.func
    def end_rows(self, ball: ti.template()):
        """Keep of what rows hold what may be a load."""
        for c in range(ti.min(self.used[0], self.capacity)):
            row = self.row[c]
            g, n, _ = loops.geometry(self, ball, row)
            inverse = self.model.inverse_mass[row.ball]
            inverse += self.model.inverse_mass[self.one[row.stick]] * g[1] * g[1]
            inverse += self.model.inverse_mass[self.two[row.stick]] * g[2] * g[2]
            held.limit(self, c, inverse, self.relative_velocity(ball, row, g).dot(n))

    @ti.func
    def solve_rows(self, ball: ti.template(), solver: ti.template(), time):
        """Further impulse of every row from the present velocities; viscous friction acts for `time` seconds."""
        for c in range(ti.min(self.used[0], self.capacity)):
            row = self.row[c]
            g, n, _ = loops.geometry(self, ball, row)
            u = self.relative_velocity(ball, row, g)
            inverse = self.inverse_mass(solver, row, g)
            mass = 1.0 / inverse
            total = contact_law.normal_impulse(u.dot(n), row.target, mass, row.impulse)
            p = (total - row.impulse) * n
            self.row[c].impulse = total
            if ti.static(self.model.has_friction):
                law = self.law(row)
                slip = contact_law.viscous_share(self.model, law, total, mass, solver.threshold[0], u, time)
                if ti.static(solver.spins):
                    u -= lever(solver.state.turn[row.ball], n)
                    mass = 1.0 / (inverse + solver.turning * solver.lightness[row.ball])
                change, slide = contact_law.sliding_impulse(
                    self.model, u, n, mass, row.slide, law.friction * total, slip
                )
                self.row[c].slide = slide
                p += change
            self.push[c] = p

    @ti.func
    def relative_velocity(self, ball: ti.template(), row, g):
        """sum g_i v_i of a row."""
        return ball[row.ball].v + g[1] * ball[self.one[row.stick]].v + g[2] * ball[self.two[row.stick]].v

    @ti.func
    def law(self, row):
        """Pair law of a row: the ball's material against that of the stick's first end."""
        return self.model.laws[
            self.model.surface[row.ball] * self.model.surfaces + self.model.surface[self.one[row.stick]]
        ]

    @ti.func
    def weight(self, ball: ti.template(), entry):
        """Weight of the ball of an entry in its row."""
        g, _, _ = loops.geometry(self, ball, self.row[entry // 3])
        return ti.select(entry % 3 == 0, g[0], ti.select(entry % 3 == 1, g[1], g[2]))

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i):
        """Impulse and twist on ball i from all rows it takes part in. The ends of a stick, being points of it, take no twist."""
        p, t = ti.Vector.zero(float, self.model.dim), zero_turn(solver)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            c = self.entry[e] // 3
            p += self.weight(ball, self.entry[e]) * self.push[c]
            if ti.static(solver.spins):
                if self.entry[e] % 3 == 0:
                    _, n, _ = loops.geometry(self, ball, self.row[c])
                    t -= cross(n, self.push[c])
        return p, t

    @ti.func
    def offset(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] from the sticks it overlaps, or as a stick's end from the balls that overlap it."""
        q = ti.Vector.zero(float, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            row = self.row[self.entry[e] // 3]
            g, n, d = loops.geometry(self, ball, row)
            u = self.relative_velocity(ball, row, g)
            depth = self.model.radius[row.ball] * (1.0 - SLOP) - d - h * ti.max(0.0, n.dot(u))
            # near a pinned end the other one is a long lever: no ball is moved by more than the depth
            one, two = self.one[row.stick], self.two[row.stick]
            lever = ti.max(self.model.inverse_mass[one] * -g[1], self.model.inverse_mass[two] * -g[2])
            share = ti.max(0.0, depth) / ti.max(self.inverse_mass(solver, row, g), lever)
            q += solver.push_out * self.weight(ball, self.entry[e]) * share * n
        return q * self.model.inverse_mass[i]

    @ti.func
    def survey(self, ball: ti.template(), i):
        """Tally of the sticks that ball i touches."""
        total = survey.nothing()
        for e in range(self.first[i], self.first[i] + self.number[i]):
            if self.entry[e] % 3 == 0:
                row = self.row[self.entry[e] // 3]
                g, n, d = loops.geometry(self, ball, row)
                u = self.relative_velocity(ball, row, g).dot(n)
                depth = self.model.radius[i] - d
                total = survey.join(total, survey.one(ti.max(0.0, depth), self.model.radius[i], u, False, i))
        return total


def has_sticks(model: Model) -> bool:
    """Whether any spring of the scene collides."""
    return bool(np.any(model.scene.collides))
