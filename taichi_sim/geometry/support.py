"""The reach of points along directions. No Taichi."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

__all__ = ["farthest"]

Floats = NDArray[np.float64]

GROUP = 64  # points, or directions, that lie close to each other
ROUNDING = 1e-12  # of a product, relative to the largest


def farthest(points: Floats, directions: Floats) -> Floats:
    """The largest products (m,) of directions (m, dim) with points (n, dim), n > 0, in memory for n + m of them.

    Both are put into groups of neighbours; for a group of directions only those points are tried whose box reaches as far as
    some point does.
    """
    axes = np.linalg.eigh((points - points.mean(axis=0)).T @ (points - points.mean(axis=0)))[1]  # a needle may lean
    points, directions = points @ axes, directions @ axes
    width = np.ptp(points, axis=0)
    order = list(_neighbours(points / np.where(width > 0.0, width, 1.0)))
    lowest, highest = (np.stack([of(points[group], axis=0) for group in order]) for of in (np.min, np.max))
    middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
    some = points[[group[0] for group in order]]
    slack = ROUNDING * np.abs(points).max()
    aim = directions * width
    aim /= np.maximum(np.linalg.norm(aim, axis=1, keepdims=True), 1e-300)
    reach = np.empty(len(directions))
    for group in _neighbours(aim):
        mine = directions[group]
        least = (mine @ some.T).max(axis=1) - slack * np.abs(mine).sum(axis=1)
        close = (mine @ middle.T + np.abs(mine) @ half.T >= least[:, None]).any(axis=0)
        tried = np.concatenate([order[k] for k in np.flatnonzero(close)])
        reach[group] = (mine @ points[tried].T).max(axis=1)
    return reach


def _neighbours(points: Floats) -> Iterator[NDArray[np.intp]]:
    """Groups of at most GROUP points, halved across where they are longest."""
    groups = [np.arange(len(points))] if len(points) else []
    while groups:
        group = groups.pop()
        if len(group) <= GROUP:
            yield group
            continue
        own = points[group]
        order = np.argpartition(own[:, np.argmax(np.ptp(own, axis=0))], len(own) // 2)
        groups += [group[part] for part in np.array_split(order, 2)]
