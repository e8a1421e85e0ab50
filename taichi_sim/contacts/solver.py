"""ContactSolver: all contacts of a scene, pass by pass, each pair once and in a fixed order.

"jacobi": impulses are accumulated from old velocities and applied at the end of a pass. Each ball splits its mass between its
contacts (see kernels.contact_law.share), so that a pass never adds energy and passes converge; the plain sum of the article
("sum") over-corrects wherever a ball has several contacts. "gauss_seidel": each contact changes the velocities that the next
one sees, which needs half the passes.
"""

import numpy as np

from taichi_sim.contacts.pairs import BLOCK, Pairs
from taichi_sim.contacts.sticks import Sticks
from taichi_sim.contacts.triangles import Facets
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
    impact_iterations,
    mass_sharing,
    pair_impacts,
    pair_sweeps,
    warm_start,
)
from taichi_sim.scene.scene import max_restitution

__all__ = ["ContactSolver"]

RELAXATION = 1.3  # of a split-mass pass; below 2 passes converge, above 1.3 friction could make one add energy
FEW = 4  # passes: with fewer, what one overshoots is not taken back by the next
PUSH_OUT = 0.5  # part of the remaining depth that one step removes
THIN = 0.5  # of the smallest radius: what moves further may cross a stick
FASTEST_PUSH = 20.0  # of the threshold speed: soft contacts do not push out faster


