"""The largest safe time step, from one pass over the springs."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene import Scene

__all__ = ["Stability", "largest_eigenvalue", "stability"]

ANY_STEP = ("xpbd", "implicit_euler", "tr_bdf2")  # methods that no spring limits


class Stability(NamedTuple):
    """`dt_any_shape` [s]: safe for every shape the scene can take; `dt_present` [s]: for the present shape (here the same
    bound); `spring`, `ball`: what limits it, or None; `reason`: one sentence. Infinite where nothing limits the step."""

    dt_any_shape: float
    dt_present: float
    spring: int | None
    ball: int | None
    reason: str


def largest_eigenvalue(scene: Scene, weight: NDArray[np.float64]) -> tuple[float, int]:
    """Bound on lambda_max(M^-1 A) for A assembled from spring weights (m,), in every shape; and the spring that sets it.

    lambda <= max over springs of S_i / m_i + S_j / m_j with S_i the sum of weights at ball i; pinned ends give 0.
    """
    sums = np.bincount(scene.pairs.ravel(), np.repeat(weight, 2), scene.n_balls)
    rate = np.where(scene.pinned, 0.0, sums / scene.mass)
    bound = rate[scene.pairs].sum(axis=1) * (weight > 0)
    worst = int(np.argmax(bound))
    return float(bound[worst]), worst


def stability(scene: Scene, integrator: str) -> Stability:
    """Largest safe step of a scene for one of the explicit methods, by name.

    Verlet: 2 / sqrt(lambda_K). Symplectic Euler: h^2 lambda(K + 2 D / h) = 4. RK4: 2.61 / max(sqrt lambda_K, lambda_D).
    Explicit Euler: min over springs of c / k, and 2 / lambda_D; nothing is safe with an undamped spring.
    """
    if scene.n_springs == 0 or scene.pinned.all():
        return Stability(np.inf, np.inf, None, None, "no spring moves a ball: every step is stable")
    if integrator in ANY_STEP:
        return Stability(np.inf, np.inf, None, None, f"{integrator} is stable at any step; only its error grows")
    k, c = scene.stiffness, scene.damping
    if integrator == "symplectic_euler":
        h, spring = _symplectic(scene)
    elif integrator == "rk4":
        lambda_k, spring_k = largest_eigenvalue(scene, k)
        lambda_d, spring_d = largest_eigenvalue(scene, c)
        elastic = np.sqrt(lambda_k) >= lambda_d
        h, spring = _over(2.61, max(np.sqrt(lambda_k), lambda_d)), spring_k if elastic else spring_d
    elif integrator == "explicit_euler":
        h, spring = _explicit(scene)
    else:
        bound, spring = largest_eigenvalue(scene, k)
        h = _over(2.0, float(np.sqrt(bound)))
    if np.isinf(h):
        return Stability(np.inf, np.inf, None, None, "no spring has stiffness or damping: every step is stable")
    i, j = (int(b) for b in scene.pairs[spring])
    load = np.bincount(scene.pairs.ravel(), np.repeat(k + c, 2), scene.n_balls) / scene.mass * ~scene.pinned
    ball = i if load[i] >= load[j] else j
    reason = (
        f"spring {spring} (balls {i} and {j}, k = {k[spring]:.4g} N/m, c = {c[spring]:.4g} N s/m) limits {integrator};"
        f" ball {ball} (m = {scene.mass[ball]:.4g} kg) carries most of it"
    )
    if h == 0.0:
        reason = f"spring {spring} (balls {i} and {j}) is undamped: explicit Euler gains energy whatever the step"
    return Stability(h, h, spring, ball, reason)


def _over(a: float, b: float) -> float:
    return a / b if b > 0 else np.inf


def _symplectic(scene: Scene) -> tuple[float, int]:
    """Root of h^2 lambda(K + 2 D / h) = 4 by bisection; the bound is monotone in h."""

    def load(h: float) -> tuple[float, int]:
        bound, spring = largest_eigenvalue(scene, scene.stiffness + 2.0 * scene.damping / h)
        return h * h * bound, spring

    high = _over(2.0, float(np.sqrt(largest_eigenvalue(scene, scene.stiffness)[0])))
    if np.isinf(high):
        bound, spring = largest_eigenvalue(scene, scene.damping)
        return _over(2.0, bound), spring
    low = 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle == 0.0 or load(middle)[0] < 4.0 else (low, middle)
    return low, load(high)[1]


def _explicit(scene: Scene) -> tuple[float, int]:
    """Every mode has d <= lambda_D and d / kappa >= min c / k: underdamped ones need h <= d / kappa, others h <= 2 / d."""
    k, c = scene.stiffness, scene.damping
    ratio = np.divide(c, k, out=np.full_like(k, np.inf), where=k > 0)
    spring = int(np.argmin(ratio))
    bound, other = largest_eigenvalue(scene, c)
    return (float(ratio[spring]), spring) if ratio[spring] <= _over(2.0, bound) else (_over(2.0, bound), other)
