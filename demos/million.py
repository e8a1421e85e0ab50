"""A million balls, let go as a block with a cloth on it, run over the floor of a box."""

import numpy as np

import taichi_sim as ts

RADIUS, LAYER, SHEET = 0.01, (160, 10, 157), 101
SPACING = 2.2 * RADIUS
LONG, WIDE, HIGH = SPACING * LAYER[0], SPACING * LAYER[2], SPACING * LAYER[1]


def scene(friction=0.02, layers=4):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    view = {"azimuth": 25, "elevation": 24, "distance": 8, "target": (LONG, 0.0, 0.56 * WIDE)}  # the whole floor
    scene.output = {"fps": 60, "duration": 1.5, "size": (1280, 720), "camera": view}
    scene.settings = {"dt": 0.002, "substeps": 2, "contact_iterations": 1, "spin": False}
    scene.add_material("marble", friction=friction)
    for k, colour in enumerate(((0.75, 0.35, 0.25), (0.92, 0.7, 0.35), (0.3, 0.5, 0.55), (0.9, 0.86, 0.78))[:layers]):
        place = (1.5 * RADIUS, HIGH * k + 1.5 * RADIUS, 1.5 * RADIUS)
        ts.shapes.pile(
            scene, LAYER, RADIUS, mass=0.004, jitter=0.1, seed=k, material="marble", colour=colour, position=place
        )
    side = 0.6 * WIDE
    ts.shapes.cloth(
        scene,
        size=(side, side),
        resolution=(SHEET, SHEET),
        mass=12.0,  # a ball of it within fourfold of a marble: all threads solve impacts of such
        stiffness=20.0,
        damping=0.02,
        radius=0.009,
        material="marble",
        position=(LONG - 1.1 * side, layers * HIGH + 3 * RADIUS, (WIDE - side) / 2),
        colour=(0.75, 0.12, 0.2),
    )
    walls = (((0, 1, 0), 0), ((1, 0, 0), 0), ((-1, 0, 0), -2 * LONG), ((0, 0, 1), 0), ((0, 0, -1), -WIDE - RADIUS))
    for normal, offset in walls:
        scene.add_wall(normal, offset, material="marble")
    return scene


def check(sim):
    x = sim.position
    assert x.min() > -0.2 * RADIUS
    assert np.quantile(x[:, 0], 0.98) > 1.8 * LONG  # they have run to the other side
    assert sim.contacts().mean_relative_penetration < 0.02
    assert sim.energy().total < 2 / 3 * len(x) * 0.004 * 10 * 2 * HIGH  # of that at the start
