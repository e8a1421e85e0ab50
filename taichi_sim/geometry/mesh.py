"""Surface meshes: reading them, and the edges and hinges from which springs are made. Imports no Taichi."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.geometry.mesh_file import SUFFIXES, load

PLACES_NAMED = 3  # in a message
THINNEST_TRIANGLE = 1e-6  # twice its area over the square of its longest side: a triangle of less has none


class Surface(NamedTuple):
    """A triangle mesh: vertices (n, 3) m and triangles (t, 3) of vertex indices, counter-clockwise from outside."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]


def read_surface(path: str | os.PathLike[str]) -> Surface:
    """Read an OBJ, PLY, STL, GLB or glTF file; larger polygons become triangles.

    Vertices at the same place become one (an STL file repeats them for each triangle, an OBJ file at texture seams), in
    the order of their first appearance; triangles that this leaves without area and vertices without a triangle go.

    Raises SceneError for a missing or unreadable file, one without faces, one with vertices that are not finite, and
    where the package for reading meshes is not installed.
    """
    file = Path(path)
    if file.suffix.lower() not in SUFFIXES:
        raise SceneError("mesh", file, f"a file that ends in {' '.join(SUFFIXES)}")
    if not file.is_file():
        raise SceneError("mesh", file, says=f"is not there; it must be an existing {file.suffix} file")
    loaded = load(file)
    vertices = np.asarray(getattr(loaded, "vertices", ()), dtype=np.float64)
    faces = np.asarray(getattr(loaded, "faces", ()), dtype=np.int64)
    if faces.size == 0 or vertices.size == 0:
        raise SceneError("mesh", file, says="has no faces; a surface needs at least one triangle")
    wrong = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if wrong.any():
        bad = int(np.argmax(wrong))
        says = f"has face {bad} (from 0) of vertices {faces[bad].tolist()}, and there are {len(vertices)}"
        raise SceneError("mesh", file, says=says)
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise SceneError(
            "mesh", file, says=f"has vertex {bad} (from 0) at {vertices[bad].tolist()}, which is not finite"
        )
    surface = _weld(vertices, faces)
    if not len(surface.triangles):
        raise SceneError("mesh", file, says="has no face with an area; a surface needs at least one triangle")
    return surface


def _weld(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Surface:
    vertices = vertices + 0.0  # no negative zero
    _, first, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    triangles = first[same.reshape(-1)][faces]
    without_area = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    used, compact = np.unique(triangles[~without_area], return_inverse=True)
    return Surface(vertices[used], compact.reshape(-1, 3).astype(np.int32))


def by_hand(where: str, mesh: Any) -> Surface:
    """A mesh that was given as two arrays, checked. Raises SceneError, which begins with `where`."""
    if not isinstance(mesh, (list, tuple)) or len(mesh) != 2:
        raise SceneError(where, mesh, f"a file {' '.join(SUFFIXES)} or (vertices, triangles)")
    vertices = validation.vectors(f"{where}.vertices", mesh[0], None, 3)
    return Surface(vertices, validation.indices(f"{where}.triangles", mesh[1], len(vertices), 3, "vertex"))


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


def hinge_pairs(triangles: NDArray) -> NDArray[np.int32]:
    """The two vertices that face each other across each interior edge, (h, 2): each pair once, lower first, sorted."""
    return np.unique(np.sort(hinges(triangles)[1], axis=1), axis=0).astype(np.int32)


def surface_area(surface: Surface) -> float:
    """Sum of the triangles' areas [m^2]."""
    a, b, c = (surface.vertices[surface.triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def holes(triangles: NDArray) -> NDArray[np.int32]:
    """The edges (k, 2) that do not lie between exactly two triangles which run along them in opposite ways; none: closed."""
    edges = Edges.of(triangles)
    return edges.ends[(edges.triangles != 2) | (edges.forward != 1)]


def flaws(surface: Surface, *, closed: bool = True) -> list[str]:
    """What keeps a mesh from having an inside, one phrase for each kind, with the first few places [m]; none: it is whole.
    Not `closed`: what keeps it from being a sheet, which may have a border and two sides that look alike."""
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
    return [f"{int(which.sum())} {what} ({where(which)})" for which, where, what in found if which.any()]


def _faces(which: NDArray) -> str:
    return _listed([str(k) for k in np.flatnonzero(which)[:PLACES_NAMED]], which)


def _listed(first: list[str], which: NDArray) -> str:
    return ", ".join(first) + (", ..." if which.sum() > PLACES_NAMED else "")


def volume(surface: Surface) -> float:
    """What a closed mesh encloses [m^3]; negative where its triangles face inward."""
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
    """The same of points (n, 2) from the area in 2D that triangles fill: every edge that belongs to one of them only."""
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
