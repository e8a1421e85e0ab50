"""Numbers that single precision holds: given ones, and those that kernels make of them, 1 / m, k, k / m, c and c / m."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.objects import ball_in_words
from taichi_sim.scene.part import Quadratic
from taichi_sim.scene.scene import Scene

__all__ = ["require_single"]

MOST = 1e34  # of single precision's 3e38: sums over a ball, and products with its displacement, stay below
LEAST_MASS = 1e-25  # kg; squares of what implicit methods leave unsolved, times it, vanish below: 0.3 % off at 1e-30
MILD, LEAST_MILD_MASS = 1e15, 1e-12  # within these no ratio is near the bounds
CURE = 'use precision "f64", or other units'
CLIPPED = ("break_strain", "compression_limit")  # large ones limit nothing
NUMBERS = np.float64  # of columns that are looked at


def require_single(scene: Scene) -> None:
    """Raise SceneError for the first number that a run in single precision would take for another: an infinite one, a mass that
    does not move, one that does not count."""
    largest = 0.0
    for name, table in scene.tables.items():
        for key in table.names:
            column = table[key]
            if column.dtype == NUMBERS and column.size and key not in CLIPPED:
                size = np.nan_to_num(np.abs(column), nan=0.0)  # of a colour that is not given
                validation.require(f"{name}.{key}", column, size <= MOST, says=_beyond(f"at most {MOST:g}"))
                largest = max(largest, float(size.max()))
    validation.require("gravity", scene.gravity, np.abs(scene.gravity) <= MOST, says=_beyond(f"at most {MOST:g}"))
    validation.require("balls.mass", scene.mass, scene.mass >= LEAST_MASS, says=_beyond(f"at least {LEAST_MASS:g} kg"))
    if largest > MILD or scene.mass.min(initial=1.0) < LEAST_MILD_MASS:
        _require_sums(scene)


def _require_sums(scene: Scene) -> None:
    for name, what, unit, sums in _sums(scene):
        good = sums <= MOST * np.minimum(1.0, scene.mass)
        if not good.all():
            ball = int(np.argmin(good))
            says = (
                f"their {what} of {sums[ball]:.4g} {unit} at {ball_in_words(scene.objects, ball)} of {scene.mass[ball]:.4g} kg"
                f" {_beyond(f'at most {MOST:g} {unit}, and as much per kg')}"
            )
            raise SceneError(name, says=says)
    for one in ELEMENTS:
        for what, unit, rate in zip(("stiffness", "damping"), ("1/s^2", "1/s"), one.further_rates(scene)):
            if rate > MOST:
                raise SceneError(
                    one.name, says=f"their {what} over mass of {rate:.4g} {unit} {_beyond(f'at most {MOST:g}')}"
                )


def _beyond(allowed: str) -> str:
    return f"does not fit into single precision, which takes {allowed}; {CURE}"


def _sums(scene: Scene) -> Iterator[tuple[str, str, str, NDArray[np.float64]]]:
    """Table, what, unit and sums (n,) over the elements of a ball: bounds of what a displacement of 1 m, or 1 m/s, calls up."""
    ends = np.tile([[[1.0], [-1.0]]], (scene.n_springs, 1, 1))
    springs = ([Quadratic(scene.pairs, ends, column)] for column in (scene.stiffness, scene.damping))
    kinds: list[Any] = [("springs", *springs)]
    kinds += [(one.name, one.stiffness(scene), one.damping(scene)) for one in ELEMENTS if one.acts(scene)]
    for name, stiffness, damping in kinds:
        for what, unit, forms in (("stiffness", "N/m", stiffness), ("damping", "N s/m", damping)):
            yield name, what, unit, sum((_of(form, scene.n_balls) for form in forms), np.zeros(scene.n_balls))


def _of(form: Quadratic, n: int) -> NDArray[np.float64]:
    size = np.linalg.norm(form.gradient, axis=2)
    each = form.strength[:, None] * size * size.sum(axis=1, keepdims=True)
    sums = np.bincount(form.corners.ravel(), np.broadcast_to(each, form.corners.shape).ravel(), minlength=n)
    return np.asarray(sums, dtype=np.float64)
