"""A square of cloth falls on a sphere that turns, and is taken along."""

import numpy as np

import taichi_sim as ts

SIDE, NUMBER, RADIUS = 1.6, 81, 0.42


def scene(number=NUMBER, stiffness=400.0, friction=0.6, turn=115.0):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 5, "size": (1280, 720)}
    scene.add_material("cloth", friction=friction)
    ts.shapes.cloth(
        scene,
        size=(SIDE, SIDE),
        resolution=(number, number),
        stiffness=stiffness,
        damping=0.02,
        material="cloth",
        position=(-SIDE / 2, 1.1, -SIDE / 2),
        colour=(0.24, 0.45, 0.7),
        self_collision=True,
    )
    scene.add_collider(ts.Sphere((0, 0.5, 0), RADIUS, rotation_rate=(0, turn, 0), material="cloth"))
    scene.add_wall((0, 1, 0), material="cloth")
    return scene


def check(sim):
    x, v = sim.position, sim.velocity
    assert np.linalg.norm(x - (0, 0.5, 0), axis=1).min() > RADIUS
    top = x[:, 1] > 0.5 + 0.8 * RADIUS
    turn = np.cross(x[top] - (0, 0.5, 0), v[top])[:, 1] / np.sum((x[top] * (1, 0, 1)) ** 2, axis=1).clip(0.01)
    assert np.median(turn) > 1.0  # of the sphere's 2 / s
