"""The plan of a report: which methods, steps and precisions, for how long, and the key that tells it from another."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.methods import VERLET, named
from taichi_sim.analysis.stability import soft_step, stability
from taichi_sim.common.version import __version__
from taichi_sim.files.source import checked_output
from taichi_sim.scene.contents import contents_of
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.settings import Settings, part_of_bound

METHODS = ("verlet", "symplectic_euler", "rk4", "explicit_euler", "xpbd", "implicit_euler", "tr_bdf2")
PRECISIONS = ("f64", "f32")
PARTS = 8  # of the duration, at whose ends states are compared; steps fit into each a whole number of times
FRAME = 1.0 / 60.0  # s, the longest step tried
HALVINGS = 4  # of the longest step
WORK = 6e8  # springs and balls that the reference goes through, about 8 s on one core; what the default duration is chosen by
MOST_WORK = 100.0 * WORK  # about a quarter of an hour on one core; longer durations are refused
OVERHEAD = 50  # springs and balls that take as long as what every step costs
NICE = (5.0, 2.5, 2.0, 1.0)


@dataclass(frozen=True)
class Plan:
    """Settings of a report. duration [s]; steps [s], or None for halvings that are chosen by method; tolerance: a part of
    the motion, see `Compared`; most: wall seconds that one run may take. quantity: the name of one, or None for positions.
    resolutions: find the error of the mesh, too. rest: positions (n, dim) [m] in which the scene's own `settle` leaves the balls,
    None without it, empty where the effect of what it leaves cannot be told."""

    name: str
    duration: float
    methods: tuple[str, ...] = METHODS
    precisions: tuple[str, ...] = PRECISIONS
    steps: tuple[float, ...] | None = None
    tolerance: float = 1e-3
    most: float = 4.0
    quantity: str | None = None
    resolutions: bool = False
    arch: str | None = None
    threads: int | None = None
    rest: NDArray[np.float64] | None = None


class Step(NamedTuple):
    """A step that fits: `number` of them in each of the PARTS of the duration."""

    number: int
    seconds: float


def fitting(duration: float, seconds: float) -> Step:
    """The longest step of at most about `seconds` that fits."""
    number = max(1, math.ceil(duration / (PARTS * seconds) * (1.0 - 1e-9)))
    return Step(number, duration / (PARTS * number))


def halved(duration: float, step: Step) -> Step:
    """Half of a step."""
    return Step(2 * step.number, duration / (PARTS * 2 * step.number))


def steps_of(scene: Scene, method: str, plan: Plan) -> list[Step]:
    """The steps to try with a method, the longest first: by default twice the safe step, which shows what becomes of it there,
    and halvings of that; for methods without a limit from a frame on. The longest that is safe in the long run is among them."""
    if plan.steps is not None:
        return sorted({fitting(plan.duration, seconds) for seconds in plan.steps}, key=lambda step: step.number)
    steps = [fitting(plan.duration, min(FRAME, 2.0 * limit(scene, method)))]
    declared = named(method).limit
    by_springs = declared is not None and declared.by_springs
    for _ in range(HALVINGS if by_springs else HALVINGS + 1):
        steps.append(halved(plan.duration, steps[-1]))
    if longest := longest_step(scene, method):
        steps.append(fitting(plan.duration, min(FRAME, longest)))
    return sorted(set(steps), key=lambda step: step.number)


def longest_step(scene: Scene, method: str) -> float:
    """The longest step [s] that is safe in the long run, and one as `fitting` rounds it; no longer one is recommended. 0 where
    there is none, infinite without a limit."""
    return part_of_bound(scene, named(method)) * bound(scene, method) * (1.0 + 1e-9)


def bound(scene: Scene, method: str) -> float:
    """The step [s] that is safe in every shape, and leaves no spring too long; see `longest_step`."""
    return min(stability(scene, named(method)).dt_any_shape, soft_step(scene, named(method)))


def limit(scene: Scene, method: str) -> float:
    """The safe step [s]; of Verlet where explicit Euler has none."""
    return stability(scene, named(method)).dt_any_shape or stability(scene, VERLET).dt_any_shape


def own_step(scene: Scene, method: str | None = None) -> tuple[str, float]:
    """A method, by default the scene's own, and the substep [s] that the scene would be run with, or less where that is safe."""
    settings = Settings.resolve(scene, {"precision": None, "arch": None, "threads": None})
    own = settings.integrator.method.name
    dt, substeps = settings.time_step(scene, stability(scene, settings.integrator.method))
    return method or own, min(dt / substeps, 0.9 * limit(scene, method or own))


def duration_of(scene: Scene) -> float:
    """The simulated seconds [s] that a report is of by default: the scene's own, or less where its reference would take long."""
    whole = float(checked_output(scene).get("duration", 5.0))
    most = WORK / _work(scene, 1)
    if most >= whole:
        return whole
    power = 10.0 ** math.floor(math.log10(most))
    return next(nice * power for nice in NICE if nice * power <= most)


def longest_duration(scene: Scene) -> float:
    """The simulated seconds [s] whose reference is a hundred times the work that a default duration may make."""
    return MOST_WORK / _work(scene, OVERHEAD)


def _work(scene: Scene, least: int) -> float:
    """Springs, bending elements and balls that the reference goes through in a simulated second: steps of a quarter and an
    eighth, 4 passes."""
    return (
        3.0
        * 4.0
        * 4.0
        / min(FRAME, limit(scene, "rk4"))
        * max(least, scene.n_balls + scene.n_springs + len(scene.bends))
    )


def size_of(scene: Scene) -> float:
    """The diagonal of the box around all balls at the start [m]."""
    reach = scene.radius[:, None]
    return float(np.linalg.norm((scene.position + reach).max(axis=0) - (scene.position - reach).min(axis=0)))


def about(scene: Scene, plan: Plan) -> dict[str, Any]:
    """The scene's content and all of the plan that rows depend on; methods and precisions may be added later."""
    return {
        "version": __version__,
        "scene": contents_of(scene),
        "settings": scene.settings,
        "plan": {"duration": plan.duration, "arch": plan.arch, "threads": plan.threads, "most": plan.most}
        | ({} if plan.quantity is None else {"quantity": plan.quantity}),
    }
