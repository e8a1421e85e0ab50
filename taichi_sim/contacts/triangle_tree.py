"""A closed mesh as a tree of boxes around its triangles, with the normals that tell inside from outside."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.mesh import Surface
from taichi_sim.kernels.contacts.triangle_tree import CORNERS, OUTWARD, WIDTH

__all__ = ["TriangleTree", "triangle_tree"]

LEAF = 2  # triangles at most

Floats = NDArray[np.float64]


class TriangleTree(NamedTuple):
    """Boxes (nodes, 6) [m], lower and upper corner, a node before what lies in it; links (nodes, 3): the node that follows all of
    that, and of a leaf its first triangle and the one after its last; triangles (t, WIDTH): unit
    vectors, the normals of the sides across from its corners, of these, and of its inside, and those away from it in its plane at
    these sides; its height over the first side [m]; its corners [m]. order (t,): the
    number of each in the mesh."""

    boxes: Floats
    links: NDArray[np.int64]
    triangles: Floats
    order: NDArray[np.int64]


NO_TREE = TriangleTree(np.zeros((0, 6)), np.zeros((0, 3), np.int64), np.zeros((0, WIDTH)), np.zeros(0, np.int64))


def triangle_tree(surface: Surface) -> TriangleTree:
    """The tree of a closed mesh: complete, each node halved across the longest side of the box around its centres."""
    corners = surface.vertices[surface.triangles]
    order, depth = _halved(corners.mean(axis=1))
    low, high = (part[order].reshape(1 << depth, -1, 3) for part in (corners.min(axis=1), corners.max(axis=1)))
    low, high = low.min(axis=1), high.max(axis=1)
    levels = [np.concatenate([low, high], axis=1)]
    for _ in range(depth):
        low, high = low.reshape(-1, 2, 3).min(axis=1), high.reshape(-1, 2, 3).max(axis=1)
        levels.insert(0, np.concatenate([low, high], axis=1))
    once = np.zeros(len(order), dtype=bool)
    once[np.unique(order, return_index=True)[1]] = True
    begin = np.concatenate([[0], np.cumsum(once.reshape(1 << depth, -1).sum(axis=1))])  # of each leaf
    nodes = (2 << depth) - 1
    boxes, links = np.empty((nodes, 6)), np.zeros((nodes, 3), dtype=np.int64)
    place = np.zeros(1, dtype=np.int64)
    for level, box in enumerate(levels):
        below = (1 << (depth - level)) - 1  # nodes under each half
        boxes[place] = box
        links[place, 0] = place + 2 * below + 1
        if level == depth:
            links[place, 1], links[place, 2] = begin[:-1], begin[1:]
        place = (place[:, None] + np.array([1, 1 + below])).ravel()
    order = order[once]
    away = outward(corners)
    height = np.sum(away[:, 0] * (corners[:, 1] - corners[:, 0]), axis=1)
    parts = (
        normals(surface).reshape(-1, OUTWARD),
        away.reshape(-1, 9),
        height[:, None],
        corners.reshape(-1, WIDTH - CORNERS),
    )
    table = np.concatenate(parts, axis=1)[order]
    return TriangleTree(boxes, links, table, order)


def _halved(centre: Floats) -> tuple[NDArray[np.int64], int]:
    """Numbers of triangles leaf by leaf, as many in each, for which some are there twice; the depth of the tree."""
    n = len(centre)
    depth = max(0, math.ceil(math.log2(n / LEAF)))
    places = -(-n >> depth) << depth
    order: NDArray[Any] = np.arange(places) * n // places
    for level in range(depth):
        order = order.reshape(1 << level, -1)
        points = centre[order]
        axis = np.argmax(np.ptp(points, axis=1), axis=1)
        along = np.take_along_axis(points, axis[:, None, None], axis=2)[:, :, 0]
        order = np.take_along_axis(order, np.argsort(along, axis=1, kind="stable"), axis=1)
    return order.ravel(), depth


def outward(corners: Floats) -> Floats:
    """Unit vectors (t, 3, 3) in the planes of triangles, away from them at the sides across from their corners."""
    side = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    return _unit(np.cross(side, _unit(np.cross(side[:, 0], side[:, 1]))[:, None]))


def normals(surface: Surface) -> Floats:
    """Unit normals (t, 7, 3) of the sides across from the corners of each triangle, of these, and of its inside. A point lies
    outside where the normal of what is nearest to it faces it: that of a corner is the mean of its triangles' by their angles, of
    a side that of both (Baerentzen and Aanaes, Signed distance computation using the angle weighted pseudonormal, 2005)."""
    t = surface.triangles
    corner = surface.vertices[t]
    side = np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1)  # across from each corner
    face = _unit(np.cross(side[:, 0], side[:, 1]))
    ends = np.sort(np.stack([np.roll(t, -1, axis=1), np.roll(t, -2, axis=1)], axis=2), axis=2).reshape(-1, 2)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    edge = edge.reshape(-1, 3)
    around = np.zeros((edge.max() + 1, 3))
    for k in range(3):
        np.add.at(around, edge[:, k], face)
    flat = ~face.any(axis=1)  # one without an area faces as those beside it do
    face[flat] = _unit(around[edge[flat]].sum(axis=1))
    for k in range(3):
        np.add.at(around, edge[flat, k], face[flat])
    at = np.zeros_like(surface.vertices)
    for k in range(3):
        one, two = _unit(side[:, k - 1]), _unit(side[:, k - 2])
        angle = np.arccos(np.clip(-np.sum(one * two, axis=1), -1.0, 1.0))
        np.add.at(at, t[:, k], angle[:, None] * face)
    return np.concatenate([_unit(around)[edge], _unit(at)[t], face[:, None]], axis=1)


def _unit(vectors: Floats) -> Floats:
    """Vectors (..., 3) of length 1, or 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
