"""Settings: the arguments of Simulation, checked and with every "auto" that depends on the scene alone resolved."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_sim.analysis.accuracy import impact_step, layers
from taichi_sim.analysis.choice import LONGEST_STEP, Demand, choose
from taichi_sim.analysis.element_rates import declared_rates, undeclared
from taichi_sim.analysis.late_impacts import late_rate
from taichi_sim.analysis.limits import StabilityLimit
from taichi_sim.analysis.methods import BUILT_IN_RULES, VERLET, Method
from taichi_sim.analysis.stability import Stability, sinking_step
from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, unknown_key
from taichi_sim.device import backend
from taichi_sim.scene.scene import Scene, max_restitution
from taichi_sim.simulation.settling import require_tolerance

__all__ = ["Settings", "part_of_bound"]

DEFAULTS: dict[str, Any] = {
    "integrator": VERLET.name,
    "dt": "auto",
    "tolerance": None,
    "substeps": "auto",
    "precision": None,
    "arch": None,
    "threads": None,
    "contacts": "auto",
    "contact_iterations": "auto",
    "accumulate": "auto",
    "driver": "auto",
    "spin": "auto",
    "settle": None,
}
WORDS: dict[str, tuple[Any, ...]] = {
    "accumulate": ("auto", "ordered", "gather", "atomic"),
    "driver": ("auto", "fused", "parallel"),
    "spin": ("auto", True, False),
}
# s, the longest step between two estimates of the error; it divides frames of 24, 30 and 60 a second
STRIDE = 1.0 / 240.0
MOST_PARTS_GIVEN = 2**31 - 1  # substeps, or iterations
MOST_PARTS = 256  # of such a step, where springs need short ones
SHORTEST_DT, LONGEST_DT = 1e-12, 1e6  # s
MOST_THREADS = 4096
SAFETY = 0.9  # of the stability bound
# The same for a symplectic method where a spring is undamped: small motion is stable up to the bound, but large motion meets
# resonances of the step itself from omega h = 1.2 on, and gains energy.
UNDAMPED = 0.4
SINKING = {2: 0.035, 3: 0.02}  # layers x g h^2 / r; the lowest of a pile sink in by up to twice that part of the radius
LATE = 0.025  # of the energy that impacts of balls exchange: how much of it automatic substeps may miss
MOST_SUBSTEPS = 8  # for balls
CLOSING = 1.0  # of the thickness of surfaces that collide: how far they may close in a substep
MANY_BALLS = 1000  # fewer can afford two iterations
# by split masses, where few balls bounce at all: each of s contacts of a ball, in one iteration, undoes the part 1 / s of what
# is left of an impact, so that (1 + e) (1 - 1 / s)^n of its speed is missing after n: 0.01 (1 + e) where s is 4
BOUNCING_ITERATIONS = 16
# folds lie in layers, each ball in up to thirty contacts, of which an iteration undoes a thirtieth of what is left; finding
# these takes far longer than an iteration
SURFACE_ITERATIONS = 30
STICK_ITERATIONS = 4  # of many balls
UNEQUAL_MASSES = 10.0  # ratio of masses from which one Gauss-Seidel iteration is not enough


@dataclass(frozen=True, slots=True)
class Settings:
    """Checked arguments. None for precision, arch, threads: what the process runs, or the default. `chosen`: the reason, in
    words, for an integrator that "auto" took."""

    integrator: Any
    dt: float | str
    tolerance: float | None
    substeps: int | str
    precision: str | None
    arch: str | None
    threads: int | None
    contacts: Any
    contact_iterations: int | str
    accumulate: str
    driver: str
    spin: Any
    settle: float | None
    chosen: str = ""

    @classmethod
    def resolve(cls, scene: Scene, given: dict[str, Any], forces: Sequence[Any] = ()) -> "Settings":
        """Arguments, else scene.settings, else defaults. forces: user-defined ones. Raises ValueError that names the argument and
        what is allowed."""
        for name in (*scene.settings, *given):
            if name not in DEFAULTS:
                raise unknown_key(name, [*DEFAULTS, "forces"], "an argument of Simulation")
        for source in (scene.settings, given):
            if source.get("tolerance") is not None:
                for name in ("dt", "substeps"):
                    if not _auto(source.get(name, "auto")):
                        says = f"chooses the step, but {name} = {source[name]!r} is given too; leave one out"
                        raise SceneError("tolerance", says=says)
        values = {**DEFAULTS, **_over(scene.settings, given)}
        for name, allowed in WORDS.items():
            validation.one_of(name, values[name], allowed)
        _check_backend(values)
        _check_contacts(values["contacts"])
        if not _auto(values["integrator"]):
            values["integrator"] = _integrator(values["integrator"])
        for name in ("contact_iterations", "substeps"):
            if not _auto(values[name]):
                values[name] = validation.whole(name, values[name], 1, MOST_PARTS_GIVEN)
        values["settle"] = require_tolerance(values["settle"])
        if not _auto(values["dt"]):
            values["dt"] = seconds_of_step(values["dt"])
        if values["tolerance"] is not None:
            values["tolerance"] = validation.number("tolerance", values["tolerance"], positive=True)
            if values["tolerance"] >= 1.0:
                raise SceneError("tolerance", values["tolerance"], "less than 1")
        if _auto(values["integrator"]):
            values |= _chosen(scene, values, forces)
        return cls(**values)

    def iterations(self, scene: Scene, in_turn: bool) -> int:
        """Iterations of each contact solve. "auto": where contacts see what those before them changed (in_turn) 2, and 1 for
        more than a thousand balls, but not where they differ tenfold in mass: a light ball under a heavy one trembles with 1.
        With sticks iterations stop impacts too, and so many balls get 4: 10^4 balls that fall into a net overlap by 0.21 of a
        radius, by 0.59 with 2. 30 where surfaces collide; with these or with sticks up to 4 more for balls that bounce well.
        With split masses 4 for small scenes to 8 for those whose piles can be high, and up to 12 more where balls bounce well:
        what has not converged then takes energy for good. Of up to a thousand balls that bounce at all it is at least 16."""
        if self.contact_iterations != "auto":
            return int(self.contact_iterations)
        surfaces, bounce = SURFACE_ITERATIONS if scene.solid.any() else 0, max_restitution(scene)
        lively = max(0.0, 2.0 * bounce - 1.0)
        if in_turn:
            mass = scene.mass[~scene.pinned]
            # else impacts are resolved one by one
            rows = scene.solid.any() or scene.collides.any()
            many = len(mass) > MANY_BALLS
            alike = many and mass.max() <= UNEQUAL_MASSES * mass.min()
            few = max(STICK_ITERATIONS if many and rows else 1 if alike else 2, surfaces)
            return few + (round(4 * lively) if rows else 0)
        few = max(surfaces, int(np.clip(round(0.4 * scene.n_balls ** (1.0 / scene.dim)), 4, 8))) + round(12 * lively)
        return max(few, BOUNCING_ITERATIONS) if bounce > 0.0 and scene.n_balls <= MANY_BALLS else few

    def time_step(self, scene: Scene, safe: Stability) -> tuple[float, int]:
        """dt [s] and the number of substeps, with "auto" resolved."""
        if self.dt != "auto":
            dt = float(self.dt)
            return dt, self._substeps(scene, dt)
        method = self.integrator.method
        if method.limit is None:
            name = "dt" if self.tolerance is None else "tolerance"
            raise SceneError(
                name,
                getattr(self, name),
                says=f"needs a step that is known to be safe, and the integrator {method} declares no stability limit; give dt in"
                f" seconds, or declare one in the integrator's class: method = Method({method.name!r},"
                " limit=StabilityLimit(undamped=..., damped=...))",
            )
        if safe.dt_any_shape == 0.0:
            says = f"finds no safe step: {safe.reason}; give a number, or take another integrator"
            raise SceneError("dt", "auto", says=says)
        longest = part_of_bound(scene, method) * safe.dt_any_shape
        if self.tolerance is not None:
            dt = float(np.minimum(STRIDE, MOST_PARTS * longest))
            return dt, 2 * max(1, int(np.ceil(dt / longest)), self._substeps(scene, dt))
        limit = longest * (1 if self.substeps == "auto" else int(self.substeps))
        dt = float(np.minimum(LONGEST_STEP, limit))
        return dt, self._substeps(scene, dt)

    def automatic_step(self, scene: Scene, method: Method, safe: Stability) -> float:
        """The substep [s] of `method`, a built-in one whose safe step is known, by dt = "auto" and otherwise these settings; 0
        where no step is safe."""
        if safe.dt_any_shape == 0.0:
            return 0.0
        substeps = self.substeps if self.dt == "auto" else "auto"
        other = replace(self, integrator=_integrator(method.name), dt="auto", tolerance=None, substeps=substeps)
        dt, parts = other.time_step(scene, safe)
        return dt / parts

    def _substeps(self, scene: Scene, dt: float) -> int:
        """Number of substeps of a step. For "auto" loose balls need so many to lie on each other firmly and, without a tolerance,
        to collide in time; surfaces that collide and the passes of xpbd need them down to LONGEST_STEP."""
        if self.substeps != "auto":
            return int(self.substeps)
        longest = _pile_step(scene, self.contacts)
        if self.tolerance is None:
            longest = min(longest, _impact_step(scene, self.contacts))
        balls = np.clip(np.ceil(dt / longest * (1.0 - 1e-9)), 1, MOST_SUBSTEPS)
        longest = _surface_step(scene, self.contacts)
        if self.integrator.method.single_pass:
            longest = min(longest, sinking_step(scene))
        needed = np.clip(np.ceil(dt / max(LONGEST_STEP, longest) * (1.0 - 1e-9)), 1, MOST_PARTS)
        return int(max(balls, needed))


def _pile_step(scene: Scene, contacts: Any) -> float:
    """The longest substep [s] with which loose balls lie on each other firmly, should they pile up as wide as they start."""
    loose = scene.loose()
    g = float(np.linalg.norm(scene.gravity))
    if contacts == "off" or np.count_nonzero(loose) < 2 or g == 0.0:
        return math.inf
    radius = float(np.median(scene.radius[loose]))
    return float(np.sqrt(SINKING[scene.dim] * radius / (g * layers(scene, loose))))


def _impact_step(scene: Scene, contacts: Any) -> float:
    """The longest substep [s] in which impacts of balls as fast as at the start miss LATE of their energy."""
    rate = 0.0 if contacts == "off" else late_rate(scene, scene.velocity)
    return LATE / rate if rate > 0.0 else math.inf


def _surface_step(scene: Scene, contacts: Any) -> float:
    """The longest substep [s] in which folds of surfaces that collide close by at most CLOSING of their thickness: they fall by
    the length of the largest body of them before they meet."""
    if contacts == "off" or not scene.solid.any():
        return math.inf
    balls = np.unique(scene.triangles[scene.solid])
    g = float(np.linalg.norm(scene.gravity))
    longest = float(np.ptp(scene.position[balls], axis=0).max())
    start = float(np.linalg.norm(scene.velocity[balls] - scene.velocity[balls].mean(axis=0), axis=1).max())
    speed = math.sqrt(start**2 + 2.0 * g * longest)
    return CLOSING * 2.0 * float(scene.radius[balls].min()) / speed if speed > 0.0 else math.inf


def part_of_bound(scene: Scene, method: Method) -> float:
    """Part of the stability bound that is safe in the long run."""
    return UNDAMPED if method.symplectic and not np.all(scene.damping > 0) else SAFETY


def seconds_of_step(dt: Any) -> float:
    """A step [s]. Raises SceneError where it is none that a simulation takes."""
    seconds = validation.number("dt", dt, high=math.inf)
    if not SHORTEST_DT <= seconds <= LONGEST_DT:
        raise SceneError("dt", seconds, f"from {SHORTEST_DT:g} to {LONGEST_DT:g} seconds")
    return seconds


def _chosen(scene: Scene, values: dict[str, Any], forces: Sequence[Any]) -> dict[str, Any]:
    """The integrator, and the step, that "auto" takes with these values, and why."""
    rule, step = values["contacts"], None
    if not _auto(values["dt"]):
        step = values["dt"] / (1 if _auto(values["substeps"]) else values["substeps"])
    by_error = values["tolerance"] is not None
    bounces = math.inf if by_error else _impact_step(scene, rule)
    contact_step = max(LONGEST_STEP, min(_pile_step(scene, rule), bounces, _surface_step(scene, rule)))
    advised = math.inf if rule == "off" else impact_step(scene)
    demand = Demand(step, contact_step, advised, rule != "off", by_error, part_of_bound(scene, VERLET))
    choice = choose(scene, demand, declared_rates(scene, forces), bool(undeclared(forces)))
    found = {"integrator": _integrator(choice.method.name), "chosen": f"{choice.method} by auto: {choice.reason}"}
    return found if choice.step is None else found | {"dt": choice.step}


def _auto(value: Any) -> bool:
    return isinstance(value, str) and value == "auto"


def _over(settings: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """Arguments over the scene's own; a tolerance takes the place of a step, and a step that of a tolerance."""
    left = dict(settings)
    if given.get("tolerance") is not None:
        left.update(dt="auto", substeps="auto")
    elif not _auto(given.get("dt", "auto")):
        left["tolerance"] = None
    return left | given


