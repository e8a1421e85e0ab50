"""Surface meshes: reading them, and the edges and hinges from which springs are made. Imports no Taichi."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.atomic_file import kind_of
from taichi_sim.common.errors import SceneError, about
from taichi_sim.common.warn import warn
from taichi_sim.geometry.mesh_file import SUFFIXES, load, states_up
from taichi_sim.geometry.polygons import FormatError, triangulated, without_repeats

PLACES_NAMED = 3  # in a message
THINNEST_TRIANGLE = 1e-6  # twice its area over the square of its longest side: a triangle of less has none


UPS = ("y", "z")  # axes of a mesh that may point up
SEAM = 0.01  # of the shortest edge there: vertices at borders that lie so close are one
NEAR = 0.05  # likewise: so close to a border a vertex was meant to lie on it


class Surface(NamedTuple):
    """A triangle mesh: vertices (n, 3) m and triangles (t, 3) of vertex indices, counter-clockwise from outside."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float64] | None = None  # (t, 3, 2) places of their corners on a texture, v upward


def read_surface(path: str | os.PathLike[str]) -> Surface:
    """Read an OBJ, PLY, STL, GLB or glTF file; larger polygons become triangles.

    Vertices at the same place become one (an STL file repeats them for each triangle, an OBJ file at texture seams), in
    the order of their first appearance, and so do vertices at borders that lie within a hundredth of their shortest edge of
    each other; triangles that this leaves without area and vertices without a triangle go. It warns of polygons that cross
    themselves.

    Raises SceneError for a missing or unreadable file, one without faces, and one with vertices that are not finite.
    """
    file = Path(path)
    if file.suffix.lower() not in SUFFIXES:
        raise SceneError("mesh", file, f"a file that ends in {' '.join(SUFFIXES)}")
    if (kind := kind_of(file)) != "file":
        says = f"is a {kind}, and no file" if kind else f"is not there; it must be an existing {file.suffix} file"
        raise SceneError("mesh", file, says=says)
    polygons = load(file)
    vertices, counts = polygons.vertices + 0.0, polygons.counts  # no negative zero
    if not (counts >= 3).any() or not len(vertices):
        raise SceneError("mesh", file, says="has no faces; a surface needs at least one triangle")
    wrong = (polygons.corners < 0) | (polygons.corners >= len(vertices))
    if wrong.any():
        ends = np.cumsum(counts)
        bad = int(np.searchsorted(ends, np.argmax(wrong), side="right"))
        face = polygons.corners[ends[bad] - counts[bad] : ends[bad]].tolist()
        says = f"has face {bad} (from 0) of vertices {face}, and there are {len(vertices)}"
        raise SceneError("mesh", file, says=says)
    finite = (np.abs(vertices) <= validation.MOST_MAGNITUDE).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        why = "too far away" if np.isfinite(vertices[bad]).all() else "not finite"
        raise SceneError("mesh", file, says=f"has vertex {bad} (from 0) at {vertices[bad].tolist()}, which is {why}")
    _, first, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    corners = first[same.reshape(-1)][polygons.corners]
    kept, counts = without_repeats(corners, counts)
    try:
        cut, crossing = triangulated(vertices, corners[kept], counts)
    except FormatError as error:
        raise SceneError("mesh", file, says=f"cannot be divided into triangles: {error}") from None
    if len(crossing):
        warn(
            f"mesh: {os.fspath(file)!r} has {len(crossing)} polygons that cross themselves, the first at"
            f" {vertices[corners[kept][counts[: crossing[0]].sum()]].tolist()}; mend the mesh, if that matters"
        )
    uv = None if polygons.uv is None else np.nan_to_num(polygons.uv[kept][cut])
    surface = _compact(vertices, corners[kept][cut], uv)
    surface = _compact(surface.vertices, _sewn(surface), surface.uv)
    if not len(surface.triangles):
        raise SceneError("mesh", file, says="has no face with an area; a surface needs at least one triangle")
    return surface


def _compact(vertices: NDArray, triangles: NDArray, uv: NDArray | None) -> Surface:
    """Triangles of three vertices, and the vertices that they have, in their order."""
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    used, compact = np.unique(triangles[whole], return_inverse=True)
    return Surface(vertices[used], compact.reshape(-1, 3).astype(np.int32), None if uv is None else uv[whole])


