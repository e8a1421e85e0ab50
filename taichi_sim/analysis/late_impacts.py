"""Late impacts: what a step takes from the collisions of a crowd of balls. No Taichi.

Balls are found to touch h / 2 late on average, v cos(a) h / 2 too deep, a being the angle between their relative velocity v and
the line of centres. By then the line has turned, and less of v lies along it: v^2 sin^2(a) v cos(a) h / d less in the square,
d the distance at which they touch. Of Gaussian velocities, u [m/s] each component, and over all offsets of the two balls, an
impact exchanges less energy by SHARE u h / r: (pi / 16) <v> h / d of 2/3 in 2D, (4 / 15) <v> h / d of 1/2 in 3D, with the means
<v> = 2 u Gamma(3) / Gamma(5/2) and 2 u Gamma(7/2) / Gamma(3) by the energy that impacts exchange.

Where impacts are solved at the moment of touch (kernels.contacts.pair_impacts), only balls that move further than their radius in
a step are late: they stop where they touch, and lose the rest of the step.
"""

import math

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.collision_groups import bits_of, meet
from taichi_sim.scene.scene import Scene

__all__ = ["cure", "late_rate", "late_share", "sentence", "touch_in_time"]

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


def touch_in_time(scene: Scene) -> bool:
    """True if all loose balls that collide with others bounce: with impacts in turn those are solved at the moment of touch."""
    return all(scene.materials[k].restitution > 0.0 for k in np.unique(scene.material[_crowd(scene)]))


def late_share(scene: Scene, velocity: Floats, h: float, at_touch: bool) -> float:
    """Share of the energy exchanged by impacts that steps of h seconds miss at velocities (n, dim) [m/s]. at_touch: whether what
    bounces is solved at the moment of touch."""
    share = h * late_rate(scene, velocity)
    if share > 0.0 and at_touch and touch_in_time(scene):
        crowd = _crowd(scene)
        share *= float(np.mean(h * np.linalg.norm(velocity[crowd], axis=1) > scene.radius[crowd]))
    return share


def sentence(share: float) -> str:
    """The energy that a step misses, in words; share: of the energy exchanged by impacts."""
    return f"of balls exchange {min(share, 1.0):.2g} less energy than they should, because they are found too late in a step"


def cure(share: float, h: float) -> str:
    """The step that is right to a hundredth, where this one of h seconds is not; else empty."""
    return f"take substeps of {h * RIGHT / share:.2g} s for {RIGHT:g}" if share > RIGHT else ""
