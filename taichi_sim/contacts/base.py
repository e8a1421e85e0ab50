"""ContactRule: what all ways to solve contacts share: pieces of a solve, moving balls, undoing overlap."""

from typing import Any

from taichi_sim.common import validation
from taichi_sim.contacts.found_contacts import FoundContacts
from taichi_sim.contacts.plan import ContactPlan
from taichi_sim.device.engine import ti
from taichi_sim.device.parts import STEP, Part
from taichi_sim.kernels.contacts import ccd_balls, impact, pair_solve, pair_sweeps, struck_pairs, surface_ways
from taichi_sim.kernels.vectors import zero_scalar_in_2d

__all__ = ["ContactRule"]


@ti.data_oriented
class ContactRule(FoundContacts):
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
                pair = self.pairs.contact[c]
                closing = ti.min(0.0, (ball[j].v - ball[i].v).dot(pair.normal))
                if pair.depth > 0.0:
                    self.exchange(i, j, pair.mass * closing * pair.normal)

        ts.Simulation(scene, contacts=Inelastic())

    Pair c of balls i and j is `self.pairs.contact[c]`, with `normal` from i to j, `depth` [m], negative where they are still
    apart, and `mass` [kg], 1 / (1 / m_i + 1 / m_j). Fast impacts on walls and overlap are taken care of when balls move. A scene
    without pairs has no `self.pairs` (`self.plan.pairs` is False). For what rests on walls, sticks and triangles, call
    `self.begin(ball, impacts)` before the first iteration, and `self.solve_sticks_and_triangles(ball, time)` and
    `self.solve_walls(ball, time)` in each.

    What a rule can do is said by class attributes, see FoundContacts; `self.rate[0]` is 1 / h [1/s].
    """

    def __init_subclass__(cls, **given: Any) -> None:
        """A rule without a name is called as its class is: "off" would switch it off."""
        super().__init_subclass__(**given)
        cls.name = vars(cls).get("name", cls.__name__)
        if cls.name == ContactRule.name:
            raise TypeError(
                f"contacts: {cls.__name__} cannot have the name {cls.name!r}; it means that none are solved"
            )

    def bind(self, plan: ContactPlan, *parts: Any) -> None:
        """Take the parts of a simulation. Called once, before the fields exist."""
        if plan.active and type(self).solve is ContactRule.solve:
            raise TypeError(f"contacts: {type(self).__name__} has no solve(self, ball, time, iterations, impacts)")
        if plan.active:
            validation.taichi_function("contacts", self, "solve", "ball, time, iterations, impacts")
        super().bind(plan, *parts)
        own = vars(type(self))
        for name in vars(self).keys() & own.keys():
            if callable(own[name]) and not callable(vars(self)[name]):  # Quadrants keeps bound functions
                raise TypeError(f"contacts: {type(self).__name__}.{name} has the name of a field; call it otherwise")

    @ti.func
    def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
        """Change velocities so that nothing approaches; friction acts for `time` seconds. Without `impacts` only slow contacts
        are solved, so that velocities reported at the end of a step are at rest where balls rest."""

    @ti.func
    def relax(self, ball: ti.template(), time):
        """Take back, after a move that ends a step, what pushing out overlap added to velocities."""

    @ti.func
    def begin(self, ball: ti.template(), impacts: ti.template()):
        """Note the velocities that target speeds depend on, and start from what contacts have accumulated."""
        for part in ti.static(self.sticks_and_triangles):
            part.begin_contacts(ball, self, impacts)
        for i in range(self.n):
            self.velocity_before[i] = ball[i].v
            if ti.static(self.plan.loaded and not self.plan.impacts_in_turn):
                self.impacts[i] = 0
            if ti.static(self.plan.limits_energy and self.model.spins):
                self.spin_before[i] = self.state.spin[i]
            if ti.static(self.plan.walls):
                self.walls.begin(ball, self, i, impacts, True)
            if ti.static(self.plan.sticks and self.plan.warm_starts):
                p, t = self.sticks.gather(ball, self, i)
                self.apply(i, p, t)
            if ti.static(self.plan.pairs and self.plan.warm_starts):
                self.state.kick(i, self.warm_velocity[i])
                if ti.static(self.model.spins):
                    self.state.spin[i] = self.state.spin[i] + self.warm_spin[i]
                if ti.static(not impacts):
                    self.exclude_pairs(ball, i)

    @ti.func
    def exclude_pairs(self, ball: ti.template(), i):
        """Toggle warm_velocity[i] between the velocity of ball i without its pairs and the change that its pairs make.

        Call it before and after an iteration that takes back (LAST, RELAX): that leaves other impulses in the pairs, but moves
        nothing. The next solve, which starts from them, then needs no measuring.
        """
        if ti.static(self.plan.pairs and self.plan.warm_starts):
            self.warm_velocity[i] = ball[i].v - self.warm_velocity[i]
            if ti.static(self.model.spins):
                self.warm_spin[i] = self.state.spin[i] - self.warm_spin[i]

    @ti.func
    def gather_sticks_and_triangles(self, ball: ti.template(), i):
        """Impulse and angular impulse on ball i from all sticks and triangles."""
        p, t = ti.Vector.zero(float, self.model.dim), zero_scalar_in_2d(self.model.dim)
        for part in ti.static(self.sticks_and_triangles):
            push, angular = part.gather(ball, self, i)
            p += push
            t += angular
        return p, t

    @ti.func
    def solve_sticks_and_triangles(self, ball: ti.template(), time):
        """One iteration over sticks and triangles, always from old velocities."""
        if ti.static(self.plan.sticks or self.plan.triangles):
            for part in ti.static(self.sticks_and_triangles):
                part.solve_contacts(ball, self, time)
            for i in range(self.n):
                p, t = self.gather_sticks_and_triangles(ball, i)
                self.apply(i, p, t)

    @ti.func
    def solve_walls(self, ball: ti.template(), time):
        """One iteration over the walls and colliders on which balls rest, or in which they are."""
        if ti.static(self.plan.walls):
            for i in range(self.n):
                p, t = self.walls.gather(ball, self, i, time)
                self.apply(i, p, t)

    @ti.func
    def each_pair(self, ball: ti.template(), visit: ti.template()):
        """visit(ball, i, j, c) for each pair that touches or nearly does, in a fixed order but with contacts by atomics."""
        if ti.static(self.plan.pairs):
            pair_sweeps.each_ball(self, ball, pair_sweeps.own_pairs, None, 0.0, (visit, ()))

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
        if ti.static(self.model.spins):
            self.state.spin[i] = self.state.spin[i] + (self.model.spin_response(i) * w) * t

    def solving(self) -> list[Part]:
        """The parts that solve all contacts before a move."""
        return [Part(self, "_solve", STEP)] if self.active else []

    @ti.func
    def _solve(self, role: ti.template(), h, time):
        self.solve(self.state.ball, self.plan.friction_part * h, self.iterations, True)

    # Moving

    @ti.func
    def note_velocities(self):
        """Note the velocities of all balls where a method has no `before_move`, see note_velocity."""
        if ti.static(self.plan.loaded and not self.plan.impacts_in_turn):
            for i in range(self.n):
                self.note_velocity(i)

    @ti.func
    def note_velocity(self, i):
        """Note the velocity of ball i, which belongs to its place, before forces act on it."""
        if ti.static(self.plan.loaded and not self.plan.impacts_in_turn):
            self.velocity_when_found[i] = self.state.ball[i].v

    @ti.func
    def advance(self, ball: ti.template(), motion: ti.template(), h, time):
        """Kick all balls, solve their contacts, with friction for `time` seconds, and move them for h seconds. motion: the
        integrator, asked for its kicks and what forces do meanwhile."""
        self.stop(ball, motion, h, time)
        self.move(ball, motion, h)

    @ti.func
    def stop(self, ball: ti.template(), motion: ti.template(), h, time):
        """Kick all balls and solve their contacts, as `advance` does before it moves them."""
        if ti.static(self.active):
            if ti.static(motion.kicks_first):
                for i in range(self.n):
                    self.note_velocity(i)
                    motion.before_move(i, h)
            self.solve(ball, time, self.iterations, True)

    @ti.func
    def move(self, ball: ti.template(), motion: ti.template(), h):
        """Move all balls for h seconds with their present velocities, then find the contacts where they are."""
        self.displace(ball, motion, h)
        self.refresh(ball)

    @ti.func
    def displace(self, ball: ti.template(), motion: ti.template(), h):
        """Move all balls, and find no contacts yet. Without contacts the kick before the move needs no loop of its own."""
        self._correct_positions(ball, h)
        if ti.static(self.plan.walls and self.plan.triangles):
            surface_ways.bound(self.walls, ball, motion, h)
        for i in range(self.n):
            if ti.static(motion.kicks_first and not self.active):
                motion.before_move(i, h)
            shift, drift = self._way(ball, i, ball[i].v, motion.acceleration(i, h), h, motion.load(i, h))
            self.state.shift(i, shift)
            ball[i].v = drift
            motion.after_move(i, h)

    @ti.func
    def _way(self, ball: ti.template(), i, v, a, h, change):
        """Displacement of ball i over h, and its drift velocity v (mid-step, acceleration a) after impacts on walls. change:
        of v by forces in this step, where `a` does not say it."""
        shift = h * v
        drift = v
        if ti.static(self.plan.walls):
            if self.model.inverse_mass[i] > 0.0:  # nothing stops a driven pin
                shift, drift = self.walls.move(i, ball[i].x, v, a, h, change)
        if ti.static(self.plan.neighbours):
            ccd_balls.note_displacement(self, i, shift)  # what only undoes overlap goes through nothing
        if ti.static(self.corrects_positions):
            shift += self.position_correction[i]
        if ti.static(self.plan.neighbours):
            self.pairs.grid.watch(i, ball[i].x + shift)
        return shift, drift

    @ti.func
    def second_half(self, i, kick):
        """Second half of the step's kick of ball i [m/s], thrown back by the walls that it met in this step."""
        result = kick
        if ti.static(self.plan.reflects):
            result = impact.thrown_back(self.walls, i, kick)
        return result

    @ti.func
    def throw_back(self, h, forces: ti.template()):
        """Add what the second half of the step's kick by `forces` has more for balls that bounced off others in this step."""
        if ti.static(self.plan.throws_back):
            for i in range(self.n):
                struck_pairs.note_late_kick(self, i, struck_pairs.late_kick(self, i, forces.change(i, h)))
            struck_pairs.throw_back(self)

    @ti.func
    def throw_back_part(self, part, kick: ti.template(), foreseen: ti.template()):
        """Add what impacts of balls in this step throw back of a part of the kicks (n) of the second half; foreseen: beside what
        was known of them when the balls bounced."""
        if ti.static(self.plan.throws_back):
            for i in range(self.n):
                late = part * kick[i]
                if ti.static(foreseen):
                    late = struck_pairs.late_kick(self, i, 2.0 * late)
                struck_pairs.note_late_kick(self, i, late)
            struck_pairs.throw_back(self)

    @ti.func
    def bounced(self, i):
        """True if ball i has bounced in this step."""
        found = False
        if ti.static(self.plan.marks_bounces):
            found = struck_pairs.bounced(self, i)
        if ti.static(self.plan.reflects):
            found = found or self.walls.reflected[i].norm_sqr() > 0.0
        return found

    @ti.func
    def record_second_half(self, h, forces: ti.template()):
        """Record for probes what walls give beside the second half of the kick by `forces`."""
        if ti.static(self.plan.reflects):
            if ti.static(self.walls.probed):
                for i in range(self.n):
                    self.record_thrown_back(i, 0.5 * forces.change(i, h))

    @ti.func
    def record_thrown_back(self, i, kick):
        """Record for probes what walls give ball i beside a kick [m/s] of the second half."""
        if ti.static(self.plan.reflects):
            if ti.static(self.walls.probed):
                if self.model.inverse_mass[i] > 0.0:
                    impact.record_thrown_back(self.walls, i, kick)

    @ti.func
    def _correct_positions(self, ball: ti.template(), h):
        """The displacements that undo overlap where contacts are rigid. They move nothing on; but pairs that do not bounce
        and are solved in turn turn more slowly when they come further apart."""
        if ti.static(self.corrects_positions):
            of_pairs = ti.static(self.pushes_out_pairs)
            in_one = ti.static(self.plan.gathers)
            for i in range(self.n):
                d = ti.Vector.zero(float, self.model.dim)
                for part in ti.static(self.sticks_and_triangles):
                    d += part.correct_positions(ball, self, i, h)
                self.position_correction[i] = d
                if ti.static(in_one and of_pairs):
                    pair_sweeps.own_pairs(self, ball, i, h, (pair_solve.correct_position, (self, h)))
                if ti.static(in_one):
                    self._correct_at_walls(ball, i, h, None)
            walls = ti.static(self._correct_at_walls if self.plan.walls and not in_one else None)
            if ti.static(of_pairs and not in_one):
                correct = ti.static((pair_solve.correct_position, (self, h)))
                pair_sweeps.each_ball(self, ball, pair_sweeps.own_pairs, walls, h, correct)
            elif ti.static(walls):
                pair_sweeps.each_end(self, ball, walls, h, None)

    @ti.func
    def _correct_at_walls(self, ball: ti.template(), i, h, how: ti.template()):
        if ti.static(self.plan.walls):
            d = self.walls.correct_positions(ball, self, i, h)
            self.position_correction[i] = self.position_correction[i] + d
