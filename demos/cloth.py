"""A square of cloth, held at two corners, is let go, swings and folds."""

import numpy as np

import taichi_sim as ts

SIDE, NUMBER, MASS = 1.2, 48, 0.3


def scene(number=NUMBER, mass=MASS, stiffness=1000.0, bending_stiffness=0.1, damping=0.04):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 5, "size": (1280, 720)}
    scene.output["looks"] = [{"of": "cloth_0", "pattern": "weave", "hem": 0.03}]
    ts.shapes.cloth(
        scene,
        size=(SIDE, SIDE),
        resolution=(number, number),
        mass=mass,
        stiffness=stiffness,
        bending_stiffness=bending_stiffness,
        damping=damping,
        pinned=[0, number * (number - 1)],
        position=(-SIDE / 2, SIDE, 0),
        rotation=(30, 0, 0),
        colour=(0.2, 0.45, 0.71),
    )
    scene.add_wall((0, 1, 0), offset=-0.3)
    return scene


def check(sim):
    assert sim.energy().total < MASS * 10 * (SIDE - SIDE / 2 * np.sin(np.radians(30)))  # as it was let go
    assert sim.position[:, 1].min() > -0.25
    assert np.quantile(np.abs(sim.frame().strain), 0.99) < 0.1
