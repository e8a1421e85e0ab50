"""A square of cloth falls on a sphere that turns, and is taken along."""

import numpy as np

import taichi_sim as ts

SIDE, NUMBER, RADIUS = 1.6, 81, 0.42


def scene(number=NUMBER, material="denim", turn=115.0):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 5, "size": (1280, 720)}
    scene.output["looks"] = [
        {"of": "cloth_0", "pattern": "weave", "repeat": 160, "pattern_colour": (0.5, 0.58, 0.7), "hem": 0.015}
    ]
    ts.shapes.cloth(
        scene,
        size=(SIDE, SIDE),
        resolution=(number, number),
        material=material,
        position=(-SIDE / 2, 1.1, -SIDE / 2),
        colour=(0.1, 0.2, 0.42),
        self_collision=True,
    )
    scene.add_collider(ts.Sphere((0, 0.5, 0), RADIUS, rotation_rate=(0, turn, 0), material=material))
    scene.add_wall((0, 1, 0), material=material)
    return scene


def check(sim):
    x, v = sim.position, sim.velocity
    assert np.linalg.norm(x - (0, 0.5, 0), axis=1).min() > RADIUS
    top = x[:, 1] > 0.5 + 0.8 * RADIUS
    turn = np.cross(x[top] - (0, 0.5, 0), v[top])[:, 1] / np.sum((x[top] * (1, 0, 1)) ** 2, axis=1).clip(0.01)
    assert np.median(turn) > 1.0  # of the sphere's 2 / s
