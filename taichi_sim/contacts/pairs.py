"""Pairs: contacts between balls, found through the grid and kept, each once, in lists for all passes of a step."""

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
PER_BALL = {2: 4, 3: 7}  # equal balls touch at most 6 others in 2D, 12 in 3D; each pair is listed once
BLOCK = 64  # balls whose lists lie one behind the other
GAP = 0.02  # of the radii: soft contacts hold balls that nearly touch, lest those that rest on each other part and meet again


@ti.data_oriented
class Pairs:
    """Ball-ball contacts: each ball lists the later balls near it, those that touch it first.

    `link` holds the other ball and what the contact holds from step to step: its impulse [N s] and, with friction, the impulse
    along the surface. `row` holds what only one step needs: normal, depth [m], mass [kg], target speed [m/s]. warm: contacts
    start from the impulses of the step before. soft: they are damped springs, see kernels.contact_law.
    """

    def __init__(self, model: Model, fields: Fields, grid: Grid, warm: bool, soft: bool) -> None:
        scene = model.scene
        self.model, self.grid, self.warm, self.soft = model, grid, warm, soft
        self.slop, self.gap = SLOP, GAP if soft else 0.0
        self.block = BLOCK
        self.room = BLOCK * PER_BALL[model.dim]
        self.pool = -(-model.n // BLOCK) * self.room
        self.capacity = self.pool + max(model.n, min(model.n**2, POOL))
        self.used, self.overflow = fields.integers(1), fields.integers(1)
        self.furthest, self.length, self.blocks = fields.integers(1), fields.integers(1), fields.integers(1)
        halves = 2 if warm else 1
        vector = ti.types.vector(model.dim, fields.real)
        columns = {"other": ti.i32, "impulse": fields.real}
        if model.has_friction:
            columns["slide"] = vector
        if model.has_restitution or soft:
            columns["target"] = fields.real
        if soft:
            columns["push"] = fields.real
        self.link = fields.table(columns, halves * self.capacity)
        columns = {"normal": vector, "depth": fields.real, "mass": fields.real}
        if model.spins:
            columns["arm"] = fields.real  # of each radius: balls that overlap touch nearer to their centres
        self.row = fields.table(columns, self.capacity)
        self.turn, self.overlap = fields.integers(1), fields.reals(1)
        self.number = fields.integers(model.n)
        self.first, self.touching = fields.integers(halves * model.n), fields.integers(halves * model.n)
        self.counts = soft and bool(scene.walls or scene.colliders)
        if self.counts:
            self.met = fields.integers(model.n)  # pairs of each ball that touch, whoever lists them
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
        """Normals and depths of the pairs that ball i lists."""
        loops.measure(self, ball, i)

    @ti.kernel
    def _deepest(self, ball: ti.template()):
        self.overlap[0] = 0.0
        for i in range(self.model.n):
            own = self.turn[0] * self.model.n + i
            for e in range(self.first[own], self.first[own] + self.touching[own]):
                j = self.link[e].other
                d = (ball[j].x - ball[i].x).norm()
                ti.atomic_max(self.overlap[0], self.model.radius[i] + self.model.radius[j] - d)

    def deepest(self, ball: Any) -> float:
        """Largest overlap [m] of two balls, of those found when contacts were last looked for."""
        self._deepest(ball)
        return float(self.overlap[0])
