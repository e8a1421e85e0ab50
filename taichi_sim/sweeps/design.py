"""Design of a sweep: what is varied, and which points are run, every combination of values or a sample of ranges."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.plain import plain

__all__ = ["DESIGNS", "Axis", "Design", "axes_of", "axis_of", "seeded"]

DESIGNS = ("product", "random", "latin", "sobol")
FORMS = "like 1,2,5 or 0.1:0.9:9 (9 values) or 1e2:1e4:5:log, or a range to sample, 0.1:0.9 or 1e2:1e4:log"
MOST_LUCK = 2**32 - 1
MOST_VALUES = 1_000_000  # of one axis
MOST_POINTS = 100_000  # that are run without being asked whether so many are meant


@dataclass(frozen=True)
class Axis:
    """A parameter and its values, or, where there are none, the range `low` to `high`; log: evenly in the logarithm."""

    path: str
    values: tuple[Any, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False

    def at(self, u: float) -> Any:
        """The value at a part u of the range, or of the list, from 0 to 1."""
        if self.values:
            return self.values[min(int(u * len(self.values)), len(self.values) - 1)]
        if self.log:
            return float(math.exp(math.log(self.low) + u * (math.log(self.high) - math.log(self.low))))
        return self.low + u * (self.high - self.low)

    @property
    def tried(self) -> tuple[Any, ...]:
        """Values that stand for all: those of a list, or the ends."""
        return self.values or (self.low, self.high)


RESERVED = ("seed", "error", "warning", "version", "wall")  # columns of the table


def axis_of(path: str, given: Any) -> Axis:
    """An axis of a text, see FORMS, or a sequence of values. Raises SceneError, which names the path."""
    if not isinstance(given, str):
        try:
            values = tuple(plain(value) for value in given)
        except TypeError:
            raise SceneError((path,), given, f"a list of values, or a text {FORMS}") from None
        if not values:
            raise SceneError((path,), says="has no values; give at least one")
        return Axis(path, values)
    text = given.strip()
    if "," in text or ":" not in text:
        parts = [part.strip() for part in text.split(",")]
        if not all(parts):
            raise SceneError((path,), given, FORMS)
        return Axis(path, tuple(map(_value, parts)))
    words = text.split(":")
    log = words[-1] == "log"
    numbers = [_value(word) for word in (words[:-1] if log else words)]
    if len(numbers) not in (2, 3) or any(isinstance(n, (str, bool)) for n in numbers):
        raise SceneError((path,), given, FORMS)
    low, high = (float(n) for n in numbers[:2])
    if not (math.isfinite(low) and math.isfinite(high)) or (log and min(low, high) <= 0.0):
        raise SceneError((path,), given, f"{FORMS}; with log both ends are above 0")
    if low == high:
        raise SceneError((path,), given, says="is an empty range; its ends are the same")
    if len(numbers) == 2:
        return Axis(path, (), low, high, log)
    count = numbers[2]
    if not isinstance(count, int) or not 1 <= count <= MOST_VALUES:
        raise SceneError((path,), given, f"{FORMS}; the number of values is from 1 to {MOST_VALUES}")
    spread = np.geomspace(low, high, count) if log else np.linspace(low, high, count)
    whole = all(isinstance(n, int) for n in numbers) and not log and bool(np.all(spread == np.round(spread)))
    return Axis(path, tuple(int(v) if whole else float(f"{v:.12g}") for v in spread), log=log)


def axes_of(given: Mapping[str, Any] | Sequence[str]) -> tuple[Axis, ...]:
    """Axes of a mapping, path to values, or of texts `path=values`."""
    pairs: list[tuple[str, Any]] = []
    if isinstance(given, Mapping):
        pairs = list(given.items())
    else:
        for text in given:
            path, equals, values = text.partition("=")
            if not equals or not path.strip():
                raise SceneError("vary", text, f"PATH=VALUES, values {FORMS}")
            pairs.append((path.strip(), values))
    axes = tuple(axis_of(path, values) for path, values in pairs)
    for axis in axes:
        if axis.path in RESERVED:
            meant = "give seeds" if axis.path == "seed" else "name the argument otherwise"
            raise SceneError((axis.path,), says=f"is a column of every table of a sweep; {meant}")
    for axis in axes:
        if sum(axis.path == other.path for other in axes) > 1:
            raise SceneError((axis.path,), says="is varied twice; give all its values once")
    return axes


@dataclass(frozen=True)
class Design:
    """Choice of points: `kind` of DESIGNS; points: how many of a sample, for "sobol" of each of its parts; luck: of the
    sample."""

    axes: tuple[Axis, ...]
    kind: str = "product"
    points: int | None = None
    luck: int = 0

    def check(self) -> None:
        """Raise SceneError where axes, kind and points do not go together."""
        if self.kind not in DESIGNS:
            raise SceneError("design", self.kind, f"one of {', '.join(DESIGNS)}")
        validation.whole("luck", self.luck, 0, MOST_LUCK)
        if self.kind == "product":
            if self.points is not None:
                raise SceneError("points", says="are for the designs random, latin and sobol; a product has all")
            for axis in self.axes:
                if not axis.values:
                    says = (
                        f"is a range; give a number of values, {axis.low:g}:{axis.high:g}:9, or a design that samples"
                    )
                    raise SceneError((axis.path,), says=says)
            return
        if not self.axes:
            raise SceneError("vary", says=f"nothing is varied; the design {self.kind!r} needs a range")
        if self.points is None or self.points < 1:
            raise SceneError("points", self.points, f"a number of points for the design {self.kind!r}, like 64")
        if self.kind == "sobol" and self.points & (self.points - 1):
            raise SceneError("points", self.points, "a power of 2 for the design 'sobol'")

    @property
    def count(self) -> int:
        """Points of it."""
        if self.kind == "product":
            return math.prod(len(axis.values) for axis in self.axes)
        return (self.points or 0) * (len(self.axes) + 2 if self.kind == "sobol" else 1)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """The parameters of each point."""
        names = [axis.path for axis in self.axes]
        if self.kind == "product":
            for values in itertools.product(*(axis.values for axis in self.axes)):
                yield dict(zip(names, values))
            return
        for row in self.units():
            yield {axis.path: axis.at(float(u)) for axis, u in zip(self.axes, row)}

    def units(self) -> NDArray[np.float64]:
        """The points in the unit cube (count, axes). Of "sobol": samples A, B, then for each axis A with that axis of B, see
        scipy.stats.sobol_indices."""
        from scipy.stats import qmc

        d, n = len(self.axes), self.points or 0
        if self.kind == "random":
            return np.random.default_rng(self.luck).uniform(size=(n, d))
        if self.kind == "latin":
            return qmc.LatinHypercube(d, **seeded(qmc.LatinHypercube, self.luck)).random(n)
        both = qmc.Sobol(2 * d, **seeded(qmc.Sobol, self.luck)).random(n)
        a, b = both[:, :d], both[:, d:]
        mixed = [np.where(np.arange(d) == k, b, a) for k in range(d)]
        return np.concatenate([a, b, *mixed])


def seeded(function: Any, luck: int) -> dict[str, Any]:
    """The argument of a function of SciPy that seeds it: 1.15 renamed it."""
    import inspect

    name = "rng" if "rng" in inspect.signature(function).parameters else "seed"
    return {name: np.random.default_rng(luck)}


def _value(text: str) -> Any:
    """A number, true or false, or the text itself."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return {"true": True, "false": False}.get(text, text)
