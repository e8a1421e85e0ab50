"""A heavy ball slides into a round tower of a hundred jelly bricks."""

import numpy as np

import taichi_sim as ts

SIDE, AROUND, LAYERS, REACH = 0.3, 10, 10, 0.8
COLOURS = ((0.86, 0.22, 0.32), (0.95, 0.62, 0.2), (0.25, 0.6, 0.45), (0.25, 0.42, 0.75))


def scene(layers=LAYERS, stiffness=20000.0, friction=0.7, speed=6.5):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    view = {"azimuth": 20, "elevation": 20, "distance": 11.5, "target": (0.4, 1.2, 0.3)}  # room for what falls
    scene.output = {"fps": 60, "duration": 5, "size": (1280, 720), "camera": view}
    scene.settings = {
        "spin": False,
        "dt": 0.001,
        "substeps": 2,
        "contact_iterations": 4,
    }  # the balls of a brick do not turn
    scene.add_material("jelly", friction=friction)
    scene.add_material("steel", friction=0.09)  # 0.25 on the floor: the ball comes to rest in the picture
    scene.add_wall((0, 1, 0), material="jelly")
    for layer in range(layers):
        for k in range(AROUND):
            turn = 2 * np.pi * (k + layer % 2 / 2) / AROUND
            out = np.array([np.cos(turn), 0, -np.sin(turn)])
            aside = np.array([np.sin(turn), 0, np.cos(turn)])
            place = REACH * out - SIDE / 2 * (out + aside) + (0, 0.05 + layer * SIDE * 1.3, 0)
            ts.shapes.jelly(
                scene,
                size=(SIDE,) * 3,
                resolution=(4, 4, 4),
                mass=10.0,
                stiffness=stiffness,
                damping=20.0,
                material="jelly",
                position=place,
                rotation=(0, np.degrees(turn), 0),
                colour=COLOURS[(layer + k) % 4],
            )
    place, velocity = (-3.5, 0.45, 1.4), (speed, 0.0, -0.4 * speed)
    scene.add_balls([place], velocity=velocity, radius=0.45, mass=700.0, material="steel", colour=(0.2, 0.2, 0.22))
    return scene


def check(sim):
    bricks = sim.position[:-1].reshape(LAYERS * AROUND, 64, 3).mean(axis=1)
    assert np.count_nonzero(bricks[:, 1] < 0.3) > 50  # most of the tower has come down
    assert sim.energy().total < 20000  # of 40000 J at the start
    assert sim.position[-1, 0] > -1.5  # the ball has come to it
    assert sim.position[:, 1].min() > 0.0
