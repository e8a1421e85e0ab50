"""Smoothing: where a surface is shaded smoothly, and where an edge of it is sharp."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.graph import components
from taichi_sim.geometry.mesh import Edges

__all__ = ["CREASE", "Smoothing"]

CREASE = 40.0  # degrees between triangles, from which their edge is sharp


class Smoothing(NamedTuple):
    """Shading of t triangles. normal_of (t, 3): number of the normal at each corner, which corners that meet at a vertex
    share unless a sharp edge parts them. part (t,): number of the smooth part, bounded by sharp edges, that a triangle
    belongs to. sheet (t,): it is of a surface with a border, of which both sides are seen. evened (k,): numbers of normals that
    are averaged with those next to them."""

    normal_of: NDArray[np.int32]
    part: NDArray[np.int32]
    sheet: NDArray[np.bool_]
    evened: NDArray[np.int32] = np.zeros(0, np.int32)

    @classmethod
    def of(cls, points: NDArray, triangles: NDArray, crease: float, soft: NDArray | None = None) -> "Smoothing":
        """Smoothing of triangles (t, 3) of points (v, 3); edges are sharp where the two triangles are more than `crease`
        degrees apart, unless they are `soft` (t,), and where they are not two, wound alike."""
        t = len(triangles)
        if t == 0:
            return cls(np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros(0, bool))
        a, b, c = (points[triangles[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1)
        normal /= np.maximum(length, 1e-300)[:, None]
        edges = Edges.of(triangles)
        inner = (edges.triangles == 2) & (edges.forward == 1)  # of two that are wound alike
        sides = np.flatnonzero(inner[edges.of_side])
        side = sides[np.argsort(edges.of_side[sides], kind="stable")].reshape(-1, 2)
        one, other = (side % t).T  # the triangles of each of these edges
        smooth = np.einsum("ed,ed->e", normal[one], normal[other]) >= np.cos(np.radians(crease)) - 1e-9
        smooth |= (length[one] == 0) | (length[other] == 0)
        if soft is not None:
            smooth |= soft[one] & soft[other]
        one, other, side = one[smooth], other[smooth], side[smooth] // t
        after = (side + 1) % 3
        ends = (3 * one + side[:, 0], 3 * other + after[:, 1]), (3 * one + after[:, 0], 3 * other + side[:, 1])
        corner = components(3 * t, np.concatenate([np.stack(pair, axis=1) for pair in ends]))
        part = components(t, np.stack([one, other], axis=1))
        whole = components(len(points), np.concatenate([triangles[:, :2], triangles[:, 1:]]))
        border = np.zeros(len(points), dtype=bool)
        border[whole[edges.ends[edges.triangles == 1, 0]]] = True
        number = np.unique(corner, return_inverse=True)[1].reshape(t, 3)
        return cls(number.astype(np.int32), part.astype(np.int32), border[whole[triangles[:, 0]]])

    @property
    def normals(self) -> int:
        """Number of normals."""
        return int(self.normal_of.max(initial=-1)) + 1

    def closed(self) -> "Smoothing":
        """Return a copy without sheets: for a surface without a border, though its vertices are doubled along sharp edges."""
        return self._replace(sheet=np.zeros_like(self.sheet))

    def joined(self, other: "Smoothing") -> "Smoothing":
        """Join this one and another one, whose triangles follow."""
        return Smoothing(
            np.concatenate([self.normal_of, other.normal_of + self.normals]).astype(np.int32),
            np.concatenate([self.part, other.part + len(self.part)]).astype(np.int32),
            np.concatenate([self.sheet, other.sheet]),
            np.concatenate([self.evened, other.evened + self.normals]).astype(np.int32),
        )
