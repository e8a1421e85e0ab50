"""A tower of a hundred jelly cubes, the lowest of which a block knocks away."""

import numpy as np

import taichi_sim as ts

SIDE, LAYERS = 0.3, 25
COLOURS = ((0.86, 0.22, 0.32), (0.95, 0.62, 0.2), (0.25, 0.6, 0.45), (0.25, 0.42, 0.75))


def scene():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 5, "size": (720, 1280)}
    scene.add_material("jelly", friction=0.6)
    scene.add_wall((0, 1, 0), material="jelly")
    for layer in range(LAYERS):
        for k in range(4):
            place = np.array([k % 2 - 1.0, layer + 0.06, k // 2 - 1.0]) * SIDE * 1.06
            ts.shapes.jelly(
                scene,
                size=(SIDE,) * 3,
                resolution=(4, 4, 4),
                mass=10.0,
                stiffness=12000.0,
                damping=6.0,
                material="jelly",
                position=place,
                colour=COLOURS[(layer + k) % 4],
            )
    return scene
