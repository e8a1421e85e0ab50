"""FoundContacts: which contacts there are, found anew after each move, and what accumulates in them."""

from typing import Any, NamedTuple

import numpy as np

from taichi_sim.contacts.pairs import Pairs
from taichi_sim.contacts.plan import ContactPlan, carried_part
from taichi_sim.contacts.sticks import Sticks
from taichi_sim.contacts.triangles import TriangleContacts
from taichi_sim.contacts.walls import Walls
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.parts import BOTH, PRIME, STEP, Part, run_parts
from taichi_sim.device.state import State
from taichi_sim.kernels.contacts import (
    ccd_balls,
    ccd_triangles,
    contact_incidence,
    contact_law,
    pair_measures,
    pair_sweeps,
    parallel_search,
    warm_start,
)
from taichi_sim.kernels.reductions import groups_of, parts_of
from taichi_sim.kernels.vectors import zero_scalar_in_2d

__all__ = ["ContactParts", "FoundContacts"]

STICK_CROSSING = 0.5  # of the smallest radius: what moves further may cross a stick


class ContactParts(NamedTuple):
    """The kinds of contact of a scene, None where it lacks one."""

    walls: Walls | None = None
    pairs: Pairs | None = None
    sticks: Sticks | None = None
    triangles: TriangleContacts | None = None


