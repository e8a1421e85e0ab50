"""Base of all integrators."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from numpy.typing import NDArray

from taichi_sim.analysis.damping import keep_energy
from taichi_sim.analysis.methods import Method
from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.contacts.base import ContactRule
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.parts import PRIME, STEP, Launches, Part, run_parts
from taichi_sim.device.state import State
from taichi_sim.forces.sum import TotalForce
from taichi_sim.scene.scene import Scene

__all__ = ["Integrator", "SolverStatistics"]


class SolverStatistics(NamedTuple):
    """Quality of an implicit method's solutions since the simulation was made. `worst`: the largest part of the impulses of a
    stage that was left over, or of the kinetic energy that this gave it; `misses`: stages where it was more than ten times the
    tolerance; `passes`: over all springs."""

    tolerance: float
    stages: int
    passes: int
    worst: float
    misses: int


@ti.data_oriented
class Integrator:
    """One method. `method`: what it declares of itself, its name, order and stability limit among it.

    `relaxes`: its substep ends with an iteration over contacts that takes back what soft contacts add to velocities when they
    push out overlap; without it contacts are rigid. `reflects`: its second half of the kick goes through `contacts.second_half`.
    `late_part`: of the kick before the move, which is not yet in the velocities that belong to the places where it starts.
    `implicit_damping`: what `damping` gives depends on the step. `each_once`: it goes through the springs itself, each once, see
    kernels.springs.edge_blocks; `in_turn`: each sees what those before it changed. `hosted`: a substep has loops that end by what
    they find; `advance` runs one from the host, kernel by kernel, because inside a kernel only the outermost loops run in
    parallel. `allocate` may add fields of the method's own. `pins`: moving ones, or None. `kicks_first`: whether `before_move`
    does anything. `friction_part`: of a step, for which friction acts where `moving` solves contacts, or pairs bounce.

    A method has a `substep` and, where that expects more of the one before than contacts, a `prime`; or `parts` in place of both,
    each of which is compiled by itself where a kernel runs on one thread.
    """

    method = Method("user-defined")
    relaxes = False
    reflects = False
    late_part = 0.5
    implicit_damping = False
    each_once = False
    in_turn = False
    hosted = False
    pins: Any = None
    friction_part = 1.0

    def fit(self, scene: Scene) -> None:
        """Choose what depends on the scene. Called first of all."""

    def refines(self, scene: Scene) -> bool:
        """True if steps of that scene read what rounding took from places."""
        return keep_energy(scene)

    def damping(self, model: Model, h: float) -> NDArray:
        """Spring damping (m,) [N s/m] as this method wants it for substeps of h seconds."""
        return model.scene.damping

    def set_step(self, h: float) -> None:
        """Substeps have h seconds from now on; called once the fields are there, and for each new step. Damping is set too."""

    def bind(self, model: Model, state: State, forces: TotalForce, contacts: ContactRule, fields: Fields) -> None:
        """Take the parts of a simulation. Called once, before the fields exist."""
        self.model, self.state, self.forces, self.contacts = model, state, forces, contacts
        self.ball = state.ball
        self.kicks_first = type(self).before_move is not Integrator.before_move
        self.allocate(fields)
        self.recipe = tuple(self._recipe())
        if self.runs_from_host:
            self.launches = Launches(self.launched_parts)

    @property
    def runs_from_host(self) -> bool:
        """True if `advance` runs a substep on many threads: where it is hosted, and no class derived from that which gives
        `advance` has a substep of its own."""
        order = type(self).__mro__
        own = next(k for k, kind in enumerate(order) if {"parts", "substep"} & vars(kind).keys())
        return self.hosted and own >= next(k for k, kind in enumerate(order) if "advance" in vars(kind))

    def parts(self) -> list[Part]:
        """The parts of a substep, and of what makes the state that it starts from; none where `substep` and `prime` are given.
        Called once the method is bound."""
        return []

    @property
    def launched_parts(self) -> Sequence[Part]:
        """The parts that run by `launches` where `advance` runs a substep: some of it, and all that makes the state that it
        starts from."""
        return self.recipe

    def _recipe(self) -> list[Part]:
        """The parts, or, where a class derived from theirs has a substep of its own, that as a whole."""
        given = next(kind for kind in type(self).__mro__ if {"parts", "substep", "prime"} & vars(kind).keys())
        if given is not Integrator and "parts" in vars(given):
            self.own_parts = tuple(self._checked(self.parts()))
            return list(self.own_parts)
        self.own_parts = tuple(self.parts())
        return [Part(self, "_whole", STEP), Part(self, "_whole_prime", PRIME)]

    def _checked(self, parts: Any) -> list[Part]:
        """The parts that `parts()` gave. Raises SceneError, which names the one that is none."""
        where = f"integrator {type(self).__name__}.parts()"
        if not isinstance(parts, (list, tuple)) or not parts:
            raise SceneError(where, parts, "a list of Part, of at least one")
        for k, part in enumerate(parts):
            if not isinstance(part, Part):
                raise SceneError(f"{where}[{k}]", part, "a Part(owner, name, roles)")
            validation.taichi_function(f"{where}[{k}]", part.owner, part.name, "role, h, time")
        return list(parts)

    def moving(self) -> list[Part]:
        """The parts that kick balls, solve their contacts, move them, and find the contacts where they are then."""
        kicks = [Part(self, "_kick_first", STEP)] if self.kicks_first and self.contacts.active else []
        return [*kicks, *self.contacts.solving(), Part(self, "_displace", STEP), *self.contacts.finding()]

    @ti.func
    def _kick_first(self, role: ti.template(), h, time):
        for i in range(self.model.n):
            self.contacts.note_velocity(i)
            self.before_move(i, h)

    @ti.func
    def _displace(self, role: ti.template(), h, time):
        self.contacts.displace(self.ball, self, h)

    @ti.func
    def _relax(self, role: ti.template(), h, time):
        self.contacts.relax(self.ball, 0.0)

    @ti.func
    def _hold(self, role: ti.template(), h, time):
        self.contacts.solve(self.ball, 0.5 * h, 1, False)

    @ti.func
    def _whole(self, role: ti.template(), h, time):
        self.substep(h, time)

    @ti.func
    def _whole_prime(self, role: ti.template(), h, time):
        self.prime(h, time)

    def allocate(self, fields: Fields) -> None:
        """Declare fields of the method's own."""

    def solver_report(self) -> SolverStatistics | None:
        """Statistics of how well equations were solved; None where a method solves none."""
        return None

    def counters(self) -> list[Any]:
        """Tables (1) of the method's own that say what it did so far."""
        return []

    def memory(self) -> list[Any]:
        """Fields (n) of the method's own that one step hands to the next and `prime` does not make anew."""
        return []

    def remembers(self) -> bool:
        """True if the memory holds what a step left, and not what `prime` made."""
        return True

    def recall(self) -> None:
        """The memory holds what a step left; called after `prime`."""

    # What `contacts.advance` and `contacts.move` ask of each ball in the course of a step; a method overrides what it has.

    @ti.func
    def before_move(self, i, h):
        """Kick of ball i before contacts are solved and it moves."""

    @ti.func
    def acceleration(self, i, h):
        """Acceleration [m/s^2] of ball i while it moves, through its velocity in the middle of the step; here it moves evenly."""
        return ti.Vector.zero(float, self.model.dim)

    @ti.func
    def load(self, i, h):
        """Velocity [m/s] that forces added to ball i in this step, where `acceleration` does not tell it: speed into a wall
        that is no impact."""
        return ti.Vector.zero(float, self.model.dim)

    @ti.func
    def after_move(self, i, h):
        """Kick of ball i once it has moved with the velocity that it had."""

    @ti.func
    def substep(self, h, time):
        """One substep of h seconds that begins at `time`."""
        run_parts(self.own_parts, STEP, h, time)

    @ti.func
    def prime(self, h, time):
        """Make what a substep expects from the one before: here, where no parts do, the contacts at the present positions."""
        if ti.static(len(self.own_parts) > 0):
            run_parts(self.own_parts, PRIME, h, time)
        else:
            self.contacts.prime(self.ball)