@ti.data_oriented
class ContactSolver:
    """The contacts of a scene.

    Args:
        walls, pairs, sticks, facets: the kinds of contact that the scene has, or None.
        threshold: field (1) [m/s], approach speed below which nothing bounces. h: seconds per substep.
        passes: of the solve before the move. rule: "gauss_seidel", "jacobi" or "sum". atomic: add impulses with atomics.
        serial: one thread runs all. warm: start from what the step before held, the load of piles. soft: pairs are damped
        springs, else rigid and pushed apart. loaded: forces may press single balls together.
        limits_energy: see kernels.contacts.energy_limiter.
    """

    def __init__(
        self,
        model: Model,
        state: State,
        fields: Fields,
        walls: Walls | None,
        pairs: Pairs | None,
        sticks: Sticks | None,
        facets: Facets | None,
        *,
        threshold: ti.Field,
        h: float,
        iterations: int,
        rule: str,
        atomic: bool,
        serial: bool,
        warm: bool,
        soft: bool,
        loaded: bool,
        limits_energy: bool,
    ) -> None:
        self.model, self.state, self.n = model, state, model.n
        self.walls, self.pairs, self.sticks, self.facets = walls, pairs, sticks, facets
        self.searched = [part for part in (pairs, sticks) if part is not None]
        self.parts = [part for part in (walls, pairs, sticks, facets) if part is not None]
        self.rows = [part for part in (sticks, facets) if part is not None]  # of more than two balls
        self.active, self.threshold, self.relaxation = bool(self.parts), threshold, RELAXATION
        self.push_out, self.fastest_push = PUSH_OUT, FASTEST_PUSH
        if iterations < FEW:  # one pass changes the energy by sum lambda |u| (relaxation (1 + e) / 2 - 1)
            self.relaxation = min(RELAXATION, 2.0 / (1.0 + max_restitution(model.scene)))
        self.rule, self.iterations, self.serial, self.atomic = rule, iterations, serial, atomic
        self.warm, self.soft, self.limits_energy = warm, soft and pairs is not None, limits_energy
        self.in_turn, self.split = rule == "gauss_seidel", rule == "jacobi"
        self.has_walls, self.has_grid, self.has_sticks = walls is not None, pairs is not None, sticks is not None
        self.has_facets, self.has_rows = facets is not None, bool(self.rows)
        self.has_colliders = walls is not None and walls.has_colliders
        self.strikes = self.in_turn and self.has_grid and not self.has_rows  # impacts one by one, see kernels.hits
        self.bounces = self.strikes and model.has_restitution
        self.foresees = self.strikes and self.soft and not self.bounces  # what bounces has to touch first
        self.loaded = loaded and self.bounces
        self.accelerates = self.strikes and pairs is not None and pairs.unequal
        self.among = walls is not None and walls.crowds  # walls take their turn in the impacts of pairs
        # by their directions, not only their number; friction pushes sideways as well
        self.by_tensor = self.active and self.split and not model.has_friction
        self.spins = model.spins
        self.sums = self.has_rows or not self.in_turn  # some impulses are accumulated before they are applied
        self.has_offset = self.active and (not self.soft or self.has_rows or self.has_walls)
        self.counts = self.split or self.among  # the pairs that touch each ball, whoever lists them
        if self.active:
            self.rate = fields.reals(np.array([1.0 / h]))
            self.before = fields.vectors(self.n, model.dim)  # velocities before a solve; displacements in a move
            if self.has_grid:  # see kernels.swept
                self.fast, self.longest = fields.integers(4), fields.reals(1)
                self.stop, self.sooner = fields.reals(self.n), fields.reals(self.n)  # the part of a step that is made
            if self.strikes:
                self.most_blocks = model.n // BLOCK + 2
                self.mark, self.struck = fields.integers(2 * self.most_blocks), fields.integers(self.most_blocks)
                self.stirred, self.rebounds = fields.integers(self.n), fields.integers(self.n)  # see kernels.hits
            if self.accelerates:  # see kernels.settle
                self.island, self.awake = fields.integers(self.n), fields.integers(self.n)
                self.way = fields.vectors(self.n, model.dim)
                self.slope, self.bend, self.far = (fields.reals(self.n) for _ in range(3))
            if self.loaded:
                self.still, self.kicked = fields.vectors(self.n, model.dim), fields.vectors(self.n, model.dim)
            if self.has_sticks:
                self.thin = fields.reals(np.array([(THIN * float(np.min(model.scene.radius))) ** 2]))
            if self.has_offset:
                self.offset = fields.vectors(self.n, model.dim)
            if limits_energy:
                self.wide = ti.f64 if fields.has_doubles else fields.real
                self.parts_of_energy = -(-self.n // energy_limiter.PART)
                self.energy = fields.table(
                    {"lost": self.wide, "linear": self.wide, "square": self.wide}, self.parts_of_energy + 1
                )
                self.stop_v = fields.vectors(self.n, model.dim)  # velocities where all that touched has stopped
                if self.spins:
                    self.before_spin, self.stopped_spin = (fields.spins(self.n, model.dim) for _ in range(2))
            if self.sums:
                self.push = fields.vectors(self.n, model.dim)
                self.lightness = fields.reals(self.n)  # 1/kg: inverse mass of the part of a ball that each contact gets
                if self.by_tensor:
                    self.tensor = fields.matrices(self.n, model.dim)
                if self.spins:
                    self.twist = fields.spins(self.n, model.dim)
            if self.counts:
                self.count = fields.integers(self.n)
            if self.warm and self.has_grid:
                self.carry = fields.vectors(self.n, model.dim)  # changes of velocity by what pairs hold from before
                if self.spins:
                    self.carry_spin = fields.spins(self.n, model.dim)

    def names(self) -> list[str]:
        """What is compiled in, for `Simulation.kernels()`."""
        return [f"contacts.{self.rule}", *(name for part in self.parts for name in part.names())] if self.active else []

    def forget(self) -> None:
        """Hold nothing from before: balls were put elsewhere, where the load is another one. `prime` has to follow."""
        for part in self.searched:
            part.forget()
        if self.walls is not None:
            self.walls.contact.impulse.fill(0)
            if self.model.has_friction:
                self.walls.contact.slide.fill(0)

    def set_step(self, h: float, ratio: float) -> None:
        """Take substeps of h seconds, `ratio` times what they were: contacts that rest hold as much less or more."""
        if self.active:
            self.rate[0] = 1.0 / h
            self._scale_held(ratio)

    @ti.kernel
    def _scale_held(self, ratio: float):
        if ti.static(self.has_grid):
            warm_start.scale(self.pairs.link, self.pairs.capacity, ratio, self.model.has_friction)
        if ti.static(self.has_sticks):
            warm_start.scale(self.sticks.row, self.sticks.capacity, ratio, self.model.has_friction)
        if ti.static(self.has_walls):
            warm_start.scale(self.walls.contact, self.n * self.walls.count, ratio, self.model.has_friction)

    @ti.func
    def refresh(self, ball: ti.template()):
        """After a move: cut ways short that lead through something, then find the contacts at the present positions."""
        self._find(ball, True)

    @ti.func
    def _find(self, ball: ti.template(), moved: ti.template()):
        """Find the contacts at the present positions, and how each ball splits its mass between them."""
        if ti.static(self.has_colliders):
            self.walls.colliders.advance()
        if ti.static(self.has_grid):
            ccd_balls.stop(self, ball)
            if ti.static(self.has_facets and moved):
                ccd_triangles.limit(self.facets, self, ball)
            self.pairs.grid.build(ball)
        for part in ti.static(self.searched):
            part.detect(ball)
        if ti.static(self.has_facets):
            ccd_triangles.detect(self.facets, self, ball)
        if ti.static(self.has_grid):
            if ti.static(self.warm or self.counts or self.strikes):
                for i in range(self.n):
                    self._clear(i)
            pair_sweeps.sweep(self, ball, 0.0, pair_sweeps.MEASURE)
        if ti.static(self.has_walls):
            for i in range(self.n):
                crowded = False
                if ti.static(self.walls.crowds):
                    crowded = self.count[i] > 0
                self.walls.measure(ball, self, i, crowded)
            if ti.static(self.strikes and self.among):
                pair_impacts.alert(self)
        if ti.static(self.loaded):
            for i in range(self.n):
                self.still[i] = ball[i].v
        if ti.static(self.active and self.sums):
            for i in range(self.n):
                T, count = mass_sharing.shares(self, ball, i)
                self.lightness[i] = (
                    contact_law.share(T, count, not self.model.has_friction) * self.model.inverse_mass[i]
                )
                if ti.static(self.has_facets):
                    self.facets.split(T, count, i)

    @ti.func
    def _clear(self, i):
        """Nothing is summed yet of what pairs do to ball i."""
        if ti.static(self.strikes):
            self.stirred[i], self.rebounds[i], self.pairs.latest[i] = pair_impacts.CALM, 0, pair_impacts.NO_ROW
        if ti.static(self.counts):
            self.count[i] = 0
        if ti.static(self.by_tensor):
            self.tensor[i] = ti.Matrix.zero(float, self.model.dim, self.model.dim)
        if ti.static(self.warm):
            self.carry[i] = ti.Vector.zero(float, self.model.dim)
            if ti.static(self.spins):
                self.carry_spin[i] = pair_sweeps.zero_spin(self)

    @ti.func
    def prime(self, ball: ti.template()):
        """Find the contacts after positions were set from outside."""
        if ti.static(self.has_colliders):
            self.walls.colliders.rewind()
        if ti.static(self.has_grid):
            self.pairs.grid.expire()
        self._find(ball, False)

    @ti.func
    def solve(self, ball: ti.template(), time, passes: ti.template(), impacts: ti.template()):
        """Change velocities so that nothing approaches; friction acts for `time` seconds. Without `impacts` only slow
        contacts are held, so that velocities reported at the end of a step are at rest where balls rest."""
        if ti.static(self.active):
            if ti.static(self.loaded):
                pair_impacts.note_kicks(self, ball)
            if ti.static(self.bounces and impacts):
                pair_impacts.all_rounds(self, ball, time)
            self._begin(ball, impacts)
            self._pass(ball, time, pair_sweeps.FIRST if impacts else pair_sweeps.LAST)
            if ti.static(self.serial):
                for _ in range(1, passes):
                    self._pass(ball, 0.0, pair_sweeps.NEXT)
            else:  # at the top level of a kernel only an unrolled loop leaves the inner ones parallel
                for _ in ti.static(range(1, passes)):
                    self._pass(ball, 0.0, pair_sweeps.NEXT)
            if ti.static(self.strikes and impacts):
                impact_iterations.settle(self, ball)
                if ti.static(self.warm):
                    pair_sweeps.sweep(self, ball, 0.0, pair_sweeps.LIMIT)
            if ti.static(self.limits_energy and impacts):
                energy_limiter.stopped(self, ball)
                if ti.static(self.serial):
                    for _ in range(passes):
                        self._pass(ball, 0.0, pair_sweeps.BOUNCE)
                else:
                    for _ in ti.static(range(passes)):
                        self._pass(ball, 0.0, pair_sweeps.BOUNCE)
                energy_limiter.tame(self, ball)
            elif ti.static(
                self.limits_energy
            ):  # what carried an impact is no load that rests: one pass may not undo it
                energy_limiter.compare_with_before(self)
                energy_limiter.tame(self, ball)
            if ti.static(self.has_sticks and self.warm):
                self.sticks.end_rows(ball)

    @ti.func
    def relax(self, ball: ti.template(), time):
        """The pass after the move, where the impulses held are applied already: takes back what pushing out added."""
        if ti.static(self.soft):
            for i in range(self.n):
                self.before[i] = ball[i].v
                if ti.static(self.loaded):
                    self.kicked[i] = ball[i].v - self.still[i]
                if ti.static(self.has_walls):
                    self.walls.begin(ball, self, i, False, False)
                self._mark(ball, i)
            self._pass(ball, time, pair_sweeps.RELAX)

    @ti.func
    def _begin(self, ball: ti.template(), impacts: ti.template()):
        """Note the velocities that target speeds depend on, and apply what contacts hold from before."""
        for part in ti.static(self.rows):
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
                self.state.kick(i, self.carry[i])
                if ti.static(self.spins):
                    self.state.spin[i] = self.state.spin[i] + self.carry_spin[i]
                if ti.static(not impacts):
                    self._mark(ball, i)

    # After the solve that ends a step pairs hold other impulses, but nothing has moved: the next solve, which starts with what
    # is held, needs no sweep if `carry` follows. Meanwhile it is the velocity without its own part.

    @ti.func
    def _mark(self, ball: ti.template(), i):
        """Before the sweep: what the velocity of ball i would be without what pairs hold."""
        if ti.static(self.warm):
            self.carry[i] = ball[i].v - self.carry[i]
            if ti.static(self.spins):
                self.carry_spin[i] = self.state.spin[i] - self.carry_spin[i]

    @ti.func
    def _carry(self, ball: ti.template(), i):
        """After the sweep: what pairs hold now."""
        self.carry[i] = ball[i].v - self.carry[i]
        if ti.static(self.spins):
            self.carry_spin[i] = self.state.spin[i] - self.carry_spin[i]

    @ti.func
    def _pass(self, ball: ti.template(), time, stage: ti.template()):
        """One pass over all contacts: pairs, then walls; sticks and surfaces are always accumulated from old velocities."""
        rows = ti.static(self.has_rows and stage != pair_sweeps.RELAX)  # that one is for soft contacts
        closes = ti.static(self.has_grid and self.warm and stage in (pair_sweeps.LAST, pair_sweeps.RELAX))
        if ti.static(rows):
            for part in ti.static(self.rows):
                part.solve_rows(ball, self, time)
        if ti.static(self.sums):
            for i in range(self.n):
                p = ti.Vector.zero(float, self.model.dim)
                t = pair_sweeps.zero_spin(self)
                if ti.static(rows):
                    for part in ti.static(self.rows):
                        push, twist = part.gather(ball, self, i)
                        p += push
                        t += twist
                if ti.static(closes):  # no pair holds these
                    self.carry[i] = self.carry[i] + self.model.inverse_mass[i] * p
                    if ti.static(self.spins):
                        ease = self.model.spin_response(i) * self.model.inverse_mass[i]
                        self.carry_spin[i] = self.carry_spin[i] + ease * t
                if ti.static(self.in_turn):
                    self.apply(i, p, t)
                else:
                    self.push[i] = p
                    if ti.static(self.spins):
                        self.twist[i] = t
        if ti.static(self.has_grid):
            pair_sweeps.sweep(self, ball, time, stage)
        if ti.static(self.has_walls or not self.in_turn or closes):
            for i in range(self.n):
                p, t = ti.Vector.zero(float, self.model.dim), pair_sweeps.zero_spin(self)
                if ti.static(self.has_walls):
                    p, t = self.walls.gather(ball, self, i, time)
                if ti.static(not self.in_turn):
                    twist = pair_sweeps.zero_spin(self)
                    if ti.static(self.spins):
                        twist = self.twist[i]
                    self.apply(i, self.push[i], twist)
                if ti.static(closes):
                    self._carry(ball, i)
                if ti.static(self.has_walls):
                    self.apply(i, p, t)

    @ti.func
    def apply(self, i, p, t):
        """v += w p, and the same for turns."""
        w = self.model.inverse_mass[i]
        self.state.kick(i, w * p)
        if ti.static(self.spins):
            self.state.spin[i] = self.state.spin[i] + (self.model.spin_response(i) * w) * t

    @ti.func
    def separate(self, ball: ti.template(), h):
        """Accumulate the offsets that undo overlap; `move` applies them. Velocities never see them."""
        if ti.static(self.has_offset):
            for i in range(self.n):
                d = ti.Vector.zero(float, self.model.dim)
                for part in ti.static(self.rows):
                    d += part.offset(ball, self, i, h)
                self.offset[i] = d
            if ti.static(self.has_grid and not self.soft):
                pair_sweeps.sweep(self, ball, h, pair_sweeps.OFFSET)
            if ti.static(self.has_walls):
                for i in range(self.n):
                    self.offset[i] = self.offset[i] + self.walls.offset(ball, self, i, h)

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
        self.separate(ball, h)
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
            if self.model.inverse_mass[i] > 0.0:  # nothing holds a pin that is led
                shift, drift = self.walls.move(i, ball[i].x, v, a, h, change)
        if ti.static(self.has_grid):
            ccd_balls.note(self, i, shift)  # what only undoes overlap goes through nothing
        if ti.static(self.has_offset):
            shift += self.offset[i]
        if ti.static(self.has_grid):
            self.pairs.grid.watch(i, ball[i].x + shift)
        return shift, drift
