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
from taichi_sim.kernels.contacts import (
    ccd_balls,
    ccd_triangles,
    contact_law,
    energy_limiter,
    mass_sharing,
    pair_measures,
    pair_solve,
    pair_sweeps,
    warm_start,
)

__all__ = ["ContactParts", "ContactRule"]

PUSH_OUT = 0.5  # part of the remaining depth that one step removes
FASTEST_PUSH_OUT = 20.0  # of the threshold speed: soft contacts do not push out faster
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

    A user-defined rule is a subclass with a `solve`. The shortest:

        @ti.data_oriented
        class Inelastic(ts.ContactRule):
            name = "inelastic"
            in_turn = True

            @ti.func
            def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
                self.each_pair(ball, self.join)

            @ti.func
            def join(self, ball: ti.template(), i, j, c):
                pair = self.pairs.row[c]
                closing = ti.min(0.0, (ball[j].v - ball[i].v).dot(pair.normal))
                if pair.depth > 0.0:
                    self.exchange(i, j, pair.mass * closing * pair.normal)

        ts.Simulation(scene, contacts=Inelastic())

    Pair c of balls i and j is `self.pairs.row[c]`, with `normal` from i to j, `depth` [m], negative where they are still apart,
    and `mass` [kg], 1 / (1 / m_i + 1 / m_j). Fast impacts on walls and overlap are taken care of when balls move. A scene without
    pairs has no `self.pairs` (`self.has_grid` is False). For what rests on walls, sticks and triangles, call
    `self.begin(ball, impacts)` before the first iteration, and `self.solve_joints(ball, time)` and `self.solve_walls(ball, time)`
    in each.

    Class attributes: `in_turn`: each pair sees what those before it changed, which needs a fixed order; `split`: each ball splits
    its mass between its contacts, see kernels.contacts.contact_law.share; `sums_plainly`: none does; `warm_starts`, `softens`,
    `impacts_in_turn`, `energy_limiter`: what of these in ContactPlan the rule can do.

    Fields that kernels read: `threshold` (1) [m/s], approach speed below which nothing bounces; `rate` (1) [1/s], 1 / h; `before`
    (n) [m/s], velocities before a solve, and in a move the displacements [m]; `lightness` (n) [1/kg], inverse mass of the part of
    a ball that each contact gets; `offset` (n) [m], the position correction; `warm_velocity` (n) [m/s] and `warm_spin` (n) [m/s],
    changes by the accumulated impulses of pairs with which a solve starts.
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
    still: Any
    kicked: Any  # see GaussSeidel.allocate

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
        self.rule = self.name
        self.plan, self.model, self.state, self.n = plan, model, state, model.n
        self.walls, self.pairs, self.sticks, self.triangles = parts
        self.searched = [part for part in (self.pairs, self.sticks) if part is not None]
        self.joints = [part for part in (self.sticks, self.triangles) if part is not None]  # of more than two balls
        self.parts = [part for part in parts if part is not None]
        self.threshold, self.push_out, self.fastest_push = threshold, PUSH_OUT, FASTEST_PUSH_OUT
        self.active, self.iterations = plan.active, plan.iterations
        self.atomic, self.serial = plan.atomic, plan.serial
        self.has_walls, self.has_grid, self.has_joints = plan.walls, plan.pairs, bool(self.joints)
        self.has_sticks, self.has_triangles, self.has_colliders = plan.sticks, plan.triangles, plan.colliders
        self.warm, self.soft, self.spins = plan.warm_starts, plan.soft, model.spins
        self.strikes, self.bounces, self.foresees = plan.impacts_in_turn, plan.bounces, plan.foresees
        self.loaded, self.accelerates, self.limits_energy = plan.loaded, plan.line_search, plan.limits_energy
        self.among = plan.walls and plan.walls_in_turn
        # by the directions of contacts, not only their number; friction pushes sideways as well
        self.by_tensor = plan.active and self.split and not model.has_friction
        self.sums = plan.active and (self.has_joints or not self.in_turn)  # impulses from old velocities
        self.has_offset = plan.active and (not self.soft or self.has_joints or self.has_walls)
        self.counts = self.split or self.among  # the pairs that touch each ball, whoever lists them
        if plan.active:
            self.rate = fields.reals(np.array([1.0 / h]))
            self.before = fields.vectors(self.n, model.dim)
            self._allocate_shared(fields)
            self.allocate(fields)
        own = vars(type(self))
        for name in vars(self).keys() & own.keys():
            if callable(own[name]):
                raise TypeError(f"contacts: {type(self).__name__}.{name} has the name of a field; call it otherwise")

    def _allocate_shared(self, fields: Fields) -> None:
        n, dim = self.n, self.model.dim
        if self.has_grid:  # see ccd_balls
            self.fast, self.longest = fields.integers(4), fields.reals(1)
            self.stop, self.sooner = fields.reals(n), fields.reals(n)  # the part of a step that is made
        if self.has_sticks:
            smallest = float(np.min(self.model.scene.radius))
            self.thin = fields.reals(np.array([(STICK_CROSSING * smallest) ** 2]))
        if self.has_offset:
            self.offset = fields.vectors(n, dim)
        if self.limits_energy:
            self.wide = ti.f64 if fields.has_doubles else fields.real
            self.parts_of_energy = -(-n // energy_limiter.PART)
            columns = dict.fromkeys(("lost", "linear", "square"), self.wide)
            self.energy = fields.table(columns, self.parts_of_energy + 1)
            self.stopped_velocity = fields.vectors(n, dim)  # where all that touched has stopped
            if self.spins:
                self.before_spin, self.stopped_spin = (fields.spins(n, dim) for _ in range(2))
        if self.sums:
            self.lightness = fields.reals(n)
        if self.counts:
            self.count = fields.integers(n)
        if self.warm and self.has_grid:
            self.warm_velocity = fields.vectors(n, dim)
            if self.spins:
                self.warm_spin = fields.spins(n, dim)

    def allocate(self, fields: Fields) -> None:
        """Declare fields of the rule's own."""

    def names(self) -> list[str]:
        """What is compiled in, for `Simulation.kernels()`."""
        return [f"contacts.{self.name}", *(name for part in self.parts for name in part.names())] if self.active else []

    def forget(self) -> None:
        """Start from nothing: balls were put elsewhere, where the load is another one. `prime` has to follow."""
        for part in self.searched:
            part.forget()
        if self.walls is not None:
            self.walls.contact.impulse.fill(0)
            if self.model.has_friction:
                self.walls.contact.slide.fill(0)

    def set_step(self, h: float, ratio: float) -> None:
        """Take substeps of h seconds, `ratio` times what they were: contacts that rest accumulate as much less or more."""
        if self.active:
            self.rate[0] = 1.0 / h
            self._scale(ratio)

    @ti.kernel
    def _scale(self, ratio: float):
        if ti.static(self.has_grid):
            warm_start.scale(self.pairs.link, self.pairs.capacity, ratio, self.model.has_friction)
        if ti.static(self.has_sticks):
            warm_start.scale(self.sticks.row, self.sticks.capacity, ratio, self.model.has_friction)
        if ti.static(self.has_walls):
            warm_start.scale(self.walls.contact, self.n * self.walls.count, ratio, self.model.has_friction)

    # To be overridden

    @ti.func
    def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
        """Change velocities so that nothing approaches; friction acts for `time` seconds. Without `impacts` only slow contacts
        are held, so that velocities reported at the end of a step are at rest where balls rest."""

    @ti.func
    def relax(self, ball: ti.template(), time):
        """After a move that ends a step: take back what pushing out overlap added to velocities."""

    @ti.func
    def clear(self, i):
        """Before pairs are measured: nothing of the rule's own is known of ball i yet."""

    @ti.func
    def found(self, ball: ti.template()):
        """All contacts are measured at the present positions."""

    @ti.func
    def iterate(self, ball: ti.template(), time, how: ti.template()):
        """One iteration over all contacts, see kernels.contacts.pair_solve.Iteration: what `repeat` repeats."""

    # Finding contacts

    @ti.func
    def _clear(self, i):
        """Nothing is summed yet of what pairs do to ball i."""
        self.clear(i)
        if ti.static(self.counts):
            self.count[i] = 0
        if ti.static(self.warm):
            self.warm_velocity[i] = ti.Vector.zero(float, self.model.dim)
            if ti.static(self.spins):
                self.warm_spin[i] = pair_sweeps.zero_spin(self)

    @ti.func
    def prime(self, ball: ti.template()):
        """Find the contacts after positions were set from outside."""
        if ti.static(self.has_colliders):
            self.walls.colliders.rewind()
        if ti.static(self.has_grid):
            self.pairs.grid.expire()
        self._find(ball, False)

    @ti.func
    def refresh(self, ball: ti.template()):
        """After a move: cut ways short that lead through something, then find the contacts at the present positions."""
        self._find(ball, True)

    @ti.func
    def _find(self, ball: ti.template(), moved: ti.template()):
        if ti.static(self.has_colliders):
            self.walls.colliders.advance()
        if ti.static(self.has_grid):
            ccd_balls.stop(self, ball)
            if ti.static(self.has_triangles and moved):
                ccd_triangles.limit(self.triangles, self, ball)
            self.pairs.grid.build(ball)
        for part in ti.static(self.searched):
            part.detect(ball)
        if ti.static(self.has_triangles):
            ccd_triangles.detect(self.triangles, self, ball)
        if ti.static(self.has_grid):
            if ti.static(self.warm or self.counts or self.strikes):
                for i in range(self.n):
                    self._clear(i)
            pair_sweeps.each_block(self, ball, pair_measures.measure_block, 0.0, None)
        if ti.static(self.has_walls):
            for i in range(self.n):
                crowded = False
                if ti.static(self.walls.crowds):
                    crowded = self.count[i] > 0
                self.walls.measure(ball, self, i, crowded)
        self.found(ball)
        if ti.static(self.sums):
            for i in range(self.n):
                T, count = mass_sharing.shares(self, ball, i)
                share = contact_law.share(T, count, not self.model.has_friction)
                self.lightness[i] = share * self.model.inverse_mass[i]
                if ti.static(self.has_triangles):
                    self.triangles.split(T, count, i)

    # Pieces of a solve

    @ti.func
    def begin(self, ball: ti.template(), impacts: ti.template()):
        """Note the velocities that target speeds depend on, and start from what contacts have accumulated."""
        for part in ti.static(self.joints):
            part.begin_rows(ball, self, impacts)
        for i in range(self.n):
            self.before[i] = ball[i].v
            if ti.static(self.limits_energy and self.spins):
                self.before_spin[i] = self.state.spin[i]
            if ti.static(self.has_walls):
                self.walls.begin(ball, self, i, impacts, True)
            if ti.static(self.has_sticks and self.warm):
                p, t = self.sticks.gather(ball, self, i)
                self.apply(i, p, t)
            if ti.static(self.has_grid and self.warm):
                self.state.kick(i, self.warm_velocity[i])
                if ti.static(self.spins):
                    self.state.spin[i] = self.state.spin[i] + self.warm_spin[i]
                if ti.static(not impacts):
                    self.take_out_pairs(ball, i)

    # A solve whose iteration takes back (LAST, RELAX) leaves other impulses in the pairs, but moves nothing: the next solve,
    # which starts from them, needs no measuring if `warm_velocity` follows. Meanwhile it is the velocity without their part.

    @ti.func
    def take_out_pairs(self, ball: ti.template(), i):
        """Before that iteration: what the velocity of ball i would be without the impulses of its pairs."""
        if ti.static(self.warm):
            self.warm_velocity[i] = ball[i].v - self.warm_velocity[i]
            if ti.static(self.spins):
                self.warm_spin[i] = self.state.spin[i] - self.warm_spin[i]

    @ti.func
    def put_back_pairs(self, ball: ti.template(), i):
        """After it: what pairs do to the velocity of ball i now."""
        self.warm_velocity[i] = ball[i].v - self.warm_velocity[i]
        if ti.static(self.spins):
            self.warm_spin[i] = self.state.spin[i] - self.warm_spin[i]

    @ti.func
    def begin_relaxing(self, ball: ti.template()):
        """The same as `begin` after a move: accumulated impulses are applied already."""
        for i in range(self.n):
            self.before[i] = ball[i].v
            if ti.static(self.loaded):
                self.kicked[i] = ball[i].v - self.still[i]
            if ti.static(self.has_walls):
                self.walls.begin(ball, self, i, False, False)
            self.take_out_pairs(ball, i)

    @ti.func
    def repeat(self, ball: ti.template(), number: ti.template(), how: ti.template()):
        """So many iterations."""
        if ti.static(self.serial):
            for _ in range(number):
                self.iterate(ball, 0.0, how)
        else:  # at the top level of a kernel only an unrolled loop leaves the inner ones parallel
            for _ in ti.static(range(number)):
                self.iterate(ball, 0.0, how)

    @ti.func
    def limit_energy(self, ball: ti.template(), iterations: ti.template(), impacts: ti.template()):
        """Let what has stopped bounce, as far as energy allows."""
        if ti.static(self.limits_energy and impacts):
            energy_limiter.note_stopped(self, ball)
            self.repeat(ball, iterations, pair_solve.BOUNCE)
            energy_limiter.limit(self, ball)
        elif ti.static(
            self.limits_energy
        ):  # what carried an impact is no load that rests: one iteration may not undo it
            energy_limiter.compare_with_before(self)
            energy_limiter.limit(self, ball)

    @ti.func
    def joint_impulses(self, ball: ti.template(), i, how: ti.template()):
        """Impulse and angular impulse on ball i from all sticks and triangles."""
        p, t = ti.Vector.zero(float, self.model.dim), pair_sweeps.zero_spin(self)
        if ti.static(how.starts):
            for part in ti.static(self.joints):
                push, twist = part.gather(ball, self, i)
                p += push
                t += twist
        if ti.static(how.takes_back and self.has_grid and self.warm):  # no pair accumulates these
            self.warm_velocity[i] = self.warm_velocity[i] + self.model.inverse_mass[i] * p
            if ti.static(self.spins):
                response = self.model.spin_response(i) * self.model.inverse_mass[i]
                self.warm_spin[i] = self.warm_spin[i] + response * t
        return p, t

    @ti.func
    def solve_joints(self, ball: ti.template(), time):
        """One iteration over sticks and triangles, always from old velocities."""
        if ti.static(self.has_joints):
            for part in ti.static(self.joints):
                part.solve_rows(ball, self, time)
            for i in range(self.n):
                p, t = self.joint_impulses(ball, i, pair_solve.NEXT)
                self.apply(i, p, t)

    @ti.func
    def solve_walls(self, ball: ti.template(), time):
        """One iteration over the walls and colliders on which balls rest, or in which they are."""
        if ti.static(self.has_walls):
            for i in range(self.n):
                p, t = self.walls.gather(ball, self, i, time)
                self.apply(i, p, t)

    @ti.func
    def each_pair(self, ball: ti.template(), visit: ti.template()):
        """visit(ball, i, j, c) for each pair that touches or nearly does, in a fixed order but with contacts by atomics."""
        if ti.static(self.has_grid):
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
        if ti.static(self.spins):
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
        of v by forces in this step, where `a` does not tell it."""
        shift = h * v
        drift = v
        if ti.static(self.has_walls):
            if self.model.inverse_mass[i] > 0.0:  # nothing holds a pin that is driven
                shift, drift = self.walls.move(i, ball[i].x, v, a, h, change)
        if ti.static(self.has_grid):
            ccd_balls.note(self, i, shift)  # what only undoes overlap goes through nothing
        if ti.static(self.has_offset):
            shift += self.offset[i]
        if ti.static(self.has_grid):
            self.pairs.grid.watch(i, ball[i].x + shift)
        return shift, drift

    @ti.func
    def _correct_positions(self, ball: ti.template(), h):
        """The displacements that undo overlap where contacts are rigid. Velocities never see them."""
        if ti.static(self.has_offset):
            for i in range(self.n):
                d = ti.Vector.zero(float, self.model.dim)
                for part in ti.static(self.joints):
                    d += part.offset(ball, self, i, h)
                self.offset[i] = d
            if ti.static(self.has_grid and not self.soft):
                pair_sweeps.each_block(self, ball, pair_solve.block_of_corrections, h, None)
            if ti.static(self.has_walls):
                for i in range(self.n):
                    self.offset[i] = self.offset[i] + self.walls.offset(ball, self, i, h)
