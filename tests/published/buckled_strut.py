"""Buckled strut.

A straight elastic rod with hinged ends that come nearer by a tenth of its length bends into Euler's elastica. With k
the sine of half the end's angle its chord is L (2 E(k) / K(k) - 1) and its middle is k L / K(k) aside. Its thrust is 4
K(k)^2 B / L^2, pi^2 B / L^2 at the onset (Love, "Mathematical Theory of Elasticity", section 263). Bending elements
with the weights 1, -2, 1 and springs form the rod.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

import taichi_sim as ts
from tests.published.common import DEFAULTS, Row, relax

LENGTH, RIGIDITY, EXTENSION, MASS = 1.0, 0.01, 400.0, 0.1  # m, N m^2, N, kg
NEARER = 0.1


def scene(pieces):
    """A rod that starts as a flat half wave of its length, hinged at both ends."""
    scene = ts.Scene(dim=2)
    piece = LENGTH / pieces
    modulus = brentq(lambda k: 2 * ellipe(k * k) / ellipk(k * k) - 1 - (1 - NEARER), 1e-3, 0.99)
    way = np.linspace(0, 1, 4001)
    angle = 2 * np.arcsin(modulus) * np.cos(np.pi * way)  # about that of the elastica
    x = np.concatenate([[[0, 0]], np.cumsum(np.stack([np.cos(angle), np.sin(angle)], 1)[1:] * LENGTH / 4000, axis=0)])
    x = x[:: 4000 // pieces]
    x[:, 0] *= LENGTH * (1 - NEARER) / x[-1, 0]
    x[:, 1] -= np.linspace(0, x[-1, 1], len(x))
    rod = scene.add_balls(x, radius=0.2 * piece, mass=MASS / pieces, pinned=[0, pieces], body=scene.new_body())
    scene.add_springs(np.stack([rod[:-1], rod[1:]], 1), stiffness=EXTENSION / piece, damping=0.5, rest_length=piece)
    first = np.arange(pieces - 1)
    spare = np.where(first > 1, 0, pieces)  # a fourth ball of weight 0
    corners = rod[np.stack([first, first + 1, first + 2, spare], 1)]
    scene.add_bending(corners, weights=np.tile([1.0, -2.0, 1.0, 0.0], (pieces - 1, 1)), stiffness=RIGIDITY / piece**3)
    return scene, modulus


def measure():
    """Place of the middle and thrust; 20 pieces at the defaults."""
    rows = []
    for pieces, settings in ((20, DEFAULTS), (40, "40 pieces")):
        made, modulus = scene(pieces)
        whole = ellipk(modulus**2)
        with ts.Simulation(made) as sim:
            relax(sim, still=2e-6, longest=60.0, chunk=5e-3)
            x = sim.position
        before, middle, after = x[pieces // 2 - 1 : pieces // 2 + 2]
        curvature = np.linalg.norm(before - 2 * middle + after) / (LENGTH / pieces) ** 2
        thrust = RIGIDITY * curvature / middle[1]  # the moment of the middle is thrust times distance
        rows += [
            Row("place of the middle", "m", modulus / whole * LENGTH, middle[1], 5e-3, settings=settings),
            Row("thrust", "N", 4 * whole**2 * RIGIDITY / LENGTH**2, thrust, 0.01, settings=settings),
        ]
    return rows
