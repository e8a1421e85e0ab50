"""Pairs: contacts between balls, found through the grid and kept, each once, in lists for all iterations of a step."""

import numpy as np

from taichi_sim.contacts.grid import Grid
from taichi_sim.contacts.plan import ContactPlan
from taichi_sim.contacts.walls import SLOP, TOUCH
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import pairs as loops
from taichi_sim.kernels.contacts import statistics
from taichi_sim.kernels.vectors import unit

__all__ = ["Pairs"]

POOL = 1 << 19  # links for what a block cannot hold; a thousand coincident balls fit
PER_BALL = {2: 4, 3: 6}  # equal balls touch at most 6 others in 2D, 12 in 3D; each pair is listed once
BLOCK = 64  # balls whose lists lie one behind the other
GAP = 0.02  # of the radii: soft contacts hold balls that nearly touch, lest those that rest on each other part and meet again


@ti.data_oriented
class Pairs:
    """Ball-ball contacts: each ball lists the later balls near it, those that touch it first.

    `link` holds the other ball and what the contact keeps from step to step: its accumulated `impulse` [N s] and, with
    friction, tangential impulse `slide`; where contacts are soft its `bias_velocity` [m/s], with which it pushes out overlap,
    or RIGID; where restitution is part of the solve its `rebound_speed` [m/s], 0 if it did not bounce. `row` holds what only
    one step needs: `normal`, `depth` [m], `mass` [kg], and `target` [m/s], the normal speed to come to, or, where impacts are
    resolved in turn, `start` [N s], the impulse before the solve, and who lists it: each ball then knows the rows in which
    others list it. capacity: links that are known to be needed."""

    what = "pairs of balls within reach of each other"

    def __init__(
        self,
        model: Model,
        fields: Fields,
        grid: Grid,
        plan: ContactPlan,
        capacity: int = 0,
    ) -> None:
        scene = model.scene
        self.model, self.grid, self.warm, self.soft = model, grid, plan.warm_starts, plan.soft
        self.slop, self.gap = SLOP, GAP if plan.soft else 0.0
        self.block = BLOCK
        self.room = BLOCK * PER_BALL[model.dim]
        self.pool = -(-model.n // BLOCK) * self.room
        self.capacity = max(capacity, self.pool + max(model.n // 2, min(model.n**2, POOL)))
        before = fields.bytes
        self.used, self.overflow = fields.integers(1), fields.integers(1)
        self.furthest, self.length, self.blocks = fields.integers(1), fields.integers(1), fields.integers(1)
        self.single = fields.real == ti.f32
        self.has_rebounds = model.has_restitution and not plan.impacts_in_turn
        self.has_target = self.has_rebounds or (plan.soft and not plan.impacts_in_turn)
        vector = ti.types.vector(model.dim, fields.real)
        columns = {"other": ti.i32, "impulse": fields.real}
        if model.has_friction:
            columns["slide"] = fields.real if model.dim == 2 else vector  # in 2D along the normal turned by 90 degrees
        if plan.soft:
            columns["bias_velocity"] = fields.real
        if self.has_rebounds:
            columns["rebound_speed"] = fields.real
        self.link = fields.table(columns, self.capacity)
        columns = {"normal": vector, "depth": fields.real, "mass": fields.real}
        if self.has_target:
            columns["target"] = fields.real
        if self.has_rebounds:
            columns["rebound_speed"] = fields.real  # while lists are made anew
        if plan.impacts_in_turn and plan.warm_starts:
            columns["start"] = fields.real
        if plan.line_search:
            columns["noted"] = fields.real  # impulse before the last iteration, see impact_iterations
        if plan.impacts_in_turn:
            # the ball whose row it is; the next row with the same other ball
            columns["lister"] = columns["next"] = ti.i32
            self.latest = fields.integers(model.n)  # the first of these
        if model.spins:
            columns["arm"] = fields.real  # of each radius: balls that overlap touch nearer to their centres
        self.row = fields.table(columns, self.capacity)
        self.most = loops.FULL
        self.bytes_each = (fields.bytes - before) / self.capacity
        self.first, self.number, self.touching = (fields.integers(model.n) for _ in range(3))
        if plan.warm_starts:
            self.old_first, self.old_touching = fields.integers(model.n), fields.integers(model.n)
        kinds = np.unique(scene.material)
        self.only_law = int(kinds[0]) * (model.surfaces + 1) if len(kinds) == 1 else -1  # of balls of one material
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

    def forget(self) -> None:
        """Nothing is held from before, once the next search asks what was."""
        self.touching.fill(0)

    @ti.func
    def detect(self, ball: ti.template()):
        """List all pairs within reach, where the last list no longer holds; the grid is built already."""
        loops.search(self)

    @ti.func
    def survey(self, ball: ti.template(), i):
        """Tally of the pairs that ball i lists and that touch, give or take rounding; see kernels.contacts.statistics."""
        total = statistics.nothing()
        begin = self.first[i]
        for e in range(begin, begin + self.number[i]):
            j = self.link[e].other
            one, two = self.model.radius[i], self.model.radius[j]
            n, d = unit(ball[j].x - ball[i].x, i, j)
            if d < (1.0 + TOUCH) * (one + two):
                u = (ball[j].v - ball[i].v).dot(n)
                held = False
                if ti.static(self.warm):
                    held = self.link[e].impulse > 0.0
                total = statistics.join(total, statistics.one(ti.max(0.0, one + two - d), ti.min(one, two), u, held, i))
        return total
