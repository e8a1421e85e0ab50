"""TR-BDF2: the trapezoidal rule over a first part of the step, then the second backward difference formula."""

from typing import Any

from taichi_sim.analysis.methods import GAMMA, TR_BDF2
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import phase_type
from taichi_sim.device.parts import STEP, Part
from taichi_sim.forces.driven_pins import DrivenPinSlopes
from taichi_sim.integrators.implicit_base import STRUCK, Implicit
from taichi_sim.integrators.step_turns import StepTurns

__all__ = ["TRBDF2"]

MIDDLE = 1.0 / (GAMMA * (2.0 - GAMMA))  # weight of the state in the middle; that of the start is 1 - MIDDLE


@ti.data_oriented
class TRBDF2(Implicit):
    """Order 2, bounded at any step for small motion; damps what is faster than a step, and much less than implicit Euler what is
    slower.

    The forces of springs at the start of a step are what the last stage of the step before came to, not evaluated anew: what a
    stage left over of a stiff spring would come back multiplied by its stiffness. In the first step they come from a stage of
    implicit Euler. Gravity and the user's forces are explicit, of order 2 by the weights of Ascher, Ruuth and Spiteri (1997).

    A ball that bounced is not where the stage put it, but up to 2 h u from there. So the next step begins with a stage of h
    seconds back from its places x and velocities v, m (v' - v) = h (F(x + h (v' - v)) - F0), F0 being the forces that the stage
    came to: v' - v is h times what forces have changed since, and stays below 2 u however stiff they are. Half of it is the
    second half of the kick, thrown back as in Verlet. Bodies of which no ball bounced are left as they are.
    """

    method = TR_BDF2
    relaxes = True
    takes_gas = True
    tolerance = 1e-3
    reflects = True
    late_part = 1.0
    stages, opening = 3, 1
    part = TR_BDF2.stage
    ends = (part, GAMMA, 1.0)
    past_parts = (1.0, 1.0, 0.5 / MIDDLE)
    carries = (0.0, 0.0, MIDDLE)
    friction_part = 0.5

    def allocate(self, fields: Fields) -> None:
        """`slope` [m/s^2]: what springs did at the end of the step before; `kick` [m/s] by other forces over a step, in the
        first stage; `here`: where those are asked; `rest` [m/s]: what is left
        to add after the move, `pull` [m/s^2]: all of the change over h."""
        super().allocate(fields)
        n, dim = self.model.n, self.model.dim
        self.slope, self.kick, self.pull, self.rest = (fields.vectors(n, dim) for _ in range(4))
        if self.forces.extra:
            self.here = fields.table(phase_type(dim, fields.real), n)
        self.driven = self.pins is not None and self.forces.damped
        self.answers = self.solves and (self.contacts.plan.reflects or self.contacts.plan.marks_bounces)
        if self.answers:
            self.struck = fields.integers(self.solver.bodies.count)  # 1: a ball of this body bounced in the last step
        self.keeps_turns = self.solves and self.solver.turns_freely and self.solver.free.some
        if self.keeps_turns:
            self.turns = StepTurns(self, fields)
        if self.driven:
            assert self.forces.springs is not None
            self.corners = DrivenPinSlopes(self.model, self.state, self.pins, self.forces.springs, fields)

    def memory(self) -> list[Any]:
        """Fields of what springs did at the end of the step before, and of what pushed each body last."""
        return [self.slope, *([self.solver.held.last_pushing] if self.solver.reports else [])]

    def recall(self) -> None:
        """No opening stage is due."""
        self.fresh[0] = 0

    @ti.func
    def begin(self, stage, h, time):
        """Places and velocities from which each stage starts."""
        s = self.part * h
        if stage > 0:  # the opening one asks for what acts at the start
            self.forces.flex(ti.select(stage == 2, 1.0, GAMMA))
        if ti.static(bool(self.forces.extra)):
            for i in range(self.model.n):
                self.here[i] = self.ball[i]
                if stage == 2:
                    self.here[i].v = self.solver.base[i].v
                    self.here[i].x = self.solver.base[i].x + s * self.solver.base[i].v
            self.forces.external(self.here, h, time + ti.select(stage == 2, GAMMA * h, 0.0))
        for i in range(self.model.n):
            ball = self.ball[i]
            kick = self.forces.external_change(i, h)
            if stage == 2:
                middle = self.solver.base[i].v
                self.begin_at(i, (MIDDLE * s) * (ball.v + self.solver.velocity(i)))
                self.solver.kick[i] = (1.0 - 0.5 / GAMMA - 1.0 / (2.0 - GAMMA)) * self.kick[i] + 0.5 / GAMMA * kick
                self.solver.q[i] = ball.v + MIDDLE * (middle - ball.v) + self.solver.kick[i]
            else:
                self.begin_at(i, ti.Vector.zero(float, self.model.dim))
                self.solver.base[i].v = ball.v
                self.solver.kick[i] = self.part * kick
                self.solver.q[i] = ball.v + self.solver.kick[i]
                if ti.static(self.answers):
                    if stage == 0 and self.fresh[0] == STRUCK:
                        self.begin_at(i, -h * ball.v)
                        self.solver.kick[i] = ti.Vector.zero(float, self.model.dim)
                        self.solver.q[i] = ball.v - h * self.slope[i]
                        self.solver.last[i] = ti.Vector.zero(float, self.model.dim)
                if stage == 1:
                    self.begin_at(i, s * ball.v)
                    self.solver.kick[i] = GAMMA * kick
                    self.solver.q[i] = ball.v + s * self.slope[i] + GAMMA * kick
                    self.kick[i] = kick

    @ti.func
    def end(self, stage, h):
        """The slope that the stage came to; the next step starts with that of the last one."""
        answers = ti.static(self.answers) and stage == 0 and self.fresh[0] == STRUCK
        for i in range(self.model.n):
            if answers:
                self.rest[i] = self.solver.base[i].v - self.ball[i].v
            elif stage != 1:
                self.slope[i] = (self.solver.base[i].v - self.solver.q[i]) / (self.part * h)
            if ti.static(self.solver.reports):
                self.solver.q[i] = self._velocity_of_kicks(i, stage, answers)
        self.solver.tell_probes(ti.select(answers, 0.5, 1.0))
        if ti.static(self.answers):
            if answers:
                self._answer(h)

    @ti.func
    def _velocity_of_kicks(self, i, stage, answers):
        """Velocity that ball i has at the end of a stage in which the momentum of its body changes for good, if nothing but
        kicks from outside change it; else the one that it has. What stages left out and slopes carry on is the difference."""
        v = self.solver.base[i].v
        if stage == 2:
            v = self.ball[i].v + self.pushed(i)
        elif ti.static(self.answers):
            if answers and self.struck[self.solver.bodies.of(i)] > 0:
                v = self.ball[i].v
        return v

    @ti.func
    def pushed(self, i):
        """Change of the velocity of ball i in a step by kicks from outside [m/s], after the last stage."""
        return (MIDDLE * GAMMA) * self.kick[i] + self.solver.kick[i]

    @ti.func
    def mean(self, i):
        """Mean velocity of ball i in a step [m/s], after the last stage, before it is kicked."""
        v, middle, after = self.ball[i].v, self.solver.first[i], self.solver.base[i].v
        return (MIDDLE * self.part) * (v + middle) + self.part * after

    @ti.func
    def _keep_turns(self, role: ti.template(), h, time):
        self.turns.find(h)

    @ti.func
    def _answer(self, h):
        """Give the bodies that bounced what forces have changed by it."""
        for i in range(self.model.n):
            if self.struck[self.solver.bodies.of(i)] > 0:
                self.slope[i] = self.slope[i] + self.rest[i] / h
                self.contacts.record_thrown_back(i, 0.5 * self.rest[i])
                self.state.kick(i, self.contacts.second_half(i, 0.5 * self.rest[i]))
        self.contacts.throw_back_part(0.5, self.rest, False)

    def finishing(self) -> list[Part]:
        """Parts that end a step: the kick to its mean velocity, contacts, the move, the rest of the change, contacts."""
        last = [Part(self, "_renew", STEP)] if self.driven else []
        first = [Part(self, "_keep_turns", STEP)] if self.keeps_turns else []
        return [*first, *self.moving(), Part(self, "_kick_by_rest", STEP), Part(self, "_hold", STEP), *last]

    @ti.func
    def _kick_by_rest(self, role: ti.template(), h, time):
        if ti.static(self.answers):
            for b in range(self.solver.bodies.count):
                self.struck[b] = 0
        for i in range(self.model.n):
            self.contacts.record_thrown_back(i, self.rest[i])
            self.state.kick(i, self.contacts.second_half(i, self.rest[i]))
            if ti.static(self.solves and self.solver.holds):
                self.solver.held.foresee(i)
            if ti.static(self.answers):
                if self.contacts.bounced(i):
                    self.struck[self.solver.bodies.of(i)] = 1
                    self.fresh[0] = STRUCK
        self.contacts.throw_back_part(1.0, self.rest, True)

    @ti.func
    def _renew(self, role: ti.template(), h, time):
        self.corners.renew(self.slope)

    @ti.func
    def before_move(self, i, h):
        """Kick ball i to the mean velocity of the step."""
        v, mean, after = self.ball[i].v, self.mean(i), self.solver.base[i].v
        self.pull[i] = (after - v) / h
        self.rest[i] = after - mean
        if ti.static(self.keeps_turns):
            self.rest[i] = self.rest[i] + self.turns.kick[i]
        self.state.kick(i, mean - v)

    @ti.func
    def acceleration(self, i, h):
        """The mean of the step; none of a ball that rests, whose stages ended where even motion leads."""
        pull = self.pull[i]
        if ti.static(self.solves and self.solver.holds):
            if self.solver.held.rests(i):
                pull *= 0.0
        return pull
