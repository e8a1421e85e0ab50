"""Assembly: from a scene and settings to model, state, forces, contacts, integrator and drivers, with only what is needed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.accuracy import Setup
from taichi_sim.analysis.rebounds import AT_ONCE, IN_SWEEPS, IN_TURN
from taichi_sim.analysis.single_numbers import require_single
from taichi_sim.contacts import CONTACT_RULES, ContactRule
from taichi_sim.contacts.colliders import Colliders
from taichi_sim.contacts.distance_grid import distance_grids
from taichi_sim.contacts.found_contacts import ContactParts
from taichi_sim.contacts.grid import Grid
from taichi_sim.contacts.impulse_totals import Received
from taichi_sim.contacts.pairs import LISTED_GAP, Pairs
from taichi_sim.contacts.plan import plan_contacts, slowest_bounce
from taichi_sim.contacts.statistics import ContactStatistics
from taichi_sim.contacts.sticks import Sticks
from taichi_sim.contacts.triangles import TriangleContacts
from taichi_sim.contacts.walls import Walls
from taichi_sim.device.backend import Backend
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.shared_kernels import share_kernels
from taichi_sim.device.spatial_sort import in_order, spatial_order
from taichi_sim.device.state import State
from taichi_sim.forces.driven_pins import DrivenPins
from taichi_sim.forces.springs import Springs, fixed_order
from taichi_sim.forces.sum import TotalForce
from taichi_sim.forces.tearing import Tearing
from taichi_sim.integrators import BUILT_IN
from taichi_sim.kernels.contacts import contact_law, statistics
from taichi_sim.scene.motion import TICKS
from taichi_sim.scene.motors import Motor
from taichi_sim.scene.probes import bodies_of
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.choices import compensates, divides, is_serial, is_small, order_of_springs, rule_of, turning
from taichi_sim.simulation.contact_capacity import (
    NO_CAPACITY_KNOWN,
    PAIR_BYTES,
    ContactCapacity,
    enough_for,
    lacking,
    room_of,
    spare_bytes,
)
from taichi_sim.simulation.division import Beginning
from taichi_sim.simulation.drivers import Drivers
from taichi_sim.simulation.moments import KEPT, Moments, unnamed
from taichi_sim.simulation.settings import Settings
from taichi_sim.simulation.state_probe import StateProbe
from taichi_sim.simulation.step_doubling import SecondSolution

__all__ = ["Assembly"]

NOT_COMPILED = (
    "arguments",
    "h",
    "capacity",
    "backend",
    "_grids",
    "kernels",
)  # of an assembly, nothing that kernels read


APART = (Scene, Fields, Motor)  # nor that


class Assembly:
    """All parts of one simulation. h: seconds per substep; `set_step` changes it. on: those of another one, whose memory is freed
    once these are declared without an error; of the same structure, they take it over, with its kernels. kernels: key of
    these, "" where no others share them."""

    fields: Fields
    integrator: Any
    colliders: Colliders | None
    received: Received | None = None

    def __init__(
        self,
        scene: Scene,
        settings: Settings,
        backend: Backend,
        h: float,
        forces: Sequence[Any],
        capacity: ContactCapacity = NO_CAPACITY_KNOWN,
        on: "Assembly | None" = None,
    ) -> None:
        self.arguments = (scene, settings, backend, h, forces)
        self.backend, self.h = backend, h
        self.capacity = capacity
        cpu = backend.arch == "cpu"
        if backend.precision == "f32":
            require_single(scene)
        if settings.driver == "fused" and not cpu:
            raise ValueError(f"driver: 'fused' runs on one CPU thread; on {backend.arch} use 'parallel' or 'auto'")
        self._grids = distance_grids(scene)  # kernels cannot run while fields are being declared
        self.fields = Fields(backend.real, backend.has_wide_numbers, None if on is None else on.fields)
        owned = [(vars(force), dict(vars(force))) for force in forces if hasattr(force, "__dict__")]
        try:
            self._assemble(scene, settings, backend, h, forces)
            self.fields.build()
            self.kernels = share_kernels(self._compiled(), APART)
            self.integrator.set_step(h)
        except BaseException:
            self.fields.abandon()
            for present, before in owned:  # the user's forces may belong to another simulation, which goes on
                present.clear()
                present.update(before)
            raise

    def _compiled(self) -> dict[str, Any]:
        """Parts that kernels may read, by name."""
        return {name: part for name, part in vars(self).items() if name not in NOT_COMPILED}

    def _assemble(self, scene: Scene, settings: Settings, backend: Backend, h: float, forces: Sequence[Any]) -> None:
        """All parts in the order in which they need each other."""
        cpu = backend.arch == "cpu"
        custom_parts = (
            bool(forces) or type(settings.integrator) not in BUILT_IN or not isinstance(settings.contacts, str)
        )
        # they may know balls by their number
        order = None if custom_parts else spatial_order(scene)
        if order is not None:
            scene = in_order(scene, order)
        self.fused = cpu and is_serial(scene, settings, backend.threads)
        self.model = Model(scene, self.fields, self.fused)
        self.model.set_spinning(turning(scene, settings, forces))
        self.state = State(
            self.model, self.fields, compensated=compensates(scene, backend, settings.integrator), order=order
        )
        self.atomic = settings.accumulate == "atomic"
        self.parallel = settings.accumulate == "gather" or not (cpu or self.atomic)
        self.integrator = settings.integrator
        self.integrator.fit(scene)
        springs = self._springs(scene, cpu, h)
        self.forces = TotalForce(self.model, self.fields, springs, forces)
        self.forces.allocate(self.state, self.fields)
        self.contacts = self._contacts(scene, settings, h, cpu)
        self._statistics = ContactStatistics(self.fields, self.contacts) if self.contacts.active else None
        touching = self.contacts.parts if self.contacts.active else ()
        self.state_probe = StateProbe(
            self.model, self.state, springs, self.forces.stores, touching, self.fields, self.fused
        )
        self.pins = DrivenPins(self.model, self.state, self.fields) if scene.moving_pins else None
        self.tearing: Tearing | None = None
        if springs is not None and np.isfinite(scene.break_strain).any():
            solid = self.contacts.triangles if self.plan.triangles else None
            parts = [*self.forces.elements, *(solid.severed if solid else ())]
            builtin = type(settings.integrator) in BUILT_IN  # others may move balls without looking for contacts
            self.tearing = Tearing(self.model, springs, parts, self.fields, before_contacts=bool(solid) and builtin)
            if solid:
                solid.tearing = self.tearing
            self.state.followers.append(self.tearing)
        moves = self.colliders is not None and self.colliders.moves
        driven = (self.colliders if moves else None, self.pins, self.forces.motors)
        self.driven = [part for part in driven if part is not None]
        self.integrator.pins = self.pins
        self.integrator.bind(self.model, self.state, self.forces, self.contacts, self.fields)
        kind = Moments if settings.tolerance is None else SecondSolution
        self.moments = kind(self.state, self.integrator, self.contacts, self.fields, self.fused)
        self.beginning: Beginning | None = None
        if divides(settings, self.integrator, self.contacts):
            self.beginning = Beginning(self.state, self.integrator, self.contacts, self.fields, self.fused)
        size = scene.n_balls + scene.n_springs
        self.drivers = Drivers(self.integrator, self.pins, self.forces.motors, self.tearing, size)

    def _springs(self, scene: Scene, cpu: bool, h: float) -> Springs | None:
        if scene.n_springs == 0:
            return None
        fixed = fixed_order(self.model, cpu, is_small(scene))
        order = order_of_springs(scene, self.integrator, fixed, cpu=cpu, atomic=self.atomic, parallel=self.parallel)
        return Springs(self.model, self.fields, self.integrator.damping(self.model, h), order)

    def _contacts(self, scene: Scene, settings: Settings, h: float, cpu: bool) -> ContactRule:
        """The parts of the plan, bound to the rule that solves them."""
        rule = rule_of(settings, cpu)
        as_on_device = self.parallel and type(rule) in CONTACT_RULES.values()
        self.plan = plan_contacts(
            scene,
            rule,
            method=settings.integrator,
            custom_method=type(settings.integrator) not in BUILT_IN,  # it may move balls unseen
            extra_forces=bool(self.forces.extra),
            iterations=settings.iterations(scene, rule.in_turn),
            parallel=as_on_device,
            atomic=self.atomic or (settings.accumulate == "auto" and not cpu),  # blocks are too few for a GPU
            serial=self.fused,
        )
        plan, model, fields = self.plan, self.model, self.fields
        # fields, so that another step compiles nothing anew
        self.threshold = fields.reals(np.array([slowest_bounce(scene, h)])) if plan.active else None
        if plan.active:
            model.add_contact_fields()
        walls = pairs = sticks = triangles = None
        if plan.pairs:
            most = spare_bytes(self.backend, self.fields) // PAIR_BYTES
            gap = LISTED_GAP if plan.soft else 0.0
            grid = Grid(model, fields, plan.skin, gap, most, plan.gathers)
            pairs = Pairs(model, fields, grid, plan, self.capacity.pairs)
            sticks = Sticks(model, fields, pairs, self.capacity.sticks) if plan.sticks else None
            triangles = TriangleContacts(model, fields, pairs, self.capacity.triangles) if plan.triangles else None
        self.colliders = Colliders(model, fields, self._grids) if plan.colliders else None
        if plan.walls:
            walls = Walls(model, self.state, fields, plan, self.threshold, self.colliders)
            if walls.probed:
                self.received = walls.received
                self.state.followers.append(self.received)
        parts = ContactParts(walls, pairs, sticks, triangles)
        rule.bind(plan, model, self.state, fields, parts, self.threshold, h)
        return rule

    @property
    def setup(self) -> Setup:
        """Settings of the run that its accuracy depends on."""
        scene, settings, backend, _, _ = self.arguments
        contacts = self.contacts
        give = contact_law.SOFT_LEAK / (contact_law.SOFT_MASS * contact_law.SOFT_PUSH) if self.plan.soft else 0.0
        if contacts.split:  # masses in two parts, those of a ball between two others
            give *= 2.0 / contacts.relaxation
        rule = contacts.name if contacts.active else "off"
        rounds = compensates(scene, backend, settings.integrator)
        impacts = IN_TURN
        if self.plan.pairs and not self.plan.impacts_in_turn:
            impacts = AT_ONCE if contacts.split else IN_SWEEPS if contacts.in_turn else IN_TURN
        method, loses = settings.integrator.method, self.plan.limits_energy
        return Setup(method, self.h, backend.precision, rule, rounds, give, loses, impacts, self.plan.bounces)

    @property
    def torn(self) -> NDArray[np.bool_] | None:
        """(m,) springs that have torn; None where none can."""
        return None if self.tearing is None else self.tearing.springs_torn

    def names(self) -> list[str]:
        """Names of the parts that were compiled in."""
        driver = "driver.fused" if self.fused else "driver.parallel"
        return [driver, f"integrator.{self.integrator.method}", *self.forces.names(), *self.contacts.names()]

    def prime(self, h: float, time: float) -> None:
        """Forces and contacts at the present positions."""
        self._load(0, h, time)
        self.drivers.prime(h, time, self.fused)

    def run(self, first: int, substeps: int, h: float, time: float) -> None:
        """Advance the fields by substeps number `first` on, of those from `time` on, where they were primed; all before have been
        run. `prime` has compiled the fused driver; the parallel one compiles with its first substep."""
        if not self.driven:
            self.drivers.run(first, substeps, h, time, self.fused)
            return
        end = first + substeps
        while True:
            block = first // TICKS
            if block != self._block and first < end:
                self._load(block, h, time)
            now = min(end, (block + 1) * TICKS)
            self.drivers.run(first, now - first, h, time, self.fused)
            if now == end:
                return
            first = now

    def _load(self, block: int, h: float, time: float) -> None:
        """Work out how pins, colliders and motors move in a block of TICKS substeps."""
        self._block = block
        for part in self.driven:
            part.load(time, h, block * TICKS)

    def set_step(self, h: float, *, anew: bool = False, holds: bool = True) -> None:
        """Take substeps of h seconds from now on; nothing is compiled, and `prime` is due. What is fitted to a step is fitted
        anew: the stages of strong damping, the rate at which overlap is left, the impulses that contacts hold. The speed
        below which nothing bounces stays that of the step that the simulation began with, a law of the scene and not of the
        method, unless it begins `anew`. holds: what contacts hold belongs to the step before."""
        if anew:
            scene, settings, backend, _, forces = self.arguments
            self.arguments = (scene, settings, backend, h, forces)
            if self.threshold is not None:
                self.threshold[0] = slowest_bounce(scene, h)
        if h == self.h:
            return
        if self.forces.springs is not None and self.integrator.implicit_damping:
            self.forces.springs.set_damping(self.integrator.damping(self.model, h))
        self.integrator.set_step(h)
        if holds:
            self.contacts.set_step(h, h / self.h)
        elif self.contacts.active:
            self.contacts.rate[0] = 1.0 / h
        self.h = h

    def contact_statistics(self) -> NDArray[np.float64]:
        """Tally (statistics.SIZE,) of all contacts, see kernels.contacts.statistics, with the user's number of the ball; they
        must be active."""
        assert self._statistics is not None
        totals = self._statistics.look(self.state.ball)
        if self.state.order is not None:
            totals[statistics.BALL] = self.state.order[int(totals[statistics.BALL])]
        return totals

    def impulses(self) -> NDArray[np.float64]:
        """(b, dim) N s that walls and colliders have received since the start, those of `probes.bodies_of`."""
        scene = self.arguments[0]
        if self.received is None or not scene.n_balls:
            return np.zeros((len(bodies_of(scene)), scene.dim))
        return self.received.value()

    def snapshot(self) -> Snapshot:
        """The state of all parts."""
        state = self.state
        low = state.rounded_off or (None, None)
        return Snapshot(
            position=state.position,
            velocity=state.velocity,
            low_position=low[0],
            low_velocity=low[1],
            surface_speed=state.surface_speed,
            torn=self.torn,
            impulses=self.impulses(),
        )

    def resume(self, from_: Snapshot) -> None:
        """Put the state back; `prime` is due."""
        x, v = from_.low_position, from_.low_velocity
        self.state.write(from_.position, from_.velocity, None if x is None or v is None else (x, v))
        self.state.write_spin(from_.surface_speed)
        if self.tearing is not None:
            self.tearing.tear(from_.torn)
        if self.received is not None:
            self.received.set(from_.impulses)

    def stored(self) -> dict[str, NDArray]:
        """All that a run is begun anew from, by names of its own, for `put_back`."""
        return self.moments.arrays() | self._followed()

    def _followed(self) -> dict[str, NDArray]:
        """Arrays that the followers of the state keep, by name."""
        return {name: values for part in self.state.followers for name, values in part.stored().items()}

    def check(self, stored: Mapping[str, NDArray], h: list[float]) -> None:
        """Raise ValueError or KeyError where that is not what `stored` gives here, h: `moments.h`."""
        self.moments.prepared(stored, h)
        for name, values in self._followed().items():
            unnamed(name, values, stored)

    def put_back(self, stored: Mapping[str, NDArray], h: list[float]) -> None:
        """Restore what `stored` gave, checked; a moment has to be loaded then."""
        self.moments.write(stored, h)
        for part in self.state.followers:
            part.put_back(stored)

    def searches(self) -> int:
        """Number of searches for neighbours so far."""
        pairs = self.contacts.pairs
        return 0 if pairs is None else int(pairs.grid.searches[0])

    def lacking(self) -> ContactCapacity | None:
        """Capacity that contact lists need where one overflowed since the last call, else None."""
        return lacking(self.contacts, self.capacity)

    def with_capacity(self, needed: ContactCapacity) -> "Assembly":
        """Return a copy, compiled anew, with lists for what is needed and half as much again, see `with_room`. Raises
        SceneError, and changes nothing, where there is no memory for them."""
        again = self.capacity != NO_CAPACITY_KNOWN
        return self.with_room(enough_for(needed, self.contacts, again, spare_bytes(self.backend, self.fields)))

    def with_room(self, capacity: ContactCapacity) -> "Assembly":
        """Return a copy with contact lists of at least so many entries, and free this one. What is stored in moments,
        positions, velocities and spin are copied; what contacts hold at present is not: a moment has to be loaded before a
        step."""
        snapshot, stored, h = self.snapshot(), self.moments.arrays(), self.moments.h
        self.free()
        larger = Assembly(*self.arguments, capacity=capacity)
        larger.set_step(self.h)
        larger.resume(snapshot)
        if h[KEPT] > 0.0:  # else nothing was stored yet
            larger.moments.write(stored, h)
        larger.moments.h = h
        return larger

    @property
    def order_of_sums(self) -> str:
        """Order in which impulses are added: runs that differ in it differ in the last digits."""
        contacts = "atomic" if self.plan.atomic else "gather" if self.plan.gathers else "blocks"
        springs = self.forces.springs
        return contacts if springs is None else f"{contacts} {springs.order}"

    @property
    def room(self) -> ContactCapacity:
        """Entries that there is room for; 0 of what is missing."""
        return room_of(self.contacts)

    def free(self) -> None:
        """Give all memory back."""
        self.fields.free()
