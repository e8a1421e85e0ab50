"""A curtain of cloth, held along its upper edge, in a gusty wind."""

import numpy as np

import taichi_sim as ts

SIZE, NUMBER = (1.6, 1.2), (65, 49)
WIND = 1.9  # m/s


def scene(wind=WIND, gust=0.6, stiffness=400.0):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 5, "size": (1280, 720)}
    top = np.arange(NUMBER[0]) * NUMBER[1]
    ts.shapes.cloth(
        scene,
        size=SIZE,
        resolution=NUMBER,
        stiffness=stiffness,
        damping=0.02,
        pinned=top[::4],
        position=(-SIZE[0] / 2, 1.5, 0),
        rotation=(90, 0, 0),
        colour=(0.85, 0.32, 0.22),
    )
    scene.add_wall((0, 1, 0))
    scene.add_wind((0.3 * wind, 0, wind), gust=gust, gust_length=1.8)
    return scene


def check(sim):
    x = sim.position
    assert np.abs(x[:, 2]).max() > 0.3  # the wind lifts it
    assert np.quantile(np.abs(sim.frame().strain), 0.99) < 0.1
    assert x[:, 1].min() > 0.0
