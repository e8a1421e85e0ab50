"""Walls and colliders: impacts at their exact time while a ball moves, resting contact as constraints of the contact solve."""

from typing import Any

import numpy as np

from taichi_sim.contacts.colliders import Colliders
from taichi_sim.contacts.plan import ContactPlan
from taichi_sim.contacts.surfaces import Surfaces
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.kernels.contacts import contact_law, impact, nearby_colliders, statistics, wall_impacts, warm_start
from taichi_sim.kernels.contacts.kinds import (
    ARRIVING,
    BALL_ALONE,
    BALL_ARRIVING,
    BALL_CROWDED,
    FORESEEN,
    LEAVING,
    REACHABLE,
    RESTING,
    SUNK,
)
from taichi_sim.kernels.contacts.nearby_colliders import FAR_GAP
from taichi_sim.kernels.contacts.pair_impacts import FAST_APPROACH
from taichi_sim.kernels.vectors import cross, lever, zero_scalar_in_2d

__all__ = ["Walls"]

MOST_SWEEPS = 64  # over the surfaces of one ball, where it has several, in an iteration


@ti.data_oriented
class Walls(Surfaces):
    """Contacts of each ball with each surface: that of ball i with surface k is i count + k."""

    def __init__(
        self, model: Model, state: State, fields: Fields, plan: ContactPlan, threshold: Any, colliders: Colliders | None
    ):
        super().__init__(model, fields, colliders, plan.limits_energy or plan.bends)
        self.state, self.plan, self.threshold = state, plan, threshold
        self.names = ("walls.impact", "walls.resting", *(["colliders"] if self.has_colliders else []))
        # target: normal speed to come to [m/s]; role: see kernels.contacts.kinds
        columns = {**fields.impulses(model.dim, model.has_friction), "target": fields.real, "role": ti.i32}
        if plan.keeps_loads:
            columns["load"] = fields.real  # N s, the part of the impulse that is no impact's, as far as it is known
        if plan.walls_in_turn:  # [N s] before the solve, and before the last iteration
            columns |= {"starting_impulse": fields.real, "previous_impulse": fields.real}
            self.crowded = fields.integers(model.n)  # see kernels.contacts.kinds
        self.contact = fields.table(columns, model.n * self.count)
        self.mass_parts = fields.reals(model.n)  # into which a ball splits its mass between surfaces
        if not self.has_colliders:
            self.clearance = fields.reals(model.n)  # m, to the nearest wall: most reach none in a step
        self.foresees = (
            False  # whether slots hold colliders that a ball may come to; for implicit stages, see HeldBalls
        )
        self.touching = fields.integers(model.n)  # surfaces that a ball touches: most touch none and are passed over
        self.facing = fields.reals(model.n)  # least cosine between one's normal and the sum of those before it, or 0
        if plan.bends:
            vector = ti.types.vector(model.dim, fields.real)
            # of a fast ball that bounces, see kernels.contacts.bent_paths: part of the step that is left then, else 0; way until
            # then, and length beyond if it bounces again, else 0 [m]; what that changed of its velocity [m/s]
            path = {"rest": fields.real, "length": fields.real, "way": vector, "change": vector}
            if model.spins:
                path["spin_change"] = fields.real if model.dim == 2 else vector
            self.path = fields.table(path, model.n)
        if plan.triangles:  # see kernels.contacts.surface_ways
            scene, of_surface = model.scene, np.zeros(model.n, np.int32)
            of_surface[scene.triangles[scene.solid]] = 1
            of_surface[scene.pairs[scene.collides]] = 1
            self.of_surface = fields.integers(of_surface)
            self.around_surfaces = fields.vectors(2, model.dim)  # m
        if plan.reflects:
            # sqrt((1 + e) t / h) n of the last impact in this step, see kernels.contacts.impact
            self.reflected = fields.vectors(model.n, model.dim)
            if self.probed:
                self.reflecting_body = fields.integers(model.n)  # that it was an impact on, or -1

    @ti.func
    def move(self, i, x, v, a, h, change):
        """Displacement over h and drift velocity of ball i; see kernels.contacts.impact. Speed that forces gave it in this very
        step (change) is a load, not an impact: a loaded ball that bounced with it would never come to rest."""
        return impact.move(self, i, x, v, a, h, ti.max(self.threshold[0], 2.0 * change.norm()))

    @ti.func
    def reach_of(self, i, touch, crowded):
        """Gap [m] up to which a wall is a contact of ball i. A crowded one may be pushed there by others in this very step."""
        return ti.select(crowded, ti.max(touch, self.model.radius[i]), touch)

    @ti.func
    def _role(self, gap, u, touch, crowded, arrives):
        """Part that a wall plays for a ball with the normal speed u. arrives: whether it may be ARRIVING: speed into the wall
        that forces gave since contacts were last looked for is a load, which is borne, and has friction, however large it is."""
        role = ti.select(
            u > self.threshold[0], LEAVING, ti.select(arrives and u < -self.threshold[0], ARRIVING, RESTING)
        )
        if gap < -touch:
            role = ti.select(role == ARRIVING, SUNK, RESTING)
        if crowded:
            role = ti.select(gap <= touch, RESTING, REACHABLE)
        return role

    @ti.func
    def looked_at(self, i):
        """Number of contacts of ball i to look at: none where it touches no surface."""
        return ti.select(self.touching[i] > 0, self.count, 0)

    @ti.func
    def is_solved(self, c):
        """True if contact c is a constraint of the solve."""
        return self.contact[c].role != LEAVING and self.contact[c].role != ARRIVING

    @ti.func
    def measure(self, ball: ti.template(), solver: ti.template(), i, crowded):
        """Find the walls that ball i touches, or may be pushed to; one that it left has accumulated nothing. crowded: it
        touches other balls."""
        count, parts = 0, 0.0 * self.model.radius[i] + 1.0
        facing, normals = 0.0 * self.model.radius[i], ti.Vector.zero(float, self.model.dim)
        # A ball that touched no plane has forgotten all of them. With colliders a place may have gone to another one since.
        touched = True
        if ti.static(not self.has_colliders):
            touched = self.touching[i] > 0
        fast = False
        clearance = FAR_GAP + 0.0 * self.model.radius[i]
        number = self.count
        if ti.static(self.has_colliders):
            number = nearby_colliders.find(self, ball[i].x, ball[i].v, i, crowded, 1.0 / solver.rate[0])
        for k in range(number):
            c = i * self.count + k
            gap = self.gap(ball[i].x, i, k)
            touch = self.touch(ball[i].x, i, k)
            clearance = ti.min(clearance, gap)
            if gap <= self.reach_of(i, touch, crowded):
                count += 1
                facing = ti.min(facing, self.normal(i, k).dot(normals))
                normals += self.normal(i, k)
                u = self.normal(i, k).dot(self.relative(ball[i].v, i, k))
                fast = fast or u < -FAST_APPROACH * self.threshold[0]
                arrives = True
                if ti.static(self.foresees):  # else what a stage had come here would keep what that left to the surface
                    arrives = self.law(i, k).restitution > 0.0
                self.contact[c].role = self._role(gap, u, touch, crowded, arrives)
                self.contact[c].target = u
                if ti.static(self.plan.keeps_loads):
                    self._start_from_load(solver, i, c, crowded)
            elif touched:
                warm_start.forget(self.contact, c, self.model.dim)
                self.contact[c].role = LEAVING
        self.touching[i] = count
        self.facing[i] = facing
        if ti.static(not self.has_colliders):
            self.clearance[i] = clearance
        if count > 1:
            self._stop_arrivals(i)
            T, number = self.sum_of_solved(i)
            parts = contact_law.share(T, number, not self.model.has_friction)
        self.mass_parts[i] = parts
        if ti.static(self.plan.walls_in_turn):
            self.crowded[i] = ti.select(crowded, ti.select(fast, BALL_ARRIVING, BALL_CROWDED), BALL_ALONE)

    @ti.func
    def _stop_arrivals(self, i):
        """Leave arrivals of ball i, which touches several surfaces, to the solve where they do not bounce: the move would throw
        it from one to the other."""
        for k in range(self.count):
            if self.contact[i * self.count + k].role == ARRIVING:
                if self.law(i, k).restitution == 0.0:
                    self.contact[i * self.count + k].role = RESTING

    @ti.func
    def foresee(self, i, k):
        """Leave contact k of ball i, which does not touch it yet, to the solve, which has it reached at the end of the step."""
        c = i * self.count + k
        if self.contact[c].role != FORESEEN:
            self.contact[c].role = FORESEEN
            self.mass_parts[i] = ti.select(self.touching[i] > 0, self.mass_parts[i] + 1.0, 1.0)
            self.touching[i] = self.touching[i] + 1

    @ti.func
    def end_foreseen(self, i, k, gap):
        """Forget contact k of ball i where a solve that ended a step had it reached, and it is not touched."""
        c = i * self.count + k
        if self.contact[c].role == RESTING and gap > self.touch(self.state.ball[i].x, i, k):
            warm_start.forget(self.contact, c, self.model.dim)
            self.contact[c].role = LEAVING
            self.touching[i] = self.touching[i] - 1
            self.mass_parts[i] = ti.max(1.0, self.mass_parts[i] - 1.0)

    @ti.func
    def sum_of_solved(self, i):
        """Sum of n n^T over the walls of ball i that are solved, and their number."""
        T, number = ti.Matrix.zero(float, self.model.dim, self.model.dim), 0
        for k in range(self.looked_at(i)):
            if self.is_solved(i * self.count + k):
                n = self.normal(i, k)
                T += n.outer_product(n)
                number += 1
        return T, number

    @ti.func
    def _start_from_load(self, solver: ti.template(), i, c, crowded):
        """Limit what contact c of ball i accumulated in an impact; by itself a ball meets walls when it moves."""
        if crowded and self.model.inverse_mass[i] > 0.0:
            warm_start.start_from_load(self.contact, solver, c, i, i)
        else:
            self.contact[c].load = self.contact[c].impulse

    @ti.func
    def begin(self, ball: ti.template(), solver: ti.template(), i, impacts: ti.template(), starts: ti.template()):
        """Choose the walls of ball i that are constraints of the solve, and fix their target speeds; where it `starts`, apply
        what they have accumulated. A ball that arrives fast at a wall is left to `move`."""
        v = ball[i].v
        crowded = False
        if ti.static(self.plan.walls_in_turn):
            crowded = self.crowded[i] != BALL_ALONE
        if ti.static(self.probed and starts):
            self.received.note(i)
        for k in range(self.looked_at(i)):
            c = i * self.count + k
            gap = self.gap(ball[i].x, i, k)
            touch = self.touch(ball[i].x, i, k)
            foreseen = self.contact[c].role == FORESEEN
            if foreseen or gap <= self.reach_of(i, touch, crowded):
                n = self.normal(i, k)
                u = n.dot(self.relative(v, i, k))
                # by a collider that leaves or stops at once: until the end of the step it bears what rested on it
                lost = 0.0 * u
                if ti.static(self.has_colliders and not impacts):
                    if k >= self.planes.count:
                        lost = self.collider_contacts.lost(i, k - self.planes.count)
                        lost = ti.select(lost > self.threshold[0] and u - lost <= self.threshold[0], lost, 0.0)
                        u -= lost
                role = self._role(gap, u, touch, crowded, self.contact[c].role >= SUNK)
                # what leaves fast has bounced: nothing presses it any more, and the impulse would push it once again
                if u > self.threshold[0] or role >= SUNK or ti.static(not solver.plan.warm_starts):
                    warm_start.forget(self.contact, c, self.model.dim)
                e = self.law(i, k).restitution
                before = ti.select(crowded or role == SUNK, u, ti.max(0.0, u))  # alone, what approaches is pressed
                forced = 0.0 * u
                if ti.static(solver.plan.loaded and not self.plan.impacts_in_turn):
                    forced = wall_impacts.approach_from_forces(self, solver, i, n)
                if ti.static(impacts):
                    if role == SUNK:  # its target is still the speed with which the step before ended
                        forced = self.contact[c].target - u
                target = contact_law.target_speed(before, forced, self.plan.late_part, e, self.threshold[0], impacts)
                if ti.static(impacts):
                    if role == SUNK and target == 0.0:  # what presses it brings it back within the step
                        role = RESTING
                if ti.static(self.plan.impacts_in_turn):
                    self.contact[c].starting_impulse = self.contact[c].impulse
                if ti.static(self.plan.walls_in_turn):
                    if crowded:
                        target, role = self._crowded_target(solver, i, n, e, u, gap, touch, target, role, impacts)
                if foreseen:
                    target, role = -ti.max(0.0, gap) * solver.rate[0], RESTING
                self.contact[c].role = role
                if ti.static(self.has_colliders and impacts):
                    if target == 0.0 and self.is_solved(c) and role != REACHABLE:
                        slides = v
                        if ti.static(self.model.has_friction):  # else what friction stops would be lifted off a hollow
                            slides += self.model.inverse_mass[i] * contact_law.along_surface(
                                n, self.contact[c].tangential_impulse
                            )
                        target = self.following(ball[i].x, slides, i, k, 1.0 / solver.rate[0])
                        if ti.static(self.foresees):  # stages end there, too
                            target -= ti.max(0.0, gap) * solver.rate[0]
                self.contact[c].target = target + lost
                if ti.static(starts):
                    p = warm_start.kept_impulse(self.contact, c, n)
                    if ti.static(self.probed):
                        self.record(i, k, p)
                    solver.apply(i, p, -cross(n, p))

    @ti.func
    def _crowded_target(
        self, solver: ti.template(), i, n, restitution, u, gap, touch, target, role, impacts: ti.template()
    ):
        """Target speed and role of a wall for ball i, a crowded one, which may come to the wall, but not go on."""
        there = -gap * solver.rate[0]
        if ti.static(solver.plan.impacts_in_turn):
            # one that rests stays: each move of a pile, however small, would be the next one's impact
            target = ti.select(gap > touch, there, 0.0)
            closing = contact_law.closing_speed(u, wall_impacts.approach_from_forces(self, solver, i, n))
            bounces = restitution > 0.0 and (restitution >= 1.0 or gap * solver.rate[0] > closing)
            if closing > self.threshold[0] and (bounces or ti.static(not impacts)):
                role = LEAVING  # left to the move, else the solve takes its energy
        elif gap > touch:
            if ti.static(impacts):
                if not (target > 0.0 and u < there):  # it bounces within this step
                    # what leaves fast may come back as fast as from a bounce: less would add energy, and surfaces that
                    # face each other could ask for what no velocity is
                    target = ti.min(there, ti.select(u > self.threshold[0], target, 0.0))
            else:  # what bounces there is left alone by the solve that ends a step
                target = ti.min(there, target)
        return target, role

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i, time):
        """Further impulse and angular impulse on ball i from the walls it rests on or is inside of. A rule that takes contacts in
        turn repeats those of one ball until they agree. Fast arrivals are left to `move`."""
        total, angular = ti.Vector.zero(float, self.model.dim), zero_scalar_in_2d(self.model.dim)
        v, spin = ball[i].v, zero_scalar_in_2d(self.model.dim)
        if ti.static(solver.model.spins):
            spin = solver.state.spin[i]
        w = self.model.inverse_mass[i]
        sweeps, sweep, gain = ti.select(self.touching[i] > 0 and w > 0.0, 1, 0), 0, 0.0 * w + 1.0
        if ti.static(solver.in_turn):
            if sweeps > 0 and self.facing[i] < 0.0:
                sweeps = MOST_SWEEPS
        scale = v.norm()
        while sweep < sweeps:
            changed = 0.0 * w
            for k in range(self.count):
                if self.is_solved(i * self.count + k):
                    n = self.normal(i, k)
                    p = self._further_impulse(solver, i, k, v, spin, gain, ti.select(sweep == 0, time, 0.0 * time))
                    t = -cross(n, p)
                    total += p
                    angular += t
                    if ti.static(solver.in_turn):
                        v += w * p
                        if ti.static(solver.model.spins):
                            spin += (self.model.spin_response(i) * w) * t
                        if sweeps > 1:
                            changed = ti.max(changed, w * p.norm())
                            if sweep == 0:
                                scale += w * self.contact[i * self.count + k].impulse
            sweep += 1
            if ti.static(solver.in_turn):
                if sweeps > 1:
                    if ti.static(not self.model.has_friction):
                        gain = contact_law.over_relaxation(self.facing[i])
                    if changed <= self.rounding * scale:
                        sweeps = sweep
        return total, angular

    @ti.func
    def _further_impulse(self, solver: ti.template(), i, k, v, spin, gain, time):
        """Further impulse on ball i, at the velocity v and this spin, by its contact k: `gain` times what reaches its target."""
        c, n = i * self.count + k, self.normal(i, k)
        mass = 1.0 / self.model.inverse_mass[i]
        if ti.static(solver.split):
            mass = 1.0 / solver.effective_inverse_mass[i]
        elif ti.static(not (solver.in_turn or solver.sums_plainly)):
            mass /= self.mass_parts[i]
        u = self.relative(v, i, k)
        slip, tangential_mass = u, mass
        if ti.static(solver.model.spins):
            slip -= self.turned_along(lever(spin, n), i, k, 0.5 / solver.rate[0])
            tangential_mass *= self.model.sideways(i)
        law, threshold = self.law(i, k), self.threshold[0]
        p = contact_law.further_impulse(
            self.model, self.contact, c, law, n, u, slip, gain * mass, tangential_mass, threshold, time
        )
        if ti.static(self.probed):
            self.record(i, k, p)
        return p

    @ti.func
    def correct_positions(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] beyond the slop that its own motion and other contacts will not undo."""
        d = ti.Vector.zero(float, self.model.dim)
        w = self.model.inverse_mass[i]
        for k in range(ti.select(self.touching[i] > 0 and w > 0.0, self.count, 0)):
            n = self.normal(i, k)
            depth, share = -self.gap(ball[i].x, i, k), 1.0 / self.mass_parts[i]
            if ti.static(solver.in_turn):
                depth -= n.dot(solver.position_correction[i])
            if ti.static(solver.split):
                share = w / solver.effective_inverse_mass[i]
            away = h * n.dot(self.relative(ball[i].v, i, k))
            d += contact_law.push_out(depth, self.model.radius[i], away) * share * n
        return d

    @ti.func
    def lift(self, ball: ti.template(), i):
        """Energy [J] that gravity gains where ball i is pushed out of walls and colliders."""
        rise, w = 0.0 * self.model.radius[i], self.model.inverse_mass[i]
        for k in range(ti.select(w > 0.0, self.looked_at(i), 0)):
            depth = ti.max(0.0, -self.gap(ball[i].x, i, k))
            rise += ti.max(0.0, -depth * self.normal(i, k).dot(self.model.gravity[0]))
        return rise / ti.max(w, 1e-30)

    @ti.func
    def statistics(self, ball: ti.template(), solver: ti.template(), i):
        """Statistics of the walls and colliders that ball i touches; one that rests lies on the surface, give or take
        rounding."""
        total = statistics.nothing()
        for k in range(ti.select(self.model.inverse_mass[i] > 0.0, self.count, 0)):
            gap = self.gap(ball[i].x, i, k)
            if gap <= self.touch(ball[i].x, i, k):
                u = self.normal(i, k).dot(self.relative(ball[i].v, i, k))
                presses = self.contact[i * self.count + k].impulse > 0.0
                total = statistics.join(total, statistics.one(ti.max(0.0, -gap), self.model.radius[i], u, presses, i))
        return total
