"""WeightedContacts: contacts of more than two balls, each a row of the solve with a weight for every ball."""

from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import contact_law, statistics, warm_start
from taichi_sim.kernels.contacts.contact_incidence import each_contact
from taichi_sim.kernels.loops import each
from taichi_sim.kernels.vectors import cross, lever, zero_scalar_in_2d

__all__ = ["WeightedContacts"]


@ti.data_oriented
class WeightedContacts:
    """Contacts whose relative velocity is sum g_i v_i, with weights g that add up to 0: from the balls k of one side to those of
    the other along `normal`. Each kind says which balls and weights those of a contact are, and finds the contacts.

    To be given: `ball_of(c, k)` and `weight_of(c, k)`; `thickness(c)`: distance at touch [m], negative where a contact does not
    push; `other_side(c)`: number k of the first ball of the other side; `turns(c)`: whether ball 0 spins in it;
    `inverse_mass(solver, c)` [1/kg]; `groups()`, how many parts there are that `solve_group` solves one by one, of at most
    `most_solved`. `contact` has the columns normal, distance, target, impulse and, with friction, tangential_impulse.
    """

    model: Model
    balls_per_contact: int
    most_solved: int
    contact: Any
    applied_impulse: Any  # N s, of each contact in an iteration
    first: Any  # of the list of each ball, see kernels.contacts.contact_incidence, as number and entry
    number: Any
    entry: Any
    ball_of: Any
    weight_of: Any
    thickness: Any
    other_side: Any
    turns: Any
    inverse_mass: Any
    groups: Any
    solve_group: Any
    warm_starts = False  # contacts accumulate impulses from step to step

    @ti.func
    def relative_velocity(self, ball: ti.template(), c):
        """Relative velocity sum g_i v_i of contact c [m/s]."""
        u = ti.Vector.zero(float, self.model.dim)
        for k in ti.static(range(self.balls_per_contact)):
            u += self.weight_of(c, k) * ball[self.ball_of(c, k)].v
        return u

    @ti.func
    def weighted_sum(self, table: ti.template(), c):
        """Sum of w_i g_i^2 over the balls of contact c, w_i [1/kg] from a table."""
        total = 0.0 * self.contact[c].distance
        for k in ti.static(range(self.balls_per_contact)):
            g = self.weight_of(c, k)
            total += table[self.ball_of(c, k)] * g * g
        return total

    @ti.func
    def own_inverse_mass(self, solver: ti.template(), i):
        """Inverse mass [1/kg] of the part of ball i that takes part in one contact."""
        return solver.effective_inverse_mass[i]

    @ti.func
    def law(self, c):
        """Pair law of contact c: the materials of the first balls on either side."""
        one, other = self.ball_of(c, 0), self.ball_of(c, self.other_side(c))
        law = contact_law.pair_law(self.model, self.model.surface[one], self.model.surface[other])
        if ti.static(self.model.holds_back):  # each ball counts by its share of the change of their relative velocity
            swing = whole = 0.0 * self.contact[c].distance
            for k in ti.static(range(self.balls_per_contact)):
                i, g = self.ball_of(c, k), self.weight_of(c, k)
                share = self.model.inverse_mass[i] * g * g
                swing += share * contact_law.swing(self.model, i, self.contact[c].normal)
                whole += share
            law = contact_law.as_resolved(self.model, law, swing / whole)
        return law

    @ti.func
    def begin_contacts(self, ball: ti.template(), solver: ti.template(), impacts: ti.template()):
        """Fix the target speed of every contact, and what it starts with."""
        each_contact(self, self.begin_contact, (ball, solver, impacts))

    @ti.func
    def begin_contact(self, c, ball: ti.template(), solver: ti.template(), impacts: ti.template()):
        """Fix the target speed of contact c, and what it starts with."""
        if self.thickness(c) >= 0.0:
            n = self.contact[c].normal
            u = self.relative_velocity(ball, c).dot(n)
            restitution, forced = self.law(c).restitution, 0.0 * u
            if ti.static(solver.plan.loaded):
                forced = -self.relative_velocity(solver.from_forces, c).dot(n)
            target = contact_law.target_speed(
                u, forced, solver.plan.late_part, restitution, solver.threshold[0], impacts
            )
            gap = self.contact[c].distance - self.thickness(c)
            if gap > 0.0:
                bounces = restitution > 0.0 and contact_law.is_impact(u, forced, solver.threshold[0])
                target = contact_law.target_until_touch(target, u, gap, bounces, solver.rate[0])
            self.contact[c].target = target
            warm_start.start(self, solver, c, u, n)

    @ti.func
    def solve_contacts(self, ball: ti.template(), solver: ti.template(), time):
        """Further impulses of all contacts from the present velocities; viscous friction acts for `time` seconds."""
        gathers = ti.static(solver.plan.gathers)
        each(self.groups(), self.most_solved, gathers, self.solve_group, (ball, solver, time))

    @ti.func
    def solve_one(self, k, ball: ti.template(), solver: ti.template(), time):
        """Further impulses of part k of the contacts, if there is such a part."""
        if k < self.groups():
            self.solve_group(k, ball, solver, time)

    @ti.func
    def further_impulse(self, solver: ti.template(), c, u, inverse, applied, time):
        """Further impulse [N s] of contact c from the relative velocity u [m/s], which has `applied` of this iteration in it but
        not in spins. inverse: `inverse_mass` [1/kg]. Viscous friction acts for `time` seconds."""
        n, mass = self.contact[c].normal, 1.0 / inverse
        slip, tangential_mass = u, mass
        if ti.static(solver.model.spins):
            if self.turns(c):
                i = self.ball_of(c, 0)
                rolling = self.model.spin_response(i) * self.own_inverse_mass(solver, i)
                slip -= lever(solver.state.spin[i] - rolling * cross(n, applied), n)
                tangential_mass = 1.0 / (inverse + rolling)
        return contact_law.further_impulse(
            self.model, self.contact, c, self.law(c), n, u, slip, mass, tangential_mass, solver.threshold[0], time
        )

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i):
        """Impulse and angular impulse on ball i from all its contacts. Balls of surfaces and ends of sticks, being points of
        them, do not spin."""
        p, t = ti.Vector.zero(float, self.model.dim), zero_scalar_in_2d(self.model.dim)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            c, k = self.entry[e] // self.balls_per_contact, self.entry[e] % self.balls_per_contact
            if self.thickness(c) >= 0.0:
                p += self.weight_of(c, k) * self.applied_impulse[c]
                if ti.static(solver.model.spins):
                    if k == 0 and self.turns(c):
                        t -= cross(self.contact[c].normal, self.applied_impulse[c])
        return p, t

    @ti.func
    def correct_positions(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] by all contacts it takes part in."""
        q = ti.Vector.zero(float, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.number[i]):
            c, k = self.entry[e] // self.balls_per_contact, self.entry[e] % self.balls_per_contact
            n, thickness = self.contact[c].normal, self.thickness(c)
            if thickness > self.contact[c].distance:
                away = h * n.dot(self.relative_velocity(ball, c))
                apart = contact_law.push_out(thickness - self.contact[c].distance, thickness, away)
                longest = 0.0 * apart  # near a pin the others are long levers: no ball is moved by more than the depth
                for m in ti.static(range(self.balls_per_contact)):
                    w = self.model.inverse_mass[self.ball_of(c, m)]
                    longest = ti.max(longest, w * ti.abs(self.weight_of(c, m)))
                q += self.weight_of(c, k) * apart / ti.max(self.inverse_mass(solver, c), longest) * n
        return q * self.model.inverse_mass[i]

    @ti.func
    def lift(self, ball: ti.template(), i):
        """Energy [J] that gravity gains where the upper side of each contact whose first ball is ball i is pushed out."""
        total = 0.0 * self.model.radius[i]
        for e in range(self.first[i], self.first[i] + self.number[i]):
            c, k = self.entry[e] // self.balls_per_contact, self.entry[e] % self.balls_per_contact
            depth = self.thickness(c) - self.contact[c].distance
            if k == 0 and depth > 0.0:
                rise = -depth * self.contact[c].normal.dot(self.model.gravity[0])
                inverse = 0.0 * rise  # of the mass that the side opposes
                for m in ti.static(range(self.balls_per_contact)):
                    g = self.weight_of(c, m)
                    if g * rise > 0.0:
                        inverse += self.model.inverse_mass[self.ball_of(c, m)] * g * g
                if inverse > 0.0:
                    total += ti.abs(rise) / inverse
        return total

    @ti.func
    def statistics(self, ball: ti.template(), solver: ti.template(), i):
        """Statistics of the contacts that touch and whose first ball is ball i."""
        total = statistics.nothing()
        for e in range(self.first[i], self.first[i] + self.number[i]):
            c, k = self.entry[e] // self.balls_per_contact, self.entry[e] % self.balls_per_contact
            depth = self.thickness(c) - self.contact[c].distance
            if k == 0 and depth > 0.0:
                u = self.relative_velocity(ball, c).dot(self.contact[c].normal)
                total = statistics.join(total, statistics.one(depth, self.model.radius[i], u, False, i))
        return total
