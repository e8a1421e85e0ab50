"""Selection of balls: by numbers, by a word like "border", or by a box or a sphere that they lie in."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, about
from taichi_sim.geometry.mesh import sides
from taichi_sim.scene.collider_shapes import Box, Capsule, Sphere
from taichi_sim.scene.colliders import build, shape_of

__all__ = ["Members", "Pins", "chosen", "ends", "is_described"]

Side = Literal["border", "corners", "left", "right", "bottom", "top", "front", "back", "ends", "start", "end"]
Part = Side | Box | Sphere | Capsule
Pins = bool | Part | Sequence[Part] | Sequence[int] | Sequence[bool] | NDArray
Members = Part | Sequence[Part] | Sequence[int]

PARTS = (str, Mapping, Box, Sphere, Capsule)
SIDES = {"left": (0, -1), "right": (0, 1), "bottom": (1, -1), "top": (1, 1), "front": (2, 1), "back": (2, -1)}
AT_SIDE = 1e-6  # of the longest extent


def is_described(pins: Any) -> bool:
    """True if balls are meant by words or shapes, and not by their numbers."""
    several = isinstance(pins, (list, tuple)) and len(pins) > 0 and all(isinstance(one, PARTS) for one in pins)
    return isinstance(pins, PARTS) or several


def ends(n: int) -> dict[str, NDArray[np.bool_]]:
    """Masks (n,) of the first and the last ball of a rope of n balls, and of both, which are its border, by their words."""
    number = np.arange(n)
    both = (number == 0) | (number == n - 1)
    return {"ends": both, "start": number == 0, "end": number == n - 1, "border": both}


def chosen(
    where: str,
    pins: Any,
    x: NDArray,
    own: NDArray | None = None,
    triangles: NDArray | None = None,
    words: Mapping[str, NDArray[np.bool_]] = MappingProxyType({}),
) -> NDArray[np.bool_]:
    """Mask (n,) of the balls at x (n, dim) [m] that are meant.

    pins: a bool, a bool per ball, numbers of them, a solid shape (or a table that describes one, as in [[colliders]]): those with
    their centre in it; or a word: left, right (along x), bottom, top (y), back, front (z): the outermost that way; border: on
    edges of the `triangles` (t, 3) that belong to one alone, or, without such edges, outermost along an axis; corners: outermost
    along all axes. A list of shapes and words means all that any of them does. own: (n, dim) [m], where border and corners are
    looked for, the places before a shape was turned. words: masks (n,) by words of this shape's own, see `ends`; they come first.
    """
    n = len(x)
    if isinstance(pins, str):
        if pins in words:
            return words[pins]
        _require_word(where, pins, x, words)
        return _named(where, pins, x, x if own is None else own, triangles)
    if isinstance(pins, PARTS):
        return _within(where, pins, x)
    if is_described(pins):
        return np.any([chosen(f"{where}[{k}]", one, x, own, triangles, words) for k, one in enumerate(pins)], axis=0)
    array = validation.as_array(pins)
    if array.dtype == object:
        says = "is not a bool, a bool per ball, a list of ball numbers, the name of a side, or a box or sphere"
        raise SceneError(where, pins, says=says)
    if array.dtype == np.bool_:
        return validation.flags(where, array, n)
    held = np.zeros(n, dtype=bool)
    held[validation.indices(where, array, n)] = True
    return held


def _require_word(where: str, word: str, x: NDArray, words: Mapping[str, NDArray]) -> None:
    """Raise SceneError for a word that means nothing here; words: those of the shape's own."""
    known = dict.fromkeys([*words, "border", "corners", *list(SIDES)[: 2 * x.shape[1]]])
    numbers = f", a list of ball numbers from 0 to {len(x) - 1}" if len(x) else ""
    validation.one_of(where, word, tuple(known), f"{numbers}, or a box or sphere")


def _named(where: str, word: str, x: NDArray, own: NDArray, triangles: NDArray | None) -> NDArray[np.bool_]:
    if not len(x):
        return np.zeros(0, dtype=bool)
    if word in SIDES:
        axis, sign = SIDES[word]
        at = _outermost(x)[sign > 0][:, axis]
        if at.all() and len(x) > 1:
            says = f"is no side of it: all of its balls lie at {'xyz'[axis]} = {x[0, axis]:.4g} m"
            raise SceneError(where, word, says=says)
        return at
    if word == "border" and triangles is not None and len(triangles):
        edges = np.sort(sides(triangles), axis=1)
        once, count = np.unique(edges, axis=0, return_counts=True)
        if not (count == 1).any():
            raise SceneError(where, word, says="is not there: its surface is closed")
        held = np.zeros(len(x), dtype=bool)
        held[once[count == 1]] = True
        return held
    low, high = _outermost(own)
    wide = ~(low & high).all(axis=0)  # axes along which it extends
    out = (low | high)[:, wide]
    held = np.asarray(out.any(axis=1) if word == "border" else out.all(axis=1))
    if not held.any() or not wide.any():
        raise SceneError(where, word, says="are not there: no ball is outermost along all axes; give their numbers")
    return held


def _outermost(x: NDArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks (n, dim) of the coordinates that are the lowest, and of those that are the highest along their axis."""
    near = AT_SIDE * float(np.ptp(x, axis=0).max())
    return x <= x.min(axis=0) + near, x >= x.max(axis=0) - near


def _within(where: str, pins: Any, x: NDArray) -> NDArray[np.bool_]:
    with about(where):
        shape = shape_of(pins) if isinstance(pins, Mapping) else pins
    held: NDArray[np.bool_] = build(shape, x.shape[1], where, 0).distance(x, 0.0) <= 0.0
    if not held.any():
        raise SceneError(where, says="holds no ball; it must hold the centre of one")
    return held
