"""HeldBalls: balls that rest on walls and colliders, held there while an implicit stage is solved.

A stage that knew of no surface would let what rests fall into it, and elements would answer to that fall. So the velocity of such
a ball along the normals n of its surfaces is theirs, and the rest of it is solved for: conjugate gradients go on in the space in
which n . v is given, where residuals and directions have no part along n (Baraff and Witkin, 1998). What the residual has along n
then is the impulse of the surface, which must push. The stage ends with velocities without it: the solve of contacts that follows
finds it, as any other load, and bears it with friction.
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
SWEEPS = 64  # over the surfaces of a ball, where it has several, for the impulses of each


@ti.data_oriented
class HeldBalls:
    """Balls (n) that surfaces hold in a stage. walls: a contacts.Walls.

    Fields: `normals` (n): the projection on the directions along which a ball is held, 0 of most; `reaction` (n) [m/s]: what the
    solution has too little of velocity without the impulses of surfaces, negative of what they give. `contact`: of ball i and its
    surface k: whether it `holds`, the `target` of the speed away from it, and its `push` [m/s].
    """

    def __init__(self, model: Model, walls: Any, bodies: Bodies, fields: Fields) -> None:
        self.model, self.walls, self.dim = model, walls, model.dim
        walls.foresees = True
        self.normals = fields.matrices(model.n, self.dim)
        self.reaction = fields.vectors(model.n, self.dim)
        self.contact = fields.table(
            {"holds": ti.i32, "target": fields.real, "push": fields.real}, model.n * walls.count
        )
        self.joined = fields.integers((bodies.joined[bodies.body] & ~model.scene.pinned).astype(np.int32))

    @ti.func
    def choose(self, i, start, q, s, meets):
        """Choose the surfaces that hold ball i in a stage of s seconds from `start`, its place and velocity.

        They are those that bore a load in the step before; those that it would go into at the velocity q that it has without
        elements; and, if it `meets` any in this stage, the planes that it would go through. Returns its velocity, with which
        it is at these when the stage ends: where it bounces it is elsewhere, but not in them.
        """
        held, v = 0, start.v
        for k in range(ti.select(self.joined[i] == 1, self.walls.count, 0)):
            c, holds = i * self.walls.count + k, False
            gap = self.walls.gap(self.walls.state.ball[i].x, i, k)
            if gap < FAR_GAP:
                n = self.walls.normal(i, k)
                approach = -n.dot(self.walls.relative(q, i, k))
                if self.walls.contact[c].role == RESTING:
                    holds = self.walls.contact[c].impulse > 0.0 or approach > 0.0
                    self.contact[c].target = 0.0
                elif meets:
                    ahead = ti.max(0.0, gap) + n.dot(start.x - self.walls.state.ball[i].x)
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
        return v

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
    def pull(self, i):
        """Impulse [N s] with which the surfaces of ball i, which is held, would have to pull at it; notes their pushes."""
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
        return rest / self.model.inverse_mass[i]

    @ti.func
    def release(self, i):
        """Release ball i from the surfaces that do not push; see `pull`."""
        first = i * self.walls.count
        for c in range(first, first + self.walls.count):
            if self.contact[c].push == 0.0:
                self.contact[c].holds = 0
        self._span(i)
