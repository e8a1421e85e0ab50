"""HeldBalls: balls that rest on walls and colliders, held there while an implicit stage is solved.

A stage that knew of no surface would let what rests fall into it, and elements would answer to that fall. So the velocity of such
a ball along the normals n of its surfaces is theirs, and the rest of it is solved for: conjugate gradients go on in the space in
which n . v is given, where residuals and directions have no part along n (Baraff and Witkin, 1998). What the residual has along n
then is the impulse of the surface, which must push. The stage ends with velocities without it: the solve of contacts that follows
finds it, as any other load, and bears it.

Friction that followed the stage would strain elements after they were solved for, which gives energy. So it acts in the stage
too, as a drag: -d m u at the slip u, d = b / |u|. Surfaces that push with impulses N allow m b = sum mu N. The slip is that of
the way since the start of the step, so that friction does no work on what moves past a surface. Each surface drags at the slip
past it; together they drag as one that moves with their mean, weighted by their drags. Both b and u are those of the solution
before it, see `renew`: the lagged friction of Li et al. (2020, Incremental Potential Contact), but for its direction, which is
implicit.
"""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.integrators.bodies import Bodies
from taichi_sim.kernels.contacts.kinds import RESTING
from taichi_sim.kernels.contacts.nearby_colliders import FAR_GAP

__all__ = ["HeldBalls"]

# squared sine of the angle (3 degrees) between a normal and those before it: below, it adds no direction
LEAST_SQUARE = 0.003
STUCK = 3e-5  # of what friction can change in a stage: a ball that slides more slowly sticks
SLOW = 2.0  # times that slip: friction may still be any
SLIPS = 8  # iterations for the slip to go on with
ROUNDING = 32.0  # of a velocity, in units of the machine's: a slower slip may be none
FRICTION_TOLERANCE = 0.05  # of friction, in units of all impulses
SWEEPS = 64  # over the surfaces of a ball, where it has several, for the impulses of each


