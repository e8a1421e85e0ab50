"""Plane linear elasticity by finite elements of nine nodes, the reference for bodies of jelly."""

from itertools import product

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve


def plane_moduli(young: float, poisson: float) -> np.ndarray:
    """Matrix (3, 3) from strains (xx, yy, 2 xy) to stresses, of two-dimensional moduli."""
    return young / (1 - poisson**2) * np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]])


def solve(elements, shape, moduli, held, weight=(0.0, 0.0), traction=(0.0, 0.0)):
    """Places (n, 2) of the nodes [m] and their displacements (n, 2) [m].

    elements: (number along u, along v). shape: maps (n, 2) of the unit square to places. held: mask (n,) of the unit square's
    points that do not move. weight: force per area [N/m^2]; traction: force per length on the side u = 1 [N/m].
    """
    across, along = 2 * np.array(elements) + 1
    unit = np.stack(np.meshgrid(np.linspace(0, 1, across), np.linspace(0, 1, along), indexing="ij"), -1).reshape(-1, 2)
    place, number = shape(unit), np.arange(len(unit)).reshape(across, along)
    corners = np.array([number[2 * i : 2 * i + 3, 2 * j : 2 * j + 3].ravel() for i, j in np.ndindex(*elements)])
    degrees = (2 * corners[:, :, None] + np.arange(2)).reshape(len(corners), 18)
    stiffness, load = np.zeros((len(corners), 18, 18)), np.zeros(2 * len(unit))
    at, weights = np.polynomial.legendre.leggauss(3)
    for (p, wp), (q, wq) in product(zip(at, weights), repeat=2):
        value, slope = _product(p, q)
        jacobian = np.einsum("dn,enk->edk", slope, place[corners])
        area = np.abs(np.linalg.det(jacobian)) * wp * wq
        gradient = np.linalg.solve(jacobian, np.broadcast_to(slope, (len(corners), 2, 9)))
        strain = np.zeros((len(corners), 3, 18))
        strain[:, 0, 0::2], strain[:, 1, 1::2] = gradient[:, 0], gradient[:, 1]
        strain[:, 2, 0::2], strain[:, 2, 1::2] = gradient[:, 1], gradient[:, 0]
        stiffness += np.einsum("eai,ab,ebj,e->eij", strain, moduli, strain, area)
        np.add.at(load, degrees, area[:, None] * np.outer(value, weight).ravel())
    for k in range(elements[1]):  # Simpson's rule on each side of the border u = 1
        nodes = number[-1, 2 * k : 2 * k + 3]
        length = np.linalg.norm(place[nodes[2]] - place[nodes[0]])
        np.add.at(load, 2 * nodes[:, None] + np.arange(2), length / 6 * np.outer([1, 4, 1], traction))
    rows, columns = np.repeat(degrees, 18, axis=1).ravel(), np.tile(degrees, (1, 18)).ravel()
    matrix = coo_matrix((stiffness.ravel(), (rows, columns)), shape=(len(load),) * 2).tocsc()
    free = np.repeat(~held(unit), 2)
    moved = np.zeros(len(load))
    moved[free] = spsolve(matrix[free][:, free], load[free])
    return place, moved.reshape(-1, 2)


def _product(p, q):
    """Values (9,) and slopes (2, 9) of the nine products of parabolas at (p, q) in -1..1."""
    (u, du), (v, dv) = (
        (np.array([s * (s - 1) / 2, 1 - s * s, s * (s + 1) / 2]), np.array([s - 0.5, -2 * s, s + 0.5])) for s in (p, q)
    )
    return np.outer(u, v).ravel(), np.stack([np.outer(du, v).ravel(), np.outer(u, dv).ravel()])


def near(place, moved, point):
    """Displacement (2,) of the node nearest to a point."""
    return moved[np.argmin(np.linalg.norm(place - point, axis=1))]
