"""Stability limits: how long a step may be for what moves fastest in a scene, one small class for each kind of law."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from taichi_sim.analysis.damping import is_weak
from taichi_sim.analysis.element_rates import Rates
from taichi_sim.analysis.spring_bounds import Network, over

__all__ = [
    "DampedKickLimit",
    "ExplicitEulerLimit",
    "ImplicitLimit",
    "RungeKuttaLimit",
    "SmallMotionLimit",
    "StabilityLimit",
]


@dataclass(frozen=True)
class StabilityLimit:
    """The longest stable step h of a method that takes all forces explicitly: (omega h / undamped)^2 + d h / damped <= 1 for each
    mode x'' + d x' + omega^2 x = 0.

    `undamped`: the largest omega h of motion without damping; `damped`: the largest d h of motion with nothing but damping.
    Symplectic Euler has StabilityLimit(undamped=2.0, damped=2.0), exactly. A method with another law overrides `of_springs` and
    `of_elements`. Raises ValueError where a number is not positive.
    """

    undamped: float
    damped: float

    by_springs: ClassVar[bool] = True  # whether springs limit the step at all
    caution: ClassVar[str] = ""  # what else the reason of a bound must say
    bouncing: ClassVar[str] = ""  # the same, of bodies that may gain energy by bounces

    def __post_init__(self) -> None:
        for name in ("undamped", "damped"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(
                    f"limit: {name} = {getattr(self, name)!r} is not allowed; it must be positive and finite"
                )

    def of_springs(self, network: Network) -> tuple[float, int]:
        """The longest step [s], and the spring that sets it: the root of h^2 lambda(K + factor D / h) = undamped^2 by bisection;
        the bound is monotone in h."""
        value, spring = network.largest(1.0, 0.0)
        high = over(self.undamped, float(np.sqrt(value)))
        most, damped = network.largest(0.0, 1.0)
        if np.isinf(high):
            return over(self.damped, most), damped
        if most == 0.0:
            return high, spring
        low, factor = 0.0, self.undamped**2 / self.damped
        while high - low > 1e-8 * high:
            middle = 0.5 * (low + high)
            enough = middle**2 * network.largest(1.0, factor / middle)[0] < self.undamped**2
            low, high = (middle, high) if enough else (low, middle)
        return low, network.largest(1.0, factor / low)[1]

    def of_elements(self, rates: Rates) -> float:
        """The longest step [s] where no spring moves: root of h^2 elastic + factor h damping = undamped^2."""
        square = self.undamped**2
        b = square / self.damped * rates.damping
        return over(2.0 * square, b + float(np.sqrt(b * b + 4.0 * square * rates.elastic)))


class DampedKickLimit(StabilityLimit):
    """Verlet: as above where spring damping is weak, see `damping.is_weak`; else it acts together with the kick, which nothing
    limits."""

    def of_springs(self, network: Network) -> tuple[float, int]:
        """2 / sqrt(lambda_K) where damping is strong."""
        if is_weak(network.scene, network.stiffness, network.damping):
            return super().of_springs(network)
        value, spring = network.largest(1.0, 0.0)
        return min(over(self.undamped, float(np.sqrt(value))), over(self.damped, network.rates.damping)), spring


class RungeKuttaLimit(StabilityLimit):
    """A region of stability that is about as wide along either axis, and holds the box between them."""

    def of_springs(self, network: Network) -> tuple[float, int]:
        """undamped / max(sqrt(lambda_K), lambda_D), and what the wind's force allows."""
        (lambda_k, spring_k), (lambda_d, spring_d) = network.largest(1.0, 0.0), network.largest(0.0, 1.0)
        elastic = np.sqrt(lambda_k) >= lambda_d
        return self._box(lambda_k, lambda_d, network.rates), spring_k if elastic else spring_d

    def of_elements(self, rates: Rates) -> float:
        """undamped / max(sqrt(lambda_K), lambda_D) [s] of elements alone, and what the wind's force allows."""
        return self._box(rates.elastic, rates.damping, rates)

    def _box(self, elastic: float, damping: float, rates: Rates) -> float:
        """The wind's force is capped, see forces.wind, so that a stage of a longer step would feel another."""
        return min(over(self.undamped, max(float(np.sqrt(elastic)), damping)), over(1.0, rates.drag))


class ExplicitEulerLimit(StabilityLimit):
    """Explicit Euler: min over springs of c / k, and damped / lambda_D; nothing is safe with an undamped spring, nor across one
    that is stretched: there it gains, by h omega^2 a second, at any step, and the bound only holds for the motion along
    springs."""

    caution = "; across stretched springs, where nothing is damped, it gains energy at any step"

    def of_springs(self, network: Network) -> tuple[float, int]:
        """Every mode has d <= lambda_D and d / kappa >= min c / k: underdamped ones need h <= d / kappa, others h <= 2 / d."""
        if network.rates.elastic > 0.0:
            return 0.0, 0
        k, c = network.stiffness, network.damping
        ratio = np.divide(c, k, out=np.full_like(k, np.inf), where=k > 0)
        spring = int(np.argmin(ratio))
        value, other = network.largest(0.0, 1.0)
        longest = over(self.damped, value)
        return (float(ratio[spring]), spring) if ratio[spring] <= longest else (longest, other)

    def of_elements(self, rates: Rates) -> float:
        """Longest step [s] of elements alone: 0 where something is elastic, as elements are hardly damped."""
        return 0.0 if rates.elastic > 0.0 else over(self.damped, rates.damping)


class ImplicitLimit(StabilityLimit):
    """Springs are solved for and do not limit the step; the numbers are those of what stays explicit."""

    by_springs = False
    caution = ": springs give no energy, but the error grows with the step"
    bouncing = ": springs give no energy but for bounces, and the error grows with the step"


class SmallMotionLimit(ImplicitLimit):
    """Limit of a method whose steps are bounded at any length for small motion alone."""

    caution = (
        " for small motion, but springs that turn far in a step may gain energy, and the error grows with the step"
    )
    bouncing = caution
