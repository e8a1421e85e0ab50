"""Settling: a scene brought to rest before its clock starts, by kinetic damping.

The scene moves freely from rest until its kinetic energy has passed a peak. There the potential energy is near a least value, so
the velocities are set to 0 and it begins again, until what is left of the forces is small (Day, 1965; Barnes, 1988). No damping
is added, so the state of rest is that of the scene itself.

Single precision rounds places, and stiff springs make forces of that, which may be many times the weight. They push balls back
and forth within what it rounds, and their kinetic energy has peaks of its own. Where stops lower the net force no further, the
scene goes on by implicit steps so long that springs answer to such a push within one step.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.contact_loads import at_contacts
from taichi_sim.common.errors import SceneError
from taichi_sim.common.quantities import measured, percent
from taichi_sim.common.warn import warn
from taichi_sim.files.checkpoint import parts_of, scene_of
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot

__all__ = ["Settled", "settle", "still"]

LOOKS = 16  # at the kinetic energy, on the way to a peak
MOST_STOPS = 2000
PATIENCE = 60  # stops, after which a residual that has not fallen by BETTER is that of rounding
BETTER = 0.9
LONGEST_STEP = 1.0 / 30.0  # s, of implicit steps


class Settled(NamedTuple):
    """Result of settling. residual [N]: the largest net force that is left on a ball that is not pinned, where steps were
    implicit without what springs take back within a step; load [N]: what it is compared with, the mean weight of these balls.
    Without gravity it is the largest net force at the start, and at least so large that forces of rounding are allowed. time [s]:
    simulated on the way; stops: how often velocities were set to 0; reached: whether the residual is within the tolerance."""

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
        part = f"{percent(self.residual / self.load)} of a load of {measured(self.load, unit='N')}"
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


def settle(
    simulate: Callable[..., Any], position: NDArray[np.float64], tolerance: float, longest: float
) -> tuple[NDArray[np.float64], Settled]:
    """Bring a scene, in which nothing is driven, to rest from positions (n, dim) [m]; where it rests and how well it balances.
    simulate: makes its simulation from settings. longest: simulated seconds, after which it is given up, with a warning."""
    # a step of this method from rest gives each ball the force at the start times h / m, exactly, at any stiffness
    with simulate(integrator="symplectic_euler", dt="auto") as simulation:
        simulation.resume(Snapshot(position, np.zeros_like(position)))
        position, found, stuck = _damp(simulation, tolerance, longest, 0.0)
        # stops that lower the residual no more, long before the time is up, end at what rounding leaves
        rounded = simulation.backend.precision == "f32" and stuck
        h = _rounding_step(simulation.scene, position, tolerance * found.load)
    if rounded and not found.reached and h <= LONGEST_STEP:
        position, found = _onwards(simulate, h, position, found, tolerance, longest)
    if not found.reached:
        cure = '; single precision may be what stands in the way: try precision = "f64"' if rounded else ""
        warn(f"settle: {found}; allowed is {percent(tolerance)}{cure}")
    return position, found


def _force_of_rounding(scene: Scene, precision: str) -> float:
    """The largest net force [N] on a free ball that rounding of places may make: that of each spring and element, added up."""
    eps = float(np.finfo(np.float32 if precision == "f32" else np.float64).eps)
    stiff = np.zeros(scene.n_balls)
    np.add.at(stiff, scene.pairs, scene.stiffness[:, None])
    for one in ELEMENTS:
        if not one.acts(scene):
            continue
        for corners, gradient, strength in one.stiffness(scene):
            size = np.linalg.norm(gradient, axis=2)
            np.add.at(stiff, corners, strength[:, None] * size * size.sum(axis=1, keepdims=True))
        balls = np.unique(one.corners(scene))
        stiff[balls] += one.further_rates(scene)[0] * scene.mass[balls]  # a bound: K_ii is at most lambda(M^-1 K) m_i
    return eps * float(np.abs(scene.position).max()) * float(stiff[~scene.pinned].max())


def _rounding_step(scene: Scene, position: NDArray[np.float64], allowed: float) -> float:
    """The step [s] in which the net force `allowed` [N] moves a ball of the mean mass by as much as single precision rounds
    places by, twice over. What rounding stretches springs by pushes balls back and forth within it, and averages out."""
    free = ~scene.pinned
    if not free.any() or allowed == 0.0:
        return 0.0
    rounding = float(np.abs(position).max()) * float(np.finfo(np.float32).eps)
    return 2.0 * float(np.sqrt(rounding * scene.mass[free].mean() / allowed))


def _onwards(
    simulate: Callable[..., Any],
    h: float,
    position: NDArray[np.float64],
    found: Settled,
    tolerance: float,
    longest: float,
) -> tuple[NDArray[np.float64], Settled]:
    """Go on by implicit steps of h seconds, whose forces answer within the step, where these are stable and show no excess at
    contacts; else what was found before."""
    with simulate(integrator="implicit_euler", dt="auto") as simulation:
        method, safe = simulation.settings.integrator.method, simulation.stability().dt_any_shape
        excess = at_contacts(simulation.scene, method, h)
        if simulation.undeclared_forces or h > safe or (excess is not None and excess.shows(method, h)):
            return position, found
        simulation.set_dt(h)
        simulation.resume(Snapshot(position, np.zeros_like(position)))
        position, last, _ = _damp(simulation, tolerance, longest - found.time, found.load)
    return position, last._replace(time=found.time + last.time, stops=found.stops + last.stops)


def _damp(simulation: Any, tolerance: float, longest: float, load: float) -> tuple[NDArray[np.float64], Settled, bool]:
    """Kinetic damping of a simulation: positions (n, dim) [m], how well they balance, and whether stops lowered the residual no
    further, before the time was up. load [N]: what it is compared with; 0: see Settled."""
    scene, dt = simulation.scene, simulation.dt
    free, mass = ~scene.pinned, scene.mass[:, None]
    if not free.any():
        return simulation.position, Settled(0.0, 0.0, 0.0, 0, True), False
    zero = np.zeros((scene.n_balls, scene.dim))
    load = load or float(np.linalg.norm(scene.gravity) * scene.mass[free].mean())
    spent, least, since, chunk = 0.0, np.inf, 0, 1
    for stops in range(1, MOST_STOPS + 1):
        at_rest = simulation.position
        simulation.set_velocity(zero)
        simulation._state.write_spin()
        simulation.step(1)
        spent += dt
        pushed = simulation.velocity[free]
        residual = float(np.linalg.norm(mass[free] * pushed, axis=1).max()) / dt
        # without weights; what rounding of places makes is no force that could be brought down
        load = load or max(residual, _force_of_rounding(scene, simulation.backend.precision) / tolerance)
        found = Settled(residual, load, spent, stops, residual <= tolerance * load)
        least, since = (residual, 0) if residual < BETTER * least else (least, since + 1)
        if found.reached or since > PATIENCE or spent > longest:
            break
        # where the step is long for the motion, the place behind a peak may balance as badly as the one before it
        back = since % 2 == 1
        steps = 1 + _to_the_peak(simulation, mass, free, chunk, round((longest - spent) / dt) + 1, back)
        spent += (steps - 1) * dt
        chunk = max(1, steps // LOOKS)
    return at_rest, found, not found.reached and spent <= longest


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
