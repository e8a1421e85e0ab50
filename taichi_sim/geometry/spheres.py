"""Icospheres: icosahedra whose triangles are cut in four again and again."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.mesh import Surface

__all__ = ["icosphere"]


def icosphere(cuts: int) -> Surface:
    """Return a unit icosphere, counter-clockwise from outside, whose triangles are cut so often: 20 4^cuts of them."""
    golden = 0.5 * (1 + 5**0.5)
    x = np.array([(s, t * golden, 0.0) for s in (-1, 1) for t in (-1, 1)])
    vertices: NDArray = np.concatenate([np.roll(x, k, axis=1) for k in range(3)])
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=2)
    near = np.isclose(apart, 2.0)
    triangles = np.array(
        [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[k, i]]
    )
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    inward = np.einsum("ti,ti->t", a, np.cross(b, c)) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    vertices = vertices / np.linalg.norm(vertices[0])
    for _ in range(cuts):
        sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
        edges, middle = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True)
        ab, bc, ca = len(vertices) + middle.reshape(3, -1)
        between = vertices[edges].sum(axis=1)
        vertices = np.concatenate([vertices, between / np.linalg.norm(between, axis=1, keepdims=True)])
        a, b, c = triangles.T
        triangles = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return Surface(vertices, triangles.astype(np.int32))
