"""Velocity Verlet, with spring damping at predicted velocities, or, where it is strong, together with the kick."""

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from taichi_sim.analysis.damping import predicts_damping
from taichi_sim.analysis.methods import VERLET
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.parts import BOTH, PRIME, STEP, Part
from taichi_sim.forces.driven_pins import DrivenPinSlopes
from taichi_sim.integrators.base import Integrator
from taichi_sim.integrators.damped_kick import DampedKick
from taichi_sim.scene.scene import Scene

__all__ = ["Verlet"]


@ti.data_oriented
class Verlet(Integrator):
    """Order 2. Undamped: K(h/2) A(h) K(h/2), K the kick, A the drift; stable for omega h < 2. With contacts a substep is half a
    kick by the forces at hand, a solve of contacts, the move (which stops at what is met and finds contacts anew), forces, the
    other half of the kick, and a short solve for what rests.

    Weak damping, see `damping.predicts_damping`, acts with all other forces at the velocities v + h a, a from the step before:
    one pass over the springs, order 2. Eliminating v, x(t+h) - 2 x + x(t-h) = h^2 a with the second backward difference of x as
    the velocity in a; on the circle of stability its damping is real at -1 alone, so it is stable just where
    h^2 lambda(K + 4 D / h) < 4 (masses left out).

    Strong damping: B(h/2) A(h) B(h/2), B the kick and the damping together, v' = W (F - D v) at the same F, see
    taichi_sim.analysis.damping: exact for lone springs, else of order 2 by stages, each a pass over the springs. Damping apart
    from the kick would stop for good what creeps: exp(-h D) takes all that the kick gave. With R the part of a velocity that both
    halves of a step leave, the velocities u between the places x obey H (u+ - u) / h + D (u+ + u) / 2 + K x = 0 with
    H = (h D / 2) (1 + R) / (1 - R): leapfrog with a mass H, at least that of the balls where R >= (1 - h D / 2) / (1 + h D / 2),
    as it is here. So it is stable for omega h < 2 at least, whatever the damping.
    """

    method = VERLET
    relaxes = True
    friction_part = 0.5
    reflects = True
    late_part = 1.0

    def fit(self, scene: Scene) -> None:
        """Choose how damping acts."""
        self.predicts = predicts_damping(scene)
        self.implicit_damping = not self.predicts

    def damping(self, model: Model, h: float) -> NDArray:
        """Damping of networks, as far as stages are stable with it; that of lone springs acts by itself."""
        return DampedKick.damping(model.scene, h) if self.implicit_damping else model.scene.damping

    def allocate(self, fields: Fields) -> None:
        """`pull` [m/s^2]: what acted at the end of the step before, where it depends on velocities."""
        self.predicts = self.predicts or (bool(self.forces.extra) and not self.forces.damped)
        self.driven = self.predicts and self.pins is not None
        self.meets_pins = self.contacts.active and self.pins is not None
        self.splits = self.forces.damped and not self.predicts
        self.delayed = self.splits and bool(self.forces.extra)
        self.kicks_first = not self.splits
        self.pull = fields.vectors(self.model.n if self.predicts or self.delayed else 0, self.model.dim)
        self.kick: Any = None
        if self.splits:
            self.kick = DampedKick(self.model, self.state, self.forces, self.contacts, fields)
        self.network = self.splits and self.kick.network
        self.has_corners = self.network and self.pins is not None
        if self.has_corners:
            assert self.forces.springs is not None
            self.corners = DrivenPinSlopes(self.model, self.state, self.pins, self.forces.springs, fields)
        self.hosted = self.network

    def set_step(self, h: float) -> None:
        """Stages of damping for substeps of h seconds."""
        if self.splits:
            self.kick.fit(h)

    def memory(self) -> list[Any]:
        """Fields of what acted at the end of the step before: at the velocities that balls had then, not those they came to;
        and how strong damping braked them."""
        own = [self.pull] if self.predicts or self.delayed else []
        return [*own, self.kick.brake] if self.network else own

    def parts(self) -> list[Part]:
        """Half kick, contacts, drift, forces, half kick, contacts. With damping in stages `launches` run `move_parts`."""
        first = last = []
        if self.network:
            first, last = [Part(self, "_first_stages", STEP)], [Part(self, "_last_stages", STEP)]
        half = [Part(self, "_end_first_half", STEP)] if self.splits else []
        drift = [Part(self, "_drift", STEP)] if self.predicts and not self.contacts.active else self.moving()
        flexed = self.predicts or self.forces.flexes
        before = [Part(self, "_before_forces", STEP)] if flexed else []
        forces = [*before, Part(self, "_sum_forces", BOTH), Part(self, "_after_forces", STEP)]
        remembered = [Part(self, "_note_start", PRIME)] if self.network or self.predicts or self.delayed else []
        self.move_parts = (*half, *drift, *forces)
        self.prime_parts = tuple(remembered)
        return [*first, *self.move_parts, *last, Part(self, "_close", STEP), *remembered, Part(self, "_hold", STEP)]

    @property
    def launched_parts(self) -> Sequence[Part]:
        """The parts between the stages of damping."""
        return (*self.move_parts, *self.prime_parts)

    @ti.func
    def _note_start(self, role: ti.template(), h, time):
        if ti.static(self.network):
            self.kick.prime(h)
        if ti.static(self.predicts or self.delayed):
            self._note_pull(h)

    @ti.func
    def _note_pull(self, h):
        for i in range(self.model.n):
            self.pull[i] = self.forces.change(i, h) / h

    @ti.func
    def _hold(self, role: ti.template(), h, time):
        """The contacts after the second half kick, whose friction brings balls to what driven pins do next."""
        if ti.static(self.meets_pins):
            self.pins.look_ahead()
        self.contacts.solve(self.ball, 0.5 * h, 1, False)
        if ti.static(self.meets_pins):
            self.pins.set_velocities(False)

    @ti.func
    def _first_stages(self, role: ti.template(), h, time):
        self._open(h)
        for j in range(1, self.kick.count[0]):
            self.kick.stage(0, j, h, self.pull, self.delayed)

    @ti.func
    def _last_stages(self, role: ti.template(), h, time):
        for j in range(1, self.kick.count[1]):
            self.kick.stage(1, j, h, self.pull, False)

    def advance(self, number: int, h: float, time: float) -> None:
        """Advance by substep `number` of those of h seconds from `time` on, from the host, because the number of stages is not
        known when loops are compiled."""
        before, after = (int(count) for count in self.kick.counts)
        self._launch_open(h)
        for j in range(1, before):
            self._launch_stage(0, j, h)
        self.launches.run(STEP, number, h, time)
        for j in range(1, after):
            self._launch_stage(1, j, h)
        self._launch_close(h)

    @ti.kernel
    def _launch_open(self, h: float):
        self._open(h)

    @ti.kernel
    def _launch_stage(self, half: ti.template(), j: int, h: float):
        self.kick.stage(half, j, h, self.pull, ti.static(self.delayed and half == 0))

    @ti.kernel
    def _launch_close(self, h: float):
        self._close(STEP, h, 0.0)
        self._hold(STEP, h, 0.0)

    @ti.func
    def before_move(self, i, h):
        """Half a kick, where damping does not make it."""
        if ti.static(self.predicts):
            self.state.kick(i, 0.5 * h * self.pull[i])
        else:
            self.state.kick(i, 0.5 * self.forces.change(i, h))

    @ti.func
    def acceleration(self, i, h):
        """Acceleration of ball i [m/s^2] by the forces at the start of the step."""
        if ti.static(self.predicts):
            return self.pull[i]
        else:
            return self.forces.change(i, h) / h

    @ti.func
    def _open(self, h):
        """The first stage of the half before the drift."""
        self.contacts.note_velocities()
        self.forces.springs.damp(self.ball, self.forces.damping_impulse, 0.5 * h)
        self.kick.start(0, h, self.pull, self.delayed)

    @ti.func
    def _end_first_half(self, role: ti.template(), h, time):
        if ti.static(not self.network):
            self.contacts.note_velocities()
            self.kick.undamped(0, h, self.pull, self.delayed)
        self.kick.lone_springs(0, h, self.pull, self.delayed)

    @ti.func
    def _drift(self, role: ti.template(), h, time):
        """Drift with the whole kick of old forces, half of it before the drift, where nothing is in the way."""
        for i in range(self.model.n):
            change = h * self.pull[i]
            self.state.shift(i, h * (self.ball[i].v + 0.5 * change))
            self.state.kick(i, change)

    @ti.func
    def _before_forces(self, role: ti.template(), h, time):
        """Predicted velocities, and springs as they are at the end of the step."""
        if ti.static(self.predicts and self.contacts.active):
            for i in range(self.model.n):
                self.state.kick(i, self.contacts.second_half(i, 0.5 * h * self.pull[i]))
        if ti.static(self.driven):  # what acts here acts half in this step and half in the next
            self.pins.set_velocities(True)
        self.forces.flex(1.0)

    @ti.func
    def _sum_forces(self, role: ti.template(), h, time):
        """The forces at the end of a step, or where it starts."""
        at = time + ti.select(role == STEP, h, 0.0)
        if ti.static(self.predicts):
            self.forces.total(self.ball, h, at)
        elif ti.static(self.network):
            self.forces.elastic_and_damping(self.ball, h, 0.5 * h, at)
        else:
            self.forces.elastic(self.ball, h, at)

    @ti.func
    def _after_forces(self, role: ti.template(), h, time):
        """The second half kick, or its first stage; or half of what the forces differ by from those predicted."""
        if ti.static(self.driven):
            self.pins.set_velocities(False)
        self.contacts.record_second_half(h, self.forces)
        self.contacts.throw_back(h, self.forces)
        if ti.static(self.predicts):
            for i in range(self.model.n):
                a = self.forces.change(i, h) / h
                self.state.kick(i, self.contacts.second_half(i, 0.5 * h * (a - self.pull[i])))
                self.pull[i] = a
        elif ti.static(self.network):
            self.kick.start(1, h, self.pull, False)
            if ti.static(self.has_corners):
                self.corners.renew(self.kick.brake)
        elif ti.static(self.splits):
            self.kick.undamped(1, h, self.pull, False)
        else:
            for i in range(self.model.n):
                self.state.kick(i, self.contacts.second_half(i, 0.5 * self.forces.change(i, h)))

    @ti.func
    def _close(self, role: ti.template(), h, time):
        """The end of the second half where it is damped."""
        if ti.static(self.splits):
            self.kick.lone_springs(1, h, self.pull, False)
            if ti.static(self.delayed):
                self._note_pull(h)
