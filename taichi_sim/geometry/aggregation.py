"""Levels of a graph: aggregates of neighbouring nodes, aggregates of these, and so on, with smooth weights between levels.

A node's function is 1 in the middle of its aggregate and falls to 0 over the neighbouring ones (smoothed aggregation; Vanek,
Mandel, Brezina 1996). Weights depend on the graph alone, not on stiffnesses or places.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Level", "levels_of"]

SMOOTHINGS = (0.6, 1.2)  # of an aggregate's function, by the Laplacian over its diagonal
LEAST_WEIGHT = 0.1  # less is left out, and the others of the node grow
LEAST_BOND = 0.01  # between neighbours, an entry over the diagonal
FEWEST_NODES = 3  # of a body, from which another level would be of no use
LEAST_GAIN = 0.7  # a level with more than this part of the nodes below is none


class Level(NamedTuple):
    """One level above another one.

    Attributes: `weight`, a sparse matrix (nodes below, nodes); `body`, `mass` (nodes,): the body of each, and the mass that its
    function moves; `shares` (orders, nodes): what its function has of an energy with derivatives of that order, over the sum of
    what nodes below have by themselves, times weights squared. That of order 0 is of masses, and no other is larger.
    """

    weight: Any
    body: NDArray[np.int64]
    mass: NDArray[np.float64]
    shares: list[NDArray[np.float64]]


def levels_of(
    edges: NDArray, held: NDArray, mass: NDArray, body: NDArray[np.int64], orders: Sequence[int]
) -> list[Level]:
    """Levels above the nodes of a graph, the finest first.

    edges: (m, 2), each between nodes of one body, repeated where it counts more; held: (n,) number of edges from each node to
    what does not move; mass, body: (n,) of each node; orders: of the derivatives that energies have, 0, 1 or 2. No weight of
    a body depends on another body.
    """
    from scipy.sparse import coo_array, diags_array

    n = len(mass)
    ends = np.concatenate([edges, edges[:, ::-1]])
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n)).tocsr()
    laplacian = (diags_array(graph.sum(axis=1) + held) - graph).tocsr()
    inertia = diags_array(mass).tocsr()
    energies = [(inertia, laplacian, laplacian @ laplacian)[order] for order in orders]
    levels: list[Level] = []
    while True:
        label, owner = _aggregates(laplacian, body)
        if len(owner) == 0:
            return levels
        weight = _smoothed(laplacian, label, len(owner))
        squares = weight.multiply(weight).T.tocsr()
        shares = [_diagonal(weight, energy) / _above_zero(squares @ energy.diagonal()) for energy in energies]
        shares = [np.clip(share, 0.0, shares[0]) for share in shares]
        levels.append(Level(weight, owner, _diagonal(weight, inertia), shares))
        laplacian, inertia, *energies = (
            (weight.T @ one @ weight).tocsr() for one in (laplacian, inertia, *energies)
        )  # fmt: skip
        body = owner


def _diagonal(weight: Any, matrix: Any) -> NDArray[np.float64]:
    """Diagonal of weight^T matrix weight."""
    return np.asarray(weight.multiply(matrix @ weight).sum(axis=0)).ravel()


def _above_zero(values: NDArray) -> NDArray[np.float64]:
    return np.where(values > 0.0, values, 1.0)


def _drop_below(matrix: Any, least: float) -> None:
    """Take entries of a smaller size out of a sparse matrix."""
    matrix.data[np.abs(matrix.data) < least] = 0.0
    matrix.eliminate_zeros()


def _smoothed(laplacian: Any, label: NDArray, count: int) -> Any:
    """Weights (n, count) of the nodes in the aggregates that `label` gives, -1 for none, and in their neighbours."""
    from scipy.sparse import coo_array, diags_array

    row = np.flatnonzero(label >= 0)
    weight = coo_array((np.ones(len(row)), (row, label[row])), shape=(len(label), count)).tocsr()
    diagonal = _above_zero(laplacian.diagonal())
    for part in SMOOTHINGS:
        weight = (weight - diags_array(part / diagonal) @ (laplacian @ weight)).tocsr()
    total = weight.sum(axis=1)
    _drop_below(weight, LEAST_WEIGHT)
    return (diags_array(total / _above_zero(weight.sum(axis=1))) @ weight).tocsr()


def _aggregates(laplacian: Any, body: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The aggregate of each node, -1 where its body has none, and the body of each aggregate."""
    graph = _neighbours(laplacian)
    label = _joined_to_roots(graph, _roots(graph))
    bodies = body.max(initial=-1) + 1
    owner = np.zeros(label.max(initial=-1) + 1, dtype=np.int64)
    owner[label] = body
    nodes, found = np.bincount(body, minlength=bodies), np.bincount(owner, minlength=bodies)
    kept = ((nodes > FEWEST_NODES) & (found < LEAST_GAIN * nodes))[owner]
    number = np.where(kept, np.cumsum(kept) - 1, -1)
    return number[label], owner[kept]