def _tree(points: NDArray) -> Any:
    """A search tree, of a package that is slow to import."""
    from scipy.spatial import cKDTree

    return cKDTree(points)


def _sewn(surface: Surface) -> NDArray:
    """The triangles with one vertex in place of several at borders that lie close to each other."""
    x, triangles = surface.vertices, surface.triangles
    border, shortest = _border(surface)
    at = np.unique(border)
    reach = SEAM * shortest[at]
    pairs = _tree(x[at]).query_pairs(reach.max(), output_type="ndarray") if len(at) else np.zeros((0, 2), dtype=int)
    apart = np.linalg.norm(x[at[pairs[:, 0]]] - x[at[pairs[:, 1]]], axis=1)
    pairs = pairs[apart <= reach[pairs].min(axis=1)]
    one = np.arange(len(x))
    low, high = np.sort(at[pairs], axis=1).T
    for _ in range(len(pairs)):  # as a rule two rounds
        before = one.copy()
        np.minimum.at(one, high, one[low])
        np.minimum.at(one, low, one[high])
        if np.array_equal(before, one):
            break
    return one[triangles]


def _border(surface: Surface) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The edges (b, 2) that one triangle has alone, and the shortest edge (n,) at each vertex [m]."""
    edges = Edges.of(surface.triangles)
    ends = surface.vertices[edges.ends]
    shortest = np.full(len(surface.vertices), np.inf)
    np.minimum.at(shortest, edges.ends.ravel(), np.repeat(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 2))
    return edges.ends[edges.triangles == 1], shortest


def loose_seams(surface: Surface) -> NDArray[np.int64]:
    """The vertices (k,) at a border that lie at another piece of the border which does not share them: a seam that is open."""
    x = surface.vertices
    border, shortest = _border(surface)
    if not len(border):
        return np.zeros(0, dtype=np.int64)
    at = np.unique(border)
    a, b = x[border[:, 0]], x[border[:, 1]]
    length = np.linalg.norm(b - a, axis=1)
    near = _tree(x[at]).query_ball_point(0.5 * (a + b), (0.5 + NEAR) * length)
    edge = np.repeat(np.arange(len(border)), [len(one) for one in near])
    vertex = at[np.concatenate([np.array(one, dtype=np.int64) for one in near])]
    other = (vertex[:, None] != border[edge]).all(axis=1)
    edge, vertex = edge[other], vertex[other]
    along, to = b[edge] - a[edge], x[vertex] - a[edge]
    square = np.maximum(np.einsum("ei,ei->e", along, along), 1e-300)
    share = np.clip(np.einsum("ei,ei->e", along, to) / square, 0.0, 1.0)
    reach = NEAR * np.minimum(shortest[vertex], length[edge])
    return np.unique(vertex[np.linalg.norm(to - share[:, None] * along, axis=1) <= reach])


def given_surface(where: str, mesh: Any, up: str | None = None) -> Surface:
    """The surface that an argument `mesh` of `where` names, or is, with y up.

    up: its axis that points up, "y" or "z"; None: y, with a warning for a file that does not tell. Raises SceneError.
    """
    if up is not None:
        validation.one_of(f"{where}.up", up, UPS)
    if isinstance(mesh, (str, os.PathLike)):
        with about(f"{where}.mesh"):
            surface = read_surface(mesh)
            if up is None and not states_up(Path(mesh)):
                kind = Path(mesh).suffix[1:].upper()
                warn(
                    f"{where}.mesh: {os.fspath(mesh)!r} is read with y up, but {kind} files do not tell which axis is up, and"
                    ' many programs write z; give up = "z", or up = "y" if it lies right'
                )
    else:
        surface = by_hand(f"{where}.mesh", mesh)
        if not len(surface.triangles):
            raise SceneError(f"{where}.mesh", says="has no triangle")
    if up == "z":
        surface = surface._replace(vertices=surface.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0] + 0.0)
    return surface


def by_hand(where: str, mesh: Any) -> Surface:
    """A mesh that was given as two arrays, checked. Raises SceneError, which begins with `where`."""
    uv = mesh.uv if isinstance(mesh, Surface) else None
    if not isinstance(mesh, Surface) and (not isinstance(mesh, (list, tuple)) or len(mesh) != 2):
        raise SceneError(where, mesh, f"a file {' '.join(SUFFIXES)} or (vertices, triangles)")
    vertices = validation.vectors(f"{where}.vertices", mesh[0], None, 3)
    return Surface(vertices, validation.indices(f"{where}.triangles", mesh[1], len(vertices), 3, "vertex"), uv)


def sides(triangles: NDArray) -> NDArray:
    """The sides (3 t, 2) of triangles (t, 3), each as its triangle runs along it: first all a-b, then b-c, then c-a."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


