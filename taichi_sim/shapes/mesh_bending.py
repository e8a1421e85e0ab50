"""Bending of meshes: elements where they are flat at rest, springs across the edges where they are folded. Imports no Taichi.

One hinge at each edge depends on how a mesh is cut: rolled up along the cuts of a grid of squares, hinges with the strength that
is right along its sides store up to 2.9 times too much, and a strip of such a grid that is cut in turns sags by 22 % too much, as
it bends where its hinges are not. Four balls in a plane measure one combination of the curvatures, whatever they are: u : kappa.
For each triangle those at its edges and those in a row through its vertices get strengths of at least 0 whose energies add up to
rigidity / 2 (|kappa|^2 + t det kappa) times its area, with any t: what is not stretched has no Gaussian curvature, det kappa = 0.
With rigidities B and C along warp and weft, (B + C) / 2 |kappa|^2 + (B - C) / 2 (kappa_uu^2 - kappa_vv^2) is in its place.
Of all such strengths the least are taken (least squares with a little weight on the strengths), so that neighbouring rows share
evenly. The half of a row beyond the last balls does not bend: a triangle at a border leaves out the curvature across it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.mesh import Surface, hinges, sides
from taichi_sim.shapes.base import Bends

__all__ = ["corners_of", "cotangent", "is_thin", "mesh_bends", "warp_directions"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Measures = tuple[Ints, Floats, Floats]  # vertices (c, 4), weights (c, 4) and stiffness (c,)

FLAT_HINGE = 1e-4  # rad: a hinge folded less is flat
STRAIGHT = np.cos(np.radians(40.0))  # of the bend at a ball up to which two of its neighbours are in a row with it
PARTNERS = 16  # of a neighbour at most, in rows through a vertex
MOST_ROWS = 256  # through a vertex, that each of its triangles considers
WARP_ACROSS = 0.9  # cosine between a normal and the warp, from which on the warp lies across
LEAST = 1e-9  # of what a triangle can measure: four balls that measure less measure nothing
EXACT = 1e-9  # of a weight: rounding of 0
FEW = 1e-3  # of the rigidity: a strength that does not count
EVENLY = 0.03  # weight of the strengths, by which the least are found
LEAST_PART = 0.05  # of a triangle that a vertex has at least
AT_EDGE = 4.0  # times as readily as in a row through a vertex is the curvature measured at an edge
POOR = 0.05  # of the energy: missed by rows and edges, so that any four of six balls are tried
ROOT = np.sqrt(2.0)
PRODUCTS = (
    (0, 0),
    (1, 1),
    (2, 2),
    (0, 1),
    (0, 2),
    (1, 2),
)  # of (k_xx, k_yy, sqrt(2) k_xy), whose squares sum to |kappa|^2
SQUARE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # |kappa|^2 in these
DETERMINANT = np.array([0.0, 0.0, -0.5, 0.5 * ROOT, 0.0, 0.0])


def mesh_bends(
    surface: Surface, rigidity: float | None = None, weft: float | None = None, warp_angle: float = 0.0
) -> tuple[Bends, NDArray, NDArray]:
    """Bending of a mesh: elements where it is flat at rest, and springs (m, 2), (m,) [N/m] across the edges where it is folded.

    A spring across an edge of length e stores rigidity [N m] e^2 / (A0 + A1) times half the square of a small change of the
    angle, which is what a cylinder stores. A hinge with cotangents K, rigidity / (A0 + A1) |K . x|^2 / 2 (Bergou et al. 2006),
    stores the same, and is taken where a triangle has one neighbour. Without a rigidity each edge has
    that of three balls in a row whose element has a stiffness of 1 N/m, the ends as far apart as the two vertices that face each
    other across the edge. Beside a triangle without area nothing bends, and no spring crosses an edge folded onto itself, which
    its opening would not stretch. weft: rigidity along the weft [N m], that along the warp
    by default; warp_angle: see `warp_directions`.
    """
    lean = 0.0 if rigidity is None or weft is None or rigidity == weft else (rigidity - weft) / (rigidity + weft)
    edge, opposite = hinges(surface.triangles)
    x = surface.vertices
    wide = np.ones(len(edge), dtype=bool)
    for k in range(2):
        wide &= ~is_thin(x[edge[:, 0]], x[edge[:, 1]], x[opposite[:, k]])
    edge, opposite = edge[wide].astype(np.int64), opposite[wide].astype(np.int64)
    x0, x1, x2, x3 = x[edge[:, 0]], x[edge[:, 1]], x[opposite[:, 0]], x[opposite[:, 1]]
    along = x1 - x0
    length = np.linalg.norm(along, axis=1)
    normals = np.cross(along, x2 - x0), np.cross(x3 - x0, along)
    double = np.linalg.norm(normals[0], axis=1), np.linalg.norm(normals[1], axis=1)
    apart = np.sum((x3 - x2) ** 2, axis=1)
    rigid = np.full(len(edge), rigidity if weft is None or rigidity is None else 0.5 * (rigidity + weft))
    if rigidity is None:
        rigid = apart / (2 * length) ** 2 * (double[0] + double[1]) / 2
    sine = np.linalg.norm(np.cross(*normals), axis=1) / (double[0] * double[1])
    flat = (sine < FLAT_HINGE) & (np.einsum("hi,hi->h", *normals) > 0)
    bends = _flat_bends(surface, edge[flat], opposite[flat], rigid[flat], lean, warp_angle)
    normal = normals[0] / double[0][:, None] + normals[1] / double[1][:, None]
    rigid = rigid * _across(lean, warp_directions(normal, warp_angle), along)
    reach = double[0] * double[1] / length**2 * sine  # of the distance across, times that, for each radian
    folded = sine >= FLAT_HINGE
    change = reach[folded] ** 2
    strength = (2 * rigid / (double[0] + double[1]))[folded]
    return bends, opposite[folded], strength * length[folded] ** 2 * apart[folded] / change


def warp_directions(normal: Floats, warp_angle: float) -> Floats:
    """Unit vectors (k, 3) of the warp in planes with these normals (k, 3): nearest to the direction `warp_angle` [rad] from x
    toward z; where that lies across, to the one a quarter turn on."""
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    warp = np.array([np.cos(warp_angle), 0.0, np.sin(warp_angle)])
    facing = np.abs(normal @ warp) > WARP_ACROSS
    warp = np.where(facing[:, None], np.array([-np.sin(warp_angle), 0.0, np.cos(warp_angle)]), warp)
    warp = warp - np.einsum("ki,ki->k", warp, normal)[:, None] * normal
    return np.asarray(warp / np.maximum(np.linalg.norm(warp, axis=1, keepdims=True), 1e-300))


def _across(lean: float, warp: Floats, along: Floats) -> Floats:
    """Rigidity (k,) against bending across edges `along` (k, d), in parts of the mean, unit vectors of the warp (k, d) given."""
    square = np.einsum("ki,ki->k", warp, along) ** 2 / np.maximum(np.sum(along**2, axis=1), 1e-300)
    return np.asarray(1.0 + lean * (1.0 - 2.0 * square))


def _flat_bends(
    surface: Surface, edge: Ints, opposite: Ints, rigidity: Floats, lean: float, warp_angle: float
) -> Bends:
    """Elements of the triangles beside flat edges (h, 2) with the vertices (h, 2) that face each other across them; rigidity
    (h,) [N m]: the mean of those along warp and weft; lean: half their difference in parts of it."""
    if not len(edge):
        return Bends(np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4)), np.zeros(0))
    mesh = _Flat(surface, edge, opposite, rigidity, lean, warp_angle)
    return _as_bends(surface.vertices, [*mesh.fitted(), mesh.hinges()])


class _Flat:
    """Triangles beside flat edges: their neighbours `flaps` (t, 3), -1 where there is none across a side, see `sides`, and their
    rigidity (t,) [N m]."""

    def __init__(
        self, surface: Surface, edge: Ints, opposite: Ints, rigidity: Floats, lean: float, warp_angle: float
    ) -> None:
        self.x, self.t = surface.vertices, surface.triangles.astype(np.int64)
        n = len(self.x)
        keys = edge @ [n, 1]
        order = np.argsort(keys)
        of_side = np.sort(sides(self.t).astype(np.int64), axis=1) @ [n, 1]  # side 0 of all triangles, then the next
        at = order[np.minimum(np.searchsorted(keys[order], of_side), len(keys) - 1)]
        there = keys[at] == of_side
        own = self.t[:, [2, 0, 1]].T.ravel()
        facing = np.where(opposite[at, 0] == own, opposite[at, 1], opposite[at, 0])
        self.flaps = np.where(there, facing, -1).reshape(3, -1).T
        self.number = (self.flaps >= 0).sum(axis=1)
        share = np.where(there, rigidity[at], 0.0).reshape(3, -1).sum(axis=0)
        self.rigidity = share / np.maximum(1, self.number)
        beyond = np.zeros(n, dtype=bool)  # vertices of triangles with more than one neighbour
        beyond[self.t[self.number > 1]] = True
        self.alone = (self.number == 1) & ~beyond[self.t].any(axis=1)
        a, b, c = (self.x[self.t[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        double = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
        self.area = 0.5 * double
        u = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1), 1e-300)[:, None]
        self.axes = np.stack([u, np.cross(normal / double[:, None], u), normal / double[:, None]], axis=1)
        self.lean = lean
        self.warp = np.einsum("tai,ti->ta", self.axes[:, :2], warp_directions(normal, warp_angle))
        self.target = self._targets()

    def hinges(self) -> Measures:
        """The hinges of two triangles that have no other neighbours, each of them half."""
        some = np.flatnonzero(self.alone)
        side = np.argmax(self.flaps[some] >= 0, axis=1)
        three = np.take_along_axis(self.t[some], (side[:, None] + np.arange(3)) % 3, axis=1)
        four = np.column_stack([three, self.flaps[some, side]])
        x0, x1, x2, x3 = (self.x[four[:, k]] for k in range(4))
        at_0, at_1 = (cotangent(x0, x1, x2), cotangent(x0, x1, x3)), (cotangent(x1, x0, x2), cotangent(x1, x0, x3))
        weights = np.stack([at_1[0] + at_1[1], at_0[0] + at_0[1], -at_0[0] - at_1[0], -at_0[1] - at_1[1]], axis=1)
        one, other = (0.5 * np.linalg.norm(np.cross(x1 - x0, end - x0), axis=1) for end in (x2, x3))
        edge = np.einsum("tai,ti->ta", self.axes[some, :2], x1 - x0)
        strength = self.rigidity[some] * _across(self.lean, self.warp[some], edge) * one / (one + other) ** 2
        return four, weights, strength

    def fitted(self) -> Iterator[Measures]:
        """Elements of each of the other triangles."""
        some = np.flatnonzero((self.number > 0) & ~self.alone)
        if not len(some):
            return
        triangle, four = self._candidates(some)
        order = np.argsort(triangle, kind="stable")
        triangle, four = triangle[order], four[order]
        place, height = self._in_plane(triangle, four)
        weights, products = _measured(place, four)
        off = np.abs(height) / np.maximum(1.0, np.linalg.norm(place, axis=2))  # an angle, so that its own edges count
        use = (off.max(axis=1) < FLAT_HINGE) & (np.abs(products).max(axis=1) > 0.0)
        triangle, four, weights, products = triangle[use], four[use], weights[use], products[use]
        ease = self._ease(triangle, four)
        first = np.searchsorted(triangle, np.append(some, len(self.t)))
        known: dict[bytes, tuple[Floats, float]] = {}  # triangles that are alike
        for k, here, there in zip(some.tolist(), first[:-1], first[1:]):
            fours, w, forms, own = four[here:there], weights[here:there], products[here:there], ease[here:there]
            alike = np.round(np.concatenate([forms.ravel(), own, self.target[k], self.number[k : k + 1]]), 9).tobytes()
            if alike not in known:
                known[alike] = self._fit(k, forms, own)
            part, left = known[alike]
            if left > POOR and self.number[k] == 3:
                any_four = np.array(list(itertools.combinations(np.append(self.t[k], self.flaps[k]), 4)))
                more_w, more = _measured(self._in_plane(np.full(len(any_four), k), any_four)[0], any_four)
                again, less = self._fit(k, np.concatenate([forms, more]), np.append(own, np.ones(len(more))))
                if less < left:
                    fours, w, part = np.concatenate([fours, any_four]), np.concatenate([w, more_w]), again
            yield fours[part > FEW], w[part > FEW] / self.area[k], part[part > FEW] * (self.rigidity[k] * self.area[k])

    def _candidates(self, some: Ints) -> tuple[Ints, Ints]:
        """Triangles (c,), of some, each with four vertices (c, 4): those of its edges, and those in rows through its vertices; a
        middle one that counts twice comes first."""
        found = []
        for k in range(3):
            here = some[self.flaps[some, k] >= 0]
            three = self.t[here][:, [k, (k + 1) % 3, (k + 2) % 3]]
            found.append((here, _canonical(self.x, np.column_stack([three, self.flaps[here, k]]))))
        rows = _rows(self.x, self.t[self.number > 0])
        first = np.searchsorted(rows[:, 0], np.arange(len(self.x) + 1))
        for k in range(3):
            vertex = self.t[some, k]
            every = -(-(first[vertex + 1] - first[vertex]) // MOST_ROWS)  # of a hub, others in the next triangle
            start = first[vertex] + some % np.maximum(every, 1)
            count = -(-(first[vertex + 1] - start) // np.maximum(every, 1))
            place = np.arange(count.sum()) - np.repeat(np.append(0, np.cumsum(count)[:-1]), count)
            at = np.repeat(start, count) + np.repeat(every, count) * place
            found.append((np.repeat(some, count), rows[at]))
        all_ = np.column_stack([np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])])
        key = np.sort(all_[:, 1:], axis=1)
        _, once = np.unique(np.column_stack([all_[:, :1], key]), axis=0, return_index=True)
        return all_[once, 0], all_[once, 1:]

    def _in_plane(self, triangle: Ints, four: Ints) -> tuple[Floats, Floats]:
        """Places (c, k, 2) of vertices (c, k) in the planes of triangles (c,), and how far they are off it (c, k), in units of
        the root of the triangles' areas."""
        middle = self.x[self.t[triangle]].mean(axis=1)
        apart = (self.x[four] - middle[:, None]) / np.sqrt(self.area[triangle])[:, None, None]
        place = np.einsum("cki,cai->cka", apart, self.axes[triangle])
        return place[:, :, :2], place[:, :, 2]

    def _targets(self) -> Floats:
        """Energies (t, 6) as `products`: all curvature, but that across a side without a neighbour."""
        every = np.arange(len(self.t))
        corners = self._in_plane(every, self.t)[0]
        weft = np.stack([-self.warp[:, 1], self.warp[:, 0]], axis=1)
        along, across = (_products(_vector(u[:, :, None] * u[:, None])) for u in (self.warp, weft))
        target = SQUARE + self.lean * (along - across)
        for side in range(3):
            edge = corners[:, (side + 1) % 3] - corners[:, side]
            normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
            normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
            left_out = _products(_vector(normal[:, :, None] * normal[:, None]))
            left_out *= _across(self.lean, self.warp, edge)[:, None]
            target -= np.where(self.flaps[:, side : side + 1] < 0, left_out, 0.0)
        return target

    def _ease(self, triangle: Ints, four: Ints) -> Floats:
        """Ease (c,) with which four vertices (c, 4) measure: in a row through a vertex the part of the triangle that is nearest
        to that, so that all rows are alike where triangles are not; at an edge more."""
        corners = self.x[self.t[triangle]]
        square = np.sum((corners[:, [1, 2, 0]] - corners[:, [2, 0, 1]]) ** 2, axis=2)  # of the side that faces each
        facing = square * (square.sum(axis=1, keepdims=True) - 2.0 * square)
        nearest = (facing.sum(axis=1, keepdims=True) - facing) / (32.0 * self.area[triangle][:, None] ** 2)
        inside = (four[:, :, None] == self.t[triangle][:, None]).any(axis=2).sum(axis=1)
        at_edge = (inside == 3) & (four[:, 0] != four[:, 1])
        share = np.where(self.t[triangle] == four[:, :1], np.clip(nearest, LEAST_PART, 1.0), 0.0).sum(axis=1)
        return np.where(at_edge, AT_EDGE, share)

    def _fit(self, k: int, products: Floats, ease: Floats) -> tuple[Floats, float]:
        """Strengths (c,) of what measures products (c, 6) in triangle k, and the part of its energy that they miss."""
        from scipy.optimize import nnls  # slow to import, and few scenes have a mesh

        free = np.stack([DETERMINANT, -DETERMINANT]) if self.number[k] == 3 else np.zeros((0, 6))
        system = np.concatenate([products, free]).T
        least = np.zeros((len(products), system.shape[1]))
        np.fill_diagonal(least, EVENLY / np.sqrt(ease))
        found = nnls(np.concatenate([system, least]), np.append(self.target[k], np.zeros(len(products))))[0]
        return found[: len(products)], float(np.linalg.norm(system @ found - self.target[k]))


