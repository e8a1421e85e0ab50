"""Bar of jelly that bends under its weight.

A bar five times as long as high is held at one end. The reference is a finite element solution with nine nodes an
element, 40 x 8; the bar is jelly four bricks high, eight in the finer one, Poisson's ratio 1/3 and 0.9 in two
dimensions. The weight bends it by 1 % of its length.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import DEFAULTS, Row, relax
from tests.published.elasticity import near, plane_moduli, solve

G, LENGTH, HEIGHT, YOUNG, DENSITY = 9.81, 1.0, 0.2, 2e5, 5.0


def measure():
    """Sag of the free end's middle."""
    rows = []
    for poisson in (1 / 3, 0.9):
        mesh = solve(
            (40, 8),
            lambda unit: unit * [LENGTH, HEIGHT],
            plane_moduli(YOUNG, poisson),
            lambda unit: unit[:, 0] == 0,
            weight=(0, -DENSITY * G),
        )
        exact = -near(*mesh, (LENGTH, HEIGHT / 2))[1]
        for squares, settings in ((4, DEFAULTS), (8, "8 squares high")):
            scene = ts.Scene(dim=2, gravity=(0, -G))
            resolution = (5 * squares + 1, squares + 1)
            ts.shapes.jelly(
                scene,
                size=(LENGTH, HEIGHT),
                resolution=resolution,
                density=DENSITY,
                young_modulus=YOUNG,
                poisson_ratio=poisson,
                pinned="left",
            )
            middle = np.argmin(np.linalg.norm(scene.position - [LENGTH, HEIGHT / 2], axis=1))
            with ts.Simulation(scene) as sim:
                relax(sim, still=2e-6, longest=20.0)
                found = HEIGHT / 2 - sim.position[middle, 1]
            rows.append(Row(f"sag, Poisson's ratio {poisson:.2g}", "m", exact, found, 0.05, settings=settings))
    return rows
