"""Simulation: a scene in motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from os import PathLike
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.analysis import diagnostics
from taichi_sim.analysis.collider_checks import check_colliders
from taichi_sim.analysis.element_rates import declared_rates, undeclared
from taichi_sim.analysis.frame import Frame, frame_count
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.analysis.preflight import cautions
from taichi_sim.analysis.stability import stability
from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, about
from taichi_sim.common.warn import warn
from taichi_sim.device import backend
from taichi_sim.forces.sum import checked_forces
from taichi_sim.integrators import BUILT_IN
from taichi_sim.scene.probes import bodies_of
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.assembly import Assembly
from taichi_sim.simulation.choices import compensates
from taichi_sim.simulation.contact_capacity import NO_CAPACITY_KNOWN
from taichi_sim.simulation.error_control import check_digits
from taichi_sim.simulation.settings import Settings, seconds_of_step
from taichi_sim.simulation.settling import Settled, require_tolerance, settle, still
from taichi_sim.simulation.stepper import Stepper
from taichi_sim.simulation.visible import Visible

__all__ = ["Simulation"]

MOST_FRAMES = 10_000_000


class Simulation(Visible):
    """Steps a scene through time.

    Args, all optional; what is left out is taken from scene.settings, then from the defaults in parentheses:
        integrator: a name ("explicit_euler", "symplectic_euler", "verlet", "rk4", and, for stiff springs, "xpbd",
            "implicit_euler", "tr_bdf2"), an Integrator, or "auto": "verlet", or an implicit method where that takes far less
            time, which `decisions` reports ("verlet").
        dt: seconds per step, or "auto": 1 ms, or 0.9 of the largest step that is safe for every shape, 0.4 where
            a spring is undamped and the method symplectic ("auto").
        tolerance: in place of dt: the error allowed in a simulated second, as a part of the scene's size; see `error` (None).
        substeps: parts that each step is divided into, or "auto": 1, and up to 8 where the loose balls could make a high pile
            or start so fast that they would collide late ("auto").
        precision: "f32" or "f64" (that which the process runs in; in its first simulation "f32"). arch: "auto", "cpu", "cuda",
            "vulkan", "metal" ("auto": that which the process runs on; in its first simulation a GPU if one works).
        contacts: "auto", "gauss_seidel", "jacobi", "sum", "off", or a ContactRule ("auto": gauss_seidel on the CPU, jacobi on a
            GPU and with accumulate "gather" or "atomic").
        contact_iterations: of each contact solve, or "auto": gauss_seidel makes 2, and 1 for more than 1000 balls whose masses
            differ up to tenfold; jacobi makes 4 to 8, more in larger scenes; both make at least 30 where surfaces collide. A
            restitution above 0.5 adds up to 12 to jacobi, and up to 4 to gauss_seidel where sticks or surfaces collide ("auto").
        accumulate: "auto", "ordered", "gather", "atomic": in which order impulses are added, see docs/physics.md ("auto").
        driver: "auto", "fused", "parallel" ("auto": fused for small scenes and on one thread).
        spin: whether balls turn: True, False or "auto": loose ones, where a material has Coulomb friction.
        settle: bring the scene to rest first: True, or the tolerance of `settle` (False).
        forces: your own force objects.
        threads: CPU threads.

    Precision, arch and threads hold for the whole process. Raises ValueError, SceneError, BackendError; warns when dt is
    above the safe bound.
    """

    def __init__(self, scene: Scene, *, forces: Sequence[Any] = (), **settings: Any) -> None:
        self._begin(scene, forces, settings)

    def _begin(self, scene: Scene, forces: Sequence[Any], settings: dict[str, Any], on: Assembly | None = None) -> None:
        """Become a simulation of a scene. on: parts of another one, which it takes the place of."""
        if not isinstance(scene, Scene):
            says = "is no Scene; ts.load_scene reads one from a file"
            raise SceneError("scene", scene, says=says)
        self._source = ref(scene)
        self.scene = scene = scene.frozen()
        self._given = settings
        with scene.in_file(settings):
            self.settings = Settings.resolve(scene, settings, forces)
        scene.has_groups()  # a mistyped name is an error, whatever collides
        self.force_rates = declared_rates(scene, checked_forces(scene, forces))
        self._forces = tuple(forces)
        self._stability = stability(scene, self.settings.integrator.method, None, self.force_rates)
        with scene.in_file(settings):
            self.dt, substeps = self.settings.time_step(scene, self._stability)
        h = self.dt / substeps
        self._warn(h)
        self.undeclared_forces = undeclared(self._forces)
        if self.undeclared_forces and self.settings.dt == "auto":
            warn(
                f'dt: "auto" does not count {", ".join(self.undeclared_forces)}, which declares neither stiffness_rate nor'
                " damping_rate (0 where a force is constant), see docs/extending.md; declare one, or give dt"
            )
        if self.settings.contacts != "off":
            check_colliders(scene, h)
        s = self.settings
        self.backend = backend.start(s.arch, s.precision, s.threads)
        own = type(s.integrator) not in BUILT_IN or bool(vars(s.integrator)) or not isinstance(s.contacts, str)
        self.has_custom_parts = bool(forces) or own
        diagnostics.check_tearing(scene)
        if s.tolerance is not None:
            with scene.in_file(settings):
                self._check_tolerance(s.tolerance, substeps)
        alike = on is not None and on.model.n == scene.n_balls  # others may need far less room for contacts
        parts = Assembly(scene, s, self.backend, h, forces, on.capacity if alike else NO_CAPACITY_KNOWN, on)
        self._stepper = Stepper(scene, s, parts, self.dt, substeps, self._stability, self.has_custom_parts)
        for caution in cautions(scene, parts.setup):
            warn(caution)
        self._closed = self._exported = False
        self._pauses: tuple[int, Callable[[], object]] | None = None
        self._still = scene.n_balls == 0
        self._moments = MomentsOf(scene)
        self.settled: Settled | None = None
        self._lead_pins()
        self._begin_readings()
        if s.settle is not None:
            self.settle(s.settle)

    def _check_tolerance(self, tolerance: float, substeps: int) -> None:
        """Raise SceneError where it cannot be kept."""
        scene, backend = self.scene, self.backend
        if np.isfinite(scene.break_strain).any():
            raise SceneError("tolerance", says="cannot be kept where springs tear; give dt, or leave break_strain out")
        check_digits(
            scene,
            tolerance,
            backend.precision,
            self.dt,
            substeps,
            compensates(scene, backend, self.settings.integrator),
        )
        if bodies_of(scene):
            says = "cannot be kept together with probes of force or impulse; give dt, or leave them out"
            raise SceneError("tolerance", says=says)

    def _warn(self, h: float) -> None:
        safe = self._stability.dt_any_shape
        if safe == 0.0:
            warn(f"no step is safe here, dt = {h:.6g} s included: {self._stability.reason}")
        elif h > safe * (1.0 + 1e-9):
            warn(
                f"dt = {h:.6g} s is above the safe bound of {safe:.6g} s for every shape of this scene:"
                f" {self._stability.reason}"
            )

    # Moving on -----------------------------------------------------------------------------------------------------

    def step(self, n: int = 1) -> None:
        """Advance by n steps of dt. step(0) only compiles; on several threads the step itself compiles with the first. Raises
        UnstableError, leaving the last good state, and SceneError during an export of it."""
        steps = validation.whole("step", n, 0)
        self._require_no_export("step")
        self._require_unchanged()
        if self._still:
            self._stepper.steps += steps
        elif self._state is not None:  # not closed
            self._step(steps)

    def _step(self, steps: int) -> None:
        if self._pauses is None or not steps:
            self._stepper.step(steps)
            return
        every, call = self._pauses
        for begin in range(0, steps, every):
            self._stepper.step(min(every, steps - begin))
            call()

    def _require_unchanged(self) -> None:
        """Raise SceneError where the scene that it was made of has got more since, which would have no effect."""
        source = self._source()
        if source is not None and (changed := source.grown_since(self.scene)):
            says = (
                f"got more {changed} after this simulation was made of it; make a new Simulation, or call reset(scene)"
            )
            raise SceneError("scene", says=says)

    def run(self, duration: float) -> None:
        """Advance by round(duration / dt) steps; duration in seconds."""
        self.step(round(validation.number("duration", duration, low=0) / self.dt))
        if not self._still and self._state is not None:
            self._stepper.checks.look_at_depth()

    def frames(self, fps: float = 60.0, duration: float = 5.0) -> Iterator[Frame]:
        """Yield the present state and a frame at each k / fps after it, up to the duration [s] and not beyond, each at the step
        nearest to its time. The simulation is left at the last one.

        Steps made between two frames count towards the next one. Raises SceneError after a `reset` between two.
        """
        rate = validation.number("fps", fps, positive=True)
        count = frame_count(1.0, min(rate * validation.number("duration", duration, low=0), 2.0 * MOST_FRAMES))
        if count > MOST_FRAMES:
            raise ValueError(
                f"frames: {rate:g} a second for {duration:g} s are more than {MOST_FRAMES}, the most allowed"
            )
        if rate * self.dt > 1.0 + 1e-9:
            warn(f"dt = {self.dt:.6g} s is longer than a frame, 1/{rate:g} s: some frames repeat")
        start, begun = self._stepper.steps, self._moments
        for k in range(count):
            self.step(max(0, start + round(k / rate / self.dt) - self._stepper.steps))
            yield self.frame()
            if self._moments is not begun:
                raise SceneError(
                    "frames", says="end here, where reset(scene) began another run; ask for its frames anew"
                )

    def settle(self, tolerance: float = 1e-3, longest: float = 120.0) -> Settled:
        """Bring the scene to rest without moving the clock, see `taichi_sim.simulation.settling`. Velocities are 0 then.

        What is driven stands still meanwhile, as it does at the start, and wind has no gusts; that needs the clock to be at 0.

        Args: tolerance: the largest net force that may be left on a ball, as a part of the mean weight of a ball (without
            gravity, of the largest net force at the start, and more where rounding pushes). longest: simulated seconds on the
            way; then it warns and stops.

        Returns what is left, which `settled` keeps until positions or velocities are set. Raises UnstableError, and SceneError
        where something is driven after the start.
        """
        with about("tolerance"):
            tolerance = require_tolerance(tolerance) or validation.number("tolerance", tolerance, positive=True)
        longest = validation.number("longest", longest, positive=True)
        held = still(self.scene)
        if self.time != 0.0 and held is not self.scene:
            raise SceneError(
                "settle", says="needs the clock at 0 where something is driven; call it before the first step"
            )
        given = {**self._given, "settle": None, "tolerance": None, "substeps": 1}

        def simulate(**chosen: Any) -> Simulation:
            return type(self)(held, forces=self._forces, **{**given, **chosen})

        position, found = settle(simulate, self.position, tolerance, longest)
        if not self._still:
            self._state.write_spin()
            if self.parts.received is not None:
                self.parts.received.set(None)
        self._write(position, np.zeros_like(position))
        self.settled = found
        self._begin_readings()
        return found

    @contextmanager
    def pausing(self, every: int, call: Callable[[], object]) -> Iterator[None]:
        """Call something in the block after so many steps each, counted in each call of `step`, and at its end. Takes longer;
        the steps have the same bits."""
        self._pauses = every, call
        try:
            yield
        finally:
            self._pauses = None

    @contextmanager
    def exported(self, is_exported: bool = True) -> Iterator[None]:
        """Refuse `reset`, `step` and a second export in the block: an export has frames of one scene, at its own times. Within,
        `exported(False)` is where the export moves it. Raises SceneError in a block of another export."""
        if is_exported:
            self._require_no_export("export")
        before, self._exported = self._exported, is_exported
        try:
            yield
        finally:
            self._exported = before

    def _require_no_export(self, name: str) -> None:
        """Raise SceneError about a function of that name during an export."""
        if self._exported:
            says = "cannot be called in an export, which moves the simulation itself; call it when the export has ended"
            raise SceneError(name, says=says)

    # Another scene -------------------------------------------------------------------------------------------------

    def reset(self, scene: Scene) -> None:
        """Begin anew at time 0 with another scene, with the same arguments and the same bits as a new Simulation of it.

        A scene of the same structure takes over memory and kernels, in milliseconds: numbers may differ, such as places,
        velocities, masses, radii, stiffnesses, materials, walls, gravity, the step. Other kernels are needed where the number of
        balls or springs differs, or which balls these join, or whether there is friction or gravity at all: then they
        are compiled. On a device the first reset of a process may take some seconds: it compiles, or loads, what empties the
        memory. Raises what a new Simulation does, and leaves this one as it is, or closes it if the error comes after the new
        scene took its memory, as where settling fails. Raises SceneError during an export of it.
        """
        self._require_no_export("reset")
        on = self.parts
        other = object.__new__(type(self))
        try:
            other._begin(scene, self._forces, self._given, on)
        except BaseException:
            if not on.fields.built:  # it was given back already
                self._closed = True
            raise
        vars(self).update(vars(other))

    # Changing it ---------------------------------------------------------------------------------------------------

    def set_dt(self, dt: float | str) -> None:
        """Go on with steps of dt seconds, or as "auto" finds; nothing is compiled anew. Raises ValueError; warns as at first."""
        if self.settings.tolerance is not None:
            raise ValueError("dt: the tolerance chooses the step of this simulation; make another one")
        parts, time = self.parts, self.time
        settings = replace(self.settings, dt=dt if dt == "auto" else seconds_of_step(dt))
        seconds, substeps = settings.time_step(self.scene, self._stability)
        h = seconds / substeps
        self._warn(h)
        if settings.contacts != "off":
            check_colliders(self.scene, h)
        parts.set_step(h, anew=True)
        self.settings, self.dt = settings, seconds
        self._stepper = Stepper(self.scene, settings, parts, seconds, substeps, self._stability, self.has_custom_parts)
        self._stepper.set_time(time)

    def at_half_step(self, scene: Scene | None = None, half: float | None = None) -> Simulation:
        """A new Simulation with the same arguments and half the step, at its start, where it does not settle. scene: one of the
        same structure in place of this one's; half: a step [s] as good as equal to the half."""
        if self.settings.tolerance is not None:
            raise SceneError("dt", says="is chosen by the tolerance of this simulation and cannot be halved")
        halved = {
            **self._given,
            "dt": self.dt / 2.0 if half is None else half,
            "substeps": self.substeps,
            "settle": None,
        }
        return type(self)(scene or self.scene, forces=self._forces, **halved)

    def apply_impulse(self, balls: ArrayLike, impulse: ArrayLike) -> None:
        """Add an impulse (dim,) or (k, dim) [N s] to the balls (k,). Pinned ones do not move."""
        index = validation.indices("balls", np.atleast_1d(np.asarray(balls)), self.scene.n_balls)
        p = validation.vectors("impulse", impulse, len(index), self.scene.dim)
        v = self.velocity
        np.add.at(v, index, np.where(self.scene.pinned, 0.0, 1.0 / self.scene.mass)[index, None] * p)
        self._write(self.position, v)

    def set_position(self, position: ArrayLike) -> None:
        """Replace all positions (n, dim) [m], pinned balls' too. Contacts find the load that they carry anew."""
        x = validation.vectors("position", position, self.scene.n_balls, self.scene.dim)
        self._write(x, self.velocity, moved=True)

    def set_velocity(self, velocity: ArrayLike) -> None:
        """Replace all velocities (n, dim) [m/s]; pinned balls keep 0."""
        v = validation.vectors("velocity", velocity, self.scene.n_balls, self.scene.dim)
        v[self.scene.pinned] = 0.0
        self._write(self.position, v)

    def snapshot(self) -> Snapshot:
        """All that it goes on from, at the present time."""
        assert self.parts is not None  # not closed
        found = self._stepper.snapshot()
        return replace(found, stepping={**found.stepping, "readings": self.readings.memory(), "settled": self.settled})

    def resume(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot of this scene; `settled` is that of its time. Raises SceneError for what does not fit."""
        if not isinstance(snapshot, Snapshot):
            raise SceneError("snapshot", snapshot, "a ts.Snapshot")
        assert self.parts is not None  # not closed
        state = snapshot.checked(self.scene)
        settled = Settled.of(snapshot.stepping.get("settled"))
        self._stepper.resume(state)
        self.settled = settled
        self._begin_readings()
        self.readings.recall(snapshot.stepping.get("readings"))

    def _write(self, x: NDArray, v: NDArray, *, moved: bool = False) -> None:
        self.settled = None  # not at rest any more
        if not self._still:
            self._state.write(x, v)
            self._lead_pins()
            if moved:
                self.parts.contacts.forget()
            self._stepper.begin_here()

    def _lead_pins(self) -> None:
        """Give driven pins the velocities that they move on with."""
        if self.scene.moving_pins:
            v = self.velocity
            for pins in self.scene.moving_pins:
                start = self.scene.position[pins.balls]
                v[pins.balls] = pins.velocities(start, self.time, self._stepper.h)
            self._state.set_values(self._state.ball.v, v)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the scene, all arguments and the present state to an .npz file."""
        from taichi_sim.files.checkpoint import save_state  # an outer room: no import at load time

        save_state(self, path)

    @classmethod
    def restore(cls, path: str | PathLike[str], **overrides: Any) -> Simulation:
        """A simulation as `save` left it; any argument may be replaced."""
        from taichi_sim.files.checkpoint import restore_state

        return restore_state(cls, path, overrides)

    def close(self) -> None:
        """Free all fields. The simulation cannot be used after that; closing twice does nothing."""
        if not self.closed:
            self.parts.free()
        self._closed = True

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