def _rows(x: Floats, t: Ints) -> Ints:
    """Rows (r, 4) through vertices of triangles (t, 3): a vertex, one beside the row that takes what it is off, and two of its
    neighbours; where it is straight the vertex itself in place of the second. Each neighbour chooses `PARTNERS` at most, evenly
    from the straightest to the most bent, so that a hub has about so many rows for each neighbour."""
    ends = np.concatenate([t[:, [i, j]] for i, j in itertools.permutations(range(3), 2)])
    ends = np.unique(ends, axis=0)
    count = np.bincount(ends[:, 0], minlength=len(x))
    first = np.append(0, np.cumsum(count))
    found = [np.zeros((0, 4), dtype=np.int64)]
    for valence in np.unique(count[count > 1]):
        vertex = np.flatnonzero(count == valence)
        ring = ends[first[vertex][:, None] + np.arange(valence), 1]
        apart = x[ring] - x[vertex][:, None]
        unit = apart / np.maximum(np.linalg.norm(apart, axis=2, keepdims=True), 1e-300)
        rank = np.arange(valence)
        for a in range(valence):
            cosine = np.einsum("vi,vni->vn", unit[:, a], unit)
            straight = (cosine < -STRAIGHT).sum(axis=1, keepdims=True)
            part = np.maximum(straight, PARTNERS)
            kept = (rank < straight) & (rank * PARTNERS // part > (rank - 1) * PARTNERS // part)
            row, at = np.nonzero(kept)
            c = np.argsort(cosine, axis=1, kind="stable")[row, at]
            line = apart[row, c] - apart[row, a]
            off = np.linalg.norm(np.cross(apart[row], line[:, None]), axis=2)
            bent = off[:, a] > EXACT * np.sum(line * line, axis=1)
            off[:, a] = off[np.arange(len(row)), c] = -1.0
            beside = np.where(bent, ring[row, np.argmax(off, axis=1)], vertex[row])
            use = ~bent | (off.max(axis=1) > 0.0)
            pair = np.sort(np.column_stack([ring[row, a], ring[row, c]]), axis=1)
            found.append(np.column_stack([vertex[row], beside, pair])[use])
    return np.unique(np.concatenate(found), axis=0)


def _canonical(x: Floats, four: Ints) -> Ints:
    """Hinges (h, 4), edge first, as rows where one end of the edge does not count."""
    made = four.copy()
    for inner in (0, 1):
        one, other = x[four[:, 2]] - x[four[:, inner]], x[four[:, 3]] - x[four[:, inner]]
        off = np.linalg.norm(np.cross(one, other), axis=1)
        straight = off <= EXACT * np.sum((other - one) ** 2, axis=1)
        made[straight, 0] = made[straight, 1] = four[straight, inner]
    return made


def _measured(p: Floats, four: Ints) -> tuple[Floats, Floats]:
    """Weights (c, 4) by which vertices (c, 4) at places p (c, 4, 2) measure u : kappa with |u| = 1, and the products (c, 6) of u;
    0 where they measure nothing."""
    weights = np.stack([(-1.0) ** k * _area(p[:, [j for j in range(4) if j != k]]) for k in range(4)], axis=1)
    row = four[:, 0] == four[:, 1]
    ends = np.linalg.norm(p[row, 2:] - p[row, :1], axis=2)
    weights[row, 2:] = 1.0 / ends
    weights[row, :2] = -0.5 * weights[row, 2:].sum(axis=1, keepdims=True)
    u = _vector(0.5 * np.einsum("tk,tka,tkb->tab", weights, p, p))
    size = np.linalg.norm(u, axis=1)
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > LEAST)[:, None]
    return weights * inverse, _products(u * inverse)


