"""The potential that an implicit stage lowers, before a change was added to it and after."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_decisions import Verdicts
from taichi_sim.integrators.newton_numbers import DOUBTFUL, TRIED
from taichi_sim.kernels.springs import newton_terms, padded_blocks

__all__ = ["Potentials"]


@ti.data_oriented
class Potentials(Verdicts):
    """The part of a StageSolver that weighs guesses and changes which may have gone too far."""

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

    @ti.func
    def doubted(self, b):
        """True if the guess of body b, or its change, may have raised its potential."""
        return self.number[b].phase == DOUBTFUL or self.number[b].phase == TRIED
