"""Late impacts: what a step takes from the collisions of a crowd of balls. No Taichi.

Balls are found to touch h / 2 late on average, v cos(a) h / 2 too deep, a being the angle between their relative velocity v and
the line of centres. By then the line has turned, and less of v lies along it: v^2 sin^2(a) v cos(a) h / d less in the square,
d the distance at which they touch. Of Gaussian velocities, u [m/s] each component, and over all offsets of the two balls, an
impact exchanges less energy by SHARE u h / r: (pi / 16) <v> h / d of 2/3 in 2D, (4 / 15) <v> h / d of 1/2 in 3D, with the means
<v> = 2 u Gamma(3) / Gamma(5/2) and 2 u Gamma(7/2) / Gamma(3) by the energy that impacts exchange.
"""

import math

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.collision_groups import bits_of, meet
from taichi_sim.scene.scene import Scene

__all__ = ["cure", "late_rate", "sentence"]

SHARE = {
    2: 3.0 * math.pi / 32.0 * math.gamma(3.0) / math.gamma(2.5),
    3: 8.0 / 15.0 * math.gamma(3.5) / math.gamma(3.0),
}
RIGHT = 0.01  # share of the energy that is lost unseen

Floats = NDArray[np.float64]


def _crowd(scene: Scene) -> NDArray[np.bool_]:
    """Loose balls (n,) that collide with some loose ball."""
    loose = scene.loose()
    bits = scene.group.astype(np.int64) << 32 | scene.mask.astype(np.uint32)
    met = np.zeros_like(loose)
    for pair in bits_of(bits[loose]):
        met |= meet(scene.group, scene.mask, pair >> 32, int(np.uint32(pair & 0xFFFFFFFF).astype(np.int32)))
    return loose & met


def late_rate(scene: Scene, velocity: Floats) -> float:
    """Share of the energy exchanged by impacts that is missed, per second of step [1/s], at velocities (n, dim) [m/s]; 0 where
    fewer than two balls can meet."""
    crowd = _crowd(scene)
    if np.count_nonzero(crowd) < 2:
        return 0.0
    v = np.asarray(velocity, dtype=np.float64)[crowd]
    v = (v - v.mean(axis=0)) / scene.radius[crowd, None]
    return SHARE[scene.dim] * float(np.sqrt(np.mean(v * v)))


def sentence(share: float) -> str:
    """The energy that a step misses, in words; share: of the energy exchanged by impacts."""
    return f"of balls exchange {min(share, 1.0):.2g} less energy than they should, because they are found at the end of a step"


def cure(share: float, h: float) -> str:
    """The step that is right to a hundredth, where this one of h seconds is not; else empty."""
    return f"take substeps of {h * RIGHT / share:.2g} s for {RIGHT:g}" if share > RIGHT else ""
