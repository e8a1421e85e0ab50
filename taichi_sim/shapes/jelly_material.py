"""Bodies of an elastic material: boxes of a lattice, and meshes of tetrahedra, in 2D triangles. Imports no Taichi."""

from __future__ import annotations

import importlib.util
import itertools
import subprocess
import sys
import tempfile
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.geometry.mesh import Surface
from taichi_sim.scene.bricks import rates_at_rest
from taichi_sim.scene.cells import cell_volumes
from taichi_sim.scene.solids import averages, rates_of
from taichi_sim.shapes.base import Bricks, Solids

__all__ = [
    "Boxes",
    "Simplices",
    "box_cells",
    "box_surface",
    "boxes_in",
    "connected",
    "inside",
    "lattice",
    "simplices",
    "skin_of_boxes",
    "skin_of_tetrahedra",
    "surface_of",
    "tetrahedra",
]

ENVELOPE = (
    0.1  # of the spacing, how far tetrahedra may leave a surface: nearer ones are thin and many, and the skin hides it
)
NEAR = 32  # tetrahedra that are looked at for each vertex of a skin
CROSSING: dict[
    int, tuple[tuple[tuple[int, ...], ...], ...]
] = {  # the corners of the cells in a box, all of positive volume
    2: (((0, 0), (1, 0), (1, 1)), ((1, 0), (1, 1), (0, 1)), ((1, 1), (0, 1), (0, 0)), ((0, 1), (0, 0), (1, 0))),
    3: (((0, 0, 0), (1, 1, 0), (0, 1, 1), (1, 0, 1)), ((1, 1, 1), (0, 1, 0), (1, 0, 0), (0, 0, 1))),
}

# fTetWild in a process and a folder of its own: some meshes end its process, and it leaves a file where it runs
FILL = """
import numpy, pytetwild
with numpy.load("surface.npz") as given:
    points, cells = pytetwild.tetrahedralize(**{name: one if one.ndim else float(one) for name, one in given.items()})
numpy.savez("filled.npz", points=points, cells=cells)
"""


class Boxes(NamedTuple):
    """A body of bricks, all with the same sides."""

    points: NDArray[np.float64]  # (n, dim) m
    volume: NDArray[np.float64]  # (n,) m^dim, of each point
    triangles: NDArray[np.int64]  # (t, 3) the surface; none in 2D
    bricks: NDArray[np.int64]  # (b, 2^dim)
    size: NDArray[np.float64]  # (dim,) m

    @property
    def side(self) -> float:
        """Distance [m] of neighbouring balls."""
        return float(np.prod(self.size)) ** (1 / len(self.size))

    def rate(self, masses: NDArray, ratio: float) -> float:
        """Largest eigenvalue of M^-1 K [1/s^2] for a modulus of 1."""
        density = float(masses.sum() / self.volume.sum())
        return rates_at_rest(self.size, 1.0, ratio)[0] / (density / 2 ** len(self.size))

    def elements(self, young_modulus: float, poisson_ratio: float, viscosity: float) -> dict[str, Any]:
        """Elements of a shape, by their name."""
        return {"bricks": Bricks(self.bricks, young_modulus, poisson_ratio, viscosity, self.size)}

    @property
    def area(self) -> NDArray[np.int64]:
        """Triangles (t, 3) that fill it in 2D, counter-clockwise."""
        return np.concatenate([self.bricks[:, corners] for corners in ((0, 2, 3), (0, 3, 1))])


class Simplices(NamedTuple):
    """A body of tetrahedra, in 2D of triangles."""

    points: NDArray[np.float64]  # (n, dim) m
    volume: NDArray[np.float64]  # (n,) m^dim, of each point
    triangles: NDArray[np.int64]  # (t, 3) the surface; none in 2D
    cells: NDArray[np.int64]  # (c, dim + 1), of positive volume

    @property
    def side(self) -> float:
        """Mean distance [m] of neighbouring balls."""
        return float(self.volume.mean()) ** (1 / self.points.shape[1])

    def rate(self, masses: NDArray, ratio: float) -> float:
        """Largest eigenvalue of M^-1 K [1/s^2] for a modulus of 1."""
        each = np.ones(len(self.cells))
        at = averages(self.cells, cell_volumes(self.points, self.cells), each, ratio * each, 0.0 * each)
        return rates_of(self.points[self.cells], masses, at)[0]

    def elements(self, young_modulus: float, poisson_ratio: float, viscosity: float) -> dict[str, Any]:
        """Elements of a shape, by their name."""
        return {"solids": Solids(self.cells, young_modulus, poisson_ratio, viscosity)}

    @property
    def area(self) -> NDArray[np.int64]:
        """Triangles (t, 3) that fill it in 2D, counter-clockwise."""
        return self.cells


