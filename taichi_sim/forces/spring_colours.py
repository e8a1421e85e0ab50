"""Colours of springs: those of one colour share no ball, so that a GPU can change both ends of all of them at once."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["MOST_COLOURS", "colours"]

MOST_COLOURS = 64  # bits of a word


def colours(pairs: NDArray[np.integer], n: int) -> NDArray[np.int64] | None:
    """The colour (m,) of each spring between two of n balls, from 0 on; None where one ball would need more than MOST_COLOURS.

    Each spring takes the first colour that neither of its balls has used, in an order in which many can choose at once: of all
    that are left, those that come before every other one at both of their balls (Jones and Plassmann, A Parallel Graph Coloring
    Heuristic, 1993). The order is by direction in the lattice, every second spring of a row first, then at random: cloth needs
    12 colours and jelly 26, as many as a ball has springs.
    """
    one, other = np.sort(pairs, axis=1).T.astype(np.int64)
    stride = other - one
    random = np.random.default_rng(0).permutation(len(one))
    rank = np.empty(len(one), dtype=np.int64)
    rank[np.lexsort((random, one // np.maximum(stride, 1) % 2, stride))] = np.arange(len(one))
    found, used, left = np.zeros(len(one), dtype=np.int64), np.zeros(n, dtype=np.uint64), np.arange(len(one))
    while len(left):
        a, b, mine = one[left], other[left], rank[left]
        first = np.full(n, len(one), dtype=np.int64)
        np.minimum.at(first, a, mine)
        np.minimum.at(first, b, mine)
        chosen = (first[a] == mine) & (first[b] == mine)
        a, b = a[chosen], b[chosen]
        free = ~(used[a] | used[b])
        if not free.all():
            return None
        bit = free & (~free + np.uint64(1))  # the lowest that is set
        found[left[chosen]] = np.log2(bit.astype(np.float64)).astype(np.int64)  # exact: powers of 2
        used[a] |= bit
        used[b] |= bit
        left = left[~chosen]
    return found