@ti.data_oriented
class HeldBalls:
    """Balls (n) that surfaces hold in a stage. walls: a contacts.Walls.

    Fields: `normals` (n): the projection on the directions along which a ball is held, 0 of most; `reaction` (n) [m/s]: what the
    solution has too little of velocity without the impulses of surfaces, negative of what they give. `contact`: of ball i and its
    surface k: whether it `rests` there when the stage begins, whether that `holds` it, the `target` of the speed away from it,
    -FAR_GAP where the ball cannot reach it, and its `push` [m/s] and `drag` in this solution. `friction`: the `most` that it can
    change a velocity by [m/s], the part of that which comes from the stage `before`, all `drag`, and the change of velocity that
    is `wrong` in it [m/s]. `last_most`: the most in each stage of the step before. Of each ball [m/s]: `moved`, its way before
    the stage begins, over its length, and `span`, the time from the start of the step to the end of the stage, over the same;
    `carried`, the velocity with which it ends the stage if its surfaces carry it; `rubbed`, what friction changed in the last
    stage, and `kept`, the part of that in this one.
    """

    def __init__(self, model: Model, walls: Any, bodies: Bodies, method: Any, fields: Fields) -> None:
        self.model, self.walls, self.dim = model, walls, model.dim
        self.rubs, self.eps = model.has_friction, 2.0**-52 if fields.real == ti.f64 else 2.0**-23
        self.rate = method.contacts.rate  # 1/s
        self.ends, self.opening = fields.reals(np.array(method.ends)), method.opening
        walls.foresees = True
        self.normals = fields.matrices(model.n, self.dim)
        self.reaction = fields.vectors(model.n, self.dim)
        reals = ("target", "push", "drag") if self.rubs else ("target", "push")
        whether = dict.fromkeys(("rests", "holds"), ti.i32)
        self.contact = fields.table(whether | dict.fromkeys(reals, fields.real), model.n * walls.count)
        if self.rubs:
            self.friction = fields.table(dict.fromkeys(("most", "before", "drag", "wrong"), fields.real), model.n)
            self.last_most = fields.reals(model.n * method.stages)
            self.span = fields.reals(model.n)
            self.carries = fields.reals(np.array(method.carries))
            self.moved, self.carried, self.kept, self.rubbed = (fields.vectors(model.n, model.dim) for _ in range(4))
        self.bodies, self.wide = bodies, fields.wide
        square = ti.types.matrix(self.dim, self.dim, fields.wide)
        self.part = bodies.columns({"stops": square, "drags": square, "mass": fields.wide})
        self.reports = walls.probed
        if self.reports:
            self.pushes = bodies.columns({"total": fields.wide})
            # (bodies) number in contacts.Received of what pushed each last; as many as balls, for Simulation.save
            self.last_pushing = fields.reals(np.full(model.n, -1.0))
        self.firm = (2.0**-52 if fields.wide == ti.f64 else 2.0**-23) ** -0.5
        self.joined = fields.integers((bodies.joined[bodies.body] & ~model.scene.pinned).astype(np.int32))

    @ti.func
    def choose(self, i, v, shift, change, q, s, stage):
        """Choose the surfaces that hold ball i in a stage of s seconds. It begins with the velocity v at a `shift` [m] from the
        place of the ball; v is expected to `change`.

        They are those that bore a load in the step before; those that it would go into at the velocity q that it has without
        elements; and, but in an opening stage, the surfaces that it would go through. Returns its velocity, with which
        it is at these when the stage ends: where it bounces it is elsewhere, but not in them.
        """
        held, x, meets, ends = 0, self.walls.state.ball[i].x, stage >= self.opening, s
        if meets:
            ends = self.ends[stage] / self.rate[0]
        else:
            shift *= 0.0
        expected = v + change
        for k in range(ti.select(self.joined[i] == 1, self.walls.count, 0)):
            c, holds = i * self.walls.count + k, False
            gap = self.walls.gap(x, i, k)
            self.contact[c].rests = 0
            self.contact[c].target = -FAR_GAP
            self.contact[c].push = 0.0
            if gap < FAR_GAP:
                self.walls.end_foreseen(i, k, gap)
                n = self.walls.normal(i, k)
                approach = -n.dot(self.walls.relative(q, i, k))
                ahead = n.dot(shift + (ends - s) * self.walls.relative(0.0 * v, i, k))
                if meets:  # it ends at the surface: what a ball at rest drifts off does not add up
                    ahead += ti.max(0.0, gap)
                if self.walls.contact[c].role == RESTING:
                    self.contact[c].rests = 1
                    ahead -= ends * self.walls.following(x, (shift + s * expected) / ends, i, k, ends)
                    holds = self.walls.contact[c].impulse > 0.0 or s * approach > ahead
                    self.contact[c].target = -ahead / s
                elif meets:
                    holds = s * approach > ahead
                    self.contact[c].target = -ahead / s
            self.contact[c].holds = ti.cast(holds, ti.i32)
            held += ti.cast(holds, ti.i32)
        self.normals[i] = ti.Matrix.zero(float, self.dim, self.dim)
        self.reaction[i] = ti.Vector.zero(float, self.dim)
        if held > 0:
            self._span(i)
            if self.holds(i):
                v = self._with_targets(i, v)
        if ti.static(self.rubs):
            self.moved[i] = shift / s
            self.span[i] = ends / s
            self._expect_friction(i, expected, stage)
        return v

    @ti.func
    def could_hold(self, i):
        """True if a surface may hold ball i in this stage."""
        found = False
        for c in range(i * self.walls.count, ti.select(self.joined[i] == 1, i + 1, i) * self.walls.count):
            found = found or self.contact[c].target > -FAR_GAP
        return found

    @ti.func
    def _span(self, i):
        """Note the directions along which ball i is held. Between two surfaces that face each other it is not: they would have to
        push without bound."""
        normals, first, narrow = ti.Matrix.zero(float, self.dim, self.dim), ti.Vector.zero(float, self.dim), False
        for k in range(self.walls.count):
            if self.contact[i * self.walls.count + k].holds == 1:
                n = self.walls.normal(i, k)
                across = n - normals @ n
                square = across.dot(across)
                if square > LEAST_SQUARE:
                    first = ti.select(normals.trace() > 0.0, first, n)
                    normals += across.outer_product(across) / square
                else:
                    narrow = narrow or n.dot(first) < 0.0
        self.normals[i] = ti.select(narrow, 0.0 * normals, normals)

    @ti.func
    def _with_targets(self, i, v):
        """The velocity v with the target speeds of the surfaces of ball i along the directions in which they hold it."""
        normals = ti.Matrix.zero(float, self.dim, self.dim)
        for k in range(self.walls.count):
            c = i * self.walls.count + k
            if self.contact[c].holds == 1:
                n = self.walls.normal(i, k)
                across = n - normals @ n
                square = across.dot(across)
                if square > LEAST_SQUARE:
                    v += (self.contact[c].target - n.dot(self.walls.relative(v, i, k))) / square * across
                    normals += across.outer_product(across) / square
        return v

    @ti.func
    def holds(self, i):
        """True if a surface holds ball i."""
        return self.normals[i].trace() > 0.0

    @ti.func
    def along(self, i, u):
        """The part of the vector u that ball i is free to take."""
        return u - self.normals[i] @ u

    @ti.func
    def note_reaction(self, i, r):
        """Note what the residual r of ball i has along the directions in which it is held."""
        self.reaction[i] = self.model.inverse_mass[i] * (self.normals[i] @ r)

    @ti.func
    def unborne(self, i):
        """Change of velocity that ball i lacks beside what its surfaces give it by pushing; notes their pushes."""
        rest = -self.reaction[i]
        first, number = i * self.walls.count, 0
        for c in range(first, first + self.walls.count):
            self.contact[c].push = 0.0
            number += self.contact[c].holds
        for _ in range(ti.select(number > 1, SWEEPS, 1)):
            for k in range(self.walls.count):
                if self.contact[first + k].holds == 1:
                    n, before = self.walls.normal(i, k), self.contact[first + k].push
                    now = ti.max(0.0, before + n.dot(rest))
                    rest -= (now - before) * n
                    self.contact[first + k].push = now
        return rest

    @ti.func
    def amiss(self, i, v, allowed):
        """Impulse [N s] that is wrong with the surfaces of ball i at the velocity v: with which those that hold it would have to
        pull, others to stop it, and by which friction is not what they can give. Notes their pushes. allowed: part of all
        impulses that the residual may be, squared."""
        rest = self.unborne(i)
        if ti.static(self.rubs):
            change = self._change_of_friction(i, v)
            rest += (ti.sqrt(allowed) / FRICTION_TOLERANCE) * change
            self.friction[i].wrong = change.norm()
        for k in range(self.walls.count):
            c = i * self.walls.count + k
            if self.contact[c].holds == 0 and self.contact[c].target > -FAR_GAP:
                n = self.walls.normal(i, k)
                short = self.contact[c].target - n.dot(self.walls.relative(v, i, k))
                if short > 0.0:
                    self.contact[c].push = short
                    rest += short * n
        return rest / self.model.inverse_mass[i]

    @ti.func
    def renew(self, i, v, inverse):
        """Have those surfaces hold ball i that push, with the friction that they can give, see `amiss`. Returns the velocity
        that it has then in place of v. inverse: of its block of the matrix [1/kg]."""
        if ti.static(self.rubs):
            self._renew_drags(i, v, inverse)
        for c in range(i * self.walls.count, (i + 1) * self.walls.count):
            self.contact[c].holds = ti.cast(self.contact[c].push > 0.0, ti.i32)
        self._span(i)
        if ti.static(self.rubs):
            self._add_drags(i)
        result = v
        if self.holds(i):
            result = self._with_targets(i, v)
        return result

    @ti.func
    def hand_on(self, i, v, stage):
        """Velocity of ball i without what surfaces give it in the stage, which ended with v: their pushes and the friction that
        these allow, so that contacts find both. Where that is not all that v asks for, the rest is left out: as an impulse that
        elements did not answer to it would give energy."""
        self.reaction[i] = self.reaction[i] + self.unborne(i)
        if ti.static(self.rubs):
            self._bound_friction(i)
            for k in range(self.walls.count):
                if self.contact[i * self.walls.count + k].holds == 1:
                    self.contact[i * self.walls.count + k].drag = self._allowed_drag(i, k, v)
            self._add_drags(i)
            self.rubbed[i] = self.rub(i, v)
            self.reaction[i] = self.reaction[i] - self.rubbed[i]
            self.last_most[stage * self.model.n + i] = self.friction[i].most
        if ti.static(self.rubs):
            self.foresee(i)
        return v + self.reaction[i]

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

    @ti.func
    def rests(self, i):
        """True if contacts solve for a surface of ball i, which does not bounce off it when it moves."""
        found = False
        for c in range(i * self.walls.count, ti.select(self.joined[i] == 1, i + 1, i) * self.walls.count):
            found = found or self.walls.contact[c].role == RESTING
        return found

    @ti.func
    def foresee(self, i):
        """Leave those surfaces to contacts that ball i was solved to reach, and does not touch yet, or not for rounding."""
        for k in range(ti.select(self.joined[i] == 1, self.walls.count, 0)):
            c = i * self.walls.count + k
            if self.walls.contact[c].role != RESTING and self.walls.gap(self.walls.state.ball[i].x, i, k) < FAR_GAP:
                if self._stays_at(i, k):
                    self.walls.foresee(i, k)

    # Friction

    @ti.func
    def _expect_friction(self, i, v, stage):
        """Expect as much friction on ball i, at the velocity v, as in this stage of the step before, shared
        alike by the surfaces that hold it; none if nothing holds it."""
        self.friction[i].most = ti.select(self.holds(i), self.last_most[stage * self.model.n + i], 0.0)
        carries, before = self.carries[stage], ti.max(0, stage - 1) * self.model.n + i
        self.friction[i].before = carries * self.last_most[before]
        self.kept[i] = carries * self.rubbed[i]
        for k in range(self.walls.count):
            if self.contact[i * self.walls.count + k].holds == 1:
                most, slow = self._most(i, k), self._slowest(i, k, v)
                speed = ti.sqrt(self._past(i, k, v).norm_sqr() + slow * slow)
                self.contact[i * self.walls.count + k].drag = ti.select(most > 0.0, most / speed, 0.0)
        self._add_drags(i)

    @ti.func
    def _add_drags(self, i):
        """Add up the drags of the surfaces that hold ball i, and note the velocity with which these together carry it."""
        drag, carried = ti.cast(0.0, float), ti.Vector.zero(float, self.dim)
        for k in range(self.walls.count):
            c = i * self.walls.count + k
            if self.contact[c].holds == 1:
                drag += self.contact[c].drag
                carried += self.contact[c].drag * self._carrier(i, k)
        self.friction[i].drag = drag
        self.carried[i] = ti.select(drag > 0.0, carried / ti.select(drag > 0.0, drag, 1.0), -self.moved[i])

    @ti.func
    def _carrier(self, i, k):
        """Velocity with which ball i ends the stage where surface k carries it."""
        carried = -self.moved[i]
        if ti.static(self.walls.moves):
            carried -= self.span[i] * self.walls.relative(ti.Vector.zero(float, self.dim), i, k)
        return carried

    @ti.func
    def slip(self, i, v):
        """Way of ball i along the surfaces that hold it, from the start of the step to the end of the stage, which it leaves with
        the velocity v; over the length of the stage [m/s]. Past surfaces that move apart: their mean, weighted by their drags."""
        return self.along(i, v - self.carried[i])

    @ti.func
    def _past(self, i, k, v):
        """Slip of ball i past surface k alone, in its plane, see `slip`."""
        slip, n = v - self._carrier(i, k), self.walls.normal(i, k)
        return slip - n.dot(slip) * n

    @ti.func
    def _slowest(self, i, k, v):
        """Slip [m/s] below which ball i, at the velocity v, sticks to surface k."""
        rounded = (ROUNDING * self.eps) ** 2 * (v.norm_sqr() + self._carrier(i, k).norm_sqr())
        return ti.sqrt((STUCK * self._most(i, k)) ** 2 + rounded)

    @ti.func
    def rub(self, i, v):
        """Change of the velocity v of ball i by friction [m/s]."""
        return -self.friction[i].drag * self.slip(i, v) - self._kept(i)

    @ti.func
    def _kept(self, i):
        """The part of friction that was given in the stage before [m/s]."""
        return ti.select(self.holds(i), 1.0, 0.0) * self.along(i, self.kept[i])

    @ti.func
    def potential(self, i, v):
        """Potential of friction at the velocity v of ball i, over its mass [J/kg]."""
        return 0.5 * self.friction[i].drag * self.slip(i, v).norm_sqr() + self._kept(i).dot(v)

    @ti.func
    def _change_of_friction(self, i, v):
        """Change of the velocity v of ball i by which its friction is not what its pushes allow."""
        self._bound_friction(i)
        change = ti.Vector.zero(float, self.dim)
        for k in range(self.walls.count):
            c = i * self.walls.count + k
            if self.contact[c].holds == 1:
                slip = self.along(i, v - self._carrier(i, k))
                change += (self.contact[c].drag - self._allowed_drag(i, k, v)) * slip
        return change

    @ti.func
    def _allowed_drag(self, i, k, v):
        """The drag of surface k on ball i at the velocity v, bounded by what its friction may be: where the ball sticks, any up
        to the most."""
        most, slip, drag = self._most(i, k), self._past(i, k, v).norm(), self.contact[i * self.walls.count + k].drag
        if slip > 0.0:
            stuck = ti.min(1.0, SLOW * self._slowest(i, k, v) / slip)
            drag = ti.max(ti.min(drag, most / slip), (1.0 - stuck * stuck) * most / slip)
        return drag

    @ti.func
    def _renew_drags(self, i, v, inverse):
        """Give each surface of ball i the drag that its friction has where it meets the line on which the ball alone answers to
        it: by more slip to less friction. As the slip is given, it is that of a ball that slides; as the friction is, of one that
        sticks."""
        whole_drag = self.dim * self.model.inverse_mass[i] / inverse.trace()
        for k in range(self.walls.count):
            c = i * self.walls.count + k
            if self.contact[c].holds == 1:
                self.contact[c].drag = self._next_drag(i, k, v, ti.max(1.0, whole_drag - self.contact[c].drag))
            else:
                self.contact[c].drag = 0.0

    @ti.func
    def _next_drag(self, i, k, v, stiff):
        """The drag of surface k to go on with, see `_renew_drags`. stiff: what else resists a change of velocity, by mass."""
        most, slip = self._most(i, k), self.along(i, v - self._carrier(i, k)).norm()
        across = ti.max(0.0, self._past(i, k, v).norm_sqr() - slip * slip)  # where other surfaces let it not go
        square = self._slowest(i, k, v) ** 2 + across
        whole, found = slip + self.contact[i * self.walls.count + k].drag / stiff * slip, 0.0 * slip
        drag = 0.0 * slip
        if most > 0.0:
            for _ in range(SLIPS):  # Newton's method from below, where it converges from one side
                speed = ti.sqrt(found * found + square)
                over = found + most / stiff * found / speed - whole
                found -= over / (1.0 + most / stiff * square / speed**3)
            drag = most / ti.sqrt(found * found + square)
        return drag

    @ti.func
    def _bound_friction(self, i):
        """Bound the friction of ball i by its pushes."""
        most = self.friction[i].before
        for k in range(self.walls.count):
            most += self._load(i, k)
        self.friction[i].most = most

    @ti.func
    def _load(self, i, k):
        """Change of velocity that friction with surface k can give for its push on ball i [m/s]."""
        load = ti.cast(0.0, float)
        if self._stays_at(i, k):
            load = self.walls.law(i, k).friction * self.contact[i * self.walls.count + k].push
        return load

    @ti.func
    def _most(self, i, k):
        """The part of the most friction of ball i that surface k gives: as it pushes, or where none does, all alike."""
        loads, number = ti.cast(0.0, float), 0
        for other in range(self.walls.count):
            if self.contact[i * self.walls.count + other].holds == 1:
                loads += self._load(i, other)
                number += 1
        share = ti.select(loads > 0.0, self._load(i, k) / ti.select(loads > 0.0, loads, 1.0), 1.0 / ti.max(1, number))
        return share * self.friction[i].most

    @ti.func
    def _stays_at(self, i, k):
        """True if surface k pushes ball i in the stage, and not only when the ball moves, in a bounce."""
        c, yes = i * self.walls.count + k, False
        if self.contact[c].holds == 1 and self.contact[c].push > 0.0:
            yes = self.contact[c].rests == 1 or self.walls.law(i, k).restitution == 0.0
        return yes
