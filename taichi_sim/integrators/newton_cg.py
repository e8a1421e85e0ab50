"""StageSolver: an implicit stage on springs and elements by Newton's method and conjugate gradients, with no matrix."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model, incidence, phase_type
from taichi_sim.forces.element import Element
from taichi_sim.forces.springs import Springs
from taichi_sim.integrators.bodies import Bodies, FreeBodies
from taichi_sim.integrators.free_turns import FreeTurns
from taichi_sim.integrators.held_balls import HeldBalls
from taichi_sim.integrators.implicit_elements import StageElements
from taichi_sim.integrators.implicit_gas import StageGas
from taichi_sim.integrators.multilevel import Levels
from taichi_sim.integrators.newton_decisions import (
    BEGUN,
    DOUBTFUL,
    FOUND,
    HELD,
    HELD_NUMBERS,
    NUMBERS,
    READY,
    SEARCHING,
    TALLY,
    TRIED,
    WITHDRAWN,
    Verdicts,
    compare_potentials,
    solve_stage,
)
from taichi_sim.integrators.newton_operators import Product, Residual
from taichi_sim.kernels.springs import edge_blocks, newton_terms, padded_blocks

__all__ = ["StageSolver"]

POTENTIAL_ROUNDING = 1e3  # in units of the machine's
FINEST_SOLUTION = 8.0  # the same
CERTAIN_NOISE = 4.0  # times the square of what rounding leaves of a residual
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
class StageSolver(Verdicts):
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
        self.holds = self.rubs = self.reports = False
        self.held: Any = None
        if not self.has_springs and not self.has_elements:
            return
        scene, width = model.scene, padded_blocks.width(self.dim)
        self.dv = fields.vectors(self.n, self.dim)
        self.last = fields.vectors(self.n * stages, self.dim)
        vector = ti.types.vector(width, fields.real)
        self.damped = springs is not None and springs.damped
        past = {"w": vector} if self.damped else {}
        self.ahead = fields.table(phase_type(width, fields.real) | past, self.n)  # padded
        block = {"r": vector, "along": fields.real, "across": fields.real}
        self.spring_block = fields.table(block, 0 if springs is None else springs.entries)
        self.product = Product(self, fields)
        self.residual = Residual(self)
        self.inverse_block = fields.matrices(self.n, self.dim)  # of the diagonal
        self.swings, self.part_of_step = method.contacts.plan.active and model.has_restitution, method.part
        if self.swings:
            model.holds_back, model.swing = True, fields.matrices(self.n, self.dim)
        if springs is not None:
            start, _, spring = incidence(scene.pairs[springs.number], self.n)
            self.start, self.own_spring = fields.integers(start), fields.integers(spring)
            self._own_springs(springs, fields)
        self.elements = StageElements(elements, model, fields) if elements else None
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
        self.rough = fields.reals(eps * np.sqrt(stiff))  # N/m: what rounding of a place makes of the forces on a ball

    @ti.func
    def mass(self, i):
        """Mass of ball i [kg]; 0 where it is pinned."""
        w = self.model.inverse_mass[i]
        return ti.select(w > 0.0, 1.0 / ti.select(w > 0.0, w, 1.0), 0.0)

    def _own_springs(self, springs: Springs, fields: Fields) -> None:
        """List each spring once, with the ball whose body it belongs to: its lower one, if that is not pinned."""
        pairs, pinned = self.model.scene.pairs[springs.number], self.model.scene.pinned
        low, high = pairs.min(axis=1), pairs.max(axis=1)
        own = np.where(pinned[low] & ~pinned[high], high, low)
        order = np.argsort(own, kind="stable")
        self.potential_start = fields.integers(np.append(0, np.cumsum(np.bincount(own, minlength=self.n))))
        entries = {"spring": order, "other": (low + high - own)[order]}
        self.potential_entry = fields.table(dict.fromkeys(entries, ti.i32), springs.m, entries)

    # Residual and matrix

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
            self.gas.push(self.base, self.product.sum, s)
        if ti.static(self.has_elements):
            self.elements.push(self.base, self.low, self.product.sum, s)

    @ti.func
    def _sum_springs(self, total: ti.template(), s):
        """total.sum (n) = own terms and those of springs."""
        if ti.static(self.has_springs):
            edge_blocks.sums(total, self.springs, s)
        else:
            for i in range(self.n):
                total.sum[i] = total.own(i)

    @ti.func
    def linearise(self, s):
        """Inverse blocks of the matrix and of levels, and the size of the residual, where guesses were added or taken back."""
        self.bodies.each_part(self._measure, (s,))
        self.bodies.join((self.part.residual, self.part.force, self.part.kinetic))
        self.bodies.join((self.part.within, self.part.noise, self.part.load))
        self.bodies.join((self.part.given, self.part.taken, self.part.moving))
        if ti.static(self.holds):
            self.bodies.join((self.part.borne, self.part.lack))
        if ti.static(self.holds):
            self.bodies.join((self.part.held, self.part.near))
        if ti.static(self.levels.active):
            self.levels.factor(self)
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.begins(b):
                self._note_sizes(b, True)
                self.number[b].scale_of_blocks = self.number[b].scale
                within = self.bodies.total(self.part.within, b)
                self.number[b].within = ti.max(self.number[b].force, within)
                self.number[b].noise = CERTAIN_NOISE * self.bodies.total(self.part.noise, b)
                self.number[b].load = self.bodies.total(self.part.load, b)
                if ti.static(self.holds):
                    self.number[b].near = self.bodies.total(self.part.near, b)
                    if ti.static(self.turns_freely):
                        self.turns.held[b] = ti.cast(self.bodies.total(self.part.held, b) > 0.0, ti.i32)
                self.judge_guess(b)

    @ti.func
    def _note_sizes(self, b, of_acting: ti.template()):
        """The sizes of the residual and of what acts on body b, and the work of the residual. Of TR-BDF2
        what acts is measured at the guess only: measured anew, stiff springs that turn far in a step take twice the passes."""
        force = self.bodies.total(self.part.force, b)
        self.number[b].residual = self.bodies.total(self.part.residual, b)
        self.number[b].force = force
        if ti.static(of_acting):
            self.number[b].scale = ti.max(force, self.bodies.total(self.part.kinetic, b))
        self.number[b].passes += 1.0
        self.note_work(b)
        if ti.static(self.holds):
            self.number[b].borne = self.bodies.total(self.part.borne, b).norm()
            self.number[b].lack = 0.0
            if self.free.mass[b] > 0.0:  # else what holds it takes the rest
                self.number[b].lack = self.bodies.total(self.part.lack, b).norm()

    @ti.func
    def _measure(self, c, s):
        """Part c of the residual and of the inverse blocks, and what they sum up to."""
        if self.begins(self.bodies.part[c].body):
            residual = force = kinetic = within = noise = load = held = near = ti.cast(0.0, self.wide)
            change = self.free.change[self.bodies.part[c].body]
            alike = self._kick_of_all(self.bodies.part[c].body)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                r = padded_blocks.cut(self.product.sum[i], self.dim)
                kept = self._keep(i, r)
                w = self.model.inverse_mass[i]
                inverse = ti.Matrix.zero(float, self.dim, self.dim)
                if w > 0.0:
                    stiff, curved = ti.Matrix.zero(float, self.dim, self.dim), ti.Matrix.zero(float, self.dim, self.dim)
                    if ti.static(self.has_elements):
                        stiff, curved = self.elements.block(i, False), self.elements.block(i, True)
                    of_elements = stiff + curved
                    inverse = self._inverse(i, w, stiff, curved)
                    sizes = self._sizes(i, kept, r, w, inverse)
                    residual += sizes[0]
                    force += sizes[1]
                    kinetic += sizes[2]
                    own, whole = self.q[i] - self.base[i].v, self.q[i] - self.first[i] - change
                    within += ti.cast(ti.max(own.norm_sqr(), whole.norm_sqr()) / w, self.wide)
                    load += ti.cast((self.kick[i] - alike).norm_sqr() / w, self.wide)
                    far, speed = ti.abs(self.base[i].x).max(), self.eps * ti.abs(self.first[i]).max()
                    blur, sway = s * self.rough[i] * far + speed / w, self.eps_of_places / s * far + speed
                    noise += ti.cast(blur * blur * inverse.trace() + sway * sway * of_elements.trace(), self.wide)
                    if ti.static(self.holds):
                        held += ti.select(self.held.holds(i), 1.0, 0.0)
                        near += ti.select(self.held.could_hold(i), 1.0, 0.0)
                self.inverse_block[i] = inverse
            self.part[c].residual = residual
            self.part[c].force = force
            self.part[c].kinetic = kinetic
            self.part[c].within = within
            self.part[c].noise = noise
            self.part[c].load = load
            if ti.static(self.holds):
                self.part[c].held = held
                self.part[c].near = near
            self._measure_work(c)

    @ti.func
    def _keep(self, i, r):
        """Keep the residual r of ball i, but for what surfaces that hold it bear."""
        kept = r
        if ti.static(self.holds):
            self.held.note_reaction(i, r)
            kept = self.held.along(i, r)
        self.sum[i] = kept
        return kept

    @ti.func
    def _kick_of_all(self, b):
        """Kick of the first ball of a free body; a uniform one deforms nothing. 0 where a pin holds the body."""
        kick = ti.Vector.zero(float, self.dim)
        if self.free.mass[b] > 0.0:
            kick = self.kick[self.bodies.ball(self.bodies.first_part(b), 0)]
        return kick

    @ti.func
    def _sizes(self, i, r, whole, w, inverse):
        """Parts of ball i, of inverse mass w and the residual r of a whole one, in `residual`, `force` and `kinetic`."""
        own, change = self.q[i] - self.base[i].v, self.q[i] - self.first[i]
        f = whole - own / w
        kinetic = ti.max(own.dot(own), change.dot(change)) / w
        return ti.cast(ti.Vector([r.dot(inverse @ r), f.dot(inverse @ f), kinetic]), self.wide)

    @ti.func
    def _measure_work(self, c):
        """Part c of the work of the residual, see Verdicts."""
        given = taken = moving = ti.cast(0.0, self.wide)
        borne, lack = ti.Vector.zero(self.wide, self.dim), ti.Vector.zero(self.wide, self.dim)
        mean = self.free.shift[self.bodies.part[c].body]
        for k in range(self.bodies.part[c].count):
            i = self.bodies.ball(c, k)
            w = self.model.inverse_mass[i]
            if w > 0.0:
                u, change = self.base[i].v - mean, self.base[i].v - self.first[i]
                given -= ti.cast(self.sum[i].dot(u), self.wide)
                taken += ti.cast(0.5 * change.dot(change) / w, self.wide)
                moving += ti.cast(0.5 * u.dot(u) / w, self.wide)
                if ti.static(self.holds):
                    borne += ti.cast(self.held.reaction[i] / w, self.wide)
                    lack += ti.cast(self.sum[i], self.wide)
        if ti.static(self.holds):
            self.part[c].borne, self.part[c].lack = borne, lack
        self.part[c].given = given
        self.part[c].taken = taken
        self.part[c].moving = moving

    @ti.func
    def _inverse(self, i, w, stiff, curved):
        """Inverse of the diagonal's block for ball i of inverse mass w, with what elements have of it by strains and curvatures;
        in double precision, or stiff springs in a line would make it indefinite."""
        across = ti.cast(0.0, self.wide)
        along = ti.cast(stiff, self.wide)
        if ti.static(self.has_springs):
            for k in range(self.start[i], self.start[i + 1]):
                block = self.spring_block[self.own_spring[k]]
                across += ti.cast(block.across, self.wide)
                for a in ti.static(range(self.dim)):
                    for b in ti.static(range(self.dim)):
                        product = ti.cast(block.r[a], self.wide) * ti.cast(block.r[b], self.wide)
                        along[a, b] += ti.cast(block.along, self.wide) * product
        one = ti.Matrix.identity(self.wide, self.dim)
        inertia, drag = 1.0 / ti.cast(w, self.wide), ti.cast(0.0, self.wide)
        if ti.static(self.rubs):
            drag = ti.cast(self.held.friction[i].drag, self.wide)
        if ti.static(self.levels.active):
            self.levels.note(i, along + across * one, ti.cast(curved, self.wide), inertia, drag)
        if ti.static(self.inflated):
            g = ti.cast(self.gas.gradient(i), self.wide)
            along += g.outer_product(g)
        elastic = along + ti.cast(curved, self.wide) + across * one
        if ti.static(self.swings):
            self.model.swing[i] = ti.cast(elastic / (inertia * ti.static(self.part_of_step**2)), float)
        return ti.cast((elastic + (inertia + drag * inertia) * one).inverse(), float)

    @ti.func
    def evaluate(self):
        """Sizes where changes that are found were added, or a part taken back. Blocks stay as they were: they
        condition well enough, and the residual keeps its measure. See `go_on`."""
        self.bodies.each_part(self._measure_residual, ())
        self.bodies.join((self.part.residual, self.part.force, self.part.kinetic))
        self.bodies.join((self.part.given, self.part.taken, self.part.moving))
        if ti.static(self.holds):
            self.bodies.join((self.part.borne, self.part.lack))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == FOUND:
                self._note_sizes(b, ti.static(self.order == 1))
                self.judge_change(b)

    @ti.func
    def _measure_residual(self, c):
        if self.number[self.bodies.part[c].body].phase == FOUND:
            sizes = ti.Vector.zero(self.wide, 3)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                r = padded_blocks.cut(self.product.sum[i], self.dim)
                kept = self._keep(i, r)
                w = self.model.inverse_mass[i]
                if w > 0.0:
                    sizes += self._sizes(i, kept, r, w, self.inverse_block[i])
            self.part[c].residual, self.part[c].force, self.part[c].kinetic = sizes[0], sizes[1], sizes[2]
            self._measure_work(c)

    @ti.func
    def weigh(self, s, taken):
        """Potential of each body in doubt, with the multiple `taken` of its guess, or its change, taken back; keep the one that
        was found before."""
        if ti.static(self.has_elements):
            for i in range(self.n):
                whole = ti.cast(self.number[self.bodies.of(i)].part, float)
                part = taken * whole
                self.elements.place(i, self.base[i].x, self.low[i], self.base[i].v - part * self.dv[i], s)
                self.elements.note_change(i, s * (whole - part) * self.dv[i])
        self.bodies.each_part(self._sum_potentials, (s, taken))
        if ti.static(self.inflated):
            self.gas.weigh(self, s, taken)

    @ti.func
    def judge_potentials(self):
        """Compare the last two potentials of each body in doubt."""
        self.bodies.join((self.part.potential, self.part.potential_before))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.doubted(b):
                now = self.bodies.total(self.part.potential, b)
                before = self.bodies.total(self.part.potential_before, b)
                self.number[b].passes += 2.0
                self.judge_potential(b, now > before + self.rounding * ti.abs(before))

    @ti.func
    def _sum_potentials(self, c, s, taken):
        b = self.bodies.part[c].body
        if self.doubted(b):
            phi = ti.cast(0.0, self.wide)
            whole = ti.cast(self.number[b].part, float)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                phi += ti.cast(self._potential(i, s, taken * whole, whole), self.wide)
                if ti.static(self.has_elements):
                    if self.model.inverse_mass[i] > 0.0:
                        phi += self.elements.potential(i, s)
            self.part[c].potential_before = self.part[c].potential
            self.part[c].potential = phi

    @ti.func
    def _potential(self, i, s, part, whole):
        """Potential of ball i and its springs, see `_own_springs`, with `part` of the change taken back, of which `whole` was
        added."""
        v = self.base[i].v - part * self.dv[i]
        phi = 0.5 * self.mass(i) * (self.q[i] - v).norm_sqr()
        if ti.static(self.rubs):
            phi += self.mass(i) * self.held.potential(i, v)
        if ti.static(self.has_springs):
            for k in range(self.potential_start[i], self.potential_start[i + 1]):
                spring, j = self.springs.spring[self.potential_entry[k].spring], self.potential_entry[k].other
                u, change = self.base[j].v - part * self.dv[j] - v, (whole - part) * (self.dv[j] - self.dv[i])
                r = (self.base[j].x - self.base[i].x) + s * u
                before, closing = r - s * change, 0.0 * s
                if ti.static(self.damped):
                    w = padded_blocks.cut(self.ahead[j].w - self.ahead[i].w, self.dim)
                    closing = newton_terms.closing(before, u - change, w, s, self.dim)
                phi += newton_terms.potential(r, s * change, before, closing, spring, s, self.damped)
        return phi

    # Newton's iterations

    @ti.func
    def begin(self, s, stage):
        """The first guess: the change of the step before, in the frame of the body, and that of its centre of mass now."""
        for i in range(self.n):
            self.first[i] = self.base[i].v
            self.ahead[i].x = padded_blocks.pad(self.base[i].x, self.dim)
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

    @ti.func
    def _shift(self, i):
        """Way [m] from the place of ball i to where the stage begins."""
        shift = (self.base[i].x - self.state.ball[i].x) + self.low[i]
        if ti.static(self.state.compensated):
            shift -= self.state.low[i].x
        return shift

    @ti.func
    def start_search(self):
        """Start the conjugate gradients of an iteration."""
        if ti.static(self.levels.active):
            self.levels.solve(self.sum)
        self.bodies.each_part(self._aim, ())
        self.bodies.join((self.part.residual,))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == READY:
                self._count_iteration(b)
                self.next_search(b)

    @ti.func
    def _aim(self, c):
        """Part c of the first p, and of its product with the residual."""
        if self.number[self.bodies.part[c].body].phase == READY:
            rz = ti.cast(0.0, self.wide)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                self.dv[i] = ti.Vector.zero(float, self.dim)
                p = self._conditioned(i)
                self.product.p[i] = padded_blocks.pad(p, self.dim)
                rz += ti.cast(self.sum[i].dot(p), self.wide)
            self.part[c].residual = rz

    @ti.func
    def _conditioned(self, i):
        """Preconditioned residual at ball i, in the directions that it is free to take."""
        z = self.inverse_block[i] @ self.sum[i]
        if ti.static(self.levels.active):
            z += self.levels.shift(i)
        if ti.static(self.holds):
            z = self.held.along(i, z)
        return z

    @ti.func
    def _count_iteration(self, b):
        """The numbers with which an iteration starts."""
        self.number[b].residual_before = self.number[b].residual
        self.number[b].moved_before = self.number[b].moved
        self.number[b].moved = 0.0
        self.number[b].rz = self.bodies.total(self.part.residual, b)
        self.number[b].iterations += 1.0
        self.number[b].searches = 0.0
        self.number[b].tries = 0.0

    @ti.func
    def search(self):
        """The best change along p; the next p conjugate to it."""
        self._sum_springs(self.product, 0.0)
        if ti.static(self.inflated):
            self.gas.multiply(self.product.p, self.product.sum)
        if ti.static(self.has_elements):
            self.elements.multiply(self.product.p, self.product.sum)
        self.bodies.each_part(self._project, ())
        self.bodies.join((self.part.descent, self.part.curvature))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == SEARCHING:
                self._choose_step(b)
        self.bodies.each_part(self._descend, ())
        if ti.static(self.levels.active):
            self.levels.solve(self.sum)
            self.bodies.each_part(self._condition, ())
        self.bodies.join((self.part.residual,))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == SEARCHING:
                self._count_search(b)
                self.next_search(b)
        self.bodies.each_part(self._turn, ())

    @ti.func
    def _choose_step(self, b):
        """The step along p that is best for body b."""
        descent, curvature = self.bodies.total(self.part.descent, b), self.bodies.total(self.part.curvature, b)
        step = ti.select(curvature > 0.0, descent / ti.select(curvature > 0.0, curvature, 1.0), 0.0)
        if ti.static(self.inflated):
            # a direction of negative curvature ends the search; the first one still leads down
            if curvature < 0.0 and self.number[b].searches == 0.0:
                step = -descent / curvature
            self.number[b].saddle = ti.select(curvature > 0.0, 0.0, 1.0)
        self.number[b].step = step
        self.add_gain(b, step * descent)  # dv A dv grows by that
        self.number[b].moved += step * descent

    @ti.func
    def _count_search(self, b):
        """The numbers after a step along p."""
        rz, before = self.bodies.total(self.part.residual, b), self.number[b].rz
        if ti.static(self.inflated):
            rz = ti.select(self.number[b].saddle > 0.0, 0.0 * rz, rz)
        self.number[b].step = ti.select(before > 0.0, rz / ti.select(before > 0.0, before, 1.0), 0.0)
        self.number[b].rz = rz
        self.number[b].searches += 1.0
        self.number[b].passes += 1.0

    @ti.func
    def _project(self, c):
        """Part c of p . r and p . A p."""
        if self.number[self.bodies.part[c].body].phase == SEARCHING:
            descent = curvature = ti.cast(0.0, self.wide)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                if self.model.inverse_mass[i] > 0.0:
                    p = self.product.p[i]
                    descent += ti.cast(padded_blocks.dot(p, self.sum[i], self.dim), self.wide)
                    curvature += ti.cast(padded_blocks.dot(p, self.product.sum[i], self.dim), self.wide)
            self.part[c].descent = descent
            self.part[c].curvature = curvature

    @ti.func
    def _descend(self, c):
        """Step along part c of p, and its residual."""
        b = self.bodies.part[c].body
        if self.number[b].phase == SEARCHING:
            step = ti.cast(self.number[b].step, float)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                self.dv[i] = self.dv[i] + step * padded_blocks.cut(self.product.p[i], self.dim)
                r = self.sum[i] - step * padded_blocks.cut(self.product.sum[i], self.dim)
                if ti.static(self.holds):
                    r = self.held.along(i, r)
                self.sum[i] = r
        if ti.static(not self.levels.active):
            self._condition(c)

    @ti.func
    def _condition(self, c):
        """Preconditioned residual of part c, and the product of both."""
        if self.number[self.bodies.part[c].body].phase == SEARCHING:
            rz = ti.cast(0.0, self.wide)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                z = self._conditioned(i)
                self.product.sum[i] = padded_blocks.pad(z, self.dim)
                rz += ti.cast(self.sum[i].dot(z), self.wide)
            self.part[c].residual = rz

    @ti.func
    def _turn(self, c):
        """Part c of the next p."""
        b = self.bodies.part[c].body
        if self.number[b].phase == SEARCHING:
            step = ti.cast(self.number[b].step, float)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                self.product.p[i] = self.product.sum[i] + step * self.product.p[i]

    @ti.func
    def release(self):
        """Renew what surfaces do to balls, of bodies that are solved but for that: they may only push."""
        self.bodies.each_part(self._sum_pulls, ())
        self.bodies.join((self.part.pull, self.part.wrong))
        self.bodies.each_part(self._release_part, ())
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == HELD:
                self.judge_pull(b, self.bodies.total(self.part.pull, b), self.bodies.total(self.part.wrong, b))

    @ti.func
    def _sum_pulls(self, c):
        if self.number[self.bodies.part[c].body].phase == HELD:
            pull, allowed = ti.cast(0.0, self.wide), ti.cast(self.number[self.bodies.part[c].body].allowed, float)
            wrong = 0.0 * pull
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                if self.held.could_hold(i):
                    p = self.held.amiss(i, self.base[i].v, allowed)
                    pull += ti.cast(p.dot(self.inverse_block[i] @ p), self.wide)
                    if ti.static(self.rubs):
                        wrong += ti.cast(self.mass(i) * self.held.friction[i].wrong, self.wide)
            self.part[c].pull = pull
            self.part[c].wrong = wrong

    @ti.func
    def _release_part(self, c):
        b = self.bodies.part[c].body
        if self.number[b].phase == HELD:
            if self.amiss(b, self.bodies.total(self.part.pull, b), self.bodies.total(self.part.wrong, b)):
                for k in range(self.bodies.part[c].count):
                    i = self.bodies.ball(c, k)
                    if self.held.could_hold(i):
                        self.base[i].v = self.held.renew(i, self.base[i].v, self.inverse_block[i])

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
            change = self.free.change[self.bodies.of(i)]  # of its body, which the next stage finds anew
            self.last[stage * self.n + i] = self.velocity(i) - self.first[i] - change
        self.judge_all()

    @ti.func
    def tell_probes(self, part):
        """Tell probes of `part` of the momentum that bodies lack with the velocities `base`, of those in q; see HeldBalls."""
        if ti.static(self.reports):
            self.free.find_lack(self.base, self.q)
            self.held.tell_probes(self.free, part)

    @ti.func
    def begins(self, b):
        """True if the guess of body b is to be looked at, or was withdrawn, or its blocks are too old."""
        return self.number[b].phase == BEGUN or self.number[b].phase == WITHDRAWN

    @ti.func
    def doubted(self, b):
        """True if the guess of body b, or its change, may have raised its potential."""
        return self.number[b].phase == DOUBTFUL or self.number[b].phase == TRIED
