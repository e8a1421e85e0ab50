"""A sheet of satin of a hundred thousand balls falls over a sphere, folds and lies on itself."""

import numpy as np

import taichi_sim as ts

SIDE, NUMBER, RADIUS = 2.0, 316, 0.4


def scene():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    view = {"azimuth": 30, "elevation": 22, "distance": 2.9, "target": (0, 0.45, 0)}
    scene.output = {"fps": 60, "duration": 3, "size": (1280, 720), "camera": view}
    scene.settings = {"spin": False}
    scene.add_material("satin", friction=0.3)
    ts.shapes.cloth(
        scene,
        size=(SIDE, SIDE),
        resolution=(NUMBER, NUMBER),
        stiffness=11.0,
        damping=5e-4,
        surface_collision=True,
        material="satin",
        position=(-SIDE / 2, 0.92, -SIDE / 2),
        colour=(0.65, 0.1, 0.2),
    )
    scene.add_collider(ts.Sphere((0, 0.5, 0), RADIUS, material="satin"))
    scene.add_wall((0, 1, 0), material="satin")
    return scene


def check(sim):
    x = sim.position
    assert sim.crossings() == 0
    assert np.linalg.norm(x - (0, 0.5, 0), axis=1).min() > RADIUS
    assert x[:, 1].min() > 0.0
    assert np.mean(x[:, 1] < 0.2) > 0.1  # its corners have come down
