"""Solids: tetrahedra, in 2D triangles, of an elastic material, whose strains are averaged at the balls."""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.scene.cells import cell_volumes
from taichi_sim.scene.columns import Column
from taichi_sim.scene.neo_hookean import CANCELLING, STRETCHED, columns, density, lame
from taichi_sim.scene.part import Columns, Element

__all__ = ["OWN_SHARE", "SOLIDS", "Averages", "SolidMethods", "averages", "operators", "rates_of", "shape_gradients"]

Floats = NDArray[np.float64]
OWN_SHARE = 0.2  # of the shear modulus, with which an element resists a strain of its own beside the averaged ones
FLAT = 1e-9  # of its longest edge to the power dim: an element of less volume is flat
CLOSE, MARGIN = 0.01, 1.02  # relative error of eigenvalues, which are found from below, and what makes up for it


class SolidMethods:
    """The part of a Scene that holds solids."""

    solids = Column("solids", "corners", "(e, dim + 1) balls of each element", ("dim + 1",), np.int32)
    solid_modulus = Column("solids", "young_modulus", "(e,) Pa, in 2D N/m")
    solid_ratio = Column("solids", "poisson_ratio", "(e,) 1")
    solid_viscosity = Column("solids", "viscosity", "(e,) Pa s, in 2D N s/m")
    solid_rest = Column("solids", "rest", "(e, dim + 1, dim) m, its corners at rest", ("dim + 1", "dim"))

    def add_solids(
        self: Any,
        corners: ArrayLike,
        *,
        young_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        viscosity: ArrayLike = 0.0,
        rest: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Add e tetrahedra, in 2D triangles, of an elastic material and return their indices, shape (e,).

        The material is neo-Hookean, and drives an element that is turned inside out back. Its strain is averaged over the
        elements at each ball, so that meshes bend as they should and keep their volume, at all ratios. Where materials meet in a
        ball, their mean holds there.

        Args:
            corners: (e, dim + 1) balls, or one element, in any order.
            young_modulus: one or one per element, > 0 [Pa, in 2D N/m].
            poisson_ratio: one or one per element, 0 to 0.4999 (in 2D 0.9996) [1]. In 2D both are those of a sheet in its plane,
                see add_bricks.
            viscosity: one or one per element, >= 0 [Pa s, in 2D N s/m]: the stress by which a rate of strain is resisted, as a
                viscous liquid's.
            rest: (e, dim + 1, dim) corners at rest [m], of positive volume; None: the present ones.
        """
        dim = self.dim
        ij = validation.corners("solids.corners", corners, self.n_balls, dim + 1)
        e = len(ij)
        if rest is None:
            turned = cell_volumes(self.position, ij) < 0
            ij[turned] = ij[turned][:, [1, 0, *range(2, dim + 1)]]
            places = self.position[ij]
        else:
            places = validation.rows_of_vectors("solids.rest", rest, e, dim + 1, dim)
        sides = places[:, 1:] - places[:, :1]
        has_volume = np.linalg.det(sides) > FLAT * np.abs(sides).max(axis=(1, 2), initial=0.0) ** dim
        says = "is flat now; give its rest" if rest is None else "has no volume at rest, or corners in another order"
        validation.require("solids.corners", ij, has_volume, says=says)
        material = columns("solids", e, dim, young_modulus, poisson_ratio, viscosity)
        return self.tables["solids"].append(e, corners=ij, rest=places, **material)  # type: ignore[no-any-return]


def shape_gradients(rest: Floats) -> tuple[Floats, Floats]:
    """Gradients (e, k, dim) [1/m] of the linear functions that are 1 at a corner, and volumes (e,) [m^dim], at rest."""
    edges = np.swapaxes(rest[:, 1:] - rest[:, :1], 1, 2)
    inverse = np.linalg.inv(edges)
    volume = np.linalg.det(edges) / math.factorial(edges.shape[1])
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1), volume


class Averages(NamedTuple):
    """Means of elements at each of their balls, weighted by their volumes."""

    balls: NDArray[np.int64]  # (b,) those that are a corner
    places: NDArray[np.int64]  # (e, dim + 1) the corners as numbers in `balls`
    mu: Floats  # (b,) Pa, in 2D N/m
    lam: Floats  # (b,) the same
    viscosity: Floats  # (b,) Pa s, in 2D N s/m
    own: Floats  # (b,) Pa, in 2D N/m, see `density_of`


def averages(corners: NDArray, volume: Floats, modulus: Floats, ratio: Floats, viscosity: Floats) -> Averages:
    """Averages of elements with these corners (e, dim + 1), of e volumes, moduli, ratios and viscosities."""
    balls, places = np.unique(corners, return_inverse=True)
    places = places.reshape(corners.shape)
    mu, lam = lame(corners.shape[1] - 1, modulus, ratio)
    mean, first, loss = (_mean(places, volume, of, len(balls)) for of in (mu, lam, viscosity))
    return Averages(balls, places, mean, first, loss, OWN_SHARE * mean)


def _mean(places: NDArray, volume: Floats, of: Floats, count: int) -> Floats:
    """Means (count,) at the balls of values (e,) of elements; 0 where there are none."""
    k = places.shape[1]
    whole = np.bincount(places.ravel(), np.repeat(volume, k), count)
    total = np.bincount(places.ravel(), np.repeat(volume * of, k), count)
    return np.divide(total, whole, out=np.zeros(count), where=whole > 0)


class _Solids(Columns, Element):
    name, method, counted = "solids", "add_solids", ("corners",)
    is_implicit = excludes_contact = has_volume = True
    work = 8
    assumed: ClassVar = {"viscosity": 0.0}
    features: ClassVar = {"viscosity of solids": lambda scene: np.any(scene.solid_viscosity > 0)}

    def gradients(self, scene: Any, x: Floats) -> Floats:
        """Deformation gradients (e, dim, dim) [1] at x (n, dim) [m]."""
        return np.einsum("eki,eka->eia", x[scene.solids], shape_gradients(scene.solid_rest)[0])

    def energies(self, scene: Any, x: Floats, whole: NDArray[np.bool_]) -> list[float]:
        """Two terms: of the averaged deformation gradients, and of what elements differ from them."""
        if not whole.any():
            return []
        corners, volume = scene.solids, shape_gradients(scene.solid_rest)[1]
        at = _averages_of(scene)
        count, k = len(at.balls), corners.shape[1]
        each, part = self.gradients(scene, x), np.where(whole, volume, 0.0)
        there = np.bincount(at.places.ravel(), np.repeat(part, k), count) / k
        mean = np.stack([_mean(at.places, part, one, count) for one in each.reshape(len(each), -1).T], axis=1)
        mean = mean.reshape(-1, scene.dim, scene.dim)
        off = np.sum((each[:, None] - mean[at.places]) ** 2, axis=(2, 3))
        own = 0.5 / k * np.sum(part[:, None] * at.own[at.places] * off)
        return [float(np.sum(there * density(mean, at.mu, at.lam))), float(own)]

    def cancelling(self, scene: Any) -> float:
        """Those of the material, and of what elements have of their own, which kernels sum over pairs of balls."""
        if not len(scene.solids):
            return 0.0
        gradient, volume = shape_gradients(scene.solid_rest)
        at = _averages_of(scene)
        link = np.abs(np.einsum("eia,eja->eij", gradient, gradient))
        square = np.sum((scene.solid_rest[:, :, None] - scene.solid_rest[:, None]) ** 2, axis=3)
        sizes = 0.25 * np.sum(link * square, axis=(1, 2)) + 0.5 * scene.dim
        mu = lame(scene.dim, scene.solid_modulus, scene.solid_ratio)[0]
        return float(np.sum(volume * (sizes * at.own[at.places].mean(axis=1) + CANCELLING * mu)))

    def further_rates(self, scene: Any) -> tuple[float, float]:
        """Largest of the elements at rest, with room for what is stretched."""
        if not len(scene.solids):
            return 0.0, 0.0
        return rates_of(scene.solid_rest, np.where(scene.pinned, np.inf, scene.mass), _averages_of(scene))


SOLIDS = _Solids()


def _averages_of(scene: Any) -> Averages:
    volume = shape_gradients(scene.solid_rest)[1]
    return averages(scene.solids, volume, scene.solid_modulus, scene.solid_ratio, scene.solid_viscosity)


def rates_of(rest: Floats, mass: Floats, at: Averages) -> tuple[float, float]:
    """Largest eigenvalues of M^-1 K [1/s^2] and M^-1 D [1/s] of elements at rest, for balls of so much mass (n,) [kg], and with
    room for what is stretched."""
    averaged, link, here = operators(rest, at)
    dim = rest.shape[2]
    root = mass[at.balls, None] ** -0.5

    def strained(v: Floats, mu: Floats, lam: Floats, own: Floats) -> Floats:
        """Forces of the averaged strains of displacements v."""
        h = (averaged @ v).reshape(-1, dim, dim)
        stress = mu[:, None, None] * (h + np.swapaxes(h, 1, 2)) - own[:, None, None] * h
        stress += (lam * np.trace(h, axis1=1, axis2=2))[:, None, None] * np.eye(dim)
        return np.asarray(averaged.T @ (here[:, None, None] * stress).reshape(-1, dim))

    def elastic(v: Floats) -> Floats:
        return root * (strained(root * v, at.mu, at.lam, at.own) + link @ (root * v))

    def viscous(v: Floats) -> Floats:
        return root * strained(root * v, at.viscosity, 0.0 * at.lam, 0.0 * at.own)

    rate = _largest(elastic, (len(root), dim))
    loss = _largest(viscous, (len(root), dim)) if at.viscosity.any() else 0.0
    return STRETCHED * rate, STRETCHED * loss


def operators(rest: Floats, at: Averages) -> tuple[Any, Any, Floats]:
    """Sparse matrices of displacements (b, dim): averages of their gradients, which they give as (b dim, dim), the first factor
    counting the axes of derivatives [1/m]; forces of what elements have of their own [N/m]; and the volume of each ball."""
    from scipy import sparse

    gradient, volume = shape_gradients(rest)
    e, k, dim = gradient.shape
    row = np.broadcast_to(np.arange(e)[:, None, None] * dim + np.arange(dim), (e, k, dim))
    column = np.broadcast_to(at.places[:, :, None], (e, k, dim))
    slopes = sparse.csr_matrix((gradient.ravel(), (row.ravel(), column.ravel())), shape=(e * dim, len(at.balls)))
    share = np.repeat(volume / k, k)
    here = np.asarray(np.bincount(at.places.ravel(), share), dtype=np.float64)
    weight = share / here[at.places.ravel()]
    mean = sparse.csr_matrix((weight, (at.places.ravel(), np.repeat(np.arange(e), k))), shape=(len(at.balls), e))
    averaged = sparse.kron(mean, sparse.identity(dim)).tocsr() @ slopes
    own = sparse.diags(np.repeat(volume * at.own[at.places].mean(axis=1), dim))
    return averaged, (slopes.T @ own @ slopes).tocsr(), here


def _largest(product: Any, shape: tuple[int, int]) -> float:
    """Bound on the largest eigenvalue of a symmetric matrix, given by its products with vectors of this shape."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    size = shape[0] * shape[1]
    matrix = LinearOperator((size, size), matvec=lambda v: product(v.reshape(shape)).ravel(), dtype=np.float64)
    start = np.random.default_rng(0).normal(size=size)
    if not matrix.matvec(start).any():  # nothing that resists can move
        return 0.0
    value = eigsh(matrix, k=1, which="LA", v0=start, tol=CLOSE, return_eigenvectors=False)[0]
    return MARGIN * float(value)
