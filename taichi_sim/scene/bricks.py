"""Bricks: hexahedra, in 2D quadrilaterals, of an elastic material: boxes at rest."""

from __future__ import annotations

import itertools
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.scene.columns import Column
from taichi_sim.scene.neo_hookean import CANCELLING, STRETCHED, columns, density, lame
from taichi_sim.scene.part import Columns, Element

__all__ = [
    "BRICKS",
    "BrickMethods",
    "at_rest",
    "corner_volumes",
    "laws",
    "rates_at_rest",
]

Floats = NDArray[np.float64]
NOT_A_BOX = 1e-6  # of its size, how far a corner may lie off
# How shears that are linear along two sides act on each other: a square bar of one brick, free to warp, then has
# Saint-Venant's torsion constant, 0.140577 a^4 in place of the a^4 / 6 of a section that stays flat
WARP = 1.0 - 6.0 * 0.140577


class BrickMethods:
    """The part of a Scene that holds bricks."""

    bricks = Column("bricks", "corners", "(b, 2^dim) balls of each brick", ("2 ** dim",), np.int32)
    brick_modulus = Column("bricks", "young_modulus", "(b,) Pa, in 2D N/m")
    brick_ratio = Column("bricks", "poisson_ratio", "(b,) 1")
    brick_viscosity = Column("bricks", "viscosity", "(b,) Pa s, in 2D N s/m")
    brick_size = Column("bricks", "rest_size", "(b, dim) m, of the sides at rest", ("dim",))

    def add_bricks(
        self: Any,
        corners: ArrayLike,
        *,
        young_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        viscosity: ArrayLike = 0.0,
        rest_size: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Add b bricks of an elastic material and return their indices, shape (b,).

        A brick, a hexahedron in 3D and a quadrilateral in 2D, is a box at rest. Its material is neo-Hookean, and drives a brick
        that is turned inside out back. One brick across a bar is enough for it to bend as it should, at all ratios.

        Args:
            corners: (b, 2^dim) balls, or one brick, as `itertools.product((0, 1), repeat=dim)` has their places along the sides:
                the last side counts fastest.
            young_modulus: one or one per brick, > 0 [Pa, in 2D N/m].
            poisson_ratio: one or one per brick, 0 to 0.4999 (in 2D 0.9996) [1]. In 2D both are those of a sheet in its plane.
                A long body in plane strain has the modulus E / (1 - nu^2) and the ratio nu / (1 - nu).
            viscosity: one or one per brick, >= 0 [Pa s, in 2D N s/m]: the stress by which a rate of strain is resisted, as a
                viscous liquid's.
            rest_size: (b, dim) or (dim,), > 0 [m]: sides of the box at rest. None: the present ones, of bricks that are boxes.
        """
        dim = self.dim
        ij = validation.corners("bricks.corners", corners, self.n_balls, 2**dim)
        b = len(ij)
        material = columns("bricks", b, dim, young_modulus, poisson_ratio, viscosity)
        if rest_size is None:
            size = _present_size(self.position[ij])
        else:
            size = validation.vectors("bricks.rest_size", rest_size, b, dim)
            validation.require("bricks.rest_size", size, (size > 0).all(axis=1), "positive")
        return self.tables["bricks"].append(b, corners=ij, rest_size=size, **material)  # type: ignore[no-any-return]


def _signs(dim: int) -> Floats:
    """Places (2^dim, dim) of the corners of a brick along its sides, -1 or 1."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=dim)))


def _present_size(x: Floats) -> Floats:
    """Sides (b, dim) [m] of bricks with corners at x (b, 2^dim, dim) [m]. Raises SceneError for one that is no box."""
    dim = x.shape[2]
    sides = np.einsum("bka,ks->bsa", x, _signs(dim)) * 2.0 / 2**dim  # the s-th side, a vector
    size = np.linalg.norm(sides, axis=2)
    box = x.mean(axis=1, keepdims=True) + 0.5 * np.einsum("ks,bsa->bka", _signs(dim), sides)
    slack = NOT_A_BOX * size.max(axis=1, initial=0.0)
    off = np.abs(x - box).max(axis=(1, 2), initial=0.0) > slack
    across = np.einsum("bsa,bta->bst", sides, sides) - np.einsum("bs,st->bst", size**2, np.eye(dim))
    off |= np.abs(across).max(axis=(1, 2), initial=0.0) > slack * size.max(axis=1, initial=0.0)
    off |= np.linalg.det(sides) <= slack**dim
    says = "is no box now, or its corners are in another order; give a rest_size, or the order of add_bricks"
    validation.require("bricks.corners", ..., ~off, says=says)
    return size


class _Bricks(Columns, Element):
    name, method, counted = "bricks", "add_bricks", ("corners",)
    is_implicit = excludes_contact = has_volume = True
    work = 16
    assumed: ClassVar = {"viscosity": 0.0}
    features: ClassVar = {"viscosity of bricks": lambda scene: np.any(scene.brick_viscosity > 0)}

    def gradients(self, scene: Any, x: Floats) -> Floats:
        """Deformation gradients (b, dim, dim) [1] at the centres, at x (n, dim) [m]."""
        return _patterns(x[scene.bricks], scene.brick_size)[0]

    def energies(self, scene: Any, x: Floats, whole: NDArray[np.bool_]) -> list[float]:
        return [float(np.sum(self.stored(scene, x[scene.bricks])[whole]))]

    def stored(self, scene: Any, x: Floats) -> Floats:
        """Energies (b,) [J] of the bricks with corners at x (b, 2^dim, dim) [m]."""
        gradient, bent = _patterns(x, scene.brick_size)
        mu, lam = lame(scene.dim, scene.brick_modulus, scene.brick_ratio)
        stored = density(gradient, mu, lam)
        strain = np.einsum("bai,bpa->bpi", gradient, bent)  # F^T q
        own, law = _distinct(_rows(scene)[:, :-1])
        stiff = np.array([stabilisation(row[2:], row[0], row[1]) for row in own]).reshape(
            len(own), *(strain.shape[1:] * 2)
        )
        stored += 0.5 * np.einsum("bpi,bpiqj,bqj->b", strain, stiff[law], strain)
        return stored * scene.brick_size.prod(axis=1)  # type: ignore[no-any-return]

    def cancelling(self, scene: Any) -> float:
        """Those of the material."""
        mu = lame(scene.dim, scene.brick_modulus, scene.brick_ratio)[0]
        return float(np.sum(scene.brick_size.prod(axis=1) * CANCELLING * mu))

    def further_rates(self, scene: Any) -> tuple[float, float]:
        """Largest of all bricks alone at rest, each with its part of the masses of its balls, which is a bound."""
        if not len(scene.bricks):
            return 0.0, 0.0
        volume = scene.brick_size.prod(axis=1)
        around = np.bincount(scene.bricks.ravel(), np.repeat(volume, scene.bricks.shape[1]), scene.n_balls)
        weight = np.where(scene.pinned, np.inf, scene.mass)[scene.bricks] / around[scene.bricks]  # of corners
        own, law = _distinct(_rows(scene))
        least = np.full(len(own), np.inf)
        np.minimum.at(least, law, weight.min(axis=1))
        rates = np.array([rates_at_rest(row[2:-1], row[0], row[1], row[-1]) for row in own]) / least[:, None]
        return float(rates[:, 0].max()), float(rates[:, 1].max())


BRICKS = _Bricks()


def _distinct(rows: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """The rows that differ, sorted, and which of them each row is; many times faster than NumPy's `unique` of rows."""
    order = np.lexsort(rows.T[::-1])
    sorted_rows = rows[order]
    first = np.ones(len(rows), dtype=bool)
    first[1:] = np.any(sorted_rows[1:] != sorted_rows[:-1], axis=1)
    law = np.empty(len(rows), dtype=np.int64)
    law[order] = np.cumsum(first) - 1
    return sorted_rows[first], law


def _patterns(x: Floats, size: Floats) -> tuple[Floats, Floats]:
    """Deformation gradients (b, dim, dim) [1] at the centres of bricks with corners at x (b, 2^dim, dim) [m] and sides at rest
    `size` (b, dim) [m]; and what else they do, (b, p, dim) [m], the amplitudes of the `_bent`."""
    dim = size.shape[1]
    gradient = np.einsum("bka,ks->bas", x, _signs(dim)) * (2.0 / 2**dim) / size[:, None, :]
    return gradient, np.einsum("bka,pk->bpa", x, _bent_signs(dim))


def _bent(dim: int) -> list[tuple[int, ...]]:
    """The sides along which each displacement that is not linear changes its sign: products of two of them or, last, three."""
    return [p for n in range(2, dim + 1) for p in itertools.combinations(range(dim), n)]


def _bent_signs(dim: int) -> Floats:
    """Shares (p, 2^dim) of the corners in the amplitudes of the `_bent`."""
    signs = _signs(dim)
    return np.array([signs[:, list(p)].prod(axis=1) for p in _bent(dim)]) / 2**dim


def stabilisation(size: Floats, young_modulus: float, poisson_ratio: float) -> Floats:
    """Stiffness (p, dim, p, dim) [Pa/m^2, in 2D N/m^3] of the `_bent`, for the volume at rest.

    What bends makes strains that are linear along one side. They cost what they would in a plate, whose thickness adapts: with
    the shear that these displacements have besides, bricks would be far too stiff (assumed strains, Belytschko, Bindeman 1993).
    What twists makes shears that are linear along one side, each with mu of its square and mu WARP of its product with another.
    """
    dim = len(size)
    mu, _ = lame(dim, young_modulus, poisson_ratio)
    plate = young_modulus / (1.0 - poisson_ratio**2) if dim == 3 else young_modulus
    found, slope = _bent(dim), 2.0 / size
    stiff = np.zeros((len(found), dim, len(found), dim))
    shears = []

    def add(strength: float, *terms: tuple[int, int, float]) -> None:
        """Add strength times the square of a sum of amplitudes."""
        for (p, i, f), (q, j, g) in itertools.product(terms, repeat=2):
            stiff[p, i, q, j] += strength * f * g / 3.0

    for s in range(dim):
        pairs = [(found.index(tuple(sorted((d, s)))), d) for d in range(dim) if d != s]
        stretch = [(p, d, slope[d]) for p, d in pairs]
        if dim == 2:
            add(plate, *stretch)
            continue
        for one in stretch:
            add(plate * (1.0 - poisson_ratio), one)
        add(plate * poisson_ratio, *stretch)
        (p, d), (q, e) = pairs
        shears.append([(p, e, slope[d]), (q, d, slope[e])])
        add(mu * (1.0 - WARP), *shears[-1])
    if dim == 3:
        add(mu * WARP, *shears[0], *shears[1], *shears[2])
        for d in range(dim):
            add(young_modulus / 3.0, (len(found) - 1, d, slope[d]))
    return stiff


def laws(scene: Any) -> tuple[Floats, NDArray[np.int32]]:
    """The different bricks of a scene, rows of (modulus, ratio, sides (dim), viscosity); and which of them each is, (b,)."""
    own, law = _distinct(_rows(scene))
    return own, law.astype(np.int32)


def _rows(scene: Any) -> Floats:
    return np.column_stack([scene.brick_modulus, scene.brick_ratio, scene.brick_size, scene.brick_viscosity])


def at_rest(size: Floats, young_modulus: float, poisson_ratio: float) -> Floats:
    """Stiffness at rest of one brick, and that of its part that viscosity acts on, (2, 2^dim dim, 2^dim dim) [N/m]."""
    dim = len(size)
    mu, lam = lame(dim, young_modulus, poisson_ratio)
    signs, one = _signs(dim), np.eye(dim)
    slope = signs * (2.0 / 2**dim) / size
    whole = np.zeros((2, signs.size, signs.size))
    for i, j in itertools.product(range(dim), repeat=2):
        strain = 0.5 * (np.outer(slope[:, j], one[i]) + np.outer(slope[:, i], one[j])).ravel()
        whole += 2.0 * mu * np.outer(strain, strain)
    whole[0] += lam * np.outer(slope.ravel(), slope.ravel())
    bent = np.einsum("pk,ij->pikj", _bent_signs(dim), one).reshape(-1, signs.size)
    stiff = stabilisation(size, young_modulus, poisson_ratio).reshape(len(bent), -1)
    return (whole + bent.T @ stiff @ bent) * float(np.prod(size))


def rates_at_rest(
    size: Floats, young_modulus: float, poisson_ratio: float, viscosity: float = 0.0
) -> tuple[float, float]:
    """Largest eigenvalues of M^-1 K [1/s^2] and M^-1 D [1/s] of bricks at rest, for balls of a mass of 1 kg for each m^dim of the
    bricks around, and with room for what is stretched."""
    stiff = at_rest(size, young_modulus, poisson_ratio) / float(np.prod(size))
    elastic, loss = (STRETCHED * float(np.linalg.eigvalsh(part)[-1]) for part in stiff)
    return elastic, viscosity / lame(len(size), young_modulus, poisson_ratio)[0] * loss


def corner_volumes(x: Floats, bricks: NDArray) -> Floats:
    """Signed volumes (b, 2^dim) [m^dim] that the sides at each corner of bricks (b, 2^dim) span, balls at x (n, dim) [m]."""
    dim = x.shape[1]
    signs = _signs(dim)
    number = np.arange(2**dim)
    volume = np.empty((len(bricks), 2**dim))
    for k in number:
        sides = [-signs[k, s] * (x[bricks[:, k ^ (1 << (dim - 1 - s))]] - x[bricks[:, k]]) for s in range(dim)]
        volume[:, k] = np.linalg.det(np.stack(sides, axis=1))
    return volume
