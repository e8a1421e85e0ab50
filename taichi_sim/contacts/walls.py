"""Walls and colliders: impacts at their exact time while a ball moves, resting contact as constraints of the contact solve."""

import numpy as np

from taichi_sim.contacts.collider_contacts import ColliderContacts
from taichi_sim.contacts.colliders import Colliders
from taichi_sim.contacts.impulse_totals import Received
from taichi_sim.contacts.planes import Planes
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.kernels.contacts import contact_law, impact, nearby_colliders, statistics, wall_impacts
from taichi_sim.kernels.contacts.kinds import ALONE, ARRIVING, CROWDED, FAST, LEAVING, NEAR, RESTING, SUNK
from taichi_sim.kernels.contacts.nearby_colliders import FAR_GAP
from taichi_sim.kernels.contacts.pair_impacts import ALERT
from taichi_sim.kernels.contacts.pair_sweeps import zero_spin
from taichi_sim.kernels.vectors import cross, lever
from taichi_sim.scene.probes import bodies_of

__all__ = ["Walls"]

TOUCH = 1e-5  # of the radius: a ball this close that hardly approaches rests on the wall
SLOP = 0.01  # of the radius: depth that position correction leaves


@ti.data_oriented
class Walls:
    """What balls have with all that has infinite mass: a contact of each ball with each wall, then with each slot for a collider
    (`planes` and `collider_contacts`, which say where a surface is).

    `contact` (n times `count`): `impulse` [N s] along the normal and, with friction, `slide` along the surface, which stay with
    their wall or collider from step to step; `target` [m/s], the normal speed that the solve gives; `role`, see kernels.kinds.
    colliders: None where the scene has none, then nothing of this is compiled. crowds: pairs of balls take part in the solve.
    straight: ways are, where a ball moves by more than its radius in a step, see kernels.ccd_balls.
    """

    def __init__(
        self,
        model: Model,
        state: State,
        fields: Fields,
        threshold: ti.Field,
        crowds: bool,
        straight: bool,
        colliders: Colliders | None = None,
        limits_energy: bool = False,
    ) -> None:
        self.model, self.state, self.colliders, self.threshold = model, state, colliders, threshold
        self.crowds, self.straight = crowds, straight
        self.rounding = 4.0 * float(np.finfo(np.float64 if fields.real == ti.f64 else np.float32).eps)
        self.planes = Planes(model, fields)
        self.has_colliders = colliders is not None
        self.moves, slots = False, 0
        if colliders is not None:
            self.collider_contacts = ColliderContacts(model, fields, colliders, self.rounding)
            self.moves, slots = colliders.moves, self.collider_contacts.count
        self.count = self.planes.count + slots
        columns = {"impulse": fields.real, "target": fields.real, "role": ti.i32}
        if model.has_friction:
            columns["slide"] = ti.types.vector(model.dim, fields.real)
        if crowds:  # impulse before the solve, and before its last pass, see kernels.wall_impacts
            columns |= {"start": fields.real, "noted": fields.real}
            self.crowded = fields.integers(model.n)
        self.contact = fields.table(columns, model.n * self.count)
        self.share = fields.reals(model.n)  # into how many parts a ball splits its mass between its walls
        if not self.has_colliders:
            self.room = fields.reals(model.n)  # m to the nearest wall: most balls cannot reach any in a step
        self.told = bool(bodies_of(model.scene))
        if self.told:
            self.received = Received(model, fields, limits_energy)
        self.touched = fields.integers(model.n)  # walls that a ball touches: most touch none and are passed over

    def names(self) -> list[str]:
        """What is compiled in, for `Simulation.kernels()`."""
        return ["walls.impact", "walls.resting", *(["colliders"] if self.has_colliders else [])]

    @ti.func
    def tolerance(self, x, i, far):
        """Gap [m] below which ball i at x touches; never finer than its coordinates are. far [m]: those of a collider's centre,
        from which points are looked at."""
        return TOUCH * self.model.radius[i] + self.rounding * (ti.abs(x).max() + far)

    @ti.func
    def touch(self, x, i, k):
        """The same for its contact k."""
        far = 0.0 * self.model.radius[i]
        if ti.static(self.has_colliders):
            if k >= self.planes.count:
                far = self.collider_contacts.far(i, k - self.planes.count)
        return self.tolerance(x, i, far)

    @ti.func
    def law(self, i, k):
        """Pair law of ball i and its contact k, which must be no empty slot."""
        surface = 0
        if k < self.planes.count:  # a table must not be read where it ends
            surface = self.planes.wall[k].material
        elif ti.static(self.has_colliders):
            surface = self.colliders.shape[self.collider_contacts.collider(i, k - self.planes.count)].surface
        return self.law_with(i, surface)

    @ti.func
    def law_with(self, i, surface):
        """Pair law of ball i and a material."""
        return self.model.laws[self.model.surface[i] * self.model.surfaces + surface]

    @ti.func
    def gap(self, x, i, k):
        """Distance from the surface of ball i to its contact k [m], negative inside; of a slot as it was found."""
        gap = FAR_GAP + 0.0 * self.model.radius[i]
        if k < self.planes.count:
            gap = self.planes.gap(x, i, k)
        elif ti.static(self.has_colliders):
            gap = self.collider_contacts.gap(i, k - self.planes.count)
        return gap

    @ti.func
    def normal(self, i, k):
        """Direction from contact k to ball i."""
        n = ti.Vector.zero(float, self.model.dim)
        if k < self.planes.count:
            n = self.planes.wall[k].normal
        elif ti.static(self.has_colliders):
            n = self.collider_contacts.normal(i, k - self.planes.count)
        return n

    @ti.func
    def relative(self, v, i, k):
        """Velocity of ball i, given its own, from the surface of its contact k."""
        u = v
        if ti.static(self.moves):
            if k >= self.planes.count:
                u -= self.collider_contacts.velocity(i, k - self.planes.count)
        return u

    @ti.func
    def tell(self, i, k, p):
        """Its contact k gave ball i the impulse p, for probes."""
        if k < self.planes.count:
            self.received.add(i, self.received.plane[k], p)
        elif ti.static(self.has_colliders):
            solid = self.collider_contacts.collider(i, k - self.planes.count)
            self.received.add(i, self.received.solid[solid], p)

    @ti.func
    def move(self, i, x, v, a, h, change):
        """Displacement over h and drift velocity of ball i; see kernels.impact. Speed that forces gave it in this very step
        (change) is a load, not an impact: a loaded ball that bounced with it would never come to rest."""
        return impact.move(self, i, x, v, a, h, ti.max(self.threshold[0], 2.0 * change.norm()))

    @ti.func
    def reach_of(self, i, touch, crowded):
        """Gap [m] up to which a wall is a contact of ball i. One among others may be pushed there by them in this very step."""
        return ti.select(crowded, ti.max(touch, self.model.radius[i]), touch)

    @ti.func
    def _role(self, gap, u, touch, crowded, arrives):
        """Part that a wall plays for a ball with the normal speed u. arrives: whether it may be ARRIVING: speed into the wall
        that forces gave since contacts were last looked for is a load, which is held, and has friction, however large it is."""
        role = ti.select(
            u > self.threshold[0], LEAVING, ti.select(arrives and u < -self.threshold[0], ARRIVING, RESTING)
        )
        if gap < -touch:
            role = ti.select(role == ARRIVING, SUNK, RESTING)
        if crowded:
            role = ti.select(gap <= touch, RESTING, NEAR)
        return role

    @ti.func
    def solved(self, c):
        """Whether contact c is a constraint of the solve."""
        return self.contact[c].role != LEAVING and self.contact[c].role != ARRIVING

    @ti.func
    def measure(self, ball: ti.template(), solver: ti.template(), i, crowded):
        """Which walls ball i touches, or may be pushed to; one that it left holds no impulse. crowded: it touches other balls."""
        count = 0
        T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        solving = 0
        fast = False
        room = FAR_GAP + 0.0 * self.model.radius[i]
        among = self.count
        if ti.static(self.has_colliders):
            among = nearby_colliders.find(self, ball[i].x, i, crowded)
        for k in range(among):
            c = i * self.count + k
            gap = self.gap(ball[i].x, i, k)
            touch = self.touch(ball[i].x, i, k)
            room = ti.min(room, gap)
            if gap <= self.reach_of(i, touch, crowded):
                count += 1
                u = self.normal(i, k).dot(self.relative(ball[i].v, i, k))
                fast = fast or u < -ALERT * self.threshold[0]
                self.contact[c].role = self._role(gap, u, touch, crowded, True)
                if self.solved(c):
                    n = self.normal(i, k)
                    T += n.outer_product(n)
                    solving += 1
            else:
                self.forget_one(c)
                self.contact[c].role = LEAVING
        self.touched[i] = count
        if ti.static(not self.has_colliders):
            self.room[i] = room
        self.share[i] = contact_law.share(T, solving, not self.model.has_friction)
        if ti.static(self.crowds):
            self.crowded[i] = ti.select(crowded, ti.select(fast, FAST, CROWDED), ALONE)

    @ti.func
    def shares(self, ball: ti.template(), i):
        """Sum of n n^T over the walls that ball i touches, and their number."""
        T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        for k in range(ti.select(self.touched[i] > 0, self.count, 0)):
            if self.solved(i * self.count + k):
                n = self.normal(i, k)
                T += n.outer_product(n)
        return T, self.touched[i]

    @ti.func
    def forget_one(self, c):
        """Contact c holds nothing from before."""
        self.contact[c].impulse = 0.0
        if ti.static(self.model.has_friction):
            self.contact[c].slide = ti.Vector.zero(float, self.model.dim)

    @ti.func
    def begin(self, ball: ti.template(), solver: ti.template(), i, impacts: ti.template(), starts: ti.template()):
        """Which walls of ball i the solve holds, with what target speed; where it `starts`, apply what they hold from before. A
        ball that arrives fast at a wall is left to `move`."""
        v = ball[i].v
        crowded = False
        if ti.static(self.crowds):
            crowded = self.crowded[i] != ALONE
        if ti.static(self.told and starts):
            self.received.note(i)
        for k in range(ti.select(self.touched[i] > 0, self.count, 0)):
            c = i * self.count + k
            gap = self.gap(ball[i].x, i, k)
            touch = self.touch(ball[i].x, i, k)
            if gap <= self.reach_of(i, touch, crowded):
                n = self.normal(i, k)
                u = n.dot(self.relative(v, i, k))
                role = self._role(gap, u, touch, crowded, self.contact[c].role >= SUNK)
                # what leaves fast has bounced: nothing presses it any more, and the impulse would push it once again
                if u > self.threshold[0] or role >= SUNK or ti.static(not solver.warm):
                    self.forget_one(c)
                e = self.law(i, k).restitution
                before = ti.select(crowded or role == SUNK, u, ti.max(0.0, u))  # alone, what approaches is pressed
                target = contact_law.target_speed(before, e, self.threshold[0], impacts)
                if ti.static(solver.strikes and self.crowds):
                    self.contact[c].start = self.contact[c].impulse
                if ti.static(self.crowds):
                    if crowded:
                        target, role = self._among_others(solver, i, n, e, u, gap, touch, target, role, impacts)
                self.contact[c].role = role
                if ti.static(self.has_colliders and impacts):
                    if k >= self.planes.count and target == 0.0 and self.solved(c) and role != NEAR:
                        slot, away = k - self.planes.count, self.relative(v, i, k)
                        target = self.collider_contacts.following(ball[i].x, v, away, i, slot, 1.0 / solver.rate[0])
                self.contact[c].target = target
                if ti.static(starts):
                    p = self.contact[c].impulse * n
                    if ti.static(self.model.has_friction):
                        p += self.contact[c].slide
                    if ti.static(self.told):
                        self.tell(i, k, p)
                    solver.apply(i, p, -cross(n, p))

    @ti.func
    def _among_others(
        self, solver: ti.template(), i, n, restitution, u, gap, touch, target, role, impacts: ti.template()
    ):
        """Target speed and role of a wall for ball i, one among others, which may come to the wall, but not go on."""
        there = -gap * solver.rate[0]
        if ti.static(solver.strikes):
            # one that rests stays: each move of a pile, however small, would be the next one's impact
            target = ti.select(gap > touch, there, 0.0)
            closing = -(u + ti.max(0.0, wall_impacts.kick(self, solver, i, n)))
            bounces = restitution > 0.0 and (restitution >= 1.0 or gap * solver.rate[0] > closing)
            if closing > self.threshold[0] and (bounces or ti.static(not impacts)):
                role = LEAVING  # left to the move, else the solve takes its energy
        elif gap > touch:
            if ti.static(impacts):
                if not (target > 0.0 and u < there):  # it bounces within this step
                    target = there
            else:  # what bounces there is left alone by the solve that ends a step
                target = ti.min(there, target)
        return target, role

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i, time):
        """Further impulse and angular impulse on ball i from the walls it rests on or is inside of. Fast arrivals are left to
        `move`."""
        total, angular = ti.Vector.zero(float, self.model.dim), zero_spin(solver)
        v, spin = ball[i].v, zero_spin(solver)
        if ti.static(solver.spins):
            spin = solver.state.spin[i]
        w = self.model.inverse_mass[i]
        for k in range(ti.select(self.touched[i] > 0 and w > 0.0, self.count, 0)):
            c = i * self.count + k
            contact = self.contact[c]
            if self.solved(c):
                n = self.normal(i, k)
                mass = 1.0 / (w * self.share[i])
                if ti.static(solver.split):
                    mass = 1.0 / solver.lightness[i]
                if ti.static(solver.rule == "sum"):
                    mass = 1.0 / w
                held = contact.impulse
                now = contact_law.normal_impulse(self.relative(v, i, k).dot(n), contact.target, mass, held)
                p = (now - held) * n
                self.contact[c].impulse = now
                if ti.static(self.model.has_friction):
                    u = self.relative(v, i, k)
                    slip, sideways = u, mass
                    if ti.static(solver.spins):
                        slip -= lever(spin, n)
                        sideways *= self.model.sideways(i)
                    change, slide = contact_law.friction_impulse(
                        self.model,
                        self.law(i, k),
                        n,
                        u,
                        slip,
                        mass,
                        sideways,
                        contact.slide,
                        now,
                        self.threshold[0],
                        time,
                    )
                    self.contact[c].slide = slide
                    p += change
                if ti.static(self.told):
                    self.tell(i, k, p)
                total += p
                angular += -cross(n, p)
        return total, angular

    @ti.func
    def offset(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] beyond the slop that its own motion and other contacts will not undo."""
        d = ti.Vector.zero(float, self.model.dim)
        w = self.model.inverse_mass[i]
        for k in range(ti.select(self.touched[i] > 0 and w > 0.0, self.count, 0)):
            n = self.normal(i, k)
            away = h * ti.max(0.0, n.dot(self.relative(ball[i].v, i, k)))
            depth = -self.gap(ball[i].x, i, k) - SLOP * self.model.radius[i] - away
            share = 1.0 / self.share[i]
            if ti.static(solver.in_turn):
                depth -= n.dot(solver.offset[i])
            if ti.static(solver.split):
                share = w / solver.lightness[i]
            if depth > 0.0:
                d += solver.push_out * depth * share * n
        return d

    @ti.func
    def survey(self, ball: ti.template(), i):
        """Tally of the walls and colliders that ball i touches; one that rests lies on the surface, give or take rounding."""
        total = statistics.nothing()
        for k in range(ti.select(self.model.inverse_mass[i] > 0.0, self.count, 0)):
            gap = self.gap(ball[i].x, i, k)
            if gap <= self.touch(ball[i].x, i, k):
                u = self.normal(i, k).dot(self.relative(ball[i].v, i, k))
                held = self.contact[i * self.count + k].impulse > 0.0
                total = statistics.join(total, statistics.one(ti.max(0.0, -gap), self.model.radius[i], u, held, i))
        return total