def _vector(tensors: Floats) -> Floats:
    """Symmetric tensors (c, 2, 2) as vectors (c, 3) of the same size."""
    return np.stack([tensors[:, 0, 0], tensors[:, 1, 1], ROOT * tensors[:, 0, 1]], axis=1)


def _products(u: Floats) -> Floats:
    """Products (c, 6) of the components of u (c, 3)."""
    return np.stack([(1.0 if i == j else ROOT) * u[:, i] * u[:, j] for i, j in PRODUCTS], axis=1)


def _area(p: Floats) -> Floats:
    """Signed areas (t,) of triangles p (t, 3, 2)."""
    one, two = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    return np.asarray(0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]))


def _as_bends(x: Floats, measures: list[Measures]) -> Bends:
    """Elements whose corners 2 and 3 are far ends of one sign, see `Scene.add_bending`; the same four vertices, whose weights are
    the same up to a factor, are one element."""
    corners, weights, stiffness = (np.concatenate(some) for some in zip(*measures))
    order = np.argsort(corners, axis=1, kind="stable")
    corners, weights = np.take_along_axis(corners, order, axis=1), np.take_along_axis(weights, order, axis=1)
    largest = np.abs(weights).max(axis=1)
    _, once, same = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    corners, weights = corners[once], weights[once] / largest[once, None]
    stiffness = np.bincount(same.ravel(), stiffness * largest**2, minlength=len(once)).astype(np.float64)
    weights[np.abs(weights) < EXACT] = 0.0
    positive = (weights > 0.0).sum(axis=1)
    weights[positive < (weights < 0.0).sum(axis=1)] *= -1.0  # two or three are positive
    two = (weights > 0.0).sum(axis=1) == 2
    apart = np.linalg.norm(x[corners][:, :, None] - x[corners][:, None], axis=3)
    near = apart + np.where((weights[:, :, None] > 0.0) & (weights[:, None] > 0.0), 0.0, np.inf)
    far = apart + np.where((weights[:, :, None] < 0.0) & (weights[:, None] < 0.0), 0.0, np.inf)
    shorter = [np.where(np.isfinite(one), one, 0.0).max(axis=(1, 2)) for one in (near, far)]
    balanced = two & ((weights < 0.0).sum(axis=1) == 2)
    weights[balanced & (shorter[1] > shorter[0])] *= -1.0  # the far ends are further apart than the ends of the hinge
    order = np.argsort(weights, axis=1, kind="stable")  # ends last: the two largest of one sign
    corners, weights = np.take_along_axis(corners, order, axis=1), np.take_along_axis(weights, order, axis=1)
    row = (weights[:, 1] == 0.0) & (weights[:, 0] < 0.0)  # three in a row: the middle one counts twice
    corners[row, 1] = corners[row, 0]
    weights[row, :2] = 0.5 * weights[row, :1]
    return Bends(corners, weights, stiffness)


def corners_of(surface: Surface) -> tuple[NDArray, NDArray, NDArray]:
    """Corners (t, 3) [m] of all triangles, the first of each, the second and the third."""
    a, b, c = (surface.vertices[surface.triangles[:, k]] for k in range(3))
    return a, b, c


def is_thin(a: NDArray, b: NDArray, c: NDArray) -> NDArray[np.bool_]:
    """Triangles (t,) without area, of corners (t, 3) each."""
    longest = np.max([np.sum((p - q) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0, initial=0.0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) <= 1e-6 * longest)


def cotangent(at: NDArray, one: NDArray, other: NDArray) -> NDArray[np.float64]:
    """Cotangents (h,) of the angles at places between the directions to two others."""
    u, v = one - at, other - at
    return np.einsum("hi,hi->h", u, v) / np.linalg.norm(np.cross(u, v), axis=1)
