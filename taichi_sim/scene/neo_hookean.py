"""The stable neo-Hookean material of bricks and solids (Smith, de Goes, Kim 2018)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation

__all__ = ["CANCELLING", "MOST_RATIO", "STRETCHED", "columns", "constants", "density", "in_plane_strain", "lame"]

Floats = NDArray[np.float64]
MOST_RATIO = {2: 0.9996, 3: 0.4999}  # Poisson's, by the dimensions: in 2D that of plane strain with the other
CANCELLING = 4.0  # times mu: terms of the energy per volume that cancel each other at rest
STRETCHED = 4.0  # times the stiffness at rest: a face that is stretched to twice its area


def columns(
    table: str, n: int, dim: int, young_modulus: ArrayLike, poisson_ratio: ArrayLike, viscosity: ArrayLike
) -> dict[str, Floats]:
    """Columns (n,) of the material of n elements, one or one per element. Raises SceneError that names the table."""
    return {
        "young_modulus": validation.per_item(f"{table}.young_modulus", young_modulus, n, positive=True),
        "poisson_ratio": validation.per_item(f"{table}.poisson_ratio", poisson_ratio, n, low=0, high=MOST_RATIO[dim]),
        "viscosity": validation.per_item(f"{table}.viscosity", viscosity, n, low=0),
    }


def lame(dim: int, young_modulus: Any, poisson_ratio: Any) -> tuple[Any, Any]:
    """Lame's constants mu and lambda [Pa, in 2D N/m]."""
    mu = young_modulus / (2.0 * (1.0 + poisson_ratio))
    return mu, 2.0 * mu * poisson_ratio / (1.0 - (dim - 1) * poisson_ratio)


def in_plane_strain(young_modulus: float, poisson_ratio: float) -> tuple[float, float]:
    """Modulus and ratio in 2D of a long body of a material whose length cannot change."""
    ratio = poisson_ratio / (1.0 - poisson_ratio)
    return young_modulus / (1.0 - poisson_ratio**2), min(ratio, MOST_RATIO[2])


def constants(mu: Any, lam: Any) -> tuple[Any, Any, Any]:
    """Constants m and k [Pa, in 2D N/m] and alpha [1] of the energy density (m (I - 3 - log(I + 1)) + k (J - alpha)^2) / 2, whose
    small strains have Lame's constants mu and lambda."""
    m, k = 4.0 / 3.0 * mu, lam + 5.0 / 6.0 * mu
    return m, k, 1.0 + 0.75 * m / k


def density(gradient: Floats, mu: Any, lam: Any) -> Floats:
    """Energies (e,) per volume at rest [Pa, in 2D N/m] at deformation gradients (e, dim, dim); 0 at rest."""
    m, k, alpha = constants(mu, lam)
    shape = np.sum(gradient**2, axis=(1, 2)) + (3 - gradient.shape[1])
    change = np.linalg.det(gradient)
    stored = 0.5 * m * (shape - 3.0 - np.log((shape + 1.0) / 4.0))
    return np.asarray(stored + 0.5 * k * ((change - alpha) ** 2 - (1.0 - alpha) ** 2))
