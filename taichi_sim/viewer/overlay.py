"""Overlay: words and marks on the picture of a live window, legible on light and on dark. Each paints into an image
(height, width, 3) of 8-bit sRGB, row 0 at the top, and touches only the part it covers."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

PANEL, SHADE = (22, 25, 31), 0.8  # sRGB of what lies under words, and how much of it
FAINT, BRIGHT = (168, 178, 192), (246, 248, 250)
RED, PULL = (232, 56, 48), (255, 138, 30)
SMALLEST, PER_HEIGHT = 13, 45  # px: text is a 45th of the picture's height


def draw_table(image: Image, rows: Sequence[tuple[str, str]], *, bottom: bool = False) -> None:
    """Rows of a name and what it is, top left or bottom right."""
    if not rows:
        return
    font, size = _font(image)
    line, pad, gap = round(1.4 * size), round(0.7 * size), round(0.9 * size)
    names = max(round(font.getlength(name)) for name, _ in rows)
    start = pad + (names + gap if names else 0)
    width = min(start + max(round(font.getlength(text)) for _, text in rows) + pad, image.shape[1])
    height = min(len(rows) * line + 2 * pad, image.shape[0])
    margin = min(pad, image.shape[0] - height, image.shape[1] - width)
    y, x = (image.shape[0] - height - margin, image.shape[1] - width - margin) if bottom else (margin, margin)

    def paint(draw: Any) -> None:
        for k, (name, text) in enumerate(rows):
            level = pad + (k + 0.5) * line
            draw.text((pad, level), name, font=font, fill=FAINT, anchor="lm")
            draw.text((start, level), text, font=font, fill=BRIGHT, anchor="lm")

    part = image[y : y + height, x : x + width]
    part[:] = part * (1 - SHADE) + np.array(PANEL) * SHADE
    _painted(part, paint)


def draw_recording(image: Image) -> None:
    """A red dot with a pale rim, top right."""
    size = 2 * _font(image)[1]
    pad = size // 3
    part = image[pad : pad + size, max(0, image.shape[1] - pad - size) : image.shape[1] - pad]
    _painted(part, lambda draw: _dot(draw, size / 2, size / 2, size / 3, RED))


def draw_line(image: Image, start: tuple[float, float], end: tuple[float, float]) -> None:
    """A line from a ball to the pointer (px), and a ring about its end."""
    r = _font(image)[1] / 3
    points = np.clip([start, end], -1e4, 1e4)
    low = np.maximum(np.floor(points.min(axis=0) - 2 * r), 0).astype(int)
    high = np.ceil(points.max(axis=0) + 2 * r).astype(int)
    part = image[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]
    if not part.size:
        return
    (ax, ay), (bx, by) = (points - low).tolist()

    def paint(draw: Any) -> None:
        for width, fill in ((5, PANEL), (3, PULL)):
            draw.line((ax, ay, bx, by), fill=fill, width=width)
        _dot(draw, ax, ay, 0.7 * r, PULL)
        _dot(draw, bx, by, r, PULL)

    _painted(part, paint)


def _dot(draw: Any, x: float, y: float, r: float, fill: tuple[int, int, int]) -> None:
    draw.ellipse((x - r - 1, y - r - 1, x + r + 1, y + r + 1), fill=BRIGHT)
    draw.ellipse((x - r, y - r, x + r, y + r), fill=fill)


def _painted(part: Image, paint: Any) -> None:
    """Let Pillow paint into a part of an image."""
    from PIL import Image as Pictures
    from PIL import ImageDraw

    picture = Pictures.fromarray(np.ascontiguousarray(part))
    paint(ImageDraw.Draw(picture))
    part[:] = np.asarray(picture)


def _font(image: Image) -> tuple[Any, int]:
    size = max(SMALLEST, round(image.shape[0] / PER_HEIGHT))
    return _of_size(size), size


@lru_cache(maxsize=4)
def _of_size(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)
