"""SIMD batches: a sweep over springs, each seeing what those before it changed, a few at a time that share no ball."""

import heapq

import numpy as np
from numpy.typing import NDArray

__all__ = ["batches"]


def batches(pairs: NDArray[np.integer], width: int) -> NDArray[np.int64]:
    """Batches (k, width) of springs, -1 where one is not full, that do what a sweep over pairs (m, 2) in their order does.

    A spring depends on the last one before it at each of its balls. Springs that wait for none are independent; the earliest of
    them make the next batch (list scheduling), so that a sweep over a cloth goes on in several rows at once.
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
    found = []
    while ready:
        batch = [heapq.heappop(ready) for _ in range(min(width, len(ready)))]
        for e in batch:
            for follower in followers[e]:
                waits[follower] -= 1
                if waits[follower] == 0:
                    heapq.heappush(ready, follower)
        found.append(batch + [-1] * (width - len(batch)))
    return np.array(found)
