"""TotalForce: the sum of all forces of a scene, accumulated from old positions and velocities into impulses.

A user-defined force is a small class with one function; it may read any field of the model:

    @ti.data_oriented
    class Drag:
        def __init__(self, coefficient):
            self.coefficient = coefficient  # N s/m

        @ti.func
        def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
            for i in range(model.n):
                impulse[i] += -h * self.coefficient * ball[i].v

    ts.Simulation(scene, forces=[Drag(0.1)])

It may have, too,
- `stiffness_rate(scene)` [1/s^2] and `damping_rate(scene)` [1/s]: the largest eigenvalues of M^-1 K and M^-1 D of what it does,
  which then bound the step; here the coefficient over the least mass. Without them the force is not counted.
- `energy(position, velocity)` [J] of (n, dim) NumPy arrays, counted in `Simulation.energy`.
- `allocate(model, state, fields)`, called before the simulation's fields exist, to declare fields of its own: see `Fields` and,
  for an example, `Pointer`.

`verlet` asks for it at predicted velocities, where springs are not strongly damped: drag is then of order 2, and stable while
h c / m < 1.
"""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from taichi_sim.analysis.damping import keep_energy
from taichi_sim.analysis.element_rates import declared_rates
from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.forces.corners import Corners
from taichi_sim.forces.element import Element
from taichi_sim.forces.motors import motors_of
from taichi_sim.forces.springs import Springs
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.scene import Scene

__all__ = ["TotalForce", "checked_forces"]


