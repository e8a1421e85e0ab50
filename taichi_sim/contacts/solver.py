"""ContactSolver: all contacts of a scene at once, impulses accumulated from old velocities and applied at the end of a pass.

Each ball splits its mass between its contacts (see kernels.contact_law.share), so that a pass never adds energy and passes
converge; the plain sum of the article ("sum") over-corrects wherever a ball has several contacts.
"""

import taichi as ti

from taichi_sim.contacts.pairs import Pairs
from taichi_sim.contacts.sticks import Sticks
from taichi_sim.contacts.walls import Walls
from taichi_sim.fields import Fields
from taichi_sim.kernels import contact_law
from taichi_sim.model import Model
from taichi_sim.state import State

__all__ = ["ContactSolver"]

RELAXATION = 1.3  # of a pass; below 2 passes converge, above 1.3 friction could make one add energy
PUSH_OUT = 0.5  # part of the remaining depth that one step removes


@ti.data_oriented
class ContactSolver:
    """The contacts of a scene.

    Args:
        walls, pairs, sticks: the kinds of contact that the scene has, or None.
        threshold: m/s, approach speed below which nothing bounces.
        passes: of the solve before the move. rule: "jacobi" or "sum". atomic: add impulses with atomics.
        serial: the fused driver runs everything on one thread. warm: start from the impulses held in the step before,
        which carries the load of piles but can give a little energy to fast crowds; pointless where no force acts.
    """

    def __init__(
        self,
        model: Model,
        state: State,
        fields: Fields,
        walls: Walls | None,
        pairs: Pairs | None,
        sticks: Sticks | None,
        *,
        threshold: float,
        passes: int,
        rule: str,
        atomic: bool,
        serial: bool,
        warm: bool,
    ) -> None:
        self.model, self.state, self.n = model, state, model.n
        self.walls, self.pairs, self.sticks = walls, pairs, sticks
        self.searched = [part for part in (pairs, sticks) if part is not None]
        self.parts = [part for part in (walls, pairs, sticks) if part is not None]
        self.gathered = [part for part in self.parts if part is walls or not atomic]
        self.scattered = [part for part in self.searched if atomic]
        self.active = bool(self.parts)
        self.threshold, self.push_out, self.relaxation, self.warm = threshold, PUSH_OUT, RELAXATION, warm
        self.passes, self.split, self.serial = passes, rule == "jacobi", serial
        self.has_walls, self.has_grid, self.has_sticks = walls is not None, pairs is not None, sticks is not None
        if self.active:
            self.lightness = fields.reals(self.n)  # 1/kg: inverse mass of the part of a ball that each contact gets
            self.push, self.offset = fields.vectors(self.n, model.dim), fields.vectors(self.n, model.dim)

    def names(self) -> list[str]:
        """What is compiled in, for `Simulation.kernels()`."""
        rule = "contacts.jacobi" if self.split else "contacts.sum"
        return [rule, *(name for part in self.parts for name in part.names())] if self.active else []

    @ti.func
    def refresh(self, ball: ti.template()):
        """Find the contacts at the present positions, and how each ball splits its mass between them."""
        if ti.static(self.active):
            if ti.static(self.has_grid):
                self.pairs.grid.build(ball)
            for part in ti.static(self.searched):
                part.detect(ball)
            for i in range(self.n):
                T = ti.Matrix.zero(float, self.model.dim, self.model.dim)
                count = 0
                for part in ti.static(self.parts):
                    t, c = part.measure(ball, i)
                    if ti.static(self.split):
                        T += t
                        count += c
                s = contact_law.share(T, count, not self.model.has_friction)
                self.lightness[i] = s * self.model.inverse_mass[i]

    @ti.func
    def prime(self, ball: ti.template()):
        """Find the contacts after positions were set from outside."""
        if ti.static(self.has_grid):
            self.pairs.grid.expire()
        self.refresh(ball)

    @ti.func
    def solve(self, ball: ti.template(), time, passes: ti.template(), impacts: ti.template()):
        """Change velocities so that nothing approaches; friction acts for `time` seconds. Without `impacts` only slow
        contacts are held, so that velocities reported at the end of a step are at rest where balls rest."""
        if ti.static(self.active):
            if ti.static(self.warm):
                self.begin(ball, impacts)
            else:
                self.first_pass(ball, time, impacts)
            done = ti.static(0 if self.warm else 1)
            if ti.static(self.serial):
                for k in range(done, passes):
                    self.one_pass(ball, ti.select(k == 0, time, 0.0))
            else:  # at the top level of a kernel only an unrolled loop leaves the inner ones parallel
                for k in ti.static(range(done, passes)):
                    self.one_pass(ball, ti.select(k == 0, time, 0.0))

    @ti.func
    def first_pass(self, ball: ti.template(), time, impacts: ti.template()):
        """Fix the target speeds and make the first pass, where nothing is held from before."""
        if ti.static(self.has_sticks):
            self.sticks.begin_rows(ball, self, impacts)
            self.sticks.solve_rows(ball, self, time)
        for i in range(self.n):
            p = ti.Vector.zero(float, self.model.dim)
            for part in ti.static(self.gathered):
                p += part.first_pass(ball, self, i, time, impacts)
            self.push[i] = p
        for part in ti.static(self.scattered):
            part.begin_scatter(ball, self, impacts)
            part.scatter(ball, self, time)
        self.apply()

    @ti.func
    def begin(self, ball: ti.template(), impacts: ti.template()):
        """Fix the target speeds, and apply the impulses that contacts hold from before."""
        if ti.static(self.has_sticks):
            self.sticks.begin_rows(ball, self, impacts)
        for i in range(self.n):
            p = ti.Vector.zero(float, self.model.dim)
            for part in ti.static(self.gathered):
                p += part.begin(ball, self, i, impacts)
            self.push[i] = p
        for part in ti.static(self.scattered):
            part.begin_scatter(ball, self, impacts)
        self.apply()

    @ti.func
    def one_pass(self, ball: ti.template(), time):
        """Accumulate the impulses of all contacts from old velocities, then apply them."""
        if ti.static(self.has_sticks):
            self.sticks.solve_rows(ball, self, time)
        for i in range(self.n):
            p = ti.Vector.zero(float, self.model.dim)
            for part in ti.static(self.gathered):
                p += part.gather(ball, self, i, time)
            self.push[i] = p
        for part in ti.static(self.scattered):
            part.scatter(ball, self, time)
        self.apply()

    @ti.func
    def apply(self):
        """v += w p for the impulses just accumulated."""
        for i in range(self.n):
            self.state.kick(i, self.model.inverse_mass[i] * self.push[i])

    @ti.func
    def separate(self, ball: ti.template(), h):
        """Accumulate the offsets that undo overlap; `move` applies them. Velocities never see them."""
        if ti.static(self.active):
            for i in range(self.n):
                d = ti.Vector.zero(float, self.model.dim)
                for part in ti.static(self.parts):
                    d += part.offset(ball, self, i, h)
                self.offset[i] = d

    @ti.func
    def move(self, ball: ti.template(), i, v, a, h):
        """Displacement of ball i over h, and its drift velocity v (mid-step, acceleration a) after impacts on walls."""
        shift = h * v
        drift = v
        if ti.static(self.has_walls):
            shift, drift = self.walls.move(i, ball[i].x, v, a, h)
        if ti.static(self.active):
            shift += self.offset[i]
        if ti.static(self.has_grid):
            self.pairs.grid.watch(i, ball[i].x + shift)
        return shift, drift
