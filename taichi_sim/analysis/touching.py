"""Words for what a ball lies in, for warnings. In NumPy and slow: it is asked once."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.objects import ball_in_words
from taichi_sim.scene.scene import Scene

__all__ = ["overlap", "overlap_at_start"]

ALIKE = 0.02  # of an overlap: kernels find it in single precision


def overlap(scene: Scene, position: NDArray, time: float, ball: int, part: float) -> str:
    """Sentence on the overlap of ball number `ball` and what it touches, by `part` of the smaller radius; position (n, dim)
    [m] at time [s]."""
    led = any(ball in pins.balls for pins in scene.moving_pins)
    one = ball_in_words(scene.objects, ball)
    if led:
        one = one.replace("ball", "moving pin", 1)
    what = _found(scene, position, time, ball, part) or "what it touches"
    return f"{one} and {what} overlap by {part:.2g} of the smaller radius"


def overlap_at_start(scene: Scene, position: NDArray, time: float, ball: int, part: float) -> float:
    """Overlap at the start, as a part of the smaller radius, of ball number `ball` and the ball that it touches by `part` at
    position (n, dim) [m] and `time` [s]; 0 where it touches something else."""
    what = _found(scene, position, time, ball, part)
    before = {name: deep for deep, name in _touched(scene, scene.position, 0.0, ball)}
    return before.get(what, 0.0) if what.startswith("ball") else 0.0


def _found(scene: Scene, position: NDArray, time: float, ball: int, part: float) -> str:
    """Name of what ball number `ball` overlaps with by `part`; empty for a stick or a surface."""
    found = min(_touched(scene, position, time, ball), key=lambda each: abs(each[0] - part), default=(np.inf, ""))
    return found[1] if abs(found[0] - part) <= ALIKE * part else ""


def _touched(scene: Scene, position: NDArray, time: float, ball: int) -> Iterator[tuple[float, str]]:
    """Overlaps with all that may be touched, as parts of the smaller radius, and its names."""
    x, r = position[ball], float(scene.radius[ball])
    for k, wall in enumerate(scene.walls):
        yield (r - float(np.dot(wall.normal, x)) + wall.offset) / r, f"wall {k}"
    for k, collider in enumerate(scene.colliders):
        name = f"collider {collider.label!r}" if collider.label else f"collider {k}"
        yield (r - float(collider.distance(x[None], time)[0])) / r, name
    if scene.n_balls > 1:
        deep = (r + scene.radius - np.linalg.norm(position - x, axis=1)) / np.minimum(r, scene.radius)
        deep[ball] = -np.inf
        for k in np.flatnonzero(deep > 0.0).tolist():
            yield float(deep[k]), ball_in_words(scene.objects, k)
