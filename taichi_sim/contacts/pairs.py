"""Pairs: contacts between balls, found through the grid and kept, each once, in lists for all iterations of a step."""

from typing import Any

import numpy as np

from taichi_sim.contacts.grid import Grid
from taichi_sim.contacts.plan import ContactPlan
from taichi_sim.device.engine import on_device, ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import pairs as loops
from taichi_sim.kernels.contacts import parallel_search, statistics
from taichi_sim.kernels.contacts.contact_law import TOUCH_TOLERANCE
from taichi_sim.kernels.contacts.pair_lists import pair_entry
from taichi_sim.kernels.vectors import unit

__all__ = ["Pairs"]

POOL_LINKS = 1 << 19  # links for what a block cannot hold; a thousand coincident balls fit
LINKS_PER_BALL = {2: 4, 3: 6}  # equal balls touch at most 6 others in 2D, 12 in 3D; each pair is listed once
OWN_LINKS = {2: 8, 3: 14}  # of each ball where both list a pair; the last one is for any that do not fit
# of the radii: soft contacts hold balls that nearly touch, lest those that rest on each other part and meet again
LISTED_GAP = 0.02


@ti.data_oriented
class Pairs:
    """Ball-ball contacts: each ball lists the later balls near it, or all where the plan gathers, those that touch it first.
    `link` holds what a contact keeps from step to step, `contact` what only one step needs.
    capacity: links that are known to be needed."""

    what = "pairs of balls within reach of each other"
    names = ("grid", "pairs")

    def __init__(self, model: Model, fields: Fields, grid: Grid, plan: ContactPlan, capacity: int = 0) -> None:
        scene = model.scene
        self.model, self.grid, self.plan = model, grid, plan
        self.gap = LISTED_GAP if plan.soft else 0.0
        self.interleaved = plan.gathers and on_device()  # lists and members, see kernels.contacts.pair_lists
        balls = 1 if plan.gathers else loops.LIST_BLOCK  # of a block
        self.block_capacity = OWN_LINKS[model.dim] if plan.gathers else balls * LINKS_PER_BALL[model.dim]
        self.pool_start = -(-model.n // balls) * self.block_capacity
        self.capacity = max(capacity, self.pool_start + max(model.n // 2, min(model.n**2, POOL_LINKS)))
        before = fields.bytes
        # links of the pool: in use, and how many would have been needed
        self.used, self.overflow = fields.integers(1), fields.integers(1)
        # longest_reach: places between balls of a pair, at most; block_length: of a block, see kernels.contacts.pair_sweeps
        self.longest_reach, self.block_length, self.blocks = fields.integers(1), fields.integers(1), fields.integers(1)
        self.single_precision = fields.real == ti.f32
        self.has_rebounds = model.has_restitution and not plan.impacts_in_turn
        self.has_target = self.has_rebounds or (plan.soft and not plan.impacts_in_turn)
        vector = ti.types.vector(model.dim, fields.real)
        # other: the ball that does not list it
        columns = {"other": ti.i32, **fields.impulses(model.dim, model.has_friction)}
        if plan.soft:
            columns["bias_velocity"] = fields.real  # m/s, with which overlap is pushed out, or RIGID
        if self.has_rebounds:
            columns["rebound_speed"] = fields.real  # m/s, 0 if it did not bounce
        if plan.keeps_loads:
            columns["load"] = fields.real  # N s, the part of the impulse that is no impact's, as far as it is known
        self.link = fields.table(columns, self.capacity, by_column=self.interleaved)
        # normal: from the ball that lists it; depth: overlap [m], negative where they are apart; mass [kg] of a lone contact
        columns = {"normal": vector, "depth": fields.real, "mass": fields.real}
        if self.has_target:
            columns["target"] = fields.real  # m/s, normal speed to come to
        if self.has_rebounds:
            columns["rebound_speed"] = fields.real  # m/s, of the link before lists were made anew
        if plan.keeps_loads or (plan.impacts_in_turn and plan.warm_starts):
            # N s, before the solve; or the load of the link before lists were made anew
            columns["starting_impulse"] = fields.real
        if plan.line_search:
            columns["previous_impulse"] = fields.real  # N s, before the last iteration
        if plan.impacts_in_turn:
            # lister: the ball that lists it; next_from_others: the next contact with the same other ball, or NO_CONTACT
            columns["lister"] = columns["next_from_others"] = ti.i32
            self.first_from_others = fields.integers(model.n)  # contact in which others list it, or NO_CONTACT
        if plan.bounces:
            columns["passed"] = fields.real  # s, since the touch of what parts again after less than a step, or 0
        if model.spins:
            columns["arm"] = fields.real  # of each radius: balls that overlap touch nearer to their centres
        self.contact = fields.table(columns, self.capacity, by_column=self.interleaved)
        self.most = loops.COUNT_LIMIT
        self.bytes_each = (fields.bytes - before) / self.capacity
        # of the list of each ball: first link, number of links, of these that touch
        self.first, self.number, self.touching = (fields.integers(model.n) for _ in range(3))
        if plan.warm_starts:  # as they were before the last search
            self.old_first, self.old_held = fields.integers(model.n), fields.integers(model.n)
        kinds = np.unique(scene.material)
        self.only_law = int(kinds[0]) * (model.surfaces + 1) if len(kinds) == 1 else -1  # of balls of one material
        self.has_bodies = bool(np.any(scene.body > 0))
        if self.has_bodies:
            self.body = fields.integers(scene.body)  # of each ball, 0: none
        start, other = model.joined()
        self.has_joined = len(other) > 0
        if self.has_joined:
            self.joined_start, self.joined_other = fields.integers(start), fields.integers(other)

    def kept(self) -> list[tuple[Any, Any]]:
        """Members of `link`, and those of `contact` that hold them while lists are made anew."""
        own, place = self.link, self.contact
        members = [(own.impulse, place.depth)]
        if self.plan.soft:
            members.append((own.bias_velocity, place.target if self.has_target else place.starting_impulse))
        if self.plan.keeps_loads:
            members.append((own.load, place.starting_impulse))
        if self.has_rebounds:
            members.append((own.rebound_speed, place.rebound_speed))
        return members

    def forget(self) -> None:
        """Clear what contacts have accumulated, from the next search on."""
        self.touching.fill(0)

    @ti.func
    def detect(self, ball: ti.template()):
        """List all pairs within reach, where the last list no longer holds; the grid is built already."""
        if ti.static(self.plan.gathers):
            parallel_search.search(self)
        else:
            loops.search(self)

    @ti.func
    def lift(self, ball: ti.template(), i):
        """Energy [J] that gravity gains where the upper ball of each pair that ball i lists is pushed out of the lower one."""
        total = 0.0 * self.model.radius[i]
        for t in range(self.touching[i]):
            e = pair_entry(self, self.first[i], t)
            j = self.link[e].other
            rise = -self.contact[e].depth * self.contact[e].normal.dot(self.model.gravity[0])
            w = self.model.inverse_mass[ti.select(rise > 0.0, j, i)]
            once = True
            if ti.static(self.plan.gathers):
                once = i < j
            if once and w > 0.0 and self.contact[e].depth > 0.0:
                total += ti.abs(rise) / w
        return total

    @ti.func
    def statistics(self, ball: ti.template(), solver: ti.template(), i):
        """Statistics of the pairs that ball i lists and that touch, give or take rounding."""
        total = statistics.nothing()
        for t in range(self.number[i]):
            e = pair_entry(self, self.first[i], t)
            j = self.link[e].other
            one, two = self.model.radius[i], self.model.radius[j]
            n, d = unit(ball[j].x - ball[i].x, i, j)
            once = True
            if ti.static(self.plan.gathers):
                once = i < j
            if once and d < (1.0 + TOUCH_TOLERANCE) * (one + two):
                u = (ball[j].v - ball[i].v).dot(n)
                presses = False
                if ti.static(self.plan.warm_starts):
                    presses = self.link[e].impulse > 0.0
                depth = ti.max(0.0, one + two - d)
                if ti.static(not self.plan.impacts_in_turn):  # then even what only just arrived may hold an impulse
                    presses = presses and statistics.is_old(depth, u, solver.rate[0])
                total = statistics.join(total, statistics.one(depth, ti.min(one, two), u, presses, i))
        return total