# Lattices ----------------------------------------------------------------------------------------------------------


def lattice(filled: NDArray[np.bool_], spacing: NDArray[np.float64]) -> Boxes:
    """Those boxes of a lattice, `filled` (a, b[, c]), that belong to a body. spacing: (dim,) m."""
    dim, first = filled.ndim, np.argwhere(filled)
    number = tuple(n + 1 for n in filled.shape)
    corners = itertools.product((0, 1), repeat=dim)
    places = np.stack([np.ravel_multi_index(tuple((first + c).T), number) for c in corners], axis=1)
    used, bricks = np.unique(places, return_inverse=True)
    bricks = bricks.reshape(places.shape)
    return Boxes(
        np.stack(np.unravel_index(used, number), axis=1) * spacing,
        np.bincount(bricks.ravel()) * float(np.prod(spacing)) / 2**dim,
        np.searchsorted(used, box_surface(filled)) if dim == 3 else np.zeros((0, 3), dtype=np.int64),
        bricks,
        spacing,
    )


def box_cells(
    filled: NDArray[np.bool_], spacing: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], float, NDArray[np.int64] | None]:
    """Cells of the boxes of a lattice that are filled, of points that count along the last axis fastest: corners (c, dim + 1),
    volumes (c,) [m^dim], the share of a modulus in each, since they cross, and which act together."""
    dim, first = filled.ndim, np.argwhere(filled)
    number = tuple(n + 1 for n in filled.shape)
    places = [[np.ravel_multi_index(tuple((first + c).T), number) for c in corners] for corners in CROSSING[dim]]
    cells = np.concatenate([np.stack(four, axis=1) for four in places])
    volume = np.full(len(cells), float(np.prod(spacing)) / (3 if dim == 3 else 2))
    if dim == 3:
        return cells, volume, 1.5, None
    return cells, volume, 0.5, np.tile(np.arange(len(first)), len(CROSSING[2]))


def _averaged(values: NDArray, axis: int) -> NDArray:
    """Means of both sides at the n + 1 planes between n layers, with nothing beyond the ends."""
    wide = np.pad(values, [(1, 1) if k == axis else (0, 0) for k in range(values.ndim)])
    ends = [slice(None)] * values.ndim
    lower, upper = list(ends), list(ends)
    lower[axis], upper[axis] = slice(None, -1), slice(1, None)
    return 0.5 * (wide[tuple(lower)] + wide[tuple(upper)])