@ti.data_oriented
class FoundContacts:
    """The parts of a plan, and the fields in which kernels find contacts and solve them: their `solver`.

    Class attributes: `in_turn`: each pair sees what those before it changed, which needs a fixed order; `split`: each ball splits
    its mass between its contacts, see kernels.contacts.contact_law.share; `sums_plainly`: none does; `warm_starts`, `softens`,
    `impacts_in_turn`, `energy_limiter`, `gathers`: what of these in ContactPlan the rule can do; `pushes_out`: overlap of pairs
    is undone when balls move, as it must not be where the rule pushes by the overlap, as a spring.
    """

    struck: Any  # where the plan throws back, see kernels.contacts.struck_pairs
    name = "off"
    in_turn = False
    split = False
    sums_plainly = False
    warm_starts = False
    softens = False
    impacts_in_turn = False
    energy_limiter = False
    gathers = False
    pushes_out = True
    relaxation = 1.0  # part of an impulse from split masses that is applied

    def bind(
        self,
        plan: ContactPlan,
        model: Model,
        state: State,
        fields: Fields,
        parts: ContactParts,
        threshold: Any,
        h: float,
    ) -> None:
        """Take the parts of a simulation with substeps of h seconds. Called once, before the fields exist."""
        self.plan, self.model, self.state, self.n = plan, model, state, model.n
        self.walls, self.pairs, self.sticks, self.triangles = parts
        self.grid_parts = [part for part in (self.pairs, self.sticks) if part is not None and plan.neighbours]
        self.sticks_and_triangles = [part for part in (self.sticks, self.triangles) if part is not None]
        self.parts = [part for part in parts if part is not None]
        tables = ((self.pairs, "link"), (self.sticks, "contact"), (self.walls, "contact"))
        self.accumulated = [getattr(part, name) for part, name in tables if part is not None]
        # threshold: (1) m/s, approach speed below which nothing bounces
        self.threshold, self.active, self.iterations = threshold, plan.active, plan.iterations
        # by the directions of contacts, not only their number; friction pushes sideways as well
        self.splits_by_direction = plan.active and self.split and not model.has_friction
        joint = plan.sticks or plan.triangles
        self.shares_mass = plan.active and (joint or not self.in_turn)  # impulses from old velocities
        self.pushes_out_pairs = self.pushes_out and plan.neighbours and not plan.soft
        self.corrects_positions = plan.active and (self.pushes_out_pairs or joint or plan.walls)
        self.counts_pairs = self.split or plan.walls_in_turn  # the pairs that touch each ball, whoever lists them
        if plan.active:
            self.rate = fields.reals(np.array([1.0 / h]))  # 1/s
            self.velocity_before = fields.vectors(self.n, model.dim)  # m/s, before the solve
            self._allocate_shared(fields)
            self._allocate_velocities(fields)
            self.allocate(fields)
        self.search_parts = tuple(self.finding())

    def _allocate_shared(self, fields: Fields) -> None:
        n, dim, plan = self.n, self.model.dim, self.plan
        if plan.neighbours:  # see ccd_balls
            # m, of the move just made; one memory: neither lasts from the move to the solve
            self.displacement = self.velocity_before
            # moved_fast: 1, something did; balls, sticks: how many to look at; shortened: 1, a way was in the last round;
            # moved, passes: 1, something did so far, or has, that pairs may have passed each other, see touch_times
            names = ("moved_fast", "balls", "sticks", "shortened", "moved", "passes")
            self.swept = fields.table(dict.fromkeys(names, ti.i32), 1)
            self.longest_displacement = fields.reals(1)  # m, of what moved fast
            # parts of the move that are made: so far, and after this round
            self.time_of_impact, self.next_time_of_impact = fields.reals(n), fields.reals(n)
        if plan.sticks:
            smallest = float(np.min(self.model.scene.radius))
            self.crossing_squared = fields.reals(np.array([(STICK_CROSSING * smallest) ** 2]))  # m^2
        if self.corrects_positions:
            self.position_correction = fields.vectors(n, dim)  # m
        if plan.limits_energy:
            self.energy_type = fields.wide
            self.energy_parts = parts_of(n)
            # [J] of each part, then of their groups: lost by what has stopped; linear, square: terms of the changes since
            columns = dict.fromkeys(("lost", "linear", "square"), self.energy_type)
            self.energy = fields.table(columns, self.energy_parts + groups_of(self.energy_parts))
            self.energy_scaling = fields.doubles(1)  # part of the changes that is taken back, negative
            self.stopped_velocity = fields.vectors(n, dim)  # m/s, where all that touched has stopped
            if self.model.spins:
                # [m/s] before the solve, and where all that touched has stopped
                self.spin_before, self.stopped_spin = (fields.spins(n, dim) for _ in range(2))
        if self.shares_mass:
            self.effective_inverse_mass = fields.reals(n)  # 1/kg, of the part that each contact gets
        if self.counts_pairs:
            self.pair_count = fields.integers(n)  # pairs that touch each ball
        if self.splits_by_direction:
            self.normal_tensor = fields.matrices(n, dim)  # sum of n n^T over the pairs of each ball
        if plan.keeps_loads:
            self.carried_part = fields.reals(np.array([carried_part(self.model.scene)]))
        if plan.warm_starts and plan.pairs:
            self.warm_velocity = fields.vectors(n, dim)  # m/s, by the impulses with which pairs start
            if self.model.spins:
                self.warm_spin = fields.spins(n, dim)  # m/s, likewise

    def _allocate_velocities(self, fields: Fields) -> None:
        n, dim, plan = self.n, self.model.dim, self.plan
        if plan.loaded:
            # m/s, when contacts were found, or, without impacts in turn, when forces began to act
            self.velocity_when_found = fields.vectors(n, dim)
            self.from_forces = fields.table({"v": ti.types.vector(dim, fields.real)}, n)  # m/s, what they added since
        if plan.impacts_in_turn or plan.loaded:
            self.impacts = fields.integers(
                n
            )  # on a ball in this step; without impacts in turn 1: off others, in this solve

    def allocate(self, fields: Fields) -> None:
        """Declare fields of the rule's own."""

    def names(self) -> list[str]:
        """Names of the parts that are compiled in, for `Simulation.kernels()`."""
        return [f"contacts.{self.name}", *(name for part in self.parts for name in part.names)] if self.active else []

    def forget(self) -> None:
        """Start from nothing: balls were put elsewhere, where the load is another one. `prime` has to follow."""
        for part in self.grid_parts:
            part.forget()
        if self.walls is not None:
            self.walls.contact.impulse.fill(0)
            if self.model.has_friction:
                self.walls.contact.tangential_impulse.fill(0)

    def set_step(self, h: float, ratio: float) -> None:
        """Take substeps of h seconds, `ratio` times what they were: contacts that rest accumulate as much less or more."""
        if self.active:
            self.rate[0] = 1.0 / h
            self._scale(ratio)

    @ti.kernel
    def _scale(self, ratio: float):
        for table in ti.static(self.accumulated):
            warm_start.scale(table, ratio)

    @ti.func
    def clear(self, i):
        """Clear what the rule itself keeps of ball i, before pairs are measured."""

    @ti.func
    def found(self, ball: ti.template(), role: ti.template()):
        """All contacts are measured at the present positions."""

    @ti.func
    def _clear(self, i):
        """Clear the sums of what pairs do to ball i."""
        self.clear(i)
        if ti.static(self.counts_pairs):
            self.pair_count[i] = 0
        if ti.static(self.splits_by_direction):
            self.normal_tensor[i] = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        if ti.static(self.plan.warm_starts):
            self.warm_velocity[i] = ti.Vector.zero(float, self.model.dim)
            if ti.static(self.model.spins):
                self.warm_spin[i] = zero_scalar_in_2d(self.model.dim)

    def finding(self) -> list[Part]:
        """The parts that find contacts: after a move, once ways are cut short that lead through something; or, after positions
        were set from outside, whatever was known."""
        if not self.active:
            return []
        surfaces = self.plan.triangles
        tears = surfaces and self.triangles is not None and self.triangles.tears
        names = [("_expire", PRIME), ("_shorten_ways", BOTH), *([("_limit_ways", STEP)] if surfaces else [])]
        names += [("_begin", BOTH), *([("_tear", STEP)] if tears else []), ("_detect", BOTH), ("_measure", BOTH)]
        return [Part(self, name, roles) for name, roles in names]

    @ti.func
    def prime(self, ball: ti.template()):
        """Find the contacts after positions were set from outside."""
        run_parts(self.search_parts, PRIME, 0.0, 0.0)

    @ti.func
    def refresh(self, ball: ti.template()):
        """Cut ways short that lead through something, after a move, then find the contacts at the present positions."""
        run_parts(self.search_parts, STEP, 0.0, 0.0)

    @ti.func
    def _expire(self, role: ti.template(), h, time):
        if ti.static(self.plan.colliders):
            self.walls.colliders.rewind()
        if ti.static(self.plan.pairs):
            self.pairs.grid.expire()
        if ti.static(self.plan.triangles):
            ccd_triangles.expire(self.triangles)

    @ti.func
    def _shorten_ways(self, role: ti.template(), h, time):
        if ti.static(self.plan.colliders):
            self.walls.colliders.advance()
        if ti.static(self.plan.neighbours):
            ccd_balls.shorten_ways(self, self.state.ball)

    @ti.func
    def _limit_ways(self, role: ti.template(), h, time):
        ccd_triangles.limit(self.triangles, self, self.state.ball)
        if ti.static(self.plan.neighbours):
            for i in range(self.n):
                ccd_triangles.cut_short(self.triangles, self, self.state.ball, i)

    @ti.func
    def _begin(self, role: ti.template(), h, time):
        if ti.static(self.plan.neighbours):
            self.pairs.grid.build(self.state.ball)
        if ti.static(self.plan.triangles):
            ccd_triangles.decide(self.triangles, self, self.state.ball)
            for i in range(self.n):
                if ti.static(not self.plan.neighbours):
                    if role == STEP:
                        ccd_triangles.cut_short(self.triangles, self, self.state.ball, i)
                    self.pairs.grid.origin[i] = self.state.ball[i].x
                ccd_triangles.begin(self.triangles, self, self.state.ball, i)

    @ti.func
    def _tear(self, role: ti.template(), h, time):  # what tears here collides no more from here on
        self.triangles.tearing.cut_overstretched(self.state.ball)

    @ti.func
    def _detect(self, role: ti.template(), h, time):
        for part in ti.static(self.grid_parts):
            part.detect(self.state.ball)
        if ti.static(self.plan.triangles):
            ccd_triangles.detect(self.triangles, self, self.state.ball)

    @ti.func
    def _measure(self, role: ti.template(), h, time):
        ball = ti.static(self.state.ball)
        if ti.static(self.plan.gathers):
            for i in range(self.n):
                parallel_search.end(self.pairs.grid, i)
                for part in ti.static(self.sticks_and_triangles):
                    contact_incidence.sort_entries(part, i)
                self._clear(i)
                if ti.static(self.plan.neighbours):
                    pair_measures.measure(self, self.pairs, ball, i)
                self._measure_walls(ball, i)
                if ti.static(self.shares_mass):
                    self._share_mass(i)
        else:
            if ti.static(self.plan.pairs):
                if ti.static(self.plan.warm_starts or self.counts_pairs or self.plan.impacts_in_turn):
                    for i in range(self.n):
                        self._clear(i)
                if ti.static(self.plan.neighbours):
                    pair_sweeps.each_block(self, ball, pair_measures.measure_block, 0.0, None)
            if ti.static(self.plan.walls):
                for i in range(self.n):
                    self._measure_walls(ball, i)
        self.found(ball, role)
        if ti.static(self.plan.loaded):
            for i in range(self.n):
                self.velocity_when_found[i] = ball[i].v
        if ti.static(self.shares_mass and not self.plan.gathers):
            for i in range(self.n):
                self._share_mass(i)

    @ti.func
    def _measure_walls(self, ball: ti.template(), i):
        if ti.static(self.plan.walls):
            crowded = False
            if ti.static(self.plan.walls_in_turn):
                crowded = self.pair_count[i] > 0
            self.walls.measure(ball, self, i, crowded)

    @ti.func
    def _share_mass(self, i):
        """Split the mass of ball i, by the sums of n n^T and of 1 over all that is accumulated from old velocities: in turn those
        are only sticks and triangles, whose weights count."""
        T, count = ti.Matrix.zero(float, self.model.dim, self.model.dim), 0.0 * self.model.inverse_mass[i]
        if ti.static(self.plan.pairs and self.split):
            count = self.pair_count[i]
            if ti.static(self.splits_by_direction):
                T = self.normal_tensor[i]
        if ti.static(self.plan.walls and self.split):
            t, _ = self.walls.sum_of_solved(i)
            T += t
            count += self.walls.touching[i]
        if ti.static(not self.sums_plainly):
            for part in ti.static(self.sticks_and_triangles):
                t, c = part.shares(i)
                T += t
                count += c
        share = contact_law.share(T, count, not self.model.has_friction)
        self.effective_inverse_mass[i] = share * self.model.inverse_mass[i]
        if ti.static(self.plan.triangles):
            self.triangles.share_mass(T, count, i)
