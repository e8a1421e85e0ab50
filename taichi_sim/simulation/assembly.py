"""Assembly: from a scene and settings to model, state, forces, contacts, integrator and drivers, with only what is needed."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.accuracy import Setup
from taichi_sim.analysis.rebounds import AT_ONCE, IN_SWEEPS, IN_TURN
from taichi_sim.analysis.touching import may_collide
from taichi_sim.common import memory
from taichi_sim.common.errors import SceneError
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
from taichi_sim.device.devices import find
from taichi_sim.device.engine import another
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.shared_kernels import share_kernels
from taichi_sim.device.spatial_sort import in_order, spatial_order
from taichi_sim.device.state import State
from taichi_sim.forces.driven_pins import DrivenPins
from taichi_sim.forces.element import Element
from taichi_sim.forces.spring_colours import MOST_COLOURS
from taichi_sim.forces.springs import Springs, fixed_order
from taichi_sim.forces.sum import TotalForce
from taichi_sim.forces.tearing import Tearing
from taichi_sim.integrators import BUILT_IN
from taichi_sim.kernels.contacts import contact_law, statistics
from taichi_sim.kernels.contacts.pairs import ENDLESS
from taichi_sim.scene.motion import TICKS
from taichi_sim.scene.motors import Motor
from taichi_sim.scene.probes import bodies_of
from taichi_sim.scene.scene import Scene, used_materials
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.drivers import Drivers
from taichi_sim.simulation.moments import KEPT, Moments, unnamed
from taichi_sim.simulation.settings import Settings
from taichi_sim.simulation.state_probe import StateProbe
from taichi_sim.simulation.step_doubling import SecondSolution

__all__ = ["Assembly", "compensates"]

# balls + springs and their like, up to which one thread is faster than two. A substep that looks for contacts has some fifty
# parallel loops, which two threads take 1.2 ms to begin: a jelly of 24 000 takes 0.5 ms fused, 1.5 ms on two threads
FUSED_UP_TO, FUSED_WITH_SEARCH = 20_000, 60_000
SEARCHED = 2  # added for each ball there: 20 000 balls alone
FINEST_ROUNDING = 1e-11  # of a radius: rounding of positions that adds up to 1e-9 in some thousand steps
MEMORY_SHARE = 0.5  # of what the machine has free, or a GPU has in all: the most that lists of contacts may grow to
GPU_MEMORY = 1 << 30  # bytes, the same where a GPU does not say what it has
PAIR_BYTES = 64  # about what a listed pair takes
# made, in units of what was found too much: once, and if that happens again
SPARE_CAPACITY, LARGE_SPARE_CAPACITY = 1.5, 4.0
NOT_COMPILED = (
    "arguments",
    "h",
    "capacity",
    "backend",
    "_grids",
    "kernels",
)  # of an assembly, nothing that kernels read


APART = (Scene, Fields, Motor)  # nor that


class ContactCapacity(NamedTuple):
    """Entries that contacts are known to need: links of pairs, rows of sticks and of triangles."""

    pairs: int = 0
    sticks: int = 0
    triangles: int = 0


NO_CAPACITY_KNOWN = ContactCapacity()


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
        self.model = Model(scene, self.fields)
        self.model.set_spinning(turning(scene, settings, forces))
        small = _is_small(scene)
        self.state = State(
            self.model, self.fields, compensated=compensates(scene, backend, settings.integrator), order=order
        )
        self.fused = cpu and _is_serial(scene, settings, backend.threads)
        self.atomic = settings.accumulate == "atomic"
        self.parallel = settings.accumulate == "gather" or not (cpu or self.atomic)
        self.integrator = settings.integrator
        self.integrator.fit(scene)
        springs = self._springs(scene, cpu, small, h)
        self.forces = TotalForce(self.model, self.fields, springs, forces)
        self.forces.allocate(self.state, self.fields)
        self.contacts = self._contacts(scene, settings, h, cpu)
        self._statistics = ContactStatistics(self.fields, self.contacts) if self.contacts.active else None
        self.state_probe = StateProbe(self.model, self.state, springs, self.forces.stores, self.fields, self.fused)
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
        size = scene.n_balls + scene.n_springs
        self.drivers = Drivers(self.integrator, self.pins, self.forces.motors, self.tearing, size)

    def _springs(self, scene: Scene, cpu: bool, small: bool, h: float) -> Springs | None:
        if scene.n_springs == 0:
            return None
        once = self.integrator.each_once  # in blocks, padded or not; a GPU has more threads than there are
        coloured = once and self.integrator.in_turn and np.bincount(scene.pairs.ravel()).max() <= MOST_COLOURS // 2
        order = fixed_order(self.model, cpu, small)
        if self.atomic:
            order = "atomic"
        elif once and self.parallel and not self.integrator.in_turn:
            order = "ends"
        elif coloured and (self.parallel or not cpu):  # ordered alike on both
            order = "colours"
        elif once and not cpu:
            order = "atomic"
        elif once and order == "gather":
            order = "blocks"
        elif self.integrator.in_turn and order == "padded":
            order = "batches"
        return Springs(self.model, self.fields, self.integrator.damping(self.model, h), order)

    def _contacts(self, scene: Scene, settings: Settings, h: float, cpu: bool) -> ContactRule:
        """The parts of the plan, bound to the rule that solves them."""
        rule = self._rule(settings, cpu)
        as_on_device = self.parallel and type(rule) in CONTACT_RULES.values()
        self.plan = plan_contacts(
            scene,
            rule,
            relaxes=settings.integrator.relaxes,
            reflects=settings.integrator.reflects,
            late_part=settings.integrator.late_part,
            friction_part=settings.integrator.friction_part,
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
            most = self._spare_bytes() // PAIR_BYTES
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

    def _rule(self, settings: Settings, cpu: bool) -> ContactRule:
        """A fixed order of pairs is what Gauss-Seidel is made of; atomics take all at once. It needs half the iterations, and
        impacts one by one, which need the blocks of a CPU, keep the energy of what bounces."""
        ordered = cpu and settings.accumulate in ("auto", "ordered")
        rule = settings.contacts
        if isinstance(rule, str):
            rule = CONTACT_RULES[("gauss_seidel" if ordered else "jacobi") if rule == "auto" else rule]()
        if rule.in_turn and not ordered:
            atomic = cpu or settings.accumulate == "atomic"
            why = f"accumulate: {settings.accumulate!r}" if atomic else "a GPU"
            raise SceneError(
                "contacts",
                says=f"{rule.name!r} changes velocities in a fixed order, which {why} does not have; use 'jacobi' or 'sum'"
                + (", or accumulate 'ordered'" if cpu else ""),
            )
        return another(rule)  # one object may serve several simulations

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
        n = len(from_.position)
        x, v = from_.low_position, from_.low_velocity
        self.state.write(from_.position, from_.velocity, None if x is None or v is None else (x, v))
        speed = from_.surface_speed
        self.state.write_spin(np.zeros((n, 1 if self.model.dim == 2 else 3)) if speed is None else speed)
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
        """Entries that contacts need where they did not all fit since the last call, else None."""
        found = {}
        for name in ContactCapacity._fields:
            part = getattr(self.contacts, name)
            if part is not None and (entries := int(part.overflow[0])) > part.capacity:
                part.overflow[0] = 0
                found[name] = entries
        return self.capacity._replace(**found) if found else None

    def with_capacity(self, needed: ContactCapacity) -> "Assembly":
        """Return a copy, compiled anew, with lists for what is needed and half as much again, see `with_room`. Raises
        SceneError, and changes nothing, where that takes more than MEMORY_SHARE of the free memory, or more entries than
        numbers of 32 bits count."""
        enough = {}
        for name in ContactCapacity._fields:
            part, entries = getattr(self.contacts, name), getattr(needed, name)
            if part is not None and entries > part.capacity:
                if entries == ENDLESS:
                    raise SceneError(self._endless())
                limit = max(part.capacity, int(min(part.most, self._spare_bytes() // part.bytes_each)))
                if entries > limit:
                    raise SceneError(
                        f"contacts: {part.what} need {entries} entries, but there is memory for {limit}"
                        f" ({limit * part.bytes_each / 2**30:.3g} GiB): too many balls lie in each other"
                    )
                spare = SPARE_CAPACITY if self.capacity == NO_CAPACITY_KNOWN else LARGE_SPARE_CAPACITY
                entries = min(limit, int(spare * entries))
            enough[name] = entries
        return self.with_room(ContactCapacity(**enough))

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
        parts = (getattr(self.contacts, name) for name in ContactCapacity._fields)
        return ContactCapacity(*(0 if part is None else part.capacity for part in parts))

    def _endless(self) -> str:
        """Message for a scene where counting itself would take too long."""
        pairs = self.contacts.pairs
        assert pairs is not None
        width = pairs.grid.widest
        return (
            f"contacts: {float(pairs.grid.most_crowded_pairs[0]):.2g} pairs of balls lie in the same cells, up to {width:.3g} m"
            f" wide, but there is memory for {float(pairs.grid.pair_limit[0]):.2g}: too many balls lie in each other"
        )

    def _spare_bytes(self) -> int:
        """Bytes that lists of contacts may take."""
        if self.backend.arch != "cpu":
            device = find(self.backend.arch)
            return int(MEMORY_SHARE * device.memory) if device is not None and device.memory else GPU_MEMORY
        return int(MEMORY_SHARE * (memory.available() + self.fields.bytes))

    def free(self) -> None:
        """Give all memory back."""
        self.fields.free()


def _size(scene: Scene) -> int:
    """Work of a substep: balls and springs, and elements by what they take of these."""
    elements = 4 * (len(scene.cells) + len(scene.bends)) + 2 * len(scene.membranes) + 16 * len(scene.bricks)
    elements += 8 * len(scene.solids)
    return scene.n_balls + scene.n_springs + elements


def _is_small(scene: Scene) -> bool:
    return _size(scene) <= FUSED_UP_TO


def _is_serial(scene: Scene, settings: Settings, threads: int) -> bool:
    """True if a CPU runs the scene on one thread: where that was asked for, or more threads would gain nothing."""
    if settings.driver != "auto":
        return settings.driver == "fused"
    if threads == 1 or _is_small(scene):
        return True
    if settings.contacts == "off" or _size(scene) + SEARCHED * scene.n_balls > FUSED_WITH_SEARCH:
        return False
    return may_collide(scene) or bool(scene.solid.any() or scene.collides.any())


def compensates(scene: Scene, backend: Backend, integrator: Any) -> bool:
    """True if sums keep what rounding takes from them. Large scenes are bound by memory, where that would cost a tenth of the
    speed of explicit methods."""
    return (_is_small(scene) or integrator.refines(scene)) and _rounds(scene, backend)


def _rounds(scene: Scene, backend: Backend) -> bool:
    """True if sums of many small steps lose digits that show: in single precision, or far from the origin."""
    if backend.precision == "f32" or not scene.n_balls:
        return backend.precision == "f32"
    return float(np.max(np.abs(scene.position))) * float(np.finfo(np.float64).eps) > FINEST_ROUNDING * float(
        np.min(scene.radius)
    )


def turning(scene: Scene, settings: Settings, forces: Sequence[Any] = ()) -> NDArray[np.bool_]:
    """Mask (n,) of the balls that turn: "auto" selects loose ones where Coulomb friction can make them turn. Those of cloth and
    jelly, which springs, cells and the like, user-defined elements too, join at their centres, would only roll under it like
    casters."""
    if settings.contacts == "off" or settings.spin is False:
        return np.zeros(scene.n_balls, dtype=bool)
    if settings.spin is True:
        return np.ones(scene.n_balls, dtype=bool)
    joined = scene.joined()
    for force in forces:
        if isinstance(force, Element):
            joined[force.corners(scene)] = True
    return ~scene.pinned & ~joined & any(m.friction > 0 for m in used_materials(scene))
