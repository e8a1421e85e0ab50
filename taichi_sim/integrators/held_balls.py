"""HeldBalls: balls that rest on walls and colliders, held there while an implicit stage is solved.

A stage that knew of no surface would let what rests fall into it, and elements would answer to that fall. So the velocity of such
a ball along the normals n of its surfaces is theirs, and the rest of it is solved for: conjugate gradients go on in the space in
which n . v is given, where residuals and directions have no part along n (Baraff and Witkin, 1998). What the residual has along n
then is the impulse of the surface, which must push. The stage ends with velocities without it: the solve of contacts that follows
finds it, as any other load, and bears it.
"""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.integrators.bodies import Bodies
from taichi_sim.integrators.held_friction import STUCK, HeldFriction
from taichi_sim.integrators.held_momentum import HeldMomentum
from taichi_sim.kernels.contacts.kinds import RESTING
from taichi_sim.kernels.contacts.nearby_colliders import FAR_GAP

__all__ = ["HeldBalls"]

# squared sine of the angle (3 degrees) between a normal and those before it: below, it adds no direction
LEAST_SQUARE = 0.003
FRICTION_TOLERANCE = 0.05  # of friction, in units of all impulses
SWEEPS = 64  # over the surfaces of a ball, where it has several, for the impulses of each


@ti.data_oriented
class HeldBalls(HeldFriction, HeldMomentum):
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
        self.stuck = STUCK[method.method.order]
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
