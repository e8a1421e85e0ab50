"""Sticks: springs that balls bounce off."""

from taichi_sim.contacts.pairs import Pairs
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import contact_law, statistics, stick_sweeps, warm_start
from taichi_sim.kernels.contacts import sticks as loops
from taichi_sim.kernels.contacts.contact_incidence import each_contact
from taichi_sim.kernels.vectors import cross, zero_scalar_in_2d

__all__ = ["Sticks"]

MINIMUM_CAPACITY = 1 << 16  # contacts
LARGEST_CAPACITY = 1 << 29  # contacts; each has three entries


@ti.data_oriented
class Sticks:
    """Ball-stick contacts: the stick is its two end balls, each taking part by how near the hit is: the weights are 1 on the
    ball and -(1 - at), -at on the ends. Contacts of a stick lie together. capacity: contacts known to be needed."""

    what = "balls that touch sticks"
    balls_per_contact = 3
    most = LARGEST_CAPACITY

    def __init__(self, model: Model, fields: Fields, pairs: Pairs, capacity: int = 0) -> None:
        scene = model.scene
        ends = scene.pairs[scene.collides]
        self.model, self.pairs, self.grid, self.plan = model, pairs, pairs.grid, pairs.plan
        self.m = len(ends)
        self.most_solved = self.m  # one by one
        # (m) ball at either end
        self.one, self.two = fields.integers(ends[:, 0]), fields.integers(ends[:, 1])
        usual = max(MINIMUM_CAPACITY if model.n > 64 else self.m * model.n, 4 * (model.n + self.m))
        self.capacity = max(capacity, usual)
        before = fields.bytes
        real, vector = fields.real, ti.types.vector(model.dim, fields.real)
        # impulse: along the normal [N s]; tangential_impulse [N s]
        accumulated = {"impulse": real, **({"tangential_impulse": vector} if model.has_friction else {})}
        # starting_impulse: before the solve [N s]; gained_speed: of approach since it was last seen, last_speed: of then [m/s]
        seen = dict.fromkeys(("starting_impulse", "gained_speed", "last_speed"), real) if self.plan.warm_starts else {}
        # normal: from stick to ball; at: part of the stick at which it touches; distance [m]
        found = {"ball": ti.i32, "stick": ti.i32, "normal": vector, **dict.fromkeys(("at", "distance"), real)}
        # target: normal speed to come to [m/s]; previous_impulse: before the last iteration [N s]
        solved = dict.fromkeys(("target", "previous_impulse"), real)
        self.contact = fields.table({**found, **solved, **accumulated, **seen}, self.capacity)
        # of each stick: its first contact, and their number
        self.begin, self.length = fields.integers(self.m), fields.integers(self.m)
        if self.plan.warm_starts:
            # what contacts had accumulated, and with which ball, while they are listed anew
            self.old = fields.table({"other": ti.i32, **accumulated}, self.capacity)
        self.applied_impulse = fields.vectors(self.capacity, model.dim)  # N s, still to be applied
        self.entry = fields.integers(3 * self.capacity)
        self.bytes_each = (fields.bytes - before) / self.capacity
        self.first, self.number = fields.integers(model.n), fields.integers(model.n)
        self.used, self.entries, self.overflow = (fields.integers(1) for _ in range(3))

    def names(self) -> list[str]:
        """Names of the parts that are compiled in, for `Simulation.kernels()`."""
        return ["sticks"]

    def forget(self) -> None:
        """Clear what contacts have accumulated, once sticks are looked at again."""
        if self.plan.warm_starts:
            self.length.fill(0)

    @ti.func
    def detect(self, ball: ti.template()):
        """Find all touching ball-stick pairs; the grid is built already."""
        loops.detect(self, ball)

    @ti.func
    def ball_of(self, entry):
        """The ball of an entry, see contact_incidence: of its contact the ball, or an end of the stick."""
        contact = self.contact[entry // 3]
        which = entry % 3
        return ti.select(
            which == 0, contact.ball, ti.select(which == 1, self.one[contact.stick], self.two[contact.stick])
        )

    @ti.func
    def comes_after(self, entry, other):
        """True if an entry comes after another: by stick, then by place among its contacts."""
        a, b = self.contact[entry // 3].stick, self.contact[other // 3].stick
        return a > b or (a == b and entry > other)

    @ti.func
    def shares(self, i):
        """Sums that decide into how many parts ball i splits its mass, see mass_sharing: one for each stick, whose contacts
        know of each other. As an end it may be pushed in any direction by one."""
        T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        count, before = 0, -1
        for e in range(self.first[i], self.first[i] + self.number[i]):
            contact = self.contact[self.entry[e] // 3]
            if contact.stick != before:  # they lie together
                count += 1
                if self.entry[e] % 3 == 0:
                    T += contact.normal.outer_product(contact.normal)
                else:
                    T += ti.Matrix.identity(float, self.model.dim)
            before = contact.stick
        return T, count

    @ti.func
    def begin_contacts(self, ball: ti.template(), solver: ti.template(), impacts: ti.template()):
        """Fix the target speed of every contact, and what it starts with."""
        each_contact(self, self.begin_contact, (ball, solver, impacts))

    @ti.func
    def begin_contact(self, c, ball: ti.template(), solver: ti.template(), impacts: ti.template()):
        """Fix the target speed of contact c, and what it starts with."""
        contact = self.contact[c]
        u = self.relative_velocity(ball, contact).dot(contact.normal)
        e, forced = self.law(contact).restitution, 0.0 * u
        if ti.static(solver.plan.loaded):
            forced = -self.relative_velocity(solver.from_forces, contact).dot(contact.normal)
        self.contact[c].target = contact_law.target_speed(
            u, forced, solver.plan.late_part, e, solver.threshold[0], impacts
        )
        warm_start.start(self, solver, c, u, contact.normal)

    @ti.func
    def end_contacts(self, ball: ti.template()):
        """Limit what contacts accumulated to what may be a load."""
        each_contact(self, self.end_contact, (ball,))

    @ti.func
    def end_contact(self, c, ball: ti.template()):
        """Limit what contact c accumulated to what may be a load."""
        contact = self.contact[c]
        inverse = self.model.inverse_mass[contact.ball]
        inverse += self.model.inverse_mass[self.one[contact.stick]] * (1.0 - contact.at) ** 2
        inverse += self.model.inverse_mass[self.two[contact.stick]] * contact.at**2
        warm_start.limit(self, c, inverse, self.relative_velocity(ball, contact).dot(contact.normal))

    @ti.func
    def solve_contacts(self, ball: ti.template(), solver: ti.template(), time):
        """Further impulses of all contacts from the present velocities; viscous friction acts for `time` seconds."""
        for s in range(ti.select(self.used[0] > 0, self.m, 0)):
            if self.length[s] > 0:
                stick_sweeps.solve(self, solver, ball, s, time)

    @ti.func
    def solve_one(self, s, ball: ti.template(), solver: ti.template(), time):
        """Further impulses of the contacts of stick s, if there is such a stick; viscous friction acts for `time` seconds."""
        if s < self.m:
            if self.length[s] > 0:
                stick_sweeps.solve(self, solver, ball, s, time)

    @ti.func
    def inverse_mass(self, solver: ti.template(), contact):
        """Sum of w_i g_i^2 s_i over the three balls [1/kg]."""
        one, two = (
            solver.effective_inverse_mass[self.one[contact.stick]],
            solver.effective_inverse_mass[self.two[contact.stick]],
        )
        return solver.effective_inverse_mass[contact.ball] + one * (1.0 - contact.at) ** 2 + two * contact.at**2

    @ti.func
    def relative_velocity(self, ball: ti.template(), contact):
        """Velocity of the ball of a contact from the stick where it touches."""
        one, two = ball[self.one[contact.stick]].v, ball[self.two[contact.stick]].v
        return ball[contact.ball].v - (1.0 - contact.at) * one - contact.at * two

    @ti.func
    def law(self, contact):
        """Pair law of a contact: the ball's material against that of the stick's first end."""
        return contact_law.pair_law(
            self.model, self.model.surface[contact.ball], self.model.surface[self.one[contact.stick]]
        )

    @ti.func
    def weight(self, entry):
        """Weight of the ball of an entry in its contact: 1, or minus the part that the hit is an end's."""
        t = self.contact[entry // 3].at
        return ti.select(entry % 3 == 0, 1.0 + 0.0 * t, ti.select(entry % 3 == 1, t - 1.0, -t))

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i):
        """Impulse and angular impulse on ball i from all its contacts. The ends of a stick, being points of it, do not spin."""
        p, t = ti.Vector.zero(float, self.model.dim), zero_scalar_in_2d(self.model.dim)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            c = self.entry[e] // 3
            p += self.weight(self.entry[e]) * self.applied_impulse[c]
            if ti.static(solver.model.spins):
                if self.entry[e] % 3 == 0:
                    t -= cross(self.contact[c].normal, self.applied_impulse[c])
        return p, t

    @ti.func
    def correct_positions(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] from the sticks it overlaps, or as a stick's end from the balls that overlap it."""
        q = ti.Vector.zero(float, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            contact = self.contact[self.entry[e] // 3]
            u = self.relative_velocity(ball, contact).dot(contact.normal)
            depth = (
                self.model.radius[contact.ball] * (1.0 - contact_law.CORRECTION_SLOP)
                - contact.distance
                - h * ti.max(0.0, u)
            )
            # near a pinned end the other one is a long lever: no ball is moved by more than the depth
            one, two = (
                self.model.inverse_mass[self.one[contact.stick]],
                self.model.inverse_mass[self.two[contact.stick]],
            )
            longest = ti.max(one * (1.0 - contact.at), two * contact.at)
            share = ti.max(0.0, depth) / ti.max(self.inverse_mass(solver, contact), longest)
            q += contact_law.PUSH_OUT * self.weight(self.entry[e]) * share * contact.normal
        return q * self.model.inverse_mass[i]

    @ti.func
    def statistics(self, ball: ti.template(), i):
        """Statistics of the sticks that ball i touches."""
        total = statistics.nothing()
        for e in range(self.first[i], self.first[i] + self.number[i]):
            if self.entry[e] % 3 == 0:
                contact = self.contact[self.entry[e] // 3]
                u = self.relative_velocity(ball, contact).dot(contact.normal)
                depth = self.model.radius[i] - contact.distance
                total = statistics.join(total, statistics.one(ti.max(0.0, depth), self.model.radius[i], u, False, i))
        return total
