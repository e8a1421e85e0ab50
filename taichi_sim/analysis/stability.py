"""The largest safe time step of a spring network, for every shape it can take and for the one it has.

Both bounds cost a pass over the springs and are never above the exact limit of the linearised motion. With the matrices
A_e of the springs, lambda_max(M^-1 K) <= max_i lambda_max(sum_e (1 + x_j / x_i) A_e) / m_i for any positive x (0 for a pinned
ball): Young's inequality for each spring, then the rows of blocks. For the present shape A_e is
k (n n^T + max(0, 1 - l/d) (I - n n^T)), and x is improved in a few rounds, which comes to nine tenths of the exact limit on
cloth; for every shape A_e is at most k I.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.element_rates import Rates, element_rates, pushing_gas
from taichi_sim.scene.scene import Scene

__all__ = [
    "ANY_STEP",
    "Stability",
    "coarsest_spring",
    "largest_eigenvalue",
    "predicts_damping",
    "present_eigenvalue",
    "present_limit",
    "sinking_spring",
    "stability",
    "without",
]

ANY_STEP = ("xpbd", "implicit_euler", "tr_bdf2")  # methods that no spring limits
SINKING = 0.05  # of a rest length: what a heavy ball may sink by with xpbd
HEAVY = 10.0  # times the mass of the other end: such a ball may not
VISIBLE = 1.0  # unit of rounding: a spring whose load stretches it by less is rigid or slack by chance
GENTLE = 0.9  # part of the undamped step that damping at predicted velocities must leave Verlet
ROUNDS = 3  # that improve the weights of the present bound

Floats = NDArray[np.float64]
Bound = Callable[[Floats, Floats], tuple[float, int]]  # of (m,) stiffness and damping: lambda [1/s^2], and a spring
Network = Callable[[float, float], tuple[float, int]]  # the same of factors of all stiffness and all damping


class Stability(NamedTuple):
    """`dt_any_shape` [s]: safe for every shape the scene can take; `dt_present` [s]: for the present shape; `spring`, `ball`:
    what limits the first, or None; `reason`: one sentence. Infinite where nothing limits the step."""

    dt_any_shape: float
    dt_present: float
    spring: int | None
    ball: int | None
    reason: str


def largest_eigenvalue(scene: Scene, weight: Floats) -> tuple[float, int]:
    """Bound on lambda_max(M^-1 A) for A assembled from spring weights (m,), in every shape; and the spring that sets it.

    lambda <= max over springs of S_i / m_i + S_j / m_j with S_i the sum of weights at ball i; pinned ends give 0.
    """
    if not len(weight):
        return 0.0, 0
    sums = np.bincount(scene.pairs.ravel(), np.repeat(weight, 2), scene.n_balls)
    rate = np.where(scene.pinned, 0.0, sums / scene.mass)
    bound = rate[scene.pairs].sum(axis=1) * (weight > 0)
    worst = int(np.argmax(bound))
    return float(bound[worst]), worst


def present_eigenvalue(scene: Scene, stiffness: Floats, damping: Floats, position: Floats) -> tuple[float, int]:
    """The same at `position` (n, dim) [m] for K of `stiffness` (m,), the tension of its springs included, plus a damping matrix
    of `damping` (m,); and a spring at the ball that sets it."""
    pairs, dim = scene.pairs, scene.dim
    if not len(pairs):
        return 0.0, 0
    r = position[pairs[:, 1]] - position[pairs[:, 0]]
    d = np.linalg.norm(r, axis=1)
    n = r / np.where(d > 0, d, 1.0)[:, None]
    tense = np.where(d > 0, np.maximum(0.0, 1.0 - scene.rest_length / np.where(d > 0, d, 1.0)), 1.0)
    across = stiffness * tense
    along = (stiffness + damping - across)[:, None, None] * (n[:, :, None] * n[:, None, :])
    block = along + across[:, None, None] * np.eye(dim)
    block[d == 0] = (stiffness + damping)[d == 0, None, None] * np.eye(dim)
    x = np.where(scene.pinned, 0.0, 1.0)
    least, worst = np.inf, 0
    for _ in range(ROUNDS + 1):
        row = np.zeros((scene.n_balls, dim, dim))
        for here, there in ((0, 1), (1, 0)):
            i, j = pairs[:, here], pairs[:, there]
            share = 1.0 + x[j] / np.where(x[i] > 0, x[i], 1.0)
            for a in range(dim):
                for b in range(dim):
                    row[:, a, b] += np.bincount(i, share * block[:, a, b], scene.n_balls)
        rate = np.where(scene.pinned, 0.0, np.linalg.eigvalsh(row)[:, -1] / scene.mass)
        top = float(rate.max())
        if top < least:
            least, ball = top, int(np.argmax(rate))
            load = (stiffness + damping) * np.any(pairs == ball, axis=1)
            worst = int(np.argmax(load))
        if top <= 0.0:
            break
        x = np.where(scene.pinned, 0.0, np.maximum(x * np.sqrt(np.maximum(rate, 1e-12 * top) / top), 1e-12))
    return least, worst


def stability(scene: Scene, integrator: str, position: Floats | None = None) -> Stability:
    """Largest safe step of a scene for one of the methods, by name. position (n, dim) [m]: the present shape; without it that
    bound, which takes seconds for a million balls, is not asked for, and dt_present is dt_any_shape.

    Verlet: h^2 lambda(K + 4 D / h) = 4 where damping is weak, see `predicts_damping`, else 2 / sqrt(lambda_K). Symplectic Euler:
    h^2 lambda(K + 2 D / h) = 4. RK4: 2.61 / max(sqrt lambda_K, lambda_D), and what the
    wind's force, which is capped beyond, allows.
    Explicit Euler: min over springs of c / k, and 2 / lambda_D; nothing is safe with an undamped spring, nor across one that is
    stretched: there it gains, by h omega^2 a second, at any step, and the bound only holds for the motion along springs.
    """
    rates = element_rates(scene, not _solves_gas(scene, integrator))
    if (scene.n_springs == 0 and not any(rates)) or scene.pinned.all():
        return Stability(np.inf, np.inf, None, None, "no spring moves a ball: every step is stable")
    pushed = pushing_gas(scene) if integrator == "xpbd" and _solves_gas(scene, integrator) else np.inf
    if pushed < _without_springs(integrator, rates):
        return Stability(
            pushed, pushed, None, None, "gas: each step leaves the springs of its skin a part of what it pushes"
        )
    if integrator in ANY_STEP and not any(rates):
        return Stability(np.inf, np.inf, None, None, f"{integrator} is stable at any step; only its error grows")
    if integrator in ANY_STEP or not np.any(scene.stiffness + scene.damping > 0):
        return _of_elements(integrator, rates)
    k, c = scene.stiffness, scene.damping
    h, spring = _step(scene, k, c, integrator, lambda k, c: largest_eigenvalue(scene, k + c), rates)
    if np.isinf(h):
        return Stability(np.inf, np.inf, None, None, "no spring has stiffness or damping: every step is stable")
    now = h if position is None else present_limit(scene, integrator, position)[0]
    now = max(h, now)
    i, j = (int(b) for b in scene.pairs[spring])
    load = np.bincount(scene.pairs.ravel(), np.repeat(k + c, 2), scene.n_balls) / scene.mass * ~scene.pinned
    ball = i if load[i] >= load[j] else j
    reason = (
        f"spring {spring} (balls {i} and {j}, k = {k[spring]:.4g} N/m, c = {c[spring]:.4g} N s/m) limits {integrator};"
        f" ball {ball} (m = {scene.mass[ball]:.4g} kg) carries most of it"
    )
    if rates.elastic > 0.0:
        part = 1.0 - largest_eigenvalue(scene, k)[0] / (largest_eigenvalue(scene, k)[0] + rates.elastic)
        reason += f"; cells, bending and gas make up {part:.0%} of the stiffness"
    if integrator == "explicit_euler":
        reason += "; across stretched springs, where nothing is damped, it gains energy at any step"
    if h == 0.0 and rates.elastic > 0.0:
        reason = "cells, bending and gas are undamped: explicit Euler gains energy whatever the step"
    elif h == 0.0:
        reason = f"spring {spring} (balls {i} and {j}) is undamped: explicit Euler gains energy whatever the step"
    return Stability(h, now, spring, ball, reason)


def present_limit(scene: Scene, integrator: str, position: Floats) -> tuple[float, int]:
    """The largest safe step [s] of a method that has one, at `position` (n, dim) [m], and the spring that sets it, or -1 where
    springs do not."""
    k, c = scene.stiffness, scene.damping
    if not len(k) or integrator in ANY_STEP:
        return stability(scene, integrator).dt_any_shape, -1
    return _step(scene, k, c, integrator, lambda k, c: present_eigenvalue(scene, k, c, position), element_rates(scene))


def without(scene: Scene, integrator: str, spring: int) -> float:
    """The bound for any shape if one spring were not there [s]."""
    k, c = scene.stiffness.copy(), scene.damping.copy()
    k[spring] = c[spring] = 0.0
    rates = element_rates(scene, not _solves_gas(scene, integrator))
    if not np.any(k + c > 0):
        return _of_elements(integrator, rates).dt_any_shape
    return _step(scene, k, c, integrator, lambda k, c: largest_eigenvalue(scene, k + c), rates)[0]


def _solves_gas(scene: Scene, integrator: str) -> bool:
    """Whether a method treats gas together with springs, so that it does not limit the step."""
    return integrator in ("xpbd", "implicit_euler") and scene.n_springs > 0


def _of_elements(integrator: str, rates: Rates) -> Stability:
    """Where only elements limit the step: they are explicit in every method."""
    h = _without_springs(integrator, rates)
    if np.isinf(h):
        return Stability(h, h, None, None, "nothing has stiffness or damping: every step is stable")
    what = "explicit Euler gains energy whatever the step" if h == 0.0 else f"explicit forces, limit {integrator}"
    return Stability(h, h, None, None, f"cells, bending and gas: {what}")


def _without_springs(integrator: str, rates: Rates) -> float:
    if integrator == "explicit_euler":
        return 0.0 if rates.elastic > 0.0 else _over(2.0, rates.damping)
    if integrator == "rk4":
        return min(_over(2.61, max(float(np.sqrt(rates.elastic)), rates.damping)), _over(1.0, rates.drag))
    part = 0.5 if integrator == "tr_bdf2" else 1.0  # its two stages take explicit forces from old places
    return part * _quadratic(rates, 4.0)


def _quadratic(rates: Rates, factor: float) -> float:
    """Root of h^2 elastic + factor h damping = 4."""
    a, b = rates.elastic, factor * rates.damping
    return _over(8.0, b + float(np.sqrt(b * b + 16.0 * a)))


def sinking_spring(scene: Scene, h: float) -> tuple[int, int, float] | None:
    """The spring whose heavier ball xpbd lets sink the furthest, that ball, and how far [m]; None where that is no more
    than the spring gives anyway, or less than SINKING of the rest length, the ball being less than HEAVY times the other end.

    In one pass a spring gives h k s / (1 + h^2 k W), s its stretch, W the inverse masses of both ends: it pulls as one of the
    compliance 1 / k + h^2 W, however still its lighter end is held by others. Under m g that gives m g h^2 W more,
    at the least: at the end of a chain of light balls, which pass the load on by one spring in a pass, tens of times as much.
    """
    g = float(np.linalg.norm(scene.gravity))
    if g == 0.0 or not scene.n_springs:
        return None
    mass = np.where(scene.pinned, 0.0, scene.mass)[scene.pairs]
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)[scene.pairs].sum(axis=1)
    load = mass.max(axis=1) * g
    depth = np.where(mass.min(axis=1) > 0, load * h**2 * w, 0.0)  # a pinned end is held by itself
    own = np.divide(load, scene.stiffness, out=np.full_like(load, np.inf), where=scene.stiffness > 0)
    little = (depth < SINKING * scene.rest_length) & (mass.max(axis=1) < HEAVY * mass.min(axis=1))
    depth[(depth < own) | little] = 0.0
    spring = int(np.argmax(depth))
    ball = int(scene.pairs[spring, np.argmax(mass[spring])])
    return (spring, ball, float(depth[spring])) if depth[spring] > 0.0 else None


def coarsest_spring(scene: Scene) -> tuple[int, float, float] | None:
    """The spring whose load shows least in single precision, the stretch [m] by its heavier ball's weight, and the distance [m]
    between neighbouring numbers there; None where each stretch is at least VISIBLE of those."""
    g = float(np.linalg.norm(scene.gravity))
    if g == 0.0 or not scene.n_springs:
        return None
    load = np.where(scene.pinned, 0.0, scene.mass)[scene.pairs].max(axis=1) * g
    rounding = np.abs(scene.position).max(axis=1)[scene.pairs].max(axis=1) * float(np.finfo(np.float32).eps)
    stretch = np.divide(load, scene.stiffness, out=np.full_like(load, np.inf), where=(scene.stiffness > 0) & (load > 0))
    ratio = np.divide(stretch, rounding, out=np.full_like(load, np.inf), where=rounding > 0)
    spring = int(np.argmin(ratio))
    return (spring, float(stretch[spring]), float(rounding[spring])) if ratio[spring] < VISIBLE else None


def predicts_damping(scene: Scene) -> bool:
    """Whether `verlet` takes spring damping at predicted velocities, for which it is weak enough, and not together with the
    kick, see taichi_sim.analysis.damping, which nothing limits and which costs passes over the springs of its own."""
    return bool(np.any(scene.damping > 0)) and _is_gentle(scene, scene.stiffness, scene.damping)


def _is_gentle(scene: Scene, k: Floats, c: Floats) -> bool:
    """Whether h^2 lambda(K + 4 D / h) < 4 in every shape at GENTLE times the undamped step."""
    h = GENTLE * _over(2.0, float(np.sqrt(largest_eigenvalue(scene, k)[0])))
    return bool(np.isfinite(h)) and h * h * largest_eigenvalue(scene, k + 4.0 * c / h)[0] <= 4.0


def _step(scene: Scene, k: Floats, c: Floats, integrator: str, springs: Bound, rates: Rates) -> tuple[float, int]:
    """The largest step by a bound, for stiffness and damping (m,), and the spring that sets it. rates: of elements, which add to
    what the bound says of springs: lambda(A + B) <= lambda(A) + lambda(B)."""

    def bound(elastic: float, damping: float) -> tuple[float, int]:
        value, spring = springs(elastic * k, damping * c)
        return value + elastic * rates.elastic + damping * rates.damping, spring

    if integrator == "symplectic_euler":
        return _with_damping(2.0, bound)
    if integrator == "verlet" and _is_gentle(scene, k, c):
        return _with_damping(4.0, bound)
    if integrator == "rk4":
        (lambda_k, spring_k), (lambda_d, spring_d) = bound(1.0, 0.0), bound(0.0, 1.0)
        elastic = np.sqrt(lambda_k) >= lambda_d
        longest = min(_over(2.61, max(np.sqrt(lambda_k), lambda_d)), _over(1.0, rates.drag))
        return longest, spring_k if elastic else spring_d
    if integrator == "explicit_euler":
        return (0.0, 0) if rates.elastic > 0.0 else _explicit(k, c, bound)
    value, spring = bound(1.0, 0.0)
    return min(_over(2.0, float(np.sqrt(value))), _over(1.0, rates.damping)), spring


def _over(a: float, b: float) -> float:
    return a / b if b > 0 else np.inf


def _with_damping(factor: float, bound: Network) -> tuple[float, int]:
    """Root of h^2 lambda(K + factor D / h) = 4 by bisection; the bound is monotone in h."""
    value, spring = bound(1.0, 0.0)
    high = _over(2.0, float(np.sqrt(value)))
    most, damped = bound(0.0, 1.0)
    if np.isinf(high):
        return _over(4.0 / factor, most), damped
    if most == 0.0:
        return high, spring
    low = 0.0
    while high - low > 1e-8 * high:
        middle = 0.5 * (low + high)
        enough = middle**2 * bound(1.0, factor / middle)[0] < 4.0
        low, high = (middle, high) if enough else (low, middle)
    return low, bound(1.0, factor / low)[1]


def _explicit(k: Floats, c: Floats, bound: Network) -> tuple[float, int]:
    """Every mode has d <= lambda_D and d / kappa >= min c / k: underdamped ones need h <= d / kappa, others h <= 2 / d."""
    ratio = np.divide(c, k, out=np.full_like(k, np.inf), where=k > 0)
    spring = int(np.argmin(ratio))
    value, other = bound(0.0, 1.0)
    return (float(ratio[spring]), spring) if ratio[spring] <= _over(2.0, value) else (_over(2.0, value), other)
