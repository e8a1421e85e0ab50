"""StageSolver: an implicit stage on springs and elements by Newton's method and conjugate gradients, with no matrix."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model, incidence, phase_type
from taichi_sim.device.state import WORLD_RADIUS
from taichi_sim.forces.element import Element
from taichi_sim.forces.springs import Springs
from taichi_sim.integrators.bodies import Bodies, FreeBodies
from taichi_sim.integrators.deflation import Deflation
from taichi_sim.integrators.free_turns import FreeTurns
from taichi_sim.integrators.held_balls import HeldBalls
from taichi_sim.integrators.implicit_elements import StageElements
from taichi_sim.integrators.implicit_gas import StageGas
from taichi_sim.integrators.multilevel import Levels
from taichi_sim.integrators.newton_decisions import compare_potentials, solve_stage
from taichi_sim.integrators.newton_numbers import HELD_NUMBERS, NUMBERS, TALLY
from taichi_sim.integrators.newton_operators import Product, Residual
from taichi_sim.integrators.newton_potential import Potentials
from taichi_sim.integrators.newton_releases import Releases
from taichi_sim.integrators.newton_search import Search
from taichi_sim.integrators.newton_sizes import Sizes
from taichi_sim.kernels.springs import padded_blocks

__all__ = ["StageSolver"]

POTENTIAL_ROUNDING = 1e3  # in units of the machine's
FINEST_SOLUTION = 8.0  # the same
LOST = 1e6 * WORLD_RADIUS  # m/s
NO_TIES = np.zeros((0, 2), dtype=np.int64)
SUMS = (
    *(
        "residual",
        "force",
        "kinetic",
        "within",
        "noise",
        "load",
        "potential",
        "potential_before",
        "descent",
        "curvature",
    ),
    "onward",  # of the residual after a change, by that change
    *("given", "taken", "moving"),  # J: by the residual, by the method; kinetic energy in the frame of the body
)
HELD_SUMS = (
    "held",
    "near",
    "pull",
    "wrong",
)  # where balls may be held: so many are; so many may be; what is wrong with it
MOMENTA = ("borne", "lack")  # there, N s: what surfaces bear; what the rest of the residual is


@ti.data_oriented
class StageSolver(Sizes, Potentials, Search, Releases):
    """Solves m (q - v) + s F(p + s v, v) = 0 for the velocities v, see kernels.springs.newton_terms.

    Fields: `base` (n) with x the places p [m] and v [m/s]: the start, then the solution; `low` (n) [m]: what rounding took from
    the places; `q` (n) [m/s], of which `kick` (n) comes from outside the bodies; `first` (n): the start.
    Without springs and elements v is q. gases, elements: those that act in the stage; elements give their derivatives.
    method: an Implicit; each of its `stages` starts with its change in the step before. `tolerance`: of the residual, in units of
    the impulses of the springs, both divided by the block diagonal of the matrix; less where the error of the method, of the
    given order, is less.
    """

    solve, compare = ti.func(solve_stage), ti.func(compare_potentials)

    def __init__(self, model: Model, springs: Springs | None, gases: Any, elements: Sequence[Any],
                 fields: Fields, method: Any) -> None:  # fmt: skip
        self.model, self.springs = model, springs
        self.order, self.tolerance, stages = method.method.order, method.tolerance, method.stages
        self.state = method.state
        self.past_parts = fields.reals(np.array(method.past_parts))
        self.n, self.dim = model.n, model.dim
        self.base = fields.table(phase_type(self.dim, fields.real), self.n)
        self.q, self.kick, self.first, self.low = (fields.vectors(self.n, self.dim) for _ in range(4))
        self.wide = fields.wide
        self.tally = fields.table(dict.fromkeys(TALLY, self.wide), 1)
        self.has_springs, self.has_elements = springs is not None, len(elements) > 0
        self.holds = self.rubs = self.reports = self.deflates = False
        self.held: Any = None
        if not self.has_springs and not self.has_elements:
            return
        scene, width = model.scene, padded_blocks.width(self.dim)
        self.dv = fields.vectors(self.n, self.dim)
        self.last = fields.vectors(self.n * stages, self.dim)
        vector = ti.types.vector(width, fields.real)
        self.damped = springs is not None and springs.damped
        ahead = {"x": ti.types.vector(width, fields.wide), "v": vector} | ({"w": vector} if self.damped else {})
        self.ahead = fields.table(ahead, self.n)
        block = {"r": vector, "along": fields.real, "across": fields.real}
        self.spring_block = fields.table(block, 0 if springs is None else springs.entries)
        self.product = Product(self, fields)
        self.residual = Residual(self, fields)
        self.inverse_block = fields.matrices(self.n, self.dim)  # of the diagonal
        self.swings, self.part_of_step = method.contacts.plan.active and model.has_restitution, method.part
        if self.swings:
            model.holds_back, model.swing = True, fields.matrices(self.n, self.dim)
        if springs is not None:
            start, _, spring = incidence(scene.pairs[springs.number], self.n)
            self.start, self.own_spring = fields.integers(start), fields.integers(spring)
            self._own_springs(springs, fields)
        self.elements = StageElements(elements, model, fields) if elements else None
        self.measures_anew = self.order == 1 or (bool(elements) and not method.contacts.plan.walls)
        self.bodies = Bodies(model, self.elements.ties if self.elements is not None else NO_TIES, fields)
        self.holds = method.contacts.plan.walls
        if self.holds:
            self.rubs = model.has_friction
            self.held = HeldBalls(model, method.contacts.walls, self.bodies, method, fields)
        numbers = (*NUMBERS, *(HELD_NUMBERS if self.holds else ()))
        self.number = fields.table(dict.fromkeys(numbers, self.wide), self.bodies.count)
        self.stage = fields.table({"passes": ti.i32, "missed": ti.i32, "worst": fields.real}, 1)
        columns = dict.fromkeys((*SUMS, *(HELD_SUMS if self.holds else ())), self.wide)
        if self.holds:
            columns |= dict.fromkeys(MOMENTA, ti.types.vector(self.dim, self.wide))
        self.part = self.bodies.columns(columns)
        self.free = FreeBodies(model, self.bodies, fields)
        self.reports = self.holds and self.held.reports and self.free.some
        self.deflates = self.holds and self.free.some and self.order == 1
        if self.deflates:
            self.deflation = Deflation(self, fields)
        self.turns_freely = not any(isinstance(one, Element) for one in elements)  # those of users may have a torque
        if self.turns_freely:
            self.turns = FreeTurns(model, self.bodies, self.free, fields)
        self.levels = Levels(model, self.bodies, self.elements, self.rubs, fields)
        self.sum = fields.vectors(self.n + self.levels.count, self.dim)
        self.gas = None if gases is None else StageGas(gases, self.bodies, fields)
        self.inflated = gases is not None
        eps = 2.0**-52 if fields.real == ti.f64 else 2.0**-23
        refined = elements and self.elements.all_refined and method.state.compensated
        self.eps_of_places = 2.0**-52 if refined else eps
        self.eps, self.rounding, self.finest = eps, POTENTIAL_ROUNDING * eps, FINEST_SOLUTION * eps
        self.least = max(self.tolerance**2, self.finest)
        stiff = np.bincount(scene.pairs.ravel(), np.repeat(scene.stiffness**2, 2), self.n)
        sharp = method.state.compensated and fields.wide == ti.f64  # places, where springs take them
        self.rough = fields.reals(
            (2.0**-52 if sharp else eps) * np.sqrt(stiff)
        )  # N/m: what rounding of a place makes of the forces on a ball

    def _own_springs(self, springs: Springs, fields: Fields) -> None:
        """List each spring once, with the ball whose body it belongs to: its lower one, if that is not pinned."""
        pairs, pinned = self.model.scene.pairs[springs.number], self.model.scene.pinned
        low, high = pairs.min(axis=1), pairs.max(axis=1)
        own = np.where(pinned[low] & ~pinned[high], high, low)
        order = np.argsort(own, kind="stable")
        self.potential_start = fields.integers(np.append(0, np.cumsum(np.bincount(own, minlength=self.n))))
        entries = {"spring": order, "other": (low + high - own)[order]}
        self.potential_entry = fields.table(dict.fromkeys(entries, ti.i32), springs.m, entries)

    @ti.func
    def move(self, s):
        """Add the multiple of the change that is due in each body to the velocities; the residual there."""
        for i in range(self.n):
            v = self.base[i].v + ti.cast(self.number[self.bodies.of(i)].change, float) * self.dv[i]
            self.base[i].v = v
            self.ahead[i].v = padded_blocks.pad(v, self.dim)
        if ti.static(self.turns_freely):
            self.turns.step[0] = s
        self._sum_springs(self.residual, s)
        if ti.static(self.inflated):
            self.gas.push(self.base, self.residual.sum, s)
        if ti.static(self.has_elements):
            self.elements.push(self.base, self.low, self.residual.sum, s)
        self.residual.round_off()

    @ti.func
    def begin(self, s, stage):
        """The first guess: the change of the step before, in the frame of the body, and that of its centre of mass now."""
        for i in range(self.n):
            self.first[i] = self.base[i].v
            x, low = padded_blocks.pad(self.base[i].x, self.dim), padded_blocks.pad(self.low[i], self.dim)
            self.ahead[i].x = ti.cast(x, self.wide) + ti.cast(low, self.wide)
            self.dv[i] = self.last[stage * self.n + i]
        self.free.add_change(self.dv, self.base, self.q)
        self.free.find_means(self.base, self.q)
        if ti.static(self.damped or self.has_elements):
            for i in range(self.n):
                w = self.past_parts[stage] / s * self._shift(i)
                if ti.static(self.damped):
                    self.ahead[i].w = padded_blocks.pad(w, self.dim)
                if ti.static(self.has_elements):
                    self.elements.note_past(i, w)
        if ti.static(self.holds):
            for i in range(self.n):
                self.base[i].v = self.held.choose(i, self.base[i].v, self._shift(i), self.dv[i], self.q[i], s, stage)
                self.dv[i] = self.held.along(i, self.dv[i])
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            self.begin_body(b)
            if ti.static(self.deflates):
                self.deflation.forget(b)

    @ti.func
    def _shift(self, i):
        """Way [m] from the place of ball i to where the stage begins."""
        shift = (self.base[i].x - self.state.ball[i].x) + self.low[i]
        if ti.static(self.state.compensated):
            shift -= self.state.low[i].x
        return shift

    @ti.func
    def velocity(self, i):
        """Velocity [m/s] with which ball i moves at the end of the last stage, with what holds it."""
        v = self.base[i].v
        if ti.static(self.holds):
            v -= self.held.reaction[i]
        return v

    @ti.func
    def end(self, stage):
        """Give bodies that fly the velocities q, and free ones the momentum that they should have; note the change of this stage,
        and how well it was solved. What surfaces give to balls that they hold is left to contacts."""
        for i in range(self.n):
            if ti.static(self.holds):
                self.base[i].v = self.held.hand_on(i, self.base[i].v, stage)
            if self.number[self.bodies.of(i)].flies == 1.0:
                self.base[i].v = self.q[i]
                if ti.static(self.holds):
                    self.held.reaction[i] = ti.Vector.zero(float, self.dim)
        self.free.share(self.base, self.q, self.held)
        if ti.static(self.turns_freely):
            self.turns.correct(self.ahead, self.base, self.q)
        for i in range(self.n):
            self.last[stage * self.n + i] = ti.Vector.zero(float, self.dim)
            if self.model.inverse_mass[i] > 0.0:
                change = self.free.change[self.bodies.of(i)]  # of its body, which the next stage finds anew
                self.last[stage * self.n + i] = self.velocity(i) - self.first[i] - change
                if self.is_lost(self.bodies.of(i)):
                    self.base[i].v = self.base[i].v + LOST  # what was found knows nothing of such forces
        self.judge_all()

    @ti.func
    def tell_probes(self, part):
        """Tell probes of `part` of the momentum that bodies lack with the velocities `base`, of those in q; see HeldBalls."""
        if ti.static(self.reports):
            self.free.find_lack(self.base, self.q)
            self.held.tell_probes(self.free, part)
