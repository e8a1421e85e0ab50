"""Graphs whose nodes are balls or vertices and whose edges are springs, sides or whatever joins two of them."""

import numpy as np
from numpy.typing import NDArray


def components(count: int, edges: NDArray[np.integer]) -> NDArray[np.int64]:
    """Lowest index to which edges (m, 2) connect each of `count` nodes, over any number of them."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if len(edges) == 0:
        return np.arange(count)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    return np.unique(label, return_index=True)[1][label]


def incidence(pairs: NDArray[np.integer], n: int) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """Edges of each of n nodes: start (n + 1), other end (2 m), edge index (2 m), sorted by the other end."""
    here = np.concatenate([pairs[:, 0], pairs[:, 1]])
    other = np.concatenate([pairs[:, 1], pairs[:, 0]])
    edge = np.tile(np.arange(len(pairs)), 2)
    order = np.lexsort((edge, other, here))
    start = np.zeros(n + 1, dtype=np.int32)
    np.cumsum(np.bincount(here, minlength=n), out=start[1:])
    return start, other[order].astype(np.int32), edge[order]


def sliced(start: NDArray[np.int32], width: int) -> tuple[NDArray[np.int32], NDArray[np.int64], int]:
    """Places of entries when the lists start[i] to start[i + 1] of `width` nodes are stored together: their first entries,
    then their second ones, and so on, as many as the longest of them has (sliced ELLPACK, Monakov et al. 2010).

    Returns where each slice begins (slices), the place of each entry, and how many places there are.
    """
    number = np.diff(start).astype(np.int64)
    lists = np.zeros(-(-len(number) // width) * width, dtype=np.int64)
    lists[: len(number)] = number
    first = np.zeros(len(lists) // width + 1, dtype=np.int64)
    np.cumsum(lists.reshape(-1, width).max(axis=1, initial=0) * width, out=first[1:])
    node = np.repeat(np.arange(len(number)), number)
    place = first[node // width] + (np.arange(start[-1]) - start[node]) * width + node % width
    return first[:-1].astype(np.int32), place, int(first[-1])
