"""Sizes of what is left of an implicit stage, and the blocks that condition it, by a loop over its balls."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_decisions import Verdicts
from taichi_sim.integrators.newton_numbers import BEGUN, FOUND, WITHDRAWN
from taichi_sim.kernels.springs import padded_blocks

__all__ = ["Sizes"]

CERTAIN_NOISE = 4.0  # times the square of what rounding leaves of a residual


@ti.data_oriented
class Sizes(Verdicts):
    """The part of a StageSolver that measures its residual."""

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
        """The sizes of the residual and of what acts on body b, and the work of the residual. Where springs alone act, or
        surfaces may hold balls, TR-BDF2 measures what acts at the guess only: stiff springs that turn far take half the
        passes so."""
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
        self.bodies.join((self.part.residual, self.part.force, self.part.kinetic, self.part.onward))
        self.bodies.join((self.part.given, self.part.taken, self.part.moving))
        if ti.static(self.holds):
            self.bodies.join((self.part.borne, self.part.lack))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.number[b].phase == FOUND:
                self._note_sizes(b, self.measures_anew)
                self.number[b].onward = self.bodies.total(self.part.onward, b)
                self.judge_change(b)

    @ti.func
    def _measure_residual(self, c):
        if self.number[self.bodies.part[c].body].phase == FOUND:
            sizes, onward = ti.Vector.zero(self.wide, 3), ti.cast(0.0, self.wide)
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                r = padded_blocks.cut(self.product.sum[i], self.dim)
                kept = self._keep(i, r)
                w = self.model.inverse_mass[i]
                if w > 0.0:
                    sizes += self._sizes(i, kept, r, w, self.inverse_block[i])
                    onward += ti.cast(kept.dot(self.dv[i]), self.wide)
            self.part[c].onward = onward
            self.part[c].residual, self.part[c].force, self.part[c].kinetic = sizes[0], sizes[1], sizes[2]
            self._measure_work(c)

    @ti.func
    def begins(self, b):
        """True if the guess of body b is to be looked at, or was withdrawn, or its blocks are too old."""
        return self.number[b].phase == BEGUN or self.number[b].phase == WITHDRAWN
