"""Sticks: springs that balls bounce off."""

from taichi_sim.contacts.pairs import Pairs
from taichi_sim.contacts.walls import SLOP
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import contact_law, statistics, stick_sweeps, warm_start
from taichi_sim.kernels.contacts import sticks as loops
from taichi_sim.kernels.contacts.pair_sweeps import zero_spin
from taichi_sim.kernels.vectors import cross

__all__ = ["Sticks"]

MINIMUM_CAPACITY = 1 << 16  # rows
MOST = 1 << 29  # rows; each has three entries


@ti.data_oriented
class Sticks:
    """Ball-stick contacts: the stick is its two end balls, each taking part by how near the hit is. capacity: rows
    known to be needed.

    `row` holds a pair: the normal from stick to ball, where on the stick (0 to 1) and how far off [m], its target speed [m/s]
    and what it holds, from step to step where that is `warm`: see kernels.contacts.warm_start and stick_sweeps. `push` [N s]:
    what is to be applied to its ball; the ends get their parts of the reverse. The rows of a stick lie at `begin`, `length` of
    them."""

    what = "balls that touch sticks"
    places = 3
    most = MOST

    def __init__(self, model: Model, fields: Fields, pairs: Pairs, capacity: int = 0) -> None:
        scene = model.scene
        ends = scene.pairs[scene.collides]
        self.model, self.pairs, self.grid = model, pairs, pairs.grid
        self.m = len(ends)
        self.one, self.two = fields.integers(ends[:, 0]), fields.integers(ends[:, 1])
        usual = max(MINIMUM_CAPACITY if model.n > 64 else self.m * model.n, 4 * (model.n + self.m))
        self.capacity = max(capacity, usual)
        before = fields.bytes
        self.warm = pairs.warm
        real, vector = fields.real, ti.types.vector(model.dim, fields.real)
        holds = {"impulse": real, **({"slide": vector} if model.has_friction else {})}
        seen = dict.fromkeys(("start", "gained", "speed"), real) if self.warm else {}
        found = {"ball": ti.i32, "stick": ti.i32, "normal": vector, **dict.fromkeys(("at", "distance"), real)}
        self.row = fields.table({**found, **dict.fromkeys(("target", "noted"), real), **holds, **seen}, self.capacity)
        self.begin, self.length = fields.integers(self.m), fields.integers(self.m)
        if self.warm:
            self.old = fields.table({"other": ti.i32, **holds}, self.capacity)
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
        """The ball of an entry, see contact_incidence: of its row the ball, or an end of the stick."""
        row = self.row[entry // 3]
        which = entry % 3
        return ti.select(which == 0, row.ball, ti.select(which == 1, self.one[row.stick], self.two[row.stick]))

    @ti.func
    def comes_after(self, entry, other):
        """Whether an entry comes after another: by stick, then by place in that stick's rows."""
        a, b = self.row[entry // 3].stick, self.row[other // 3].stick
        return a > b or (a == b and entry > other)

    @ti.func
    def shares(self, i):
        """What decides into how many parts ball i splits its mass, see mass_sharing: one for each stick, whose rows know of
        each other. As an end it may be pushed in any direction by one."""
        T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        count, before = 0, -1
        for e in range(self.first[i], self.first[i] + self.number[i]):
            row = self.row[self.entry[e] // 3]
            if row.stick != before:  # they lie together
                count += 1
                if self.entry[e] % 3 == 0:
                    T += row.normal.outer_product(row.normal)
                else:
                    T += ti.Matrix.identity(float, self.model.dim)
            before = row.stick
        return T, count

    @ti.func
    def begin_rows(self, ball: ti.template(), solver: ti.template(), impacts: ti.template()):
        """Fix the target speed of every row, and what it starts with."""
        for c in range(ti.min(self.used[0], self.capacity)):
            row = self.row[c]
            u = self.relative_velocity(ball, row).dot(row.normal)
            e = self.law(row).restitution
            self.row[c].target = contact_law.target_speed(u, e, solver.threshold[0], impacts)
            warm_start.start(self, solver, c, u, row.normal)

    @ti.func
    def end_rows(self, ball: ti.template()):
        """Keep of what rows hold what may be a load."""
        for c in range(ti.min(self.used[0], self.capacity)):
            row = self.row[c]
            inverse = self.model.inverse_mass[row.ball]
            inverse += self.model.inverse_mass[self.one[row.stick]] * (1.0 - row.at) ** 2
            inverse += self.model.inverse_mass[self.two[row.stick]] * row.at**2
            warm_start.limit(self, c, inverse, self.relative_velocity(ball, row).dot(row.normal))

    @ti.func
    def solve_rows(self, ball: ti.template(), solver: ti.template(), time):
        """Further impulses of all rows from the present velocities; viscous friction acts for `time` seconds."""
        for s in range(ti.select(self.used[0] > 0, self.m, 0)):
            if self.length[s] > 0:
                stick_sweeps.solve(self, solver, ball, s, time)

    @ti.func
    def inverse_mass(self, solver: ti.template(), row):
        """sum w_i g_i^2 s_i over the three balls."""
        one, two = solver.lightness[self.one[row.stick]], solver.lightness[self.two[row.stick]]
        return solver.lightness[row.ball] + one * (1.0 - row.at) ** 2 + two * row.at**2

    @ti.func
    def relative_velocity(self, ball: ti.template(), row):
        """Velocity of the ball of a row from the stick where it touches."""
        one, two = ball[self.one[row.stick]].v, ball[self.two[row.stick]].v
        return ball[row.ball].v - (1.0 - row.at) * one - row.at * two

    @ti.func
    def law(self, row):
        """Pair law of a row: the ball's material against that of the stick's first end."""
        return self.model.laws[
            self.model.surface[row.ball] * self.model.surfaces + self.model.surface[self.one[row.stick]]
        ]

    @ti.func
    def weight(self, entry):
        """Weight of the ball of an entry in its row: 1, or minus the part that the hit is an end's."""
        t = self.row[entry // 3].at
        return ti.select(entry % 3 == 0, 1.0 + 0.0 * t, ti.select(entry % 3 == 1, t - 1.0, -t))

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i):
        """Impulse and twist on ball i from all rows it takes part in. The ends of a stick, being points of it, take no twist."""
        p, t = ti.Vector.zero(float, self.model.dim), zero_spin(solver)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            c = self.entry[e] // 3
            p += self.weight(self.entry[e]) * self.push[c]
            if ti.static(solver.spins):
                if self.entry[e] % 3 == 0:
                    t -= cross(self.row[c].normal, self.push[c])
        return p, t

    @ti.func
    def offset(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] from the sticks it overlaps, or as a stick's end from the balls that overlap it."""
        q = ti.Vector.zero(float, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            row = self.row[self.entry[e] // 3]
            u = self.relative_velocity(ball, row).dot(row.normal)
            depth = self.model.radius[row.ball] * (1.0 - SLOP) - row.distance - h * ti.max(0.0, u)
            # near a pinned end the other one is a long lever: no ball is moved by more than the depth
            one, two = self.model.inverse_mass[self.one[row.stick]], self.model.inverse_mass[self.two[row.stick]]
            lever = ti.max(one * (1.0 - row.at), two * row.at)
            share = ti.max(0.0, depth) / ti.max(self.inverse_mass(solver, row), lever)
            q += solver.push_out * self.weight(self.entry[e]) * share * row.normal
        return q * self.model.inverse_mass[i]

    @ti.func
    def survey(self, ball: ti.template(), i):
        """Tally of the sticks that ball i touches."""
        total = statistics.nothing()
        for e in range(self.first[i], self.first[i] + self.number[i]):
            if self.entry[e] % 3 == 0:
                row = self.row[self.entry[e] // 3]
                u = self.relative_velocity(ball, row).dot(row.normal)
                depth = self.model.radius[i] - row.distance
                total = statistics.join(total, statistics.one(ti.max(0.0, depth), self.model.radius[i], u, False, i))
        return total
