"""A million balls, let go as a block with a cloth on it, run over the floor of a box."""

import numpy as np

import taichi_sim as ts

RADIUS, EACH, SHEET = 0.01, 100, 81
WIDTH = 2.2 * RADIUS * EACH


def scene():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 1.5, "size": (1280, 720)}
    scene.settings = {"dt": 0.002, "substeps": 1, "contact_passes": 1, "spin": False}
    scene.add_material("sand", friction=0.3)
    for k, colour in enumerate(((0.75, 0.35, 0.25), (0.92, 0.7, 0.35), (0.3, 0.5, 0.55), (0.9, 0.86, 0.78))):
        layer = (EACH, EACH // 4, EACH)
        up = (0.5 + EACH // 4 * k) * 2.2 * RADIUS
        ts.shapes.pile(
            scene, layer, RADIUS, mass=0.004, seed=k, material="sand", colour=colour, position=(RADIUS, up, RADIUS)
        )
    side = 0.8 * WIDTH
    ts.shapes.cloth(
        scene,
        size=(side, side),
        resolution=(SHEET, SHEET),
        mass=4.0,
        stiffness=20.0,
        damping=0.02,
        radius=0.009,
        material="sand",
        position=(0.1 * WIDTH, WIDTH + 2 * RADIUS, 0.1 * WIDTH),
        colour=(0.75, 0.12, 0.2),
    )
    walls = (((0, 1, 0), 0), ((1, 0, 0), 0), ((-1, 0, 0), -2 * WIDTH), ((0, 0, 1), 0), ((0, 0, -1), -WIDTH))
    for normal, offset in walls:
        scene.add_wall(normal, offset, material="sand")
    return scene


def check(sim):
    x = sim.position
    assert x.min() > -0.2 * RADIUS
    assert np.quantile(x[:, 0], 0.99) > 1.5 * WIDTH  # it has run to the other side
    assert sim.energy().total < EACH**3 * 0.004 * 10 * WIDTH