def box_surface(filled: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The triangles (t, 3) between boxes of a 3D lattice that are filled and others, counter-clockwise from outside."""
    number = tuple(n + 1 for n in filled.shape)
    index = np.arange(int(np.prod(number))).reshape(number)
    triangles = []
    for axis in range(3):
        # with the axes (axis, axis + 1, axis + 2) in cyclic order, the far side's outward normal is first x second
        order = (axis, (axis + 1) % 3, (axis + 2) % 3)
        layers, solid = np.moveaxis(index, order, (0, 1, 2)), np.moveaxis(filled, order, (0, 1, 2))
        wide = np.pad(solid, ((1, 1), (0, 0), (0, 0)))
        for outward, border in ((True, wide[:-1] & ~wide[1:]), (False, wide[1:] & ~wide[:-1])):
            plane, b, c = np.nonzero(border)
            four = [layers[plane, b + u, c + v] for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))]
            for three in ((0, 1, 2), (0, 2, 3)):
                turned = three if outward else three[::-1]
                triangles.append(np.stack([four[k] for k in turned], axis=1))
    return np.concatenate(triangles)


# Meshes ------------------------------------------------------------------------------------------------------------


def boxes_in(surface: Surface, step: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Lowest corner (3,) [m] of the lattice of boxes with sides of `step` metres around a mesh, and the mask (a, b, c) of those
    that fill it."""
    extent = np.ptp(surface.vertices, axis=0)
    number = np.maximum(1, np.ceil(extent / step - 1e-9))
    low = surface.vertices.min(axis=0) - 0.5 * (number * step - extent)
    return low, connected(inside(surface, low, step, tuple(int(n) for n in number)))


def inside(surface: Surface, low: NDArray, spacing: float, number: tuple[int, ...]) -> NDArray[np.bool_]:
    """Mask (a, b, c) of the boxes of a lattice that have their centre inside a mesh; box 0 begins at `low` (3,) m.

    Rays through the centres along each axis count the triangles that they leave and enter through; two axes of three decide,
    so that a hole or a wrong face here and there does no harm.
    """
    edges = np.concatenate([surface.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    turned = len(np.unique(edges, axis=0)) < len(edges)  # faces that do not agree: count crossings alone
    votes = np.zeros(number, dtype=np.int8)
    for axis in range(3):
        order = ((axis + 1) % 3, (axis + 2) % 3, axis)
        corners = ((surface.vertices - low) / spacing)[surface.triangles][:, :, order]
        count = _crossings(corners, tuple(number[k] for k in order), turned)
        votes += np.moveaxis(count % 2 == 1 if turned else count != 0, (0, 1, 2), order)
    return votes >= 2


def _crossings(corners: NDArray, number: tuple[int, ...], turned: bool) -> NDArray[np.int64]:
    """Number of times that the ray upward from each box's centre leaves the triangles `corners` (t, 3, 3), less the number
    of times that it enters."""
    shift = np.array([1.4142e-5, 1.7321e-5])  # no ray meets an edge of a mesh made of round numbers
    a, b, c = (corners[:, k, :2] - 0.5 + shift for k in range(3))
    low = np.clip(np.ceil(np.minimum(np.minimum(a, b), c)), 0, number[:2]).astype(np.int64)
    high = np.clip(np.floor(np.maximum(np.maximum(a, b), c)) + 1, 0, number[:2]).astype(np.int64)
    wide = np.maximum(high - low, 0)
    many = wide.prod(axis=1)
    face = np.repeat(np.arange(len(corners)), many)
    place = np.arange(len(face)) - np.repeat(np.cumsum(many) - many, many)
    ray = low[face] + np.stack(np.divmod(place, np.maximum(wide[face, 1], 1)), axis=1)

    def cross(u: NDArray, v: NDArray) -> NDArray:
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

    area = cross(b - a, c - a)[face]
    a, b, c = a[face] - ray, b[face] - ray, c[face] - ray
    shares = np.stack([cross(b, c), cross(c, a), cross(a, b)]) * np.sign(area)
    hit = (shares > 0).all(axis=0)
    face, ray, shares, area = face[hit], ray[hit], shares[:, hit], area[hit]
    height = np.einsum("kf,fk->f", shares, corners[face, :, 2]) / np.abs(area)
    below = np.clip(np.ceil(height - 0.5), 0, number[2]).astype(np.int64)  # centres under the crossing
    steps = np.zeros((*number[:2], number[2] + 1), dtype=np.int64)
    np.add.at(steps, (ray[:, 0], ray[:, 1], below), 1 if turned else np.sign(area).astype(np.int64))
    return np.cumsum(steps[:, :, :0:-1], axis=2)[:, :, ::-1]


def connected(filled: NDArray[np.bool_], least: float = 0.02) -> NDArray[np.bool_]:
    """Mask of the boxes that hang together by their faces, without crumbs smaller than `least` of the largest piece."""
    from scipy.ndimage import label

    names, _ = label(filled)
    sizes = np.bincount(names.ravel())
    sizes[0] = 0
    return (sizes >= max(1, least * sizes.max(initial=0)))[names]


def tetrahedra(where: str, surface: Surface, edge: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points (n, 3) m and tetrahedra (c, 4), of positive volume and about `edge` m long, that fill a closed mesh (fTetWild)."""
    if importlib.util.find_spec("pytetwild") is None:
        says = 'tetrahedra need one more package: pip install "taichi-sim[mesh]"; or use fill = "voxels"'
        raise SceneError(f"{where}.fill", says=says)
    size, low = float(np.ptp(surface.vertices, axis=0).max()), surface.vertices.min(axis=0)
    unit = (surface.vertices - low) / size  # what is very small ends it without a word
    edge = edge / size
    across = float(np.linalg.norm(np.ptp(unit, axis=0)))
    with tempfile.TemporaryDirectory() as folder:
        np.savez(
            f"{folder}/surface.npz",
            vertices=unit,
            faces=surface.triangles,
            edge_length_abs=edge,
            epsilon=ENVELOPE * edge / across,
        )
        done = subprocess.run([sys.executable, "-c", FILL], cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            why = (done.stderr.strip().splitlines() or [f"fTetWild ended with status {done.returncode}"])[-1]
            raise SceneError(f"{where}.mesh", says=f'cannot be filled with tetrahedra: {why}; use fill = "voxels"')
        with np.load(f"{folder}/filled.npz") as filled:
            points, cells = filled["points"].astype(np.float64) * size + low, filled["cells"].astype(np.int64)
    if not len(cells):
        raise SceneError(f"{where}.mesh", says='no tetrahedron fits into it; use fill = "voxels", or a smaller spacing')
    used, new = np.unique(cells, return_inverse=True)
    points, compact = points[used], new.reshape(-1, 4).astype(np.int32)
    turned = cell_volumes(points, compact) < 0
    return points, np.where(turned[:, None], compact[:, [1, 0, 2, 3]], compact).astype(np.int64)


def simplices(points: NDArray[np.float64], cells: NDArray[np.int64]) -> Simplices:
    """Body of tetrahedra (c, 4), in 2D of triangles (c, 3), of positive volume, with points (n, dim) [m]."""
    corners = cells.shape[1]
    volume = np.repeat(cell_volumes(points, cells) / corners, corners)
    each: NDArray = np.bincount(cells.ravel(), volume, minlength=len(points))
    return Simplices(points, each, surface_of(cells) if corners == 4 else np.zeros((0, 3), dtype=np.int64), cells)


def surface_of(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """The triangles (t, 3) that one tetrahedron of positive volume alone has, counter-clockwise from outside."""
    faces = np.concatenate([cells[:, three] for three in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


# Skins -------------------------------------------------------------------------------------------------------------


def skin_of_boxes(filled: NDArray[np.bool_], places: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The points (v, 8) of `lattice(filled)`, and their weights, that vertices at `places` (v, 3), in boxes, follow.

    The box around a vertex, or the nearest filled one, moves it trilinearly.
    """
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~filled, return_distances=False, return_indices=True)
    box = np.clip(np.floor(places).astype(np.int64), 0, np.array(filled.shape) - 1)
    box = nearest[:, box[:, 0], box[:, 1], box[:, 2]].T
    t = places - box
    corners = np.array(list(itertools.product((0, 1), repeat=3)))
    weights = np.where(corners[None] == 1, t[:, None], 1.0 - t[:, None]).prod(axis=2)
    number = tuple(n + 1 for n in filled.shape)
    part = filled.astype(np.float64)
    for axis in range(3):
        part = _averaged(part, axis)
    new = np.cumsum(part.ravel() > 0) - 1
    points = np.ravel_multi_index(tuple(np.moveaxis(box[:, None] + corners, 2, 0)), number)
    return new[points], weights


def skin_of_tetrahedra(
    points: NDArray, cells: NDArray, vertices: NDArray
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The points (v, 4), and their weights, that `vertices` (v, 3) follow: of the tetrahedron around each, or the nearest."""
    from scipy.spatial import cKDTree

    near = cKDTree(points[cells].mean(axis=1)).query(vertices, k=min(NEAR, len(cells)))[1].reshape(len(vertices), -1)
    back = np.linalg.inv(np.swapaxes(points[cells[:, 1:]] - points[cells[:, :1]], 1, 2))
    shares = np.einsum("vkij,vkj->vki", back[near], vertices[:, None] - points[cells[near, 0]])
    shares = np.concatenate([1.0 - shares.sum(axis=2, keepdims=True), shares], axis=2)
    best = np.argmax(shares.min(axis=2), axis=1)
    rows = np.arange(len(vertices))
    return cells[near[rows, best]], shares[rows, best]