def _check_backend(values: dict[str, Any]) -> None:
    for name, allowed in (("arch", backend.ARCHES), ("precision", backend.PRECISIONS)):
        if values[name] is not None:
            validation.one_of(name, values[name], allowed)
    if values["threads"] is not None:
        validation.whole("threads", values["threads"], 1, MOST_THREADS)


def _check_contacts(value: Any) -> None:
    words = ("auto", *BUILT_IN_RULES)
    if isinstance(value, str) and value in words:
        return
    from taichi_sim.contacts import ContactRule  # brings Taichi: only when a simulation is made

    if not isinstance(value, ContactRule):
        validation.one_of("contacts", value, words, ", or a ContactRule")


def _integrator(value: Any) -> Any:
    from taichi_sim.device.engine import another
    from taichi_sim.integrators import BUILT_IN, Integrator  # brings Taichi: only when a simulation is made

    if isinstance(value, Integrator):
        if not isinstance(value.method, Method):
            raise SceneError(
                "integrator", says=f"{type(value).__name__}.method must be a ts.Method, not {value.method!r}"
            )
        if not isinstance(value.method.limit, (StabilityLimit, type(None))):
            raise SceneError(
                "integrator", says=f"the limit of {type(value).__name__}.method must be a ts.StabilityLimit"
            )
        validation.taichi_function("integrator", value, "substep", "h, time")
        if type(value).substep is Integrator.substep and type(value).parts is Integrator.parts:
            raise SceneError(
                "integrator",
                says=f"{type(value).__name__} has no substep; give a @ti.func substep(self, h, time), or parts()",
            )
        return another(value)  # one object may serve several simulations
    for kind in BUILT_IN:
        if kind.method.name == value:
            return kind()
    validation.one_of("integrator", value, ["auto", *(kind.method.name for kind in BUILT_IN)], ", or an Integrator")
