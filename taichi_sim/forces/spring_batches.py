"""Waves: a sweep over springs, each seeing what those before it changed, in groups whose springs share no ball."""

import heapq

import numpy as np
from numpy.typing import NDArray

__all__ = ["waves"]


def waves(pairs: NDArray[np.integer], width: int) -> NDArray[np.int64]:
    """Groups (k, width) of springs, -1 where one is not full, that do what a sweep over pairs (m, 2) in their order does.

    A spring depends on the last one before it at each of its balls. Springs that wait for none are independent; the earliest of
    them make the next group (list scheduling), so that a sweep over a cloth goes on in several rows at once.
    """
    followers: list[list[int]] = [[] for _ in pairs]
    waits = np.zeros(len(pairs), dtype=np.int64)
    last: dict[int, int] = {}
    for e, ends in enumerate(pairs.tolist()):
        for ball in ends:
            if ball in last:
                followers[last[ball]].append(e)
                waits[e] += 1
            last[ball] = e
    ready = np.flatnonzero(waits == 0).tolist()  # sorted, so a heap
    groups = []
    while ready:
        group = [heapq.heappop(ready) for _ in range(min(width, len(ready)))]
        for e in group:
            for follower in followers[e]:
                waits[follower] -= 1
                if waits[follower] == 0:
                    heapq.heappush(ready, follower)
        groups.append(group + [-1] * (width - len(group)))
    return np.array(groups)
