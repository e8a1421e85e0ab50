"""Levels of a graph: aggregates of neighbouring nodes, aggregates of these, and so on, with smooth weights between levels.

A node's function is 1 in the middle of its aggregate and falls to 0 over the neighbouring ones (smoothed aggregation; Vanek,
Mandel, Brezina 1996). Weights depend on the graph alone, not on stiffnesses or places.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Level", "levels_of"]

SMOOTHING = 2.0 / 3.0  # of an aggregate's function, by the Laplacian over its diagonal
LEAST_WEIGHT = 0.05  # less is left out, and the others of the node grow
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
    whole = coo_array((np.ones(len(row)), (row, label[row])), shape=(len(label), count)).tocsr()
    weight = (whole - diags_array(SMOOTHING / _above_zero(laplacian.diagonal())) @ (laplacian @ whole)).tocsr()
    total = weight.sum(axis=1)
    _drop_below(weight, LEAST_WEIGHT)
    return (diags_array(total / _above_zero(weight.sum(axis=1))) @ weight).tocsr()


def _aggregates(laplacian: Any, body: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The aggregate of each node, -1 where its body has none, and the body of each aggregate."""
    graph = _neighbours(laplacian)
    label = _joined_to_roots(graph, _roots(graph, body))
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
    return (graph + eye_array(graph.shape[0])).tocsr()


def _roots(graph: Any, body: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Nodes no two of which have a common neighbour, as many as fit: those before which none within two edges comes, in an order
    that is mixed within each body (Luby 1986)."""
    count = np.bincount(body)
    grouped = np.argsort(body, kind="stable")
    rank = np.empty(len(body), dtype=np.int64)
    rank[grouped] = np.arange(len(body)) - np.repeat(np.cumsum(count) - count, count)
    rank = 1 + (rank * 2654435761) % 2**32  # one to one: 2654435761 is odd
    first, other = graph.indptr[:-1], graph.indices

    def greatest(values: NDArray) -> NDArray:
        for _ in range(2):
            values = np.maximum.reduceat(values[other], first)
        return values

    open_, root = np.ones(len(body), dtype=bool), np.zeros(len(body), dtype=bool)
    while open_.any():
        chosen = open_ & (greatest(np.where(open_, rank, 0)) == rank)
        root |= chosen
        open_ &= ~greatest(chosen)
    return root


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