class Edges(NamedTuple):
    """The edges of triangles (t, 3), each once, lower vertex first, sorted."""

    ends: NDArray[np.int32]  # (e, 2)
    of_side: NDArray[np.int64]  # (3 t,) the edge that each of the `sides` is
    triangles: NDArray[np.int64]  # (e,) how many triangles meet there
    forward: NDArray[np.int64]  # (e,) those of them that run from its lower vertex to its higher one

    @classmethod
    def of(cls, triangles: NDArray) -> "Edges":
        """All edges of triangles (t, 3)."""
        side = sides(np.asarray(triangles).reshape(-1, 3))
        ends, of_side, count = np.unique(np.sort(side, axis=1), axis=0, return_inverse=True, return_counts=True)
        of_side = of_side.reshape(-1)
        forward = np.bincount(of_side[side[:, 0] < side[:, 1]], minlength=len(ends))
        return cls(ends.astype(np.int32), of_side, count, forward)


def unique_edges(triangles: NDArray) -> NDArray[np.int32]:
    """The edges (e, 2) of triangles (t, 3): each once, lower vertex first, sorted."""
    return Edges.of(triangles).ends


def hinges(triangles: NDArray) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The edges (h, 2) that exactly two triangles share, and the two vertices (h, 2) that face each other across them.

    Where three or more triangles meet there is no single hinge. The edges are sorted, lower vertex first.
    """
    edges, opposite = Edges.of(triangles), triangles[:, [2, 0, 1]].T.ravel()
    inner = edges.triangles[edges.of_side] == 2
    by_edge = np.argsort(edges.of_side[inner], kind="stable")
    facing = opposite[inner][by_edge].reshape(-1, 2)
    two = facing[:, 0] != facing[:, 1]  # a triangle that is there twice is no hinge
    return edges.ends[edges.triangles == 2][two], facing[two].astype(np.int32)


def surface_area(surface: Surface) -> float:
    """Sum of the triangles' areas [m^2]."""
    a, b, c = (surface.vertices[surface.triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def holes(triangles: NDArray) -> NDArray[np.int32]:
    """The edges (k, 2) that do not lie between exactly two triangles which run along them in opposite ways; none: closed."""
    edges = Edges.of(triangles)
    return edges.ends[(edges.triangles != 2) | (edges.forward != 1)]


def flaws(surface: Surface, *, closed: bool = True) -> list[str]:
    """Flaws that keep a mesh from having an inside, one phrase for each kind, with the first few places [m]; none: it is
    whole. Not `closed`: those that keep it from being a sheet, which may have a border and two sides that look alike."""
    t, x = surface.triangles, surface.vertices
    if not len(t):
        return ["it has no triangle"]
    edges, _, count, forward = Edges.of(t)
    _, first, times = np.unique(np.sort(t, axis=1), axis=0, return_index=True, return_counts=True)
    a, b, c = (x[t[:, k]] for k in range(3))
    longest = np.max([np.sum((p - q) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    thin = np.linalg.norm(np.cross(b - a, c - a), axis=1) <= THINNEST_TRIANGLE * longest

    def at_edges(which: NDArray) -> str:
        return _listed(
            [f"{i}-{j} at {x[[i, j]].mean(axis=0).round(4).tolist()}" for i, j in edges[which][:PLACES_NAMED]], which
        )

    found = (
        ((count == 1) & closed, at_edges, "edges have a triangle on one side only"),
        (count > 2, at_edges, "edges have more than two triangles"),
        ((count == 2) & (forward != 1) & closed, at_edges, "edges lie between triangles that face opposite ways"),
        (np.isin(np.arange(len(t)), first[times > 1]), _faces, "triangles are there more than once"),
        (thin, _faces, "triangles have next to no area"),
    )
    said = [f"{int(which.sum())} {what} ({where(which)})" for which, where, what in found if which.any()]
    seams = np.zeros(0, dtype=np.int64) if closed else loose_seams(surface)
    if len(seams):
        first_few = ", ".join(f"{k} at {x[k].round(4).tolist()}" for k in seams[:PLACES_NAMED].tolist())
        more = ", ..." if len(seams) > PLACES_NAMED else ""
        said.append(
            f"{len(seams)} vertices touch triangles that do not share them, so it comes apart there ({first_few}{more})"
        )
    return said


def _faces(which: NDArray) -> str:
    return _listed([str(k) for k in np.flatnonzero(which)[:PLACES_NAMED]], which)


def _listed(first: list[str], which: NDArray) -> str:
    return ", ".join(first) + (", ..." if which.sum() > PLACES_NAMED else "")


def volume(surface: Surface) -> float:
    """Volume that a closed mesh encloses [m^3]; negative where its triangles face inward."""
    origin = surface.vertices.mean(axis=0)  # of a mesh far out the products would cancel
    a, b, c = (surface.vertices[surface.triangles[:, k]] - origin for k in range(3))
    return float(np.sum(a * np.cross(b, c))) / 6.0


def mesh_distance(surface: Surface, points: NDArray, far: float = np.inf) -> NDArray[np.float64]:
    """Signed distance (n,) [m] of points (n, 3) from a closed mesh, negative inside: every triangle for every point."""
    corners = surface.vertices[surface.triangles]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    result = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)  # at least so far
    near = np.flatnonzero(result < far)
    for part in np.array_split(near, max(1, len(near) * len(corners) // 2_000_000)):
        p = points[part][:, None]
        a, b, c = (corners[None, :, k] - p for k in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
        volume = np.einsum("pti,pti->pt", a, np.cross(b, c))
        dots = [np.einsum("pti,pti->pt", u, v) for u, v in ((a, b), (b, c), (c, a))]
        solid = 2.0 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
        inside = np.abs(solid.sum(axis=1)) > 2.0 * np.pi  # the winding number, 0 or 1, against 1/2
        normal = np.cross(b - a, c - a)
        area = np.linalg.norm(normal, axis=2)
        d = np.full(area.shape, np.inf)
        over = area > 0
        for u, v in ((a, b), (b, c), (c, a)):
            e = v - u
            square = np.maximum(np.einsum("pti,pti->pt", e, e), 1e-300)
            t = np.clip(-np.einsum("pti,pti->pt", u, e) / square, 0.0, 1.0)
            d = np.minimum(d, np.linalg.norm(u + t[..., None] * e, axis=2))
            over = over & (np.einsum("pti,pti->pt", np.cross(e, -u), normal) >= 0)
        height = np.abs(np.einsum("pti,pti->pt", a, normal)) / np.maximum(area, 1e-300)
        nearest = np.where(over, np.minimum(d, height), d).min(axis=1)
        result[part] = np.where(inside, -nearest, nearest)
    return result


def area_distance(area: Surface, points: NDArray) -> NDArray[np.float64]:
    """Signed distance (n,) [m] of points (n, 2) from the area in 2D that triangles fill, negative inside. Its border is
    every edge that belongs to one of them only."""
    edges = Edges.of(area.triangles)
    a, b = (area.vertices[edges.ends[edges.triangles == 1, k]][None] for k in range(2))
    p, e = points[:, None], b - a
    t = np.clip(np.sum((p - a) * e, axis=2) / np.sum(e * e, axis=2), 0.0, 1.0)
    d = np.linalg.norm(p - a - t[..., None] * e, axis=2).min(axis=1)
    corners = area.vertices[area.triangles][None]
    sides = np.stack([_side(corners[:, :, k - 1], corners[:, :, k], p) for k in range(3)])
    inside = np.any(np.all(sides >= 0.0, axis=0) | np.all(sides <= 0.0, axis=0), axis=1)
    return np.where(inside, -d, d)


def _side(a: NDArray, b: NDArray, p: NDArray) -> NDArray[np.float64]:
    """Positive where p lies to the left of the way from a to b, in 2D."""
    return (b - a)[..., 0] * (p - a)[..., 1] - (b - a)[..., 1] * (p - a)[..., 0]