def _neighbours(laplacian: Any) -> Any:
    """The graph of nodes that a matrix joins firmly, with its weights; each also with itself."""
    from scipy.sparse import diags_array, eye_array

    scale = diags_array(1.0 / np.sqrt(_above_zero(laplacian.diagonal())))
    graph = abs(scale @ laplacian @ scale).tocsr()
    _drop_below(graph, LEAST_BOND)
    graph = (graph + eye_array(graph.shape[0])).tocsr()
    graph.sort_indices()  # or the order of nodes is left to chance
    return graph


def _roots(graph: Any) -> NDArray[np.bool_]:
    """Nodes no two of which have a common neighbour: from one end of the graph on, each that fits beside those before it. So
    they lie close and even, where those of a random order leave gaps, and functions are wide where gaps are."""
    order = _from_ends(graph)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    first, other = graph.indptr, graph.indices
    root, closed = np.zeros(len(order), dtype=bool), bytearray(len(order))  # a byte is found sooner than an item
    marks, at = np.frombuffer(closed, dtype=np.uint8), closed.find(0)
    while at >= 0:
        node = order[at]
        root[node] = True
        for near in other[first[node] : first[node + 1]]:
            marks[place[other[first[near] : first[near + 1]]]] = 1
        at = closed.find(0, at)
    return root


def _from_ends(graph: Any) -> NDArray[np.int64]:
    """All nodes, those of each connected part by their distance from an end of it."""
    from scipy.sparse import block_array, coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    n = graph.shape[0]
    count, part = connected_components(graph, directed=False)
    order = np.arange(n)[::-1]
    for _ in range(2):  # from the first node of each part, then from the last one that this finds
        end = np.zeros(count, dtype=np.int64)
        end[part[order]] = order
        begin = coo_array((np.ones(count), (np.zeros(count, dtype=np.int64), end)), shape=(1, n))
        order = breadth_first_order(block_array([[graph, coo_array((n, 1))], [begin, None]], format="csr"), n)[0][1:]
    return order


def _joined_to_roots(graph: Any, root: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number of the aggregate of each node: of the root beside it, or of what most of its neighbours belong to."""
    from scipy.sparse import coo_array

    n, count = len(root), int(root.sum())
    label = np.full(n, -1)
    label[root] = np.arange(count)
    pairs = graph.tocoo()
    beside = root[pairs.col]
    label[pairs.row[beside]] = label[pairs.col[beside]]
    near = np.flatnonzero(label >= 0)
    whole = coo_array((np.ones(len(near)), (near, label[near])), shape=(n, count)).tocsr()
    votes = (graph @ whole).tocoo()
    order = np.lexsort((votes.col, -votes.data, votes.row))
    row, first = np.unique(votes.row[order], return_index=True)
    chosen = np.full(n, -1)
    chosen[row] = votes.col[order][first]
    return np.where(label >= 0, label, chosen)
