"""Strong damping in `verlet`: springs that are alone exactly, networks by stabilised Runge-Kutta polynomials.

With places held for a while tau, velocities obey dv/dt = W (F - D v), W the inverse masses, F the forces that do not depend on
velocity, D the damping matrix: v(tau) = R v + (1 - R) D^-1 F with R = exp(-tau W D). A polynomial of tau W D in place of the
exponential costs a product with D for each of its degrees and is stable for z = tau lambda_max(W D) up to about half of the
degree's square: the Runge-Kutta-Legendre method of order 2 (Meyer, Balsara and Aslam, J. Comput. Phys. 257, 2014). All are sums
of forces along the springs, so momentum and angular momentum are kept, and all leave D^-1 F, the creep of what is damped most,
as it is.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.analysis.spring_bounds import largest_eigenvalue, over
from taichi_sim.scene.scene import Scene

__all__ = ["MOST_STAGES", "Stages", "decay", "is_weak", "keep_energy", "lone", "predicts_damping", "softened", "stages"]

Floats = NDArray[np.float64]

FEW = 0.8  # z up to which one product for each half will do: R = 1 - 2 z + 2 z^2 of both, 0.68 there and 1 at z = 1
TWO = 1.3  # z up to which two are taken: R = 1 - z + z^2 / 2 has its least value at 1
MOST_STAGES = 61  # of half a step
HARDLY = 0.01  # of what is critical: damping of the fastest motion that leaves heat of rounding in
GENTLE = 0.9  # part of the undamped step that damping at predicted velocities must leave Verlet
AFTER = np.array([[0.0, 0.0, 1.0, 0.0]])  # R = 1 - z
BEFORE = np.array([[0.0, 0.0, 1.0, 1.0]])  # the same, and the damping of what that half before it changed


class Stages(NamedTuple):
    """Rows (s, 4) for the half of a step before the drift, and for the one after it: with L(v) = tau W (F - D v) the change y of
    v after stage j is a y_{j-1} + b y_{j-2} + c L(v + y_{j-1}) + d L(v), y_0 = y_{-1} = 0; after the first stage it is
    c L(v) + d (L(v) - L(u)), u the velocity with which the half after the last drift began: both halves act at the same places,
    as the two stages of one method of order 2."""

    before: Floats
    after: Floats


def predicts_damping(scene: Scene) -> bool:
    """True if spring damping is weak enough for `verlet` to take it at predicted velocities, and not together with the kick,
    which nothing limits and which costs passes over the springs of its own."""
    return bool(np.any(scene.damping > 0)) and is_weak(scene, scene.stiffness, scene.damping)


def is_weak(scene: Scene, k: Floats, c: Floats) -> bool:
    """True if springs of stiffness k and damping c, both (m,), leave h^2 lambda(K + 4 D / h) < 4 in every shape at GENTLE
    times the undamped step."""
    h = GENTLE * over(2.0, float(np.sqrt(largest_eigenvalue(scene, k)[0])))
    return bool(np.isfinite(h)) and h * h * largest_eigenvalue(scene, k + 4.0 * c / h)[0] <= 4.0


def keep_energy(scene: Scene) -> bool:
    """True if a scene's membranes, bricks or solids are hardly damped, so that random kicks by rounding heat them."""
    takes = (scene.membrane_damping, scene.brick_viscosity, scene.solid_viscosity)
    if not any(len(damping) for damping in takes):
        return False
    rates = element_rates(scene)
    weak = rates.damping - rates.drag < 2.0 * HARDLY * np.sqrt(rates.elastic)
    return weak or any(bool(np.any(damping == 0.0)) for damping in takes)


def lone(scene: Scene) -> NDArray[np.bool_]:
    """Mask (m,) of the springs that are damped and share no ball that can move with another damped one. All False if any
    spring can tear."""
    damped = scene.damping > 0
    count = np.bincount(scene.pairs[damped].ravel(), minlength=scene.n_balls)
    alone = ((count == 1) | scene.pinned)[scene.pairs].all(axis=1) & ~scene.pinned[scene.pairs].all(axis=1)
    return damped & alone & ~np.isfinite(scene.break_strain).any()


def softened(scene: Scene, tau: float) -> Floats:
    """Damping (m,) [N s/m] that MOST_STAGES over `tau` seconds are stable for; 0 for lone springs.

    Each spring by itself: z <= tau max c D, D = w_i s_i + w_j s_j with s the damped springs of a ball, because the square of a
    relative speed is at most D (v_i^2 / (w_i s_i) + v_j^2 / (w_j s_j)) by Cauchy and Schwarz.
    """
    c = np.where(lone(scene), 0.0, scene.damping)
    rate = tau * _shares(scene, c)
    return np.where(rate * c > _reach(MOST_STAGES), _reach(MOST_STAGES) / np.where(rate > 0, rate, 1.0), c)


def stages(scene: Scene, tau: float) -> Stages:
    """The stages of both halves of a step, of `tau` seconds each."""
    c = softened(scene, tau)
    z = tau * min(largest_eigenvalue(scene, c)[0], float(np.max(c * _shares(scene, c), initial=0.0)))
    if z <= FEW:
        return Stages(BEFORE, AFTER)
    s = 2 if z <= TWO else 3
    while 2 < s < MOST_STAGES and _reach(s) < z:  # rounding may leave a little more than was softened
        s += 2  # odd: an even polynomial comes back to 1 at the end of its reach
    return Stages(legendre(s), legendre(s))


def decay(both: Stages, z: Floats) -> Floats:
    """R(z), the part of a velocity that the half after a drift and the one before the next leave together, z that of a half."""
    left = _of_half(both.after, z)
    return _of_half(both.before, z) * left + both.before[0, 3] * z * (1.0 - left)


def _of_half(rows: Floats, z: Floats) -> Floats:
    start = -z  # of a unit velocity without forces
    before, now = np.zeros_like(z), rows[0, 2] * start
    for a, b, c, d in rows[1:]:
        before, now = now, a * now + b * before - c * z * (1.0 + now) + d * start
    return 1.0 + now


def legendre(s: int) -> Floats:
    """Rows (s, 4) of the Runge-Kutta-Legendre method of order 2 with s >= 2 stages."""
    j = np.arange(s + 1)
    b = np.full(s + 1, 1.0 / 3.0)
    b[2:] = (j[2:] ** 2 + j[2:] - 2.0) / (2.0 * j[2:] * (j[2:] + 1.0))
    width = 4.0 / (s * s + s - 2.0)
    rows = [(0.0, 0.0, b[1] * width, 0.0)]
    for k in range(2, s + 1):
        ahead = (2.0 * k - 1.0) / k * b[k] / b[k - 1]
        rows.append((ahead, (1.0 - k) / k * b[k] / b[k - 2], ahead * width, (b[k - 1] - 1.0) * ahead * width))
    return np.array(rows)


def _reach(s: int) -> float:
    """The largest z at which s stages are stable."""
    return (s * s + s - 2.0) / 2.0


def _shares(scene: Scene, c: Floats) -> Floats:
    """w_i s_i + w_j s_j (m,) [1/kg] with s the springs of a ball that are damped."""
    count = np.bincount(scene.pairs[c > 0].ravel(), minlength=scene.n_balls)
    share: Floats = np.where(scene.pinned, 0.0, count / scene.mass)[scene.pairs].sum(axis=1)
    return share
