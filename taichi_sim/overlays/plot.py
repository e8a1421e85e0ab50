"""Plot: curves of numbers over time so far, over the curves that are expected."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from taichi_sim.overlays.panel import Colour, Panel, Tints, decimals, ticks
from taichi_sim.scene.overlay import ShownProbe

__all__ = ["Plot", "label_of", "padded", "written"]

PAD = 0.06  # of the range of the values, above and below them
CROWDED = 1e5  # from here on numbers are written with an exponent


def label_of(one: ShownProbe) -> str:
    """Name of a probe in a picture."""
    return one.of if one.label is None else one.label


def written(value: float, places: int) -> str:
    """A value with so many decimals; a dash where it is none."""
    if not math.isfinite(value):
        return "\u2013"
    if abs(value) >= CROWDED or places > 6:
        return f"{value:.2e}"
    return f"{value:.{places}f}".replace("-", "\u2212")


def padded(values: NDArray[np.float64]) -> tuple[float, float]:
    """A range with all values that are finite, and some room; 0 to 1 without any."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    room = PAD * (high - low) or max(abs(low), 1e-300) or 1.0
    return low - room, high + room


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
        marks, places = ticks(*values, max(2.0, size[1] / (3.5 * text)))
        self._places = places + 1
        gap = 0.5 * text
        wide = max(Panel.length(written(one, places), text) for one in marks) if marks else 0.0
        header = self._rows(label) * 1.3 * text + gap
        self._left, self._right = wide + 2.5 * gap, size[0] - 2 * gap
        self._top, self._bottom = header + gap, size[1] - 2.2 * text
        self._axes = self._drawn(size, marks, places, label)

    def _rows(self, label: str) -> int:
        return len(self._curves) + bool(label)

    def _drawn(self, size: tuple[float, float], marks: Sequence[float], places: int, label: str) -> Panel:
        """The panel with all that does not change: axes and what is expected."""
        panel, text, tints = Panel(size, self._text, self._tints.ground), self._text, self._tints
        thin = max(1.0, text / 16)
        for one in marks:
            y = self._place(0.0, one)[1]
            panel.line([(self._left, y), (self._right, y)], (*tints.faint[:3], 64), thin)
            panel.text((self._left - 0.4 * text, y), written(one, places), tints.faint, "rm")
        seconds, places = ticks(*self._times, max(2.0, (self._right - self._left) / (4.5 * text)))
        for one in seconds:
            x = self._place(one, 0.0)[0]
            panel.line([(x, self._bottom), (x, self._bottom + 0.3 * text)], tints.faint, thin)
            words = written(one, places) + (" s" if one == seconds[-1] else "")
            x = min(x, size[0] - 0.4 * text - Panel.length(words, text) / 2)
            panel.text((x, self._bottom + 0.45 * text), words, tints.faint, "ma")
        panel.line([(self._left, self._bottom), (self._right, self._bottom)], tints.faint, thin)
        if label:
            panel.text((0.6 * text, 0.4 * text), label, tints.faint)
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
            panel.text((2.3 * text, y), label_of(one), self._tints.text, "lm")
            panel.text((self._right, y), written(values[-1, k], self._places), self._tints.text, "rm")
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
