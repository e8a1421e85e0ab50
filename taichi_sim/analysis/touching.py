"""Contacts that may be and overlaps, and words for them. In NumPy and slow: they are asked for once."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.objects import ball_in_words
from taichi_sim.scene.scene import Scene

__all__ = ["further_overlap", "may_collide", "may_touch", "overlap", "overlap_at_start", "overlap_of_bodies"]

ALIKE = 0.02  # of an overlap: kernels find it in single precision
MEASURED = 20_000  # balls at once, so that what is near them takes little memory


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
    """Overlap that two balls had at the start of the scene, as a part of the smaller radius: ball number `ball`, and the one that
    it overlaps by `part` now, at position (n, dim) [m] and `time` [s]. 0 where what it overlaps now is no ball."""
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


def further_overlap(scene: Scene, finer: Scene) -> str:
    """Words on the deepest overlap at the start of a scene with finer meshes, of things that overlap less in the given one;
    empty where there is none, and without contacts."""
    if scene.settings.get("contacts") == "off":
        return ""
    before, now = _overlaps(scene), _overlaps(finer)
    further = [(deep - before.get(both, (0.0,))[0], words) for both, (deep, words) in now.items()]
    most, words = max(further, default=(0.0, ""))
    return f"{words} overlap at the start" if most > ALIKE else ""


def overlap_of_bodies(scene: Scene, least: float) -> str:
    """Words on the deepest overlap of balls of two bodies at the start, by `least` of the smaller radius or more; empty where
    there is none. Bodies: objects whose balls are joined. Slow only for balls within the box around another body."""
    joined = scene.joined()
    bodies = [one.balls for one in scene.objects if joined[one.balls].all()]
    if len(bodies) < 2:
        return ""
    reach = float(scene.radius.max())
    low = np.array([scene.position[balls].min(axis=0) for balls in bodies]) - reach
    high = np.array([scene.position[balls].max(axis=0) for balls in bodies]) + reach
    which = np.zeros(scene.n_balls, dtype=bool)
    for k, balls in enumerate(bodies):
        near = ((low < high[k]) & (low[k] < high)).all(axis=1)
        near[k] = False
        for other in np.flatnonzero(near):
            x = scene.position[balls]
            which[balls] |= ((low[other] < x) & (x < high[other])).all(axis=1)
    if not which.any():  # as of most scenes: what follows loads SciPy
        return ""
    deep, words = max(_overlaps(scene, which).values(), default=(0.0, ""))
    return f"{words} overlap by {deep:.2g} of the smaller radius at the start" if deep >= least else ""


def _overlaps(scene: Scene, which: NDArray[np.bool_] | None = None) -> dict[tuple[int, int], tuple[float, str]]:
    """The deepest overlap of balls at the start, as a part of the smaller radius, of every two objects whose contacts act, and
    the balls in words; objects by their numbers, -1: balls of none. which: mask (n,) of balls;
    None: all, and within an object."""
    part_of = np.full(scene.n_balls, -1)
    for k, one in enumerate(scene.objects):
        part_of[one.balls] = k
    found: dict[tuple[int, int], tuple[float, str]] = {}
    for i, j, deep in _overlapping(scene, np.arange(scene.n_balls) if which is None else np.flatnonzero(which)):
        if which is not None and part_of[i] == part_of[j]:
            continue
        both = min(part_of[i], part_of[j]), max(part_of[i], part_of[j])
        if deep > found.get(both, (0.0,))[0]:
            found[both] = deep, " and ".join(ball_in_words(scene.objects, k) for k in sorted((i, j)))
    return found


def _overlapping(scene: Scene, balls: NDArray[np.int64]) -> Iterator[tuple[int, int, float]]:
    """Pairs of these balls that overlap at the start and that contacts part, and by how much of the smaller radius."""
    from scipy.spatial import cKDTree  # slow to import

    x, r = scene.position, scene.radius
    joined = scene.excluded_pairs().astype(np.int64) @ [scene.n_balls, 1]
    tree = cKDTree(x[balls])
    for first in range(0, len(balls), MEASURED):
        part = balls[first : first + MEASURED]
        # of each pair the larger finds the other
        near = tree.query_ball_point(x[part], 2.0 * r[part], return_sorted=False)
        i = np.repeat(part, [len(found) for found in near])
        j = balls[np.concatenate(near).astype(np.int64)]
        meets = (r[j] < r[i]) | ((r[j] == r[i]) & (j > i))
        meets &= ~(scene.pinned[i] & scene.pinned[j]) & ((scene.body[i] == 0) | (scene.body[i] != scene.body[j]))
        meets &= ((scene.group[i] & scene.mask[j]) != 0) & ((scene.group[j] & scene.mask[i]) != 0)
        i, j = i[meets], j[meets]
        deep = (r[i] + r[j] - np.linalg.norm(x[j] - x[i], axis=1)) / r[j]
        apart = (deep > 0.0) & ~np.isin(np.minimum(i, j) * scene.n_balls + np.maximum(i, j), joined)
        yield from zip(i[apart].tolist(), j[apart].tolist(), deep[apart].tolist())


def may_collide(scene: Scene) -> bool:
    """True if any two balls may touch: not both pinned, not of one body, not joined by a spring."""
    n = scene.n_balls
    total = n * (n - 1) // 2
    pinned = int(scene.pinned.sum())
    bodies = np.bincount(scene.body[scene.body > 0]).astype(np.int64)
    both = np.bincount(scene.body[(scene.body > 0) & scene.pinned]).astype(np.int64)  # pinned and of one body: once
    total -= pinned * (pinned - 1) // 2 + int(np.sum(bodies * (bodies - 1) // 2) - np.sum(both * (both - 1) // 2))
    pairs = np.unique(np.sort(scene.pairs, axis=1), axis=0)
    i, j = pairs[:, 0], pairs[:, 1]
    apart = (scene.body[i] == 0) | (scene.body[i] != scene.body[j])
    total -= int(np.sum(apart & ~(scene.pinned[i] & scene.pinned[j])))
    return total > 0


def may_touch(scene: Scene) -> bool:
    """True if anything may touch: balls each other, or a wall, a collider, a stick or a surface."""
    return bool(scene.walls or scene.colliders or scene.solid.any() or scene.collides.any()) or may_collide(scene)