@ti.data_oriented
class TotalForce:
    """Gravity, springs, the scene's elements (see ELEMENTS) and the user's forces. What the scene lacks compiles to nothing."""

    def __init__(self, model: Model, fields: Fields, springs: Springs | None, extra: Sequence[Any]) -> None:
        self.model, self.n = model, model.n
        self.declared = declared_rates(model.scene, extra)
        elements = [_kernels(one.name)(model, fields) for one in ELEMENTS if one.acts(model.scene)]
        self.springs, self.extra = springs, [*elements, *extra]
        self.external_forces = self.extra  # those that `external` sums
        self.elements = [force for force in self.extra if isinstance(force, Corners)]
        self.stores = [force for force in elements if force.elastic]  # energy, that the state probe counts
        self.motors = motors_of(model, springs, fields)
        self.flexes = self.motors is not None
        self.has_springs, self.has_impulse = springs is not None, springs is not None or bool(self.extra)
        self.impulse = fields.vectors(model.n if self.has_impulse else 0, model.dim)  # N s, summed from old values
        self.damped = springs is not None and springs.damped
        if self.damped:
            self.damping_impulse = fields.vectors(model.n, model.dim)

    def allocate(self, state: State, fields: Fields) -> None:
        """Allocate the fields of the user's forces, and, where elements lose no energy, `sharp` (n): balls with x in double
        precision, their places and what rounding took from these. Stiff elements make random kicks of it, which heat."""
        self.state, self.wide = state, fields.wide
        refined = [one for one in self.elements if one.refined and one.implicit]
        known = state.compensated and fields.widens and keep_energy(self.model.scene)
        self.refined = refined if known else []
        if self.refined:
            vector = {
                "x": ti.types.vector(self.model.dim, fields.wide),
                "v": ti.types.vector(self.model.dim, fields.real),
            }
            self.sharp = fields.table(vector, self.n)
        for one in self.elements:
            one.allocate_places(fields, fields.wide if one in self.refined else fields.real)
        for force in self.extra:
            if hasattr(force, "allocate"):
                force.allocate(self.model, state, fields)

    def of_kind(self, kind: Any) -> Any:
        """The scene's elements of a kind, or None."""
        return next((force for force in self.elements if isinstance(force, kind)), None)

    def take(self, taken: Sequence[Any]) -> None:
        """Leave some elements to the method that asks, so that `external` does not sum them."""
        self.external_forces = [force for force in self.extra if force not in taken]

    def names(self) -> list[str]:
        """Names of the parts that are compiled in, for `Simulation.kernels()`."""
        names = ["gravity"] if self.model.has_gravity else []
        names += self.springs.names() if self.springs is not None else []
        names += ["springs.motors"] if self.motors is not None else []
        return names + [getattr(force, "name", f"force.{type(force).__name__}") for force in self.extra]

    @ti.func
    def flex(self, part):
        """Give springs with motors the rest lengths of a later time, once that part of the present substep, in 0..1, is over. At
        the start of a substep they have those of its start: a method calls this before it asks for forces at another time."""
        if ti.static(self.flexes):
            self.motors.flex(part)

    @ti.func
    def change(self, i, h):
        """Velocity change of ball i over h: gravity, and the accumulated impulse of the same h."""
        return self._change(i, h, self.has_impulse)

    @ti.func
    def _change(self, i, h, forced: ti.template()):
        dv = ti.Vector.zero(float, self.model.dim)
        w = self.model.inverse_mass[i]
        if ti.static(self.model.has_gravity):
            if w > 0.0:
                dv += h * self.model.gravity[0]
        if ti.static(forced):
            dv += w * self.impulse[i]
        return dv

    @ti.func
    def _extra(self, ball: ti.template(), h, time):
        """Add the user's forces; clear first where no springs have written."""
        if ti.static(self.has_impulse and not self.has_springs):
            for i in range(self.n):
                self.impulse[i] = ti.Vector.zero(float, self.model.dim)
        if ti.static(self._sharpens(ball)):
            for i in range(self.n):
                self.sharp[i].x = ti.cast(ball[i].x, self.wide) + ti.cast(self.state.low[i].x, self.wide)
                self.sharp[i].v = ball[i].v
        for force in ti.static(self.extra):
            if ti.static(force in self.refined and self._sharpens(ball)):
                force.accumulate(self.model, self.sharp, self.impulse, h, time)
            else:
                force.accumulate(self.model, ball, self.impulse, h, time)

    def _sharpens(self, ball: Any) -> bool:
        """True if some elements act, and rounding is known of the places of these balls."""
        return bool(self.refined) and ball is self.state.ball

    @ti.func
    def external(self, ball: ti.template(), h, time):
        """impulse = h times the user's forces and all elements that no method has taken; `external_change` adds gravity."""
        if ti.static(bool(self.external_forces)):
            for i in range(self.n):
                self.impulse[i] = ti.Vector.zero(float, self.model.dim)
            for force in ti.static(self.external_forces):
                force.accumulate(self.model, ball, self.impulse, h, time)

    @ti.func
    def external_change(self, i, h):
        """Velocity change of ball i over h by gravity and the user's forces, for methods that treat springs apart."""
        return self._change(i, h, bool(self.external_forces))

    @ti.func
    def elastic(self, ball: ti.template(), h, time):
        """impulse = h times all forces but spring damping."""
        if ti.static(self.has_springs):
            self.springs.elastic(ball, self.impulse, h)
        self._extra(ball, h, time)

    @ti.func
    def elastic_and_damping(self, ball: ti.template(), h, tau, time):
        """impulse = h times all forces but spring damping; damping_impulse = tau times that; one pass for both."""
        if ti.static(self.damped):
            self.springs.both(ball, self.impulse, self.damping_impulse, h, tau)
        elif ti.static(self.has_springs):
            self.springs.elastic(ball, self.impulse, h)
        self._extra(ball, h, time)

    @ti.func
    def total(self, ball: ti.template(), h, time):
        """impulse = h times all forces, spring damping among them."""
        if ti.static(self.has_springs):
            self.springs.total(ball, self.impulse, h)
        self._extra(ball, h, time)


def _kernels(name: str) -> Any:
    """Class that computes the elements of a name: `Cells` in forces/cells.py those that are called cells."""
    return getattr(import_module(f"taichi_sim.forces.{name}"), name.title().replace("_", ""))


def checked_forces(scene: Scene, forces: Sequence[Any]) -> Sequence[Any]:
    """The forces that a user hands in. Raises SceneError where something is not one, and for corners of elements."""
    if not isinstance(forces, (list, tuple)):
        raise SceneError("forces", forces, "a list of forces")
    for force in forces:
        if isinstance(force, Element):
            force.check(scene)
        else:
            validation.taichi_function("forces", force, "accumulate", "model, ball, impulse, h, time")
    return forces
