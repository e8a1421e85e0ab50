"""Settling: a scene brought to rest before its clock starts, by kinetic damping.

The scene moves freely from rest until its kinetic energy has passed a peak. There the potential energy is near a least value, so
the velocities are set to 0 and it begins again, until what is left of the forces is small (Day, 1965; Barnes, 1988). No damping
is added, so the state of rest is that of the scene itself.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.common.quantities import measured, percent
from taichi_sim.common.warn import warn
from taichi_sim.files.checkpoint import parts_of, scene_of
from taichi_sim.scene.scene import Scene

__all__ = ["Settled", "settle", "still"]

LOOKS = 16  # at the kinetic energy, on the way to a peak
MOST_STOPS = 2000
PATIENCE = 60  # stops, after which a residual that has not fallen by BETTER is that of rounding
BETTER = 0.9


class Settled(NamedTuple):
    """Result of settling. residual [N]: the largest net force that is left on a ball that is not pinned; load [N]: what it is
    compared with, the mean weight of these balls, or, without gravity, the largest net force at the start; time [s]: simulated
    on the way; stops: how often velocities were set to 0; reached: whether the residual is within the tolerance."""

    residual: float
    load: float
    time: float
    stops: int
    reached: bool

    @classmethod
    def of(cls, plain: Sequence[Any] | None) -> "Settled | None":
        """Settled from a list of the five values, as files hold it; None of None. Raises SceneError for anything else."""
        kinds = (float, float, float, int, bool)
        if plain is None:
            return None
        if not isinstance(plain, (list, tuple)) or tuple(map(type, plain)) != kinds or not np.isfinite(plain[:3]).all():
            raise SceneError("settled", plain, "residual, load, time, stops and reached, or null")
        return cls(*plain)

    def __str__(self) -> str:
        if not self.load:
            return "at rest, no net force"
        part = f"{percent(self.residual / self.load)} of a ball's mean weight"
        left = f"largest net force {measured(self.residual, unit='N')}, {part}"
        how = f"after {self.stops} stops in {self.time:.3g} s of motion"
        return f"at rest, {left}, {how}" if self.reached else f"not at rest, {left}, {how}"


def still(scene: Scene) -> Scene:
    """A copy in which nothing is driven: colliders, pins and springs with motors stand as at the start, and wind has no gusts.
    The scene itself where that is so already. Raises SceneError for a user-defined collider that moves."""
    wind = scene.wind
    gusts = wind is not None and wind.gust > 0.0
    moving = any(collider.motion.moves for collider in scene.colliders)
    if not (gusts or moving or scene.moving_pins or scene.motors):
        return scene
    about, arrays = parts_of(scene.at(0.0))
    for given in about.get("colliders", ()):
        for key in ("path", "velocity", "rotation_rate"):
            given.pop(key, None)
    about |= {"moving_pins": [], "motors": []}
    if wind is not None:
        about["wind"]["gust"] = 0.0
    made = scene_of(about, arrays)
    made.settings = dict(scene.settings)
    return made


def settle(simulation: Any, tolerance: float, longest: float) -> tuple[NDArray[np.float64], Settled]:
    """Bring a simulation, in which nothing is driven, to rest; positions (n, dim) [m] and how well they balance. longest:
    simulated seconds, after which it is given up, with a warning."""
    scene, dt = simulation.scene, simulation.dt
    free, mass = ~scene.pinned, scene.mass[:, None]
    if not free.any():
        return simulation.position, Settled(0.0, 0.0, 0.0, 0, True)
    zero = np.zeros((scene.n_balls, scene.dim))
    load = float(np.linalg.norm(scene.gravity) * scene.mass[free].mean())
    spent, least, since, chunk = 0.0, np.inf, 0, 1
    for stops in range(1, MOST_STOPS + 1):
        at_rest = simulation.position
        simulation.set_velocity(zero)
        simulation._state.write_spin(np.zeros_like(simulation._state.surface_speed))
        simulation.step(1)
        spent += dt
        pushed = simulation.velocity[free]
        residual = float(np.linalg.norm(mass[free] * pushed, axis=1).max()) / dt
        load = load or residual
        found = Settled(residual, load, spent, stops, residual <= tolerance * load)
        least, since = (residual, 0) if residual < BETTER * least else (least, since + 1)
        if found.reached or since > PATIENCE or spent > longest:
            break
        # where the step is long for the motion, the place behind a peak may balance as badly as the one before it
        back = since % 2 == 1
        steps = 1 + _to_the_peak(simulation, mass, free, chunk, round((longest - spent) / dt) + 1, back)
        spent += (steps - 1) * dt
        chunk = max(1, steps // LOOKS)
    if not found.reached:
        # stops that lower the residual no more, long before the time is up, end at what rounding leaves
        rounded = simulation.parts.backend.precision == "f32" and since > PATIENCE
        cure = '; single precision may be what stands in the way: try precision = "f64"' if rounded else ""
        warn(f"settle: {found}; allowed is {percent(tolerance)}{cure}")
    return at_rest, found


def _to_the_peak(
    simulation: Any, mass: NDArray[np.float64], free: NDArray[np.bool_], chunk: int, most: int, back: bool
) -> int:
    """Step until the kinetic energy falls, looking at it every `chunk` steps; the number of steps, at most about `most`. back:
    go back to the place where it was largest."""

    def energy() -> float:
        return float((mass[free] * simulation.velocity[free] ** 2).sum())

    steps, before, place = 0, energy(), simulation.position
    while steps < most:
        simulation.step(chunk)
        steps += chunk
        now = energy()
        if now <= before:
            break
        before, place = now, simulation.position
    if back:
        simulation.set_position(place)
    return steps


def require_tolerance(value: Any) -> float | None:
    """The tolerance of a setting: True is 1e-3, False and None are none. Raises SceneError."""
    if value is None:
        return None
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_)):
        return 1e-3 if value else None
    if isinstance(value, (int, float, np.integer, np.floating)) and 0.0 < value < 1.0:
        return float(value)
    raise SceneError("settle", value, "true, false, or the part of the load that may be left, between 0 and 1")
