"""Springs given by the rates of the motion between their two balls."""

import math

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError

__all__ = ["spring_from_rates"]


def spring_from_rates(K: float, C: float = 0.0, mass_a: float = 1.0, mass_b: float = 1.0) -> dict[str, float]:
    """Stiffness k [N/m] and damping c [N s/m] of a spring whose length obeys d'' = -K (d - l) - C d'.

        scene.add_springs(pairs, **ts.spring_from_rates(10000, 200))

    Both ends feel the full opposite force, so the distance d of a pair moves like one ball of mass mu with
    1 / mu = 1 / mass_a + 1 / mass_b: k = K mu and c = C mu. Two balls of 1 kg give k = K / 2 and c = C / 2, which is
    the article's rule of half the force for each. sqrt(K) is the angular frequency, and C = 2 sqrt(K) damps critically.

    Args:
        K: 1/s^2, at least 0. C: 1/s, at least 0.
        mass_a, mass_b: kg, positive; `math.inf` for a pinned ball, but not for both.
    Raises SceneError for anything else. Source: physics notes, section 1.
    """
    inverse = _inverse("mass_a", mass_a) + _inverse("mass_b", mass_b)
    if inverse == 0.0:
        raise SceneError("spring_from_rates.mass_b", mass_b, "finite where mass_a is not; one end must move")
    stiffness = validation.number("spring_from_rates.K", K, low=0) / inverse
    return {"stiffness": stiffness, "damping": validation.number("spring_from_rates.C", C, low=0) / inverse}


def _inverse(name: str, mass: float) -> float:
    if isinstance(mass, float) and mass == math.inf:
        return 0.0
    return 1.0 / validation.number(f"spring_from_rates.{name}", mass, positive=True)
