"""Views of a simulation: its state, what is worked out from that, and what runs."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis import diagnostics
from taichi_sim.analysis.accuracy import Setup
from taichi_sim.analysis.element_rates import Declared
from taichi_sim.analysis.frame import Contacts, Frame
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.analysis.outcome import Scales
from taichi_sim.analysis.probe_readings import Reader
from taichi_sim.analysis.stability import Stability, stability
from taichi_sim.device import backend
from taichi_sim.device.state import State
from taichi_sim.geometry.intersections import crossings
from taichi_sim.integrators.base import SolverStatistics
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.summary import as_html, in_words, parts_of
from taichi_sim.simulation.assembly import Assembly
from taichi_sim.simulation.error_control import ErrorEstimate
from taichi_sim.simulation.settings import Settings
from taichi_sim.simulation.stepper import Stepper

__all__ = ["Visible"]


class Visible(Reader):
    """The part of a Simulation that tells of it and changes nothing."""

    scene: Scene
    settings: Settings
    backend: backend.Backend
    force_rates: Declared
    _forces: Sequence[Any]
    _stability: Stability
    _stepper: Stepper
    _moments: MomentsOf
    _still: bool
    _closed: bool
    dt: float

    @property
    def substeps(self) -> int:
        """Parts that each step is divided into; with dt = "auto" more, once energy has grown that nothing explains."""
        return self._stepper.substeps

    @property
    def parts(self) -> Assembly:
        """Model, state, forces, contacts, plan and integrator that were put together for this scene. To look inside, as tests
        do: it may differ in the next version. `print(sim.parts.plan)` says what contacts it has, and why."""
        backend.check_thread()
        if (
            self._closed or not self._stepper.parts.fields.built
        ):  # its memory is gone: touching it would end the process
            raise RuntimeError("this simulation is closed; make a new one")
        return self._stepper.parts

    @property
    def _state(self) -> State:
        return self.parts.state

    @property
    def closed(self) -> bool:
        """True if it cannot be used any more."""
        return self._closed or not self._stepper.parts.fields.built

    @property
    def time(self) -> float:
        """Seconds since the start: steps x dt."""
        return self._stepper.time

    @property
    def position(self) -> NDArray[np.float64]:
        """(n, dim) m, a copy."""
        return self._state.position

    @property
    def velocity(self) -> NDArray[np.float64]:
        """(n, dim) m/s, a copy; belongs to the same moment as `position`, after contacts."""
        return self._state.velocity

    def _spin(self) -> NDArray[np.float64]:
        return self._state.surface_speed / self.scene.radius[:, None]

    @property
    def angular_velocity(self) -> NDArray[np.float64]:
        """1/s, counter-clockwise: (n,) in 2D, (n, 3) in 3D, a copy; 0 where balls do not spin."""
        spin = self._spin()
        return spin[:, 0] if self.scene.dim == 2 else spin

    def energy(self) -> diagnostics.Energy:
        """Kinetic, spring, gravity and total energy [J], computed in float64."""
        scene = self.scene.at(self.time)
        return diagnostics.energy(scene, self.position, self.velocity, self._spin(), self.torn, self._forces)

    def momentum(self) -> NDArray[np.float64]:
        """(dim,) kg m/s."""
        return diagnostics.momentum(self.scene, self.velocity)

    def angular_momentum(self) -> Any:
        """About the origin [kg m^2/s]: a float in 2D, (3,) in 3D."""
        return diagnostics.angular_momentum(self.scene, self.position, self.velocity, self._spin())

    def contacts(self) -> Contacts:
        """Number and depth of the contacts, what the solver left of approach speeds, and what it did; all 0 where contacts
        are off, but for the largest speed. Costs a search of all contacts, and a kernel at the first call. Warns, once,
        where steps have brought balls deep into something."""
        fastest = diagnostics.largest_speed(self.velocity)
        if self._still or not self.parts.contacts.active:
            return diagnostics.contacts(None, 0, self.substeps, fastest, 0)
        self._stepper.prime()
        parts = self.parts  # after priming, for which lists may have grown
        return diagnostics.contacts(
            self._stepper.checks.contact_statistics(),
            parts.contacts.iterations,
            self.substeps,
            fastest,
            parts.searches(),
        )

    def penetration(self) -> float:
        """Largest overlap of a ball with a wall, a collider, a stick or another ball, or of surfaces [m]; 0 with contacts off."""
        return self.contacts().penetration

    def crossings(self) -> int:
        """Number of times that an edge of the triangles pierces one of them, of all that have not torn; 0 in 2D. In NumPy."""
        return len(crossings(self.position, self.frame().triangles)) if self.scene.dim == 3 else 0

    def frame(self) -> Frame:
        """The present moment as NumPy arrays."""
        return self._moments.at(self.time, self.position, self.velocity, self._spin(), self.torn)

    @property
    def torn(self) -> NDArray[np.bool_] | None:
        """(m,) springs that have torn, a copy; None where none can."""
        return None if self._still else self.parts.torn

    def inverted(self) -> int:
        """Number of cells, bricks and solids that are flat or turned inside out, and not torn: 0 of a jelly that is
        not crushed."""
        torn = self.torn
        return diagnostics.inverted(self.scene, self.position, None if torn is None else self.scene.pairs[torn])

    def error(self) -> ErrorEstimate | None:
        """Error that its control found so far; None without `tolerance`."""
        return self._stepper.policy.report()

    def decisions(self) -> list[str]:
        """Decisions made for the run, such as the integrator, and during it, each with the time from which on it holds: shorter
        substeps, more room for contacts."""
        run = self._stepper
        return [*filter(None, [self.settings.chosen]), *run.checks.decisions, *run.division.said()]

    def scales(self) -> Scales:
        """Scales by which a run is judged."""
        return self._stepper.checks.scales()

    def solver(self) -> SolverStatistics | None:
        """Statistics of how well an implicit method solved its stages so far; None for methods that solve nothing."""
        return self.parts.integrator.solver_report() if self._state is not None else None

    def stability(self) -> Stability:
        """The largest safe step of what has not torn, in every shape and in the present one, and what limits it."""
        if self._still:
            return self._stability
        return stability(self.scene, self.settings.integrator.method, self.position, self.force_rates, self.torn)

    @property
    def setup(self) -> Setup:
        """Settings of the run, as `taichi_sim.analysis.accuracy.findings` wants them."""
        return self.parts.setup

    def kernels(self) -> list[str]:
        """The parts that were compiled for this scene; what it lacks is not among them."""
        return self.parts.names()

    def _about(self) -> dict[str, Any]:
        """Description of what runs, in words by their names."""
        step = f"{self.dt:g} s" + (f" in {self.substeps} substeps" if self.substeps > 1 else "")
        contacts = self.parts.contacts
        rule = f"{contacts.name}, {contacts.iterations} iterations" if contacts.active else "off"
        return {
            "time": f"{self.time:.6g} s",
            "integrator": self.settings.integrator.method.name,
            "step": step
            if self.settings.tolerance is None
            else f"by a tolerance of {self.settings.tolerance:g} a second",
            "contacts": rule,
            "device": str(self.backend),
        }

    def __repr__(self) -> str:
        if self.closed:
            return f"<Simulation, closed, of a {in_words(self.scene)}>"
        return f"<Simulation of a {in_words(self.scene)}; {', '.join(f'{k} {v}' for k, v in self._about().items())}>"

    def _repr_html_(self) -> str:
        """Picture of the present moment and a description of what runs, for notebooks."""
        if self.closed:
            return as_html("Simulation, closed", parts_of(self.scene))
        seen = BytesIO()
        import_module("taichi_sim").picture(self).save(seen, "png")  # by name: it is an outer room's
        return as_html("Simulation", self._about() | parts_of(self.scene), seen.getvalue())
