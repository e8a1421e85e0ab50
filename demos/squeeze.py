"""A ring of jelly, a mesh filled with it, is pressed flat by a piston and springs back."""

import numpy as np
from taichi_sim.demos.shell import LARGE, SMALL, ring

import taichi_sim as ts


def scene(young_modulus=1e5, density=400.0, flat=0.27):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 4, "size": (1280, 720)}
    scene.add_material("rubber", friction=0.5)
    scene.add_wall((0, 1, 0), material="rubber")
    ts.shapes.jelly(
        scene,
        mesh=ring(),
        spacing=0.1,
        young_modulus=young_modulus,
        density=density,
        damping=1.0,
        radius=0.02,
        material="rubber",
        position=(0, SMALL + 0.03, 0),
        rotation=(90, 0, 0),
        colour=(0.9, 0.3, 0.35),
    )
    top = 1.2
    path = [(0.0, 0.0), (0.2, 0.0), (1.4, flat - top), (1.8, flat - top), (2.2, 0.0), (9.0, 0.0)]
    scene.add_collider(
        ts.Box((0, top, 0), (1.7, 0.2, 1.7), path=[(time, (0, y, 0)) for time, y in path], colour=(0.45, 0.5, 0.55))
    )
    return scene


def check(sim):
    assert sim.inverted() == 0
    sides = np.sort(np.ptp(sim.position, axis=0))
    np.testing.assert_allclose(sides, [2 * SMALL, 2 * (LARGE + SMALL), 2 * (LARGE + SMALL)], atol=0.3)  # a ring again
