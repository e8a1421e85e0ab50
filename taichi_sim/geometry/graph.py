"""Graphs: which nodes pairs of them join."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["components"]


def components(n: int, pairs: NDArray) -> NDArray[np.int64]:
    """For each of n nodes (n,) the lowest one among those that pairs (m, 2) join it to, over any number of pairs."""
    if not n:
        return np.zeros(0, dtype=np.int64)
    graph = coo_array((np.ones(len(pairs), dtype=bool), np.asarray(pairs).reshape(-1, 2).T), shape=(n, n))
    label = connected_components(graph, directed=False)[1]
    return np.unique(label, return_index=True)[1][label]
