"""Assembly: from a scene and settings to model, state, forces, contacts, integrator and drivers, with only what is needed."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from taichi_sim.backend import Backend
from taichi_sim.contacts.grid import SKIN, Grid
from taichi_sim.contacts.pairs import GAP, Pairs
from taichi_sim.contacts.solver import ContactSolver
from taichi_sim.contacts.sticks import Sticks
from taichi_sim.contacts.walls import Walls
from taichi_sim.drivers import Drivers
from taichi_sim.errors import SceneError
from taichi_sim.fields import Fields
from taichi_sim.forces.springs import Springs, fixed_order
from taichi_sim.forces.total import TotalForce
from taichi_sim.integrators import BUILT_IN
from taichi_sim.model import Model
from taichi_sim.order import in_order, spatial_order
from taichi_sim.scene import Scene
from taichi_sim.settings import Settings
from taichi_sim.state import State

__all__ = ["Assembly"]

FUSED_UP_TO = 20_000  # balls + springs; measured, see the benchmark notes
MOST_BOUNCE = 0.5  # above that, only split masses are sure never to gain energy
SLOWEST_BOUNCE = 0.01  # m/s
FINE = 1e-11  # of a radius: rounding of positions that adds up to 1e-9 in some thousand steps


class Assembly:
    """All parts of one simulation. h: seconds per substep."""

    def __init__(self, scene: Scene, settings: Settings, backend: Backend, h: float, forces: Sequence[Any]) -> None:
        cpu = backend.arch == "cpu"
        if settings.driver == "fused" and not cpu:
            raise ValueError(f"driver: 'fused' runs on one CPU thread; on {backend.arch} use 'parallel' or 'auto'")
        self.fields = Fields(backend.real)
        try:
            self._assemble(scene, settings, backend, h, forces)
            self.fields.build()
        except BaseException:
            self.fields.abandon()
            raise

    def _assemble(self, scene: Scene, settings: Settings, backend: Backend, h: float, forces: Sequence[Any]) -> None:
        """All parts in the order in which they need each other."""
        cpu = backend.arch == "cpu"
        own_parts = bool(forces) or type(settings.integrator) not in BUILT_IN  # they may know balls by their number
        order = None if own_parts else spatial_order(scene)
        if order is not None:
            scene = in_order(scene, order)
        self.model = Model(scene, self.fields)
        self.model.spins = spins(scene, settings)
        small = scene.n_balls + scene.n_springs <= FUSED_UP_TO
        # Larger scenes are bound by memory, where the rounded-off parts would cost a tenth of the speed.
        self.state = State(self.model, self.fields, compensated=small and _rounds(scene, backend), order=order)
        self.fused = cpu and (settings.driver == "fused" or (settings.driver == "auto" and small))
        self.atomic = settings.accumulate == "atomic"
        self.integrator = settings.integrator
        springs = self._springs(scene, cpu, h)
        self.forces = TotalForce(self.model, self.state, self.fields, springs, forces)
        self.contacts = self._contacts(scene, settings, h, cpu)
        self.integrator.bind(self.model, self.state, self.forces, self.contacts, self.fields)
        self.drivers = Drivers(self.integrator)

    def _springs(self, scene: Scene, cpu: bool, h: float) -> Springs | None:
        if scene.n_springs == 0:
            return None
        order = "atomic" if self.atomic else fixed_order(self.model, cpu)
        return Springs(self.model, self.fields, self.integrator.damping(self.model, h), order)

    def _contacts(self, scene: Scene, settings: Settings, h: float, cpu: bool) -> ContactSolver:
        on = settings.contacts != "off" and bool(np.any(~scene.pinned))
        threshold = max(2.0 * float(np.linalg.norm(scene.gravity)) * h, SLOWEST_BOUNCE)
        sticks = on and bool(np.any(scene.collides)) and scene.n_balls > 2
        pairs = on and (sticks or may_collide(scene))
        if pairs or (on and scene.walls):
            self.model.add_contact_fields()
        # sticks look balls up in the grid itself, so it must be fresh; an integrator of one's own may move balls unseen
        skin = 0.0 if sticks or type(settings.integrator) not in BUILT_IN else SKIN
        pulls = bool(np.any(scene.stiffness > 0) or np.any(scene.damping > 0))
        warm = self.model.has_gravity or pulls or bool(self.forces.extra)
        # only what rests is soft, and that takes gravity: a rigid contact is exact for two balls
        soft = self.model.has_gravity and pairs and settings.integrator.relaxes and settings.contacts != "sum"
        grid = Grid(self.model, self.fields, skin, GAP if soft else 0.0) if pairs else None
        pair_part = Pairs(self.model, self.fields, grid, warm, soft) if grid is not None else None
        walled = on and bool(scene.walls)
        wall_part = Walls(self.model, self.state, self.fields, threshold, soft) if walled else None
        stick_part = Sticks(self.model, self.fields, pair_part) if sticks and pair_part is not None else None
        rule = self._rule(scene, settings, cpu)
        return ContactSolver(
            self.model,
            self.state,
            self.fields,
            wall_part,
            pair_part,
            stick_part,
            threshold=threshold,
            h=h,
            passes=settings.passes(scene, rule),
            rule=rule,
            atomic=self.atomic or (settings.accumulate == "auto" and not cpu),  # blocks are too few for a GPU
            serial=self.fused,
            warm=warm,
            soft=soft,
        )

    def _rule(self, scene: Scene, settings: Settings, cpu: bool) -> str:
        """A fixed order of pairs is what Gauss-Seidel is made of; atomics and GPUs take all at once. It needs half the passes,
        but what bounces well can gain energy from it."""
        if settings.contacts != "auto":
            if settings.contacts == "gauss_seidel" and (self.atomic or not cpu):
                why = "accumulate: 'atomic'" if self.atomic else "a GPU"
                raise ValueError(
                    f"contacts: 'gauss_seidel' changes velocities in a fixed order, which {why} does not have"
                )
            return settings.contacts
        bounce = max(material.restitution for material in scene.materials)
        return "gauss_seidel" if cpu and not self.atomic and bounce <= MOST_BOUNCE else "jacobi"

    def names(self) -> list[str]:
        """What was compiled in."""
        driver = "driver.fused" if self.fused else "driver.parallel"
        return [driver, f"integrator.{self.integrator.name}", *self.forces.names(), *self.contacts.names()]

    def prime(self, h: float, time: float) -> None:
        """Forces and contacts at the present positions."""
        self.drivers.prime(h, time)

    def run(self, substeps: int, h: float, time: float) -> None:
        """Advance the fields. 0 substeps compile the fused driver; the parallel one compiles with its first."""
        self.drivers.run(substeps, h, time, self.fused)

    def ball_overlap(self) -> float:
        """Largest overlap of two balls [m]; 0 where they do not collide."""
        pairs = self.contacts.pairs
        return 0.0 if pairs is None else pairs.deepest(self.state.ball)

    def check_capacity(self) -> None:
        """Raise where contacts were found that did not fit: never silently fewer of them."""
        for part in self.contacts.searched:
            needed = int(part.overflow[0])
            if needed > part.capacity:
                part.overflow[0] = 0
                raise SceneError(
                    f"contacts: {needed} entries were found, but there is room for {part.capacity}: too many balls lie within"
                    " reach of each other, or a stick is longer than 65536 balls"
                )

    def free(self) -> None:
        """Give all memory back."""
        self.fields.free()


def _rounds(scene: Scene, backend: Backend) -> bool:
    """Whether sums of many small steps lose digits that show: in single precision, or far from the origin."""
    if backend.precision == "f32" or not scene.n_balls:
        return backend.precision == "f32"
    return float(np.max(np.abs(scene.position))) * float(np.finfo(np.float64).eps) > FINE * float(np.min(scene.radius))


def spins(scene: Scene, settings: Settings) -> bool:
    """Whether balls turn: "auto" where Coulomb friction can make them."""
    if settings.contacts == "off" or settings.spin is False:
        return False
    return settings.spin is True or any(material.friction > 0 for material in scene.materials)


def may_collide(scene: Scene) -> bool:
    """Whether any two balls may touch: not both pinned, not of one body, not joined by a spring."""
    n = scene.n_balls
    total = n * (n - 1) // 2
    held = int(scene.pinned.sum())
    bodies = np.bincount(scene.body[scene.body > 0]).astype(np.int64)
    both = np.bincount(scene.body[(scene.body > 0) & scene.pinned]).astype(np.int64)  # pinned and of one body: once
    total -= held * (held - 1) // 2 + int(np.sum(bodies * (bodies - 1) // 2) - np.sum(both * (both - 1) // 2))
    pairs = np.unique(np.sort(scene.pairs, axis=1), axis=0)
    i, j = pairs[:, 0], pairs[:, 1]
    apart = (scene.body[i] == 0) | (scene.body[i] != scene.body[j])
    total -= int(np.sum(apart & ~(scene.pinned[i] & scene.pinned[j])))
    return total > 0
