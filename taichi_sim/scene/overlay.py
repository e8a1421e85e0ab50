"""Overlay: what is written and drawn over pictures, as [output.overlay] of a scene file says it. Imports no Taichi."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, did_you_mean, unknown_key

__all__ = ["ExpectedPlace", "Overlay", "ShownProbe"]

Place = Literal["top left", "top right", "bottom left", "bottom right"]
LEAST_SHARE = 0.1  # of the picture, of a plot
MOST_LETTERS, MOST_LISTED, MOST_ROWS = 200, 20, 100_000  # of a text, of tables, and of what is expected


@dataclass(frozen=True, slots=True)
class ShownProbe:
    """A probe whose value pictures show, with its curve so far.

    Args:
        of: name of the number, like `ball.y`, or of a probe that has one number.
        label: what the picture calls it; its name otherwise.
        curve: false: the value alone.
        expected: (k, 2) times [s] and the values that are expected then, joined to a grey curve under the other one.
        colour: sRGB in 0..1 [1].
    """

    of: str
    label: str | None = None
    curve: bool = True
    expected: ArrayLike | None = None
    colour: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class ExpectedPlace:
    """A mark where something is expected to be.

    Args:
        position: (dim,) of the mark, or (k, dim) where it is at `times` [m].
        times: (k,) in ascending order; between them it moves evenly [s].
        label: what is written beside it.
    """

    position: ArrayLike
    times: ArrayLike | None = None
    label: str = ""

    def at(self, time: float) -> NDArray[np.float64]:
        """The place (dim,) [m] at a time [s]."""
        places = np.atleast_2d(np.asarray(self.position, dtype=float))
        if self.times is None:
            return places[0]
        return np.array([np.interp(time, np.asarray(self.times, dtype=float), column) for column in places.T])


@dataclass(frozen=True, slots=True)
class Overlay:
    """Text, curves and marks over pictures.

    Args:
        title: a line at the top.
        clock: the time of the picture.
        scale_bar: a bar with its length; in 3D as long as it appears at what the camera looks at.
        legend: the names of shapes and colliders with their colours, or the scale that `colour` chooses.
        probes: tables of probes whose values are shown, most with a curve.
        marks: tables of places where something is expected to be.
        plot: the corner of the curves.
        plot_size: width and height of the curves, as shares of those of the picture, no smaller than can be read [1].
        plot_range: the lowest and the highest value of the curves; by default what they need.
        plot_label: what is written above the curves; their unit by default.
        text_size: height of the letters; a thirtieth of that of the picture by default [pixels].
    """

    title: str | None = None
    clock: bool = False
    scale_bar: bool = False
    legend: bool = False
    probes: tuple[ShownProbe, ...] = ()
    marks: tuple[ExpectedPlace, ...] = ()
    plot: Place = "top right"
    plot_size: tuple[float, float] = (0.4, 0.4)
    plot_range: tuple[float, float] | None = None
    plot_label: str | None = None
    text_size: float | None = None

    @classmethod
    def of(cls, given: Mapping[str, Any], dim: int, probes: Collection[str] | None) -> Overlay:
        """Make an overlay from the keys of [output.overlay], with the full names of the numbers that probes have, or None where
        these are not known. Raises SceneError that names the key, the value and what is allowed."""
        values = _known(cls, "overlay", given)
        for key, value in values.items():
            values[key] = _value(key, value)
        for key, kind in (("probes", partial(_probe, names=probes)), ("marks", partial(_mark, dim=dim))):
            listed = values.get(key, ())
            if not isinstance(listed, (list, tuple)) or len(listed) > MOST_LISTED:
                raise SceneError(f"overlay.{key}", listed, f"a list of at most {MOST_LISTED} tables")
            values[key] = tuple(kind(f"overlay.{key}[{k}]", one) for k, one in enumerate(listed))
        return cls(**values)

    @property
    def curves(self) -> tuple[ShownProbe, ...]:
        """The probes that are drawn as curves."""
        return tuple(one for one in self.probes if one.curve)


def _known(kind: Any, where: str, given: Any, needed: str | None = None) -> dict[str, Any]:
    """The keys of a table, those that it may have. Raises SceneError for others."""
    known = [one.name for one in fields(kind)]
    if not isinstance(given, Mapping) or (needed is not None and needed not in given):
        others = ", ".join(key for key in known if key != needed)
        allowed = f"the key {needed}, and others" if needed else "keys"
        raise SceneError(where, given, f"a table with {allowed} among {others}")
    for key in given:
        if key not in known:
            raise unknown_key(f"{where}.{key}", known, f"a key of {where.partition('[')[0]}")
    return {key: value for key, value in given.items() if value is not None}


def _value(key: str, value: Any) -> Any:
    where = f"overlay.{key}"
    if key in ("clock", "scale_bar", "legend"):
        return _flag(where, value)
    if key in ("title", "plot_label"):
        return _text(where, value)
    if key == "plot":
        validation.one_of(where, value, get_args(Place))
    elif key == "plot_size":
        width, height = validation.per_item(where, value, 2, low=LEAST_SHARE, high=1).tolist()
        return width, height
    elif key == "plot_range":
        low, high = validation.vector(where, value, 2).tolist()
        if low >= high:
            raise SceneError(where, value, "two numbers, the lower first")
        return low, high
    elif key == "text_size":
        return validation.number(where, value, low=4, high=400)
    return value


def _flag(where: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise SceneError(where, value, "true or false")
    return bool(value)


def _text(where: str, value: Any) -> str:
    if not isinstance(value, str) or not value.isprintable() or len(value) > MOST_LETTERS:
        raise SceneError(where, value, f"a text of one line and at most {MOST_LETTERS} letters")
    return value


def _probe(where: str, given: Any, names: Collection[str] | None) -> ShownProbe:
    keys = _known(ShownProbe, where, given, "of")
    name = _text(f"{where}.of", keys["of"])
    if names is not None:
        found = [one for one in names if name in (one, one.partition(".")[0])]
        if len(found) != 1:
            says = f"is no number of a probe of this scene; {did_you_mean(name, found or names)}"
            raise SceneError(f"{where}.of", name, says=says)
        keys["of"] = found[0]
    if "label" in keys:
        _text(f"{where}.label", keys["label"])
    if "curve" in keys:
        keys["curve"] = _flag(f"{where}.curve", keys["curve"])
    if "expected" in keys:
        keys["expected"] = expected = validation.vectors(f"{where}.expected", keys["expected"], None, 2)
        _ascending(f"{where}.expected", expected[:, 0])
    if "colour" in keys:
        red, green, blue = validation.per_item(f"{where}.colour", keys["colour"], 3, low=0, high=1).tolist()
        keys["colour"] = red, green, blue
    return ShownProbe(**keys)


def _mark(where: str, given: Any, dim: int) -> ExpectedPlace:
    keys = _known(ExpectedPlace, where, given, "position")
    _text(f"{where}.label", keys.get("label", ""))
    if "times" not in keys:
        return ExpectedPlace(**keys | {"position": validation.vector(f"{where}.position", keys["position"], dim)})
    times = np.atleast_1d(validation.as_array(keys["times"]))
    times = validation.per_item(f"{where}.times", keys["times"], len(times))
    _ascending(f"{where}.times", times)
    position = validation.vectors(f"{where}.position", keys["position"], len(times), dim)
    return ExpectedPlace(**keys | {"position": position, "times": times})


def _ascending(where: str, times: NDArray[np.float64]) -> None:
    if not 0 < len(times) <= MOST_ROWS or np.any(np.diff(times) < 0):
        raise SceneError(where, says=f"needs 1 to {MOST_ROWS} times in ascending order")
