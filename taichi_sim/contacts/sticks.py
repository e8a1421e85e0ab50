"""Sticks: springs that balls bounce off."""

from taichi_sim.contacts.pairs import Pairs
from taichi_sim.contacts.weighted_contacts import WeightedContacts
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import stick_sweeps, warm_start
from taichi_sim.kernels.contacts import sticks as loops
from taichi_sim.kernels.contacts.contact_incidence import each_contact

__all__ = ["Sticks"]

MINIMUM_CAPACITY = 1 << 16  # contacts
LARGEST_CAPACITY = 1 << 29  # contacts; each has three entries


@ti.data_oriented
class Sticks(WeightedContacts):
    """Ball-stick contacts: the stick is its two end balls, each taking part by how near the hit is: the weights are 1 on the
    ball and -(1 - at), -at on the ends. Contacts of a stick lie together. capacity: contacts known to be needed."""

    what = "balls that touch sticks"
    names = ("sticks",)
    balls_per_contact = 3
    most = LARGEST_CAPACITY

    def __init__(self, model: Model, fields: Fields, pairs: Pairs, capacity: int = 0) -> None:
        scene = model.scene
        ends = scene.pairs[scene.collides]
        self.model, self.pairs, self.grid, self.plan = model, pairs, pairs.grid, pairs.plan
        self.m, self.warm_starts = len(ends), pairs.plan.warm_starts
        self.most_solved = self.m  # one by one
        # (m) ball at either end
        self.one, self.two = fields.integers(ends[:, 0]), fields.integers(ends[:, 1])
        usual = max(MINIMUM_CAPACITY if model.n > 64 else self.m * model.n, 4 * (model.n + self.m))
        self.capacity = max(capacity, usual)
        before = fields.bytes
        real, vector = fields.real, ti.types.vector(model.dim, fields.real)
        accumulated = fields.impulses(model.dim, model.has_friction)
        # starting_impulse: before the solve [N s]; gained_speed: of approach since it was last seen, last_speed: of then [m/s]
        seen = dict.fromkeys(("starting_impulse", "gained_speed", "last_speed"), real) if self.warm_starts else {}
        # normal: from stick to ball; at: part of the stick at which it touches; distance [m]
        found = {"ball": ti.i32, "stick": ti.i32, "normal": vector, **dict.fromkeys(("at", "distance"), real)}
        # target: normal speed to come to [m/s]; previous_impulse: before the last iteration [N s]
        solved = dict.fromkeys(("target", "previous_impulse"), real)
        self.contact = fields.table({**found, **solved, **accumulated, **seen}, self.capacity)
        # of each stick: its first contact, and their number
        self.begin, self.length = fields.integers(self.m), fields.integers(self.m)
        if self.warm_starts:
            # what contacts had accumulated, and with which ball, while they are listed anew
            self.old = fields.table({"other": ti.i32, **accumulated}, self.capacity)
        self.applied_impulse = fields.vectors(self.capacity, model.dim)  # N s, still to be applied
        self.entry = fields.integers(3 * self.capacity)
        self.bytes_each = (fields.bytes - before) / self.capacity
        self.first, self.number = fields.integers(model.n), fields.integers(model.n)
        self.used, self.entries, self.overflow = (fields.integers(1) for _ in range(3))

    def forget(self) -> None:
        """Clear what contacts have accumulated, once sticks are looked at again."""
        if self.warm_starts:
            self.length.fill(0)

    @ti.func
    def detect(self, ball: ti.template()):
        """Find all touching ball-stick pairs; the grid is built already."""
        loops.detect(self, ball)

    @ti.func
    def ball_of(self, c, k):
        """Ball k of contact c: the ball, or an end of the stick."""
        stick = self.contact[c].stick
        return ti.select(k == 0, self.contact[c].ball, ti.select(k == 1, self.one[stick], self.two[stick]))

    @ti.func
    def weight_of(self, c, k):
        """Weight of ball k of contact c: 1, or minus the part that the hit is an end's."""
        t = self.contact[c].at
        return ti.select(k == 0, 1.0 + 0.0 * t, ti.select(k == 1, t - 1.0, -t))

    @ti.func
    def thickness(self, c):
        """Distance at touch [m]: sticks have no thickness of their own."""
        return self.model.radius[self.contact[c].ball]

    @ti.func
    def other_side(self, c):
        """Number of the first end."""
        return 1

    @ti.func
    def turns(self, c):
        """True: the ball of a contact spins."""
        return True

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
    def end_contacts(self, ball: ti.template()):
        """Limit what contacts accumulated to what may be a load."""
        each_contact(self, self.end_contact, (ball,))

    @ti.func
    def end_contact(self, c, ball: ti.template()):
        """Limit what contact c accumulated to what may be a load."""
        u = self.relative_velocity(ball, c).dot(self.contact[c].normal)
        warm_start.limit(self, c, self.weighted_sum(self.model.inverse_mass, c), u)

    @ti.func
    def groups(self):
        """Number of sticks to look at: 0 where none has contacts."""
        return ti.select(self.used[0] > 0, self.m, 0)

    @ti.func
    def solve_group(self, s, ball: ti.template(), solver: ti.template(), time):
        """Further impulses of the contacts of stick s; viscous friction acts for `time` seconds."""
        if self.length[s] > 0:
            stick_sweeps.solve(self, solver, ball, s, time)

    @ti.func
    def inverse_mass(self, solver: ti.template(), c):
        """Sum of w_i g_i^2 s_i over the three balls [1/kg]."""
        return self.weighted_sum(solver.effective_inverse_mass, c)
