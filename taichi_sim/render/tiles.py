"""Lists of the shapes that touch each tile of a picture."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["tile_lists"]

MOST_ENTRIES = 4_000_000  # entries: beyond, the shapes drawn last (on top) are kept


def tile_lists(
    low: NDArray, high: NDArray, size: tuple[int, int], tile: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Lists of boxes low..high (n, 2) px by tile: entry, the boxes tile after tile in their own order; start (tiles + 1,)."""
    across, down = -(-size[0] // tile), -(-size[1] // tile)
    limit = np.array([across, down])
    first = np.clip(np.floor(low / tile), 0, limit).astype(np.int64)
    after = np.clip(np.floor(high / tile) + 1, 0, limit).astype(np.int64)
    span = np.maximum(after - first, 0)
    count = span[:, 0] * span[:, 1]
    if count.sum() > MOST_ENTRIES:
        count[np.cumsum(count[::-1])[::-1] > MOST_ENTRIES] = 0
    box = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(box)) - np.repeat(np.cumsum(count) - count, count)
    wide = np.maximum(span[box, 0], 1)
    index = (first[box, 1] + nth // wide) * across + first[box, 0] + nth % wide
    if across * down < 1 << 16:
        index = index.astype(np.uint16)  # a radix sort
    order = np.argsort(index, kind="stable")
    start = np.zeros(across * down + 1, dtype=np.int32)
    start[1:] = np.cumsum(np.bincount(index, minlength=across * down))
    entry = box[order].astype(np.int32)
    return (entry if len(entry) else np.zeros(1, dtype=np.int32)), start
