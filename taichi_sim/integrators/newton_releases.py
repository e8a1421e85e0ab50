"""Renewal of what surfaces do to balls in an implicit stage, of each body when it is its turn."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_decisions import Verdicts
from taichi_sim.integrators.newton_numbers import HELD

__all__ = ["Releases"]


@ti.data_oriented
class Releases(Verdicts):
    """The part of a StageSolver that renews which balls are held."""

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
