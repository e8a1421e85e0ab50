"""ContactRule: what all ways to solve contacts share: finding them, what they start from, moving balls, undoing overlap."""

from typing import Any, NamedTuple

import numpy as np

from taichi_sim.contacts.pairs import Pairs
from taichi_sim.contacts.plan import ContactPlan
from taichi_sim.contacts.sticks import Sticks
from taichi_sim.contacts.triangles import TriangleContacts
from taichi_sim.contacts.walls import Walls
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.kernels import reductions
from taichi_sim.kernels.contacts import (
    ccd_balls,
    ccd_triangles,
    contact_law,
    mass_sharing,
    pair_measures,
    pair_solve,
    pair_sweeps,
    warm_start,
)
from taichi_sim.kernels.vectors import zero_scalar_in_2d

__all__ = ["ContactParts", "ContactRule"]

STICK_CROSSING = 0.5  # of the smallest radius: what moves further may cross a stick


class ContactParts(NamedTuple):
    """The kinds of contact of a scene, None where it lacks one."""

    walls: Walls | None = None
    pairs: Pairs | None = None
    sticks: Sticks | None = None
    triangles: TriangleContacts | None = None


@ti.data_oriented
class ContactRule:
    """One way to solve the contacts of a scene; this one, "off", solves none.

    A rule of your own is a subclass with a `solve`, and is passed as an object, `Simulation(scene, contacts=Inelastic())`. Pair c
    of balls i and j has `self.pairs.contact[c]`, with `normal` from i to j, `depth` [m], negative where they are still apart, and
    `mass` [kg], 1 / (1 / m_i + 1 / m_j). Fast impacts on walls and overlap are taken care of when balls move. The shortest:

        @ti.data_oriented
        class Inelastic(ts.ContactRule):
            name = "inelastic"
            in_turn = True

            @ti.func
            def solve(self, ball, time, iterations: ti.template(), impacts: ti.template()):
                self.each_pair(ball, self.stop_pair)

            @ti.func
            def stop_pair(self, ball, i, j, c):
                pair = self.pairs.contact[c]
                closing = ti.min(0.0, (ball[j].v - ball[i].v).dot(pair.normal))
                if pair.depth > 0.0:
                    self.exchange(i, j, pair.mass * closing * pair.normal)

    with `ti` from `taichi_sim.device.engine`. A scene without pairs has no `self.pairs` (`self.plan.pairs` is False). For what
    rests on walls, sticks and triangles, call `self.begin(ball, impacts)` before the first iteration, and
    `self.solve_sticks_and_triangles(ball, time)` and `self.solve_walls(ball, time)` in each.

    Class attributes: `in_turn`: each pair sees what those before it changed, which needs a fixed order; `split`: each ball splits
    its mass between its contacts, see kernels.contacts.contact_law.share; `sums_plainly`: none does; `warm_starts`, `softens`,
    `impacts_in_turn`, `energy_limiter`: what of these in ContactPlan the rule can do.

    Fields: those of kernels.contacts.interfaces.Solver. `rate` (1) [1/s]: 1 / h.
    """

    name = "off"
    in_turn = False
    split = False
    sums_plainly = False
    warm_starts = False
    softens = False
    impacts_in_turn = False
    energy_limiter = False
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
        if plan.active and type(self).solve is ContactRule.solve:
            raise TypeError(f"contacts: {type(self).__name__} has no solve(self, ball, time, iterations, impacts)")
        self.plan, self.model, self.state, self.n = plan, model, state, model.n
        self.walls, self.pairs, self.sticks, self.triangles = parts
        self.grid_parts = [part for part in (self.pairs, self.sticks) if part is not None]
        self.sticks_and_triangles = [part for part in (self.sticks, self.triangles) if part is not None]
        self.parts = [part for part in parts if part is not None]
        self.threshold, self.active, self.iterations = threshold, plan.active, plan.iterations
        # by the directions of contacts, not only their number; friction pushes sideways as well
        self.splits_by_direction = plan.active and self.split and not model.has_friction
        joint = plan.sticks or plan.triangles
        self.shares_mass = plan.active and (joint or not self.in_turn)  # impulses from old velocities
        self.corrects_positions = plan.active and (not plan.soft or joint or plan.walls)
        self.counts_pairs = self.split or plan.walls_in_turn  # the pairs that touch each ball, whoever lists them
        if plan.active:
            self.rate = fields.reals(np.array([1.0 / h]))
            self.velocity_before = fields.vectors(self.n, model.dim)
            self._allocate_shared(fields)
            self.allocate(fields)

    def _allocate_shared(self, fields: Fields) -> None:
        n, dim, plan = self.n, self.model.dim, self.plan
        if plan.pairs:  # see ccd_balls
            self.displacement = self.velocity_before  # one memory: neither lasts from the move to the solve
            self.swept = fields.table(dict.fromkeys(("moved_fast", "balls", "sticks", "shortened"), ti.i32), 1)
            self.longest_displacement = fields.reals(1)
            self.time_of_impact, self.next_time_of_impact = fields.reals(n), fields.reals(n)
        if plan.sticks:
            smallest = float(np.min(self.model.scene.radius))
            self.crossing_squared = fields.reals(np.array([(STICK_CROSSING * smallest) ** 2]))
        if self.corrects_positions:
            self.position_correction = fields.vectors(n, dim)
        if plan.limits_energy:
            self.energy_type = ti.f64 if fields.has_doubles else fields.real
            self.energy_parts = -(-n // reductions.PART)
            columns = dict.fromkeys(("lost", "linear", "square"), self.energy_type)
            self.energy = fields.table(columns, self.energy_parts + 1)
            self.stopped_velocity = fields.vectors(n, dim)  # where all that touched has stopped
            if self.model.spins:
                self.spin_before, self.stopped_spin = (fields.spins(n, dim) for _ in range(2))
        if self.shares_mass:
            self.effective_inverse_mass = fields.reals(n)
        if self.counts_pairs:
            self.pair_count = fields.integers(n)
        if plan.warm_starts and plan.pairs:
            self.warm_velocity = fields.vectors(n, dim)
            if self.model.spins:
                self.warm_spin = fields.spins(n, dim)

    def allocate(self, fields: Fields) -> None:
        """Declare fields of the rule's own."""

    def names(self) -> list[str]:
        """What is compiled in, for `Simulation.kernels()`."""
        return [f"contacts.{self.name}", *(name for part in self.parts for name in part.names())] if self.active else []

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
        if ti.static(self.plan.pairs):
            warm_start.scale(self.pairs.link, self.pairs.capacity, ratio, self.model.has_friction)
        if ti.static(self.plan.sticks):
            warm_start.scale(self.sticks.contact, self.sticks.capacity, ratio, self.model.has_friction)
        if ti.static(self.plan.walls):
            warm_start.scale(self.walls.contact, self.n * self.walls.count, ratio, self.model.has_friction)

    # To be overridden

    @ti.func
    def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
        """Change velocities so that nothing approaches; friction acts for `time` seconds. Without `impacts` only slow contacts
        are solved, so that velocities reported at the end of a step are at rest where balls rest."""

    @ti.func
    def relax(self, ball: ti.template(), time):
        """After a move that ends a step: take back what pushing out overlap added to velocities."""

    @ti.func
    def clear(self, i):
        """Before pairs are measured: nothing of the rule's own is known of ball i yet."""

    @ti.func
    def found(self, ball: ti.template()):
        """All contacts are measured at the present positions."""

    # Finding contacts

    @ti.func
    def _clear(self, i):
        """Nothing is summed yet of what pairs do to ball i."""
        self.clear(i)
        if ti.static(self.counts_pairs):
            self.pair_count[i] = 0
        if ti.static(self.plan.warm_starts):
            self.warm_velocity[i] = ti.Vector.zero(float, self.model.dim)
            if ti.static(self.model.spins):
                self.warm_spin[i] = zero_scalar_in_2d(self.model.dim)

    @ti.func
    def prime(self, ball: ti.template()):
        """Find the contacts after positions were set from outside."""
        if ti.static(self.plan.colliders):
            self.walls.colliders.rewind()
        if ti.static(self.plan.pairs):
            self.pairs.grid.expire()
        self._find(ball, False)

    @ti.func
    def refresh(self, ball: ti.template()):
        """After a move: cut ways short that lead through something, then find the contacts at the present positions."""
        self._find(ball, True)

    @ti.func
    def _find(self, ball: ti.template(), moved: ti.template()):
        if ti.static(self.plan.colliders):
            self.walls.colliders.advance()
        if ti.static(self.plan.pairs):
            ccd_balls.shorten_ways(self, ball)
            if ti.static(self.plan.triangles and moved):
                ccd_triangles.limit(self.triangles, self, ball)
            self.pairs.grid.build(ball)
        for part in ti.static(self.grid_parts):
            part.detect(ball)
        if ti.static(self.plan.triangles):
            ccd_triangles.detect(self.triangles, self, ball)
        if ti.static(self.plan.pairs):
            if ti.static(self.plan.warm_starts or self.counts_pairs or self.plan.impacts_in_turn):
                for i in range(self.n):
                    self._clear(i)
            pair_sweeps.each_block(self, ball, pair_measures.measure_block, 0.0, None)
        if ti.static(self.plan.walls):
            for i in range(self.n):
                crowded = False
                if ti.static(self.walls.crowds):
                    crowded = self.pair_count[i] > 0
                self.walls.measure(ball, self, i, crowded)
        self.found(ball)
        if ti.static(self.shares_mass):
            for i in range(self.n):
                T, count = mass_sharing.shares(self, ball, i)
                share = contact_law.share(T, count, not self.model.has_friction)
                self.effective_inverse_mass[i] = share * self.model.inverse_mass[i]
                if ti.static(self.plan.triangles):
                    self.triangles.share_mass(T, count, i)

    # Pieces of a solve

    @ti.func
    def begin(self, ball: ti.template(), impacts: ti.template()):
        """Note the velocities that target speeds depend on, and start from what contacts have accumulated."""
        for part in ti.static(self.sticks_and_triangles):
            part.begin_contacts(ball, self, impacts)
        for i in range(self.n):
            self.velocity_before[i] = ball[i].v
            if ti.static(self.plan.limits_energy and self.model.spins):
                self.spin_before[i] = self.state.spin[i]
            if ti.static(self.plan.walls):
                self.walls.begin(ball, self, i, impacts, True)
            if ti.static(self.plan.sticks and self.plan.warm_starts):
                p, t = self.sticks.gather(ball, self, i)
                self.apply(i, p, t)
            if ti.static(self.plan.pairs and self.plan.warm_starts):
                self.state.kick(i, self.warm_velocity[i])
                if ti.static(self.model.spins):
                    self.state.spin[i] = self.state.spin[i] + self.warm_spin[i]
                if ti.static(not impacts):
                    self.take_out_pairs(ball, i)

    # A solve whose iteration takes back (LAST, RELAX) leaves other impulses in the pairs, but moves nothing: the next solve,
    # which starts from them, needs no measuring if `warm_velocity` follows. Meanwhile it is the velocity without their part.

    @ti.func
    def take_out_pairs(self, ball: ti.template(), i):
        """Before that iteration: what the velocity of ball i would be without the impulses of its pairs."""
        if ti.static(self.plan.warm_starts):
            self.warm_velocity[i] = ball[i].v - self.warm_velocity[i]
            if ti.static(self.model.spins):
                self.warm_spin[i] = self.state.spin[i] - self.warm_spin[i]

    @ti.func
    def put_back_pairs(self, ball: ti.template(), i):
        """After it: what pairs do to the velocity of ball i now."""
        self.warm_velocity[i] = ball[i].v - self.warm_velocity[i]
        if ti.static(self.model.spins):
            self.warm_spin[i] = self.state.spin[i] - self.warm_spin[i]

    @ti.func
    def gather_sticks_and_triangles(self, ball: ti.template(), i):
        """Impulse and angular impulse on ball i from all sticks and triangles."""
        p, t = ti.Vector.zero(float, self.model.dim), zero_scalar_in_2d(self.model.dim)
        for part in ti.static(self.sticks_and_triangles):
            push, angular = part.gather(ball, self, i)
            p += push
            t += angular
        return p, t

    @ti.func
    def solve_sticks_and_triangles(self, ball: ti.template(), time):
        """One iteration over sticks and triangles, always from old velocities."""
        if ti.static(self.plan.sticks or self.plan.triangles):
            for part in ti.static(self.sticks_and_triangles):
                part.solve_contacts(ball, self, time)
            for i in range(self.n):
                p, t = self.gather_sticks_and_triangles(ball, i)
                self.apply(i, p, t)

    @ti.func
    def solve_walls(self, ball: ti.template(), time):
        """One iteration over the walls and colliders on which balls rest, or in which they are."""
        if ti.static(self.plan.walls):
            for i in range(self.n):
                p, t = self.walls.gather(ball, self, i, time)
                self.apply(i, p, t)

    @ti.func
    def each_pair(self, ball: ti.template(), visit: ti.template()):
        """visit(ball, i, j, c) for each pair that touches or nearly does, in a fixed order but with contacts by atomics."""
        if ti.static(self.plan.pairs):
            pair_sweeps.each_block(self, ball, pair_sweeps.own_pairs, 0.0, visit)

    @ti.func
    def exchange(self, i, j, p):
        """Impulse p [N s] on ball i and -p on ball j."""
        self.state.kick(i, self.model.inverse_mass[i] * p)
        self.state.kick(j, -self.model.inverse_mass[j] * p)

    @ti.func
    def apply(self, i, p, t):
        """Impulse p [N s] on ball i, and angular impulse t in units of its radius."""
        w = self.model.inverse_mass[i]
        self.state.kick(i, w * p)
        if ti.static(self.model.spins):
            self.state.spin[i] = self.state.spin[i] + (self.model.spin_response(i) * w) * t

    # Moving

    @ti.func
    def advance(self, ball: ti.template(), motion: ti.template(), h, time):
        """Kick all balls, solve their contacts, with friction for `time` seconds, and move them for h seconds. motion: the
        integrator, asked for its kicks and what forces do meanwhile."""
        if ti.static(self.active):
            if ti.static(motion.kicks_first):
                for i in range(self.n):
                    motion.before_move(i, h)
            self.solve(ball, time, self.iterations, True)
        self.move(ball, motion, h)

    @ti.func
    def move(self, ball: ti.template(), motion: ti.template(), h):
        """Move all balls for h seconds with their present velocities, then find the contacts where they are. Without contacts
        the kick before the move needs no loop of its own."""
        self._correct_positions(ball, h)
        for i in range(self.n):
            if ti.static(motion.kicks_first and not self.active):
                motion.before_move(i, h)
            shift, drift = self._way(ball, i, ball[i].v, motion.acceleration(i, h), h, motion.load(i, h))
            self.state.shift(i, shift)
            ball[i].v = drift
            motion.after_move(i, h)
        self.refresh(ball)

    @ti.func
    def _way(self, ball: ti.template(), i, v, a, h, change):
        """Displacement of ball i over h, and its drift velocity v (mid-step, acceleration a) after impacts on walls. change:
        of v by forces in this step, where `a` does not say it."""
        shift = h * v
        drift = v
        if ti.static(self.plan.walls):
            if self.model.inverse_mass[i] > 0.0:  # nothing stops a driven pin
                shift, drift = self.walls.move(i, ball[i].x, v, a, h, change)
        if ti.static(self.plan.pairs):
            ccd_balls.note_displacement(self, i, shift)  # what only undoes overlap goes through nothing
        if ti.static(self.corrects_positions):
            shift += self.position_correction[i]
        if ti.static(self.plan.pairs):
            self.pairs.grid.watch(i, ball[i].x + shift)
        return shift, drift

    @ti.func
    def _correct_positions(self, ball: ti.template(), h):
        """The displacements that undo overlap where contacts are rigid. Velocities never see them."""
        if ti.static(self.corrects_positions):
            for i in range(self.n):
                d = ti.Vector.zero(float, self.model.dim)
                for part in ti.static(self.sticks_and_triangles):
                    d += part.correct_positions(ball, self, i, h)
                self.position_correction[i] = d
            if ti.static(self.plan.pairs and not self.plan.soft):
                pair_sweeps.each_block(self, ball, pair_solve.block_of_corrections, h, None)
            if ti.static(self.plan.walls):
                for i in range(self.n):
                    self.position_correction[i] = self.position_correction[i] + self.walls.correct_positions(
                        ball, self, i, h
                    )
