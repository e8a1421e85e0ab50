"""Colours: a harmonious palette, one colour for each connected body, and sRGB to linear."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry.graph import components

__all__ = ["PALETTE", "background_colours", "body_colours", "to_linear"]

PALETTE = np.array(  # sRGB: coral, amber, teal, blue, cream, rose, sea green, slate blue
    [
        [0.91, 0.38, 0.31],
        [0.95, 0.68, 0.25],
        [0.16, 0.62, 0.60],
        [0.20, 0.45, 0.71],
        [0.93, 0.86, 0.74],
        [0.83, 0.45, 0.56],
        [0.47, 0.72, 0.50],
        [0.38, 0.40, 0.62],
    ]
)

GRAIN_COLOURS = np.array([0, 1, 1, 1, 4, 4, 0, 1, 4, 2])  # mostly warm
MANY_BODIES = 4000  # bodies


def to_linear(colour: NDArray) -> NDArray[np.float64]:
    """sRGB in 0..1 to linear light."""
    c = np.clip(np.asarray(colour, dtype=float), 0.0, 1.0)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def background_colours(given: Any, top: Any, bottom: Any) -> tuple[NDArray, NDArray]:
    """Linear colours of top and bottom from None (the defaults), one sRGB colour, or the pair (top, bottom)."""
    if given is None:
        return to_linear(np.array(top)), to_linear(np.array(bottom))
    colours = np.asarray(given, dtype=float)
    if colours.shape not in ((3,), (2, 3)):
        raise ValueError(f"background: one sRGB colour or a pair (top, bottom) is allowed, not shape {colours.shape}")
    top, bottom = (colours, colours) if colours.ndim == 1 else colours
    return to_linear(top), to_linear(bottom)


def body_colours(frame: Frame) -> NDArray[np.float64]:
    """sRGB (n, 3): the frame's own colours where it has them, otherwise one of the palette for each connected body, of springs,
    triangles or elements."""
    n = len(frame.position)
    given = frame.colour if len(frame.colour) == n else np.full((n, 3), np.nan)
    missing = ~np.all(np.isfinite(given), axis=1)
    if not missing.any():
        return np.clip(given, 0.0, 1.0)
    label = components(n, np.concatenate([_chains(rows) for rows in _joined(frame)]))
    order = np.cumsum(label == np.arange(n)) - 1  # bodies counted in order of their first ball
    body = order[label]
    bodies = int(body.max()) + 1
    noise = _hash(body)
    if bodies <= len(PALETTE):
        index = body
    elif bodies <= MANY_BODIES:
        index = (noise % np.uint64(len(PALETTE))).astype(np.int64)
    else:  # grains of a few pixels: fewer hues, or the mixture looks grey
        index = GRAIN_COLOURS[(noise % np.uint64(len(GRAIN_COLOURS))).astype(np.int64)]
    shade = 0.93 + 0.14 * ((noise >> np.uint64(20)) % np.uint64(16)).astype(float)[:, None] / 16
    chosen = PALETTE[index] * shade
    return np.clip(np.where(missing[:, None], chosen, given), 0.0, 1.0)


def _joined(frame: Frame) -> list[NDArray]:
    """Balls (k, width) that are parts of one body, row by row; what tears keeps its colour."""
    springs, triangles = [frame.springs, frame.torn_springs], [frame.triangles, frame.torn_triangles]
    scene = getattr(frame, "scene", None)
    return [*springs, *triangles, *(() if scene is None else (scene.bricks, scene.solids))]


def _chains(rows: NDArray) -> NDArray:
    """Pairs (p, 2) of those that stand beside each other in rows (k, width)."""
    return np.stack([rows[:, :-1].ravel(), rows[:, 1:].ravel()], axis=1)


def _hash(index: NDArray) -> NDArray[np.uint64]:
    """Scrambled bits of an index (the 32-bit finaliser of MurmurHash3)."""
    mask = np.uint64(0xFFFFFFFF)
    h = index.astype(np.uint64)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35), (16, 1)):
        h = ((h ^ (h >> np.uint64(shift))) * np.uint64(factor)) & mask
    return h
