"""Plot: curves of numbers over time so far, over the curves that are expected."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from taichi_sim.overlays.panel import Colour, Panel, Tints, decimals, nice_step, ticks
from taichi_sim.scene.overlay import ShownProbe

__all__ = ["Plot", "label_of", "padded", "written"]

PAD = 0.06  # of the range of the values, above and below them
ALIKE = 1e-9  # of the largest value: values that differ by less are alike
SMALLEST = 1e-100  # values below it are drawn as 0
CROWDED = 1e5  # from here on numbers are written with an exponent


def label_of(one: ShownProbe) -> str:
    """Name of a probe in a picture."""
    return one.of if one.label is None else one.label


def written(value: float, places: int, digits: int = 2) -> str:
    """A value with so many decimals, or digits after the first where it has an exponent; a dash where it is none."""
    if not math.isfinite(value):
        return "\u2013"
    crowded = abs(value) >= CROWDED or places > 6
    words = f"{value:.{digits}e}" if crowded else f"{value:.{places}f}"
    return (words.lstrip("-") if float(words) == 0.0 else words).replace("-", "\u2212")


def labels_of(marks: Sequence[float], places: int, unit: str = "") -> list[str]:
    """Labels of the marks of an axis, with so many decimals, or digits, that no two are alike, and the unit at the last."""
    for digits in range(2, 16):
        words = [written(one, places, digits) for one in marks]
        if len(set(words)) == len(words):
            break
    return [*words[:-1], words[-1] + unit] if words else words


def padded(values: NDArray[np.float64]) -> tuple[float, float]:
    """A range with all values that are finite, and some room: as much as their size where all are alike; 0 to 1 without any."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    largest = max(abs(low), abs(high))
    if largest < SMALLEST:
        return -1.0, 1.0
    room = PAD * (high - low) if high - low > ALIKE * largest else largest
    return low - room, high + room


Axis = tuple[list[float], list[str]]  # places of marks, and what is written there


def _marked(low: float, high: float, parts: float, fits: Callable[[Axis], bool], unit: str = "") -> Axis:
    """Marks of an axis, as many as `parts` allows whose labels fit; where not even two do, the first."""
    for number in range(max(2, int(parts)), 0, -1):
        marks, places = ticks(low, high, number)
        axis = marks, labels_of(marks, places, unit)
        if fits(axis):
            return axis
    ends = axis[0][:: max(1, len(axis[0]) - 1)], axis[1][:: max(1, len(axis[1]) - 1)]
    return ends if fits(ends) else (ends[0][:1], ends[1][:1])


