"""Friction of held balls in an implicit stage.

Friction that followed the stage would strain elements after they were solved for, which gives energy. So it acts in the stage
too, as a drag: -d m u at the slip u, d = b / |u|. Surfaces that push with impulses N allow m b = sum mu N. The slip is that of
the way since the start of the step, so that friction does no work on what moves past a surface. Each surface drags at the slip
past it; together they drag as one that moves with their mean, weighted by their drags. Both b and u are those of the solution
before it, see `renew`: the lagged friction of Li et al. (2020, Incremental Potential Contact), but for its direction, which is
implicit.
"""

from typing import Any

from taichi_sim.device.engine import ti

__all__ = ["STUCK", "HeldFriction"]

# by order of the method, of what friction can change in a stage: a ball that slides more slowly sticks; with more, balls that
# TR-BDF2 leaves at rest in a hollow moved by 1e-8 m
STUCK = {1: 3e-4, 2: 3e-5}
SLOW = 2.0  # times that slip: friction may still be any
SLIPS = 8  # iterations for the slip to go on with
ROUNDING = 32.0  # of a velocity, in units of the machine's: a slower slip may be none


@ti.data_oriented
class HeldFriction:
    """The part of HeldBalls that rubs balls, see there for its fields."""

    model: Any
    walls: Any
    contact: Any
    friction: Any
    dim: int
    eps: float
    stuck: float
    last_most: Any
    span: Any
    carries: Any
    moved: Any
    carried: Any
    kept: Any
    rubbed: Any
    along: Any
    holds: Any

    @ti.func
    def _expect_friction(self, i, v, stage):
        """Expect as much friction on ball i, at the velocity v, as in this stage of the step before, shared
        alike by the surfaces that hold it; none if nothing holds it."""
        self.friction[i].most = ti.select(self.holds(i), self.last_most[stage * self.model.n + i], 0.0)
        carries, before = self.carries[stage], ti.max(0, stage - 1) * self.model.n + i
        self.friction[i].before = carries * self.last_most[before]
        self.kept[i] = carries * self.rubbed[i]
        for k in range(self.walls.count):
            if self.contact[i * self.walls.count + k].holds == 1:
                most, slow = self._most(i, k), self._slowest(i, k, v)
                speed = ti.sqrt(self._past(i, k, v).norm_sqr() + slow * slow)
                self.contact[i * self.walls.count + k].drag = ti.select(most > 0.0, most / speed, 0.0)
        self._add_drags(i)

    @ti.func
    def _add_drags(self, i):
        """Add up the drags of the surfaces that hold ball i, and note the velocity with which these together carry it."""
        drag, carried = ti.cast(0.0, float), ti.Vector.zero(float, self.dim)
        for k in range(self.walls.count):
            c = i * self.walls.count + k
            if self.contact[c].holds == 1:
                drag += self.contact[c].drag
                carried += self.contact[c].drag * self._carrier(i, k)
        self.friction[i].drag = drag
        self.carried[i] = ti.select(drag > 0.0, carried / ti.select(drag > 0.0, drag, 1.0), -self.moved[i])

    @ti.func
    def _carrier(self, i, k):
        """Velocity with which ball i ends the stage where surface k carries it."""
        carried = -self.moved[i]
        if ti.static(self.walls.moves):
            carried -= self.span[i] * self.walls.relative(ti.Vector.zero(float, self.dim), i, k)
        return carried

    @ti.func
    def slip(self, i, v):
        """Way of ball i along the surfaces that hold it, from the start of the step to the end of the stage, which it leaves with
        the velocity v; over the length of the stage [m/s]. Past surfaces that move apart: their mean, weighted by their drags."""
        return self.along(i, v - self.carried[i])

    @ti.func
    def _past(self, i, k, v):
        """Slip of ball i past surface k alone, in its plane, see `slip`."""
        slip, n = v - self._carrier(i, k), self.walls.normal(i, k)
        return slip - n.dot(slip) * n

    @ti.func
    def _slowest(self, i, k, v):
        """Slip [m/s] below which ball i, at the velocity v, sticks to surface k."""
        rounded = (ROUNDING * self.eps) ** 2 * (v.norm_sqr() + self._carrier(i, k).norm_sqr())
        return ti.sqrt((self.stuck * self._most(i, k)) ** 2 + rounded)

    @ti.func
    def rub(self, i, v):
        """Change of the velocity v of ball i by friction [m/s]."""
        return -self.friction[i].drag * self.slip(i, v) - self._kept(i)

    @ti.func
    def _kept(self, i):
        """The part of friction that was given in the stage before [m/s]."""
        return ti.select(self.holds(i), 1.0, 0.0) * self.along(i, self.kept[i])

    @ti.func
    def potential(self, i, v):
        """Potential of friction at the velocity v of ball i, over its mass [J/kg]."""
        return 0.5 * self.friction[i].drag * self.slip(i, v).norm_sqr() + self._kept(i).dot(v)

    @ti.func
    def _change_of_friction(self, i, v):
        """Change of the velocity v of ball i by which its friction is not what its pushes allow."""
        self._bound_friction(i)
        change = ti.Vector.zero(float, self.dim)
        for k in range(self.walls.count):
            c = i * self.walls.count + k
            if self.contact[c].holds == 1:
                slip = self.along(i, v - self._carrier(i, k))
                change += (self.contact[c].drag - self._allowed_drag(i, k, v)) * slip
        return change

    @ti.func
    def _allowed_drag(self, i, k, v):
        """The drag of surface k on ball i at the velocity v, bounded by what its friction may be: where the ball sticks, any up
        to the most."""
        most, slip, drag = self._most(i, k), self._past(i, k, v).norm(), self.contact[i * self.walls.count + k].drag
        if slip > 0.0:
            stuck = ti.min(1.0, SLOW * self._slowest(i, k, v) / slip)
            drag = ti.max(ti.min(drag, most / slip), (1.0 - stuck * stuck) * most / slip)
        return drag

    @ti.func
    def _renew_drags(self, i, v, inverse):
        """Give each surface of ball i the drag that its friction has where it meets the line on which the ball alone answers to
        it: by more slip to less friction. As the slip is given, it is that of a ball that slides; as the friction is, of one that
        sticks."""
        whole_drag = self.dim * self.model.inverse_mass[i] / inverse.trace()
        for k in range(self.walls.count):
            c = i * self.walls.count + k
            if self.contact[c].holds == 1:
                self.contact[c].drag = self._next_drag(i, k, v, ti.max(1.0, whole_drag - self.contact[c].drag))
            else:
                self.contact[c].drag = 0.0

    @ti.func
    def _next_drag(self, i, k, v, stiff):
        """The drag of surface k to go on with, see `_renew_drags`. stiff: what else resists a change of velocity, by mass."""
        most, slip = self._most(i, k), self.along(i, v - self._carrier(i, k)).norm()
        across = ti.max(0.0, self._past(i, k, v).norm_sqr() - slip * slip)  # where other surfaces let it not go
        square = self._slowest(i, k, v) ** 2 + across
        whole, found = slip + self.contact[i * self.walls.count + k].drag / stiff * slip, 0.0 * slip
        drag = 0.0 * slip
        if most > 0.0:
            for _ in range(SLIPS):  # Newton's method from below, where it converges from one side
                speed = ti.sqrt(found * found + square)
                over = found + most / stiff * found / speed - whole
                found -= over / (1.0 + most / stiff * square / speed**3)
            drag = most / ti.sqrt(found * found + square)
        return drag

    @ti.func
    def _bound_friction(self, i):
        """Bound the friction of ball i by its pushes."""
        most = self.friction[i].before
        for k in range(self.walls.count):
            most += self._load(i, k)
        self.friction[i].most = most

    @ti.func
    def _load(self, i, k):
        """Change of velocity that friction with surface k can give for its push on ball i [m/s]."""
        load = ti.cast(0.0, float)
        if self._stays_at(i, k):
            load = self.walls.law(i, k).friction * self.contact[i * self.walls.count + k].push
        return load

    @ti.func
    def _most(self, i, k):
        """The part of the most friction of ball i that surface k gives: as it pushes, or where none does, all alike."""
        loads, number = ti.cast(0.0, float), 0
        for other in range(self.walls.count):
            if self.contact[i * self.walls.count + other].holds == 1:
                loads += self._load(i, other)
                number += 1
        share = ti.select(loads > 0.0, self._load(i, k) / ti.select(loads > 0.0, loads, 1.0), 1.0 / ti.max(1, number))
        return share * self.friction[i].most

    @ti.func
    def _stays_at(self, i, k):
        """True if surface k pushes ball i in the stage, and not only when the ball moves, in a bounce."""
        c, yes = i * self.walls.count + k, False
        if self.contact[c].holds == 1 and self.contact[c].push > 0.0:
            yes = self.contact[c].rests == 1 or self.walls.law(i, k).restitution == 0.0
        return yes
