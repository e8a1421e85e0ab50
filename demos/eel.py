"""An eel of jelly swims by a wave that runs down its sides."""

import numpy as np

import taichi_sim as ts

LONG, HIGH, WIDE = 1.0, 0.12, 0.08  # m
FREQUENCY, WAVE, PART = 1.0, 0.8, 0.3  # 1/s, m, of the muscles' rest length
MUSCLE = 0.08  # m, stiffness of a muscle for each unit of the modulus


def scene(frequency=FREQUENCY, wave=WAVE, part=PART, young_modulus=2e5):
    scene = ts.Scene(dim=3)  # afloat: no weight
    scene.settings = {"settle": True}  # begin bent as the muscles are at the start: straight, they would jerk it
    body = {"size": (LONG, HIGH, WIDE), "resolution": (31, 5, 3), "position": (0, 0, -0.5 * WIDE)}
    eel = ts.shapes.jelly(scene, **body, density=1000.0, young_modulus=young_modulus, colour=(0.25, 0.45, 0.4))
    scene.add_wall((0, 1, 0), -0.2)
    scene.add_wind((0, 0, 0), density=1000.0)  # water that stands still
    ball, x = eel.balls.reshape(31, 5, 3), scene.position
    for side, start in ((0, 0.0), (-1, 180.0)):  # one side is short where the other is long
        skin = ball[:, :, side]
        pairs = np.stack([skin[:-1].ravel(), skin[1:].ravel()], axis=1)
        muscles = scene.add_springs(pairs, stiffness=young_modulus * MUSCLE)
        middle = x[pairs, 0].mean(axis=1)
        scene.add_motor(muscles, amplitude=part, frequency=frequency, phase=start + 360.0 * middle / wave)
    scene.output = {"duration": 4.0, "fps": 30, "camera": {"azimuth": 0.0, "elevation": 55.0}}
    return scene


def check(sim):
    middle, turned = sim.position.mean(axis=0), sim.momentum() / sim.scene.mass.sum()
    assert middle[0] - 0.5 * LONG > 0.25 * sim.time  # it swims forwards
    assert 0.27 < turned[0] < 0.33  # m/s
    assert abs(middle[2]) < 0.1 * middle[0]