class Plot:
    """Curves in a panel: times [s] along it, values upwards, and a legend with the values now.

    Args:
        size: of the panel [pixels]. text: height of the letters [pixels].
        curves: what is drawn; colours: of each. label: what is written above it.
        times, values: what the axes reach from and to.
    """

    def __init__(
        self,
        size: tuple[float, float],
        text: float,
        tints: Tints,
        curves: Sequence[ShownProbe],
        colours: Sequence[Colour],
        label: str,
        times: tuple[float, float],
        values: tuple[float, float],
    ) -> None:
        self._text, self._tints, self._curves, self._colours = text, tints, curves, colours
        self._times, self._values = times, values
        gap = 0.5 * text
        self._top, self._bottom = self._rows(label) * 1.3 * text + 2 * gap, size[1] - 2.2 * text
        self._left, self._right = 0.0, size[0] - 2 * gap
        self._places = decimals(nice_step(values[1] - values[0], max(2.0, size[1] / (3.5 * text)))) + 1
        levels = _marked(*values, size[1] / (3.5 * text), self._fit_upwards)
        self._left = 2.5 * gap + max((Panel.length(words, text) for words in levels[1]), default=0.0)
        self._axes = self._drawn(size, levels, label)

    @staticmethod
    def least_size(text: float, curves: int) -> tuple[float, float]:
        """Width and height [pixels] of the smallest panel in which so many curves and their axes can be read."""
        return 12.0 * text, (1.3 * (curves + 1) + 6.0) * text

    def _fit_upwards(self, axis: Axis) -> bool:
        heights = [self._place(0.0, one)[1] for one in axis[0]]
        return all(one - other > 1.2 * self._text for one, other in pairwise(heights))

    def _fit_along(self, axis: Axis) -> bool:
        wide = [0.5 * Panel.length(words, self._text) + 0.3 * self._text for words in axis[1]]
        middles = [self._along(*one) for one in zip(*axis)]
        return all(a + b <= d - c for a, b, c, d in zip(wide, wide[1:], middles, middles[1:]))

    def _along(self, time: float, words: str) -> float:
        """The middle of the label of a time, which ends within the panel."""
        return min(self._place(time, 0.0)[0], self._right + 0.6 * self._text - 0.5 * Panel.length(words, self._text))

    def _rows(self, label: str) -> int:
        return len(self._curves) + bool(label)

    def _drawn(self, size: tuple[float, float], levels: Axis, label: str) -> Panel:
        """The panel with all that does not change: axes and what is expected."""
        panel, text, tints = Panel(size, self._text, self._tints.ground), self._text, self._tints
        thin = max(1.0, text / 16)
        for one, words in zip(*levels):
            y = self._place(0.0, one)[1]
            panel.line([(self._left, y), (self._right, y)], (*tints.faint[:3], 64), thin)
            panel.text((self._left - 0.4 * text, y), words, tints.faint, "rm")
        seconds = _marked(*self._times, (self._right - self._left) / (4.5 * text), self._fit_along, " s")
        for one, words in zip(*seconds):
            x = self._place(one, 0.0)[0]
            panel.line([(x, self._bottom), (x, self._bottom + 0.3 * text)], tints.faint, thin)
            panel.text((self._along(one, words), self._bottom + 0.45 * text), words, tints.faint, "ma")
        panel.line([(self._left, self._bottom), (self._right, self._bottom)], tints.faint, thin)
        if label:
            panel.text((0.6 * text, 0.4 * text), Panel.shortened(label, text, size[0] - 1.2 * text), tints.faint)
        for curve in self._curves:
            if curve.expected is not None:
                self._curve(panel, np.asarray(curve.expected, dtype=float), tints.expected, 4 * thin)
        return panel

    def at(self, times: Sequence[float], values: NDArray[np.float64]) -> Panel:
        """The panel with the curves (k, number of curves) at so many times, up to now."""
        panel, text = self._axes.copy(), self._text
        above = self._rows("") * 1.3 * text
        for k, (one, colour) in enumerate(zip(self._curves, self._colours)):
            self._curve(panel, np.column_stack([times, values[:, k]]), colour, text / 6)
            y = self._top - 0.5 * text - above + (1.3 * k + 0.65) * text
            panel.line([(0.6 * text, y), (1.8 * text, y)], colour, text / 6)
            now = written(values[-1, k], self._places)
            room = self._right - 2.8 * text - Panel.length(now, text)
            panel.text((2.3 * text, y), Panel.shortened(label_of(one), text, room), self._tints.text, "lm")
            panel.text((self._right, y), now, self._tints.text, "rm")
            if np.isfinite(values[-1, k]) and self._values[0] <= values[-1, k] <= self._values[1]:
                panel.disc(self._place(times[-1], values[-1, k]), text / 5, colour, colour, 1.0)
        return panel

    def _place(self, time: float, value: float) -> tuple[float, float]:
        along = (time - self._times[0]) / (self._times[1] - self._times[0])
        up = (value - self._values[0]) / (self._values[1] - self._values[0])
        return self._left + along * (self._right - self._left), self._bottom - up * (self._bottom - self._top)

    def _curve(self, panel: Panel, rows: NDArray[np.float64], colour: Colour, width: float) -> None:
        """A curve through rows of time and value, within the axes and broken where there is no value."""
        seen = np.isfinite(rows).all(axis=1) & (rows[:, 0] <= self._times[1] * (1 + 1e-9) + 1e-12)
        rows = np.column_stack([rows[:, 0], np.clip(rows[:, 1], *self._values)])
        for part in np.split(np.arange(len(rows)), np.flatnonzero(~seen)):
            panel.line([self._place(*rows[k]) for k in part if seen[k]], colour, width)


def places_for(largest: float) -> int:
    """Decimals that show three digits of the largest value."""
    return 0 if largest <= 0 or not math.isfinite(largest) else decimals(10.0 ** (math.floor(math.log10(largest)) - 2))
