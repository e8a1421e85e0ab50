"""Panels: rectangles with text and lines, drawn several times as large as they are shown, so that edges are smooth."""

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

__all__ = ["DARK", "LIGHT", "Panel", "Tints", "decimals", "nice_step", "ticks"]

FINER = 2  # times as many pixels along each side while a panel is drawn
Colour = tuple[int, ...]


class Tints(NamedTuple):
    """Colours (red, green, blue, alpha) in 0..255 of text, of what stands back behind it, of curves that are expected, of the
    panel, and of marks."""

    text: Colour
    faint: Colour
    expected: Colour
    ground: Colour
    mark: Colour


LIGHT = Tints((28, 30, 36, 255), (104, 110, 122, 255), (182, 186, 194, 255), (255, 255, 255, 214), (217, 26, 107, 255))
DARK = Tints((240, 242, 246, 255), (168, 176, 190, 255), (112, 120, 136, 255), (18, 22, 32, 204), (255, 110, 170, 255))


@lru_cache(maxsize=16)
def _font(size: int) -> Any:
    """The font of all text, which comes with matplotlib, so that pictures look the same everywhere."""
    from matplotlib import get_data_path

    file = Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return ImageFont.truetype(str(file), size, layout_engine=ImageFont.Layout.BASIC)


class Panel:
    """A rectangle of a picture. Lengths are pixels of the picture, counted from its upper left corner.

    Args:
        size: width and height [pixels]. text: height of the letters [pixels]. ground: its colour; None: see-through.
    """

    def __init__(self, size: tuple[float, float], text: float, ground: Colour | None = None) -> None:
        self.width, self.height = (max(1, math.ceil(side)) for side in size)
        self._image = Image.new("RGBA", (FINER * self.width, FINER * self.height))
        self._draw = ImageDraw.Draw(self._image)
        self._font = _font(max(1, round(FINER * text)))
        if ground is not None:
            box = (0, 0, self._image.width - 1, self._image.height - 1)
            self._draw.rounded_rectangle(box, FINER * 0.3 * text, fill=ground)

    def text(self, place: tuple[float, float], words: str, colour: Colour, anchor: str = "la") -> None:
        """Write words at a place; anchor: which point of them lies there, as Pillow names it."""
        self._draw.text(self._scaled(place), words, fill=colour, font=self._font, anchor=anchor)

    def line(self, points: Sequence[tuple[float, float]], colour: Colour, width: float) -> None:
        """Draw a line through points."""
        if len(points) > 1:
            scaled = [self._scaled(one) for one in points]
            self._draw.line(scaled, fill=colour, width=max(1, round(FINER * width)), joint="curve")

    def disc(self, centre: tuple[float, float], radius: float, fill: Colour | None, edge: Colour, width: float) -> None:
        """Draw a disc with an edge, or a ring."""
        x, y = self._scaled(centre)
        r = FINER * radius
        self._draw.ellipse((x - r, y - r, x + r, y + r), fill, edge, max(1, round(FINER * width)))

    def box(self, low: tuple[float, float], high: tuple[float, float], fill: Colour) -> None:
        """Fill a rectangle."""
        self._draw.rectangle((*self._scaled(low), *self._scaled(high)), fill)

    def copy(self) -> "Panel":
        """A panel with the same content, which can be drawn on."""
        other = object.__new__(Panel)
        other.width, other.height, other._font = self.width, self.height, self._font
        other._image = self._image.copy()
        other._draw = ImageDraw.Draw(other._image)
        return other

    def onto(self, picture: Any, left: float, top: float) -> None:
        """Lay it over an RGB or RGBA picture; what lies beyond its edges is cut off."""
        x, y = round(left), round(top)
        reduced = self._image.reduce(FINER)
        if picture.mode == "RGB":
            picture.paste(reduced, (x, y), reduced)
            return
        cut = (max(0, -x), max(0, -y))
        if cut[0] < reduced.width and cut[1] < reduced.height and x < picture.width and y < picture.height:
            picture.alpha_composite(reduced, (max(0, x), max(0, y)), cut)

    @staticmethod
    def length(words: str, text: float) -> float:
        """Width of words [pixels] in letters of a height, digits all as wide as a 0 so that a number that runs keeps it."""
        steady = "".join("0" if letter.isdigit() else letter for letter in words)
        return float(_font(max(1, round(FINER * text))).getlength(steady)) / FINER

    @staticmethod
    def shortened(words: str, text: float, most: float) -> str:
        """Words that are at most so wide [pixels], cut off at their end, with an ellipsis, where they are wider."""
        if Panel.length(words, text) <= most:
            return words
        room = most - Panel.length("\u2026", text)
        kept = next((k for k in range(len(words), 0, -1) if Panel.length(words[:k], text) <= room), 0)
        return words[:kept].rstrip() + "\u2026"

    @staticmethod
    def wrapped(words: str, text: float, most: float) -> list[str]:
        """Rows of words, each at most so wide [pixels]."""
        rows = [""]
        for word in words.split():
            longer = f"{rows[-1]} {word}".lstrip()
            if rows[-1] and Panel.length(longer, text) > most:
                rows.append(word)
            else:
                rows[-1] = longer
        return [Panel.shortened(row, text, most) for row in rows]

    @staticmethod
    def _scaled(place: tuple[float, float]) -> tuple[float, float]:
        return FINER * place[0], FINER * place[1]


def nice_step(span: float, parts: float) -> float:
    """The smallest of 1, 2, 5, 10, ... that divides a span into at most so many parts."""
    rough = max(span, 1e-300) / parts
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= 0.999999 * rough)


def ticks(low: float, high: float, parts: float) -> tuple[list[float], int]:
    """Round numbers from low to high, two at least, and how many decimals they need. parts: how many parts there are at most
    between them, where two are among so few."""
    for finer in (1.0, 2.0, 4.0, 8.0):
        step = nice_step(high - low, finer * parts)
        first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
        if last > first:
            break
    return [k * step for k in range(first, last + 1)], decimals(step)


def decimals(step: float) -> int:
    """Number of decimals that show multiples of a step of 1, 2 or 5 times a power of ten."""
    return min(12, max(0, -math.floor(math.log10(step) + 1e-6)))


def to_bytes(colour: Any) -> Colour:
    """An opaque colour in 0..255 of one of sRGB in 0..1."""
    return (*np.rint(255 * np.clip(np.asarray(colour, dtype=float), 0, 1)).astype(int).tolist(), 255)
