"""Pairs: contacts between balls, found through the grid and kept as one list per ball for all passes of a step."""

from typing import Any

import numpy as np
import taichi as ti

from taichi_sim.contacts.grid import Grid
from taichi_sim.contacts.walls import SLOP
from taichi_sim.fields import Fields
from taichi_sim.kernels import pairs as loops
from taichi_sim.model import Model

__all__ = ["Pairs"]

POOL = 1 << 20  # links for what a block cannot hold; a thousand coincident balls fit
PER_BALL = {2: 7, 3: 13}  # equal balls touch at most 6 others in 2D, 12 in 3D, itself is listed for a moment
KEEP_NORMALS = (
    20_000  # balls; above that, reading a normal from memory costs as much as computing it from positions again
)
BLOCK = 64  # balls whose lists lie one behind the other


@ti.data_oriented
class Pairs:
    """Ball-ball contacts: each ball lists all balls near it, those that touch it first.

    `link` holds the other ball and the impulse [N s]; `row` what only one step needs: mass [kg], target
    speed [m/s], impulse along the surface. warm: contacts start from the impulses of the step before.
    """

    def __init__(self, model: Model, fields: Fields, grid: Grid, warm: bool) -> None:
        scene = model.scene
        self.model, self.grid, self.warm = model, grid, warm
        self.slop = SLOP
        self.block = BLOCK
        self.room = BLOCK * PER_BALL[model.dim]
        self.pool = -(-model.n // BLOCK) * self.room
        self.capacity = self.pool + max(2 * model.n, min(2 * model.n**2, POOL))
        self.used = fields.integers(1)
        self.overflow = fields.integers(1)
        self.link = fields.table({"other": ti.i32, "impulse": fields.real}, (2 if warm else 1) * self.capacity)
        self.keeps_normals = model.n <= KEEP_NORMALS
        columns = {"mass": fields.real, "target": fields.real}
        if self.keeps_normals:
            columns["normal"] = ti.types.vector(model.dim, fields.real)
        if model.has_friction:
            columns["slide"] = ti.types.vector(model.dim, fields.real)
        self.row = fields.table(columns, self.capacity)
        self.half, self.overlap = fields.integers(1), fields.reals(1)
        self.first = fields.integers(model.n)
        self.number, self.touching = fields.integers(model.n), fields.integers(model.n)
        self.has_bodies = bool(np.any(scene.body > 0))
        if self.has_bodies:
            self.body = fields.integers(scene.body)
        self.has_joints = scene.n_springs > 0
        if self.has_joints:
            start, other = model.joined()
            self.joint_start, self.joint_other = fields.integers(start), fields.integers(other)

    def names(self) -> list[str]:
        """What is compiled in, for `Simulation.kernels()`."""
        return ["grid", "pairs"]

    @ti.func
    def detect(self, ball: ti.template()):
        """List all pairs within reach, where the last list no longer holds; the grid is built already."""
        loops.search(self)

    @ti.func
    def measure(self, ball: ti.template(), i):
        """Normals and depths of the pairs of ball i; sum of n n^T over those that touch, and their number."""
        return loops.measure(self, ball, i)

    @ti.func
    def begin(self, ball: ti.template(), solver: ti.template(), i, impacts: ti.template()):
        """Impulse on ball i that its contacts hold from before, their targets fixed on the way."""
        p = ti.Vector.zero(float, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.touching[i]):
            p += loops.hold(self, ball, solver, i, e, impacts)
        return p

    @ti.func
    def first_pass(self, ball: ti.template(), solver: ti.template(), i, time, impacts: ti.template()):
        """`begin` and `gather` in one, where nothing is held from before."""
        p = ti.Vector.zero(float, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.touching[i]):
            p += loops.first_contact(self, ball, solver, i, e, time, impacts)
        return p

    @ti.func
    def gather(self, ball: ti.template(), solver: ti.template(), i, time):
        """Further impulse on ball i from all balls that touch it."""
        p = ti.Vector.zero(float, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.touching[i]):
            p += loops.contact(self, ball, solver, i, e, time)
        return p

    @ti.func
    def begin_scatter(self, ball: ti.template(), solver: ti.template(), impacts: ti.template()):
        """The same as `begin`, each pair once, added to both balls with atomics."""
        for i in range(self.model.n):
            for e in range(self.first[i], self.first[i] + self.touching[i]):
                j = self.link[e].other
                if j > i:
                    p = loops.hold(self, ball, solver, i, e, impacts)
                    solver.push[i] += p
                    solver.push[j] -= p

    @ti.func
    def scatter(self, ball: ti.template(), solver: ti.template(), time):
        """The same as `gather`, each pair once, added to both balls with atomics."""
        for i in range(self.model.n):
            for e in range(self.first[i], self.first[i] + self.touching[i]):
                j = self.link[e].other
                if j > i:
                    p = loops.contact(self, ball, solver, i, e, time)
                    solver.push[i] += p
                    solver.push[j] -= p

    @ti.func
    def offset(self, ball: ti.template(), solver: ti.template(), i, h):
        """Push-out of ball i [m] from the balls it overlaps."""
        q = ti.Vector.zero(float, self.model.dim)
        for e in range(self.first[i], self.first[i] + self.touching[i]):
            q -= loops.push_out(self, ball, solver, i, e, h)
        return q * self.model.inverse_mass[i]

    @ti.kernel
    def _deepest(self, ball: ti.template()):
        self.overlap[0] = 0.0
        for i in range(self.model.n):
            for e in range(self.first[i], self.first[i] + self.touching[i]):
                j = self.link[e].other
                d = (ball[j].x - ball[i].x).norm()
                ti.atomic_max(self.overlap[0], self.model.radius[i] + self.model.radius[j] - d)

    def deepest(self, ball: Any) -> float:
        """Largest overlap [m] of two balls, of those found when contacts were last looked for."""
        self._deepest(ball)
        return float(self.overlap[0])
