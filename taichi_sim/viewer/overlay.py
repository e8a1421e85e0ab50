"""Overlay: words and marks on the picture of a live window, legible on light and on dark. Each is laid over an image
(height, width, 3) of 8-bit sRGB, row 0 at the top, and touches only the part it covers."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures

from taichi_sim.overlays.panel import DARK, Panel

Image = NDArray[np.uint8]

RED, PULL = (232, 56, 48), (255, 138, 30)
SMALLEST, PER_HEIGHT = 13, 45  # px: text is a 45th of the picture's height


def draw_table(image: Image, rows: Sequence[tuple[str, str]], *, bottom: bool = False) -> None:
    """Rows of a name and what it is, top left or bottom right."""
    if not rows:
        return
    size = _letters(image)
    pad, line = round(0.7 * size), round(1.4 * size)
    names, texts = (max(Panel.length(words, size) for words in column) for column in zip(*rows, strict=True))
    start = pad + (names + 0.9 * size if names else 0)
    panel = Panel((start + texts + pad, len(rows) * line + 2 * pad), size, DARK.ground)
    for k, (name, text) in enumerate(rows):
        level = pad + (k + 0.5) * line
        panel.text((pad, level), name, DARK.faint, "lm")
        panel.text((start, level), text, DARK.text, "lm")
    room = image.shape[1] - panel.width, image.shape[0] - panel.height
    margin = min(pad, *room)
    _lay(image, panel, *((side - margin for side in room) if bottom else (margin, margin)))


def draw_recording(image: Image) -> None:
    """A red dot with a pale rim, top right."""
    size = _letters(image)
    panel = Panel((2 * size, 2 * size), size)
    panel.disc((size, size), size / 1.5 + 1, RED, DARK.text, 1)
    _lay(image, panel, image.shape[1] - 8 * size // 3, 2 * size // 3)


def draw_line(image: Image, start: tuple[float, float], end: tuple[float, float]) -> None:
    """A line from a ball to the pointer (px), and a ring about its end."""
    size = _letters(image)
    points = np.clip([start, end], -1e4, 1e4)
    low = np.maximum(np.floor(points.min(axis=0) - size), 0).astype(int)
    high = np.minimum(np.ceil(points.max(axis=0) + size), image.shape[1::-1]).astype(int)
    if np.any(high <= low):
        return
    panel = Panel(tuple(high - low), size)
    ends = (points - low).tolist()
    for width, colour in ((5, DARK.ground), (3, PULL)):
        panel.line(ends, colour, width)
    for place, radius in zip(ends, (size / 4, size / 3), strict=True):
        panel.disc(place, radius + 1, PULL, DARK.text, 1)
    _lay(image, panel, *low)


def _lay(image: Image, panel: Panel, left: int, top: int) -> None:
    """Lay a panel over an image; one that would begin beyond the upper left corner begins there."""
    x, y = max(left, 0), max(top, 0)
    part = image[y : y + panel.height, x : x + panel.width]
    if part.size:
        picture = Pictures.fromarray(np.ascontiguousarray(part))
        panel.onto(picture, 0, 0)
        part[:] = np.asarray(picture)


def _letters(image: Image) -> int:
    return max(SMALLEST, round(image.shape[0] / PER_HEIGHT))
