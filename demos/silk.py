"""A curtain of 100 000 balls of silk, gathered in pleats, is lifted by gusts, in steps as long as a frame."""

import numpy as np

import taichi_sim as ts

SIDE, NUMBER, PLEATS, SLOPE = 1.6, 320, 6, 0.5


def pleats(number):
    """Places (number, 2) [m] along x and z of a thread of the length SIDE that lies in pleats, neither stretched nor pressed."""
    u = np.linspace(0.0, 1.0, number)
    z = SLOPE * SIDE / (2 * np.pi * (PLEATS + 3)) * np.sin(2 * np.pi * (PLEATS * u + 0.4 * np.sin(2.6 * np.pi * u)))
    x = np.append(0.0, np.cumsum(np.sqrt((SIDE / (number - 1)) ** 2 - np.diff(z) ** 2)))
    return np.stack([x - x[-1] / 2, z], axis=1)


def scene(number=NUMBER, wind=0.9, gust=0.5, dt=1 / 60):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.settings = {"integrator": "implicit_euler", "dt": dt}
    scene.output = {"fps": 60, "duration": 3, "size": (1280, 720), "stage": "dusk"}
    scene.output["camera"] = {"azimuth": 28, "elevation": 6}
    rail = np.arange(number) * number
    silk = ts.shapes.cloth(
        scene,
        size=(SIDE, SIDE),
        resolution=(number, number),
        material="silk",
        warp_angle=0,  # of triangles
        pinned=rail,
        position=(0, 1.75, 0),
        rotation=(90, 0, 0),
        colour=(0.62, 0.06, 0.16),
    )
    place = scene.position[silk.balls].reshape(number, number, 3)
    place[:, :, [0, 2]] = pleats(number)[:, None]
    scene.set_balls(silk.balls, position=place.reshape(-1, 3))
    scene.add_wind((0.1 * wind, 0, wind), gust=gust, gust_length=1.2)
    return scene


def check(sim):
    x, number = sim.position, round(len(sim.position) ** 0.5)
    spacing, grid = SIDE / (number - 1), x.reshape(number, number, 3)
    for axis in (0, 1):
        stretch = np.linalg.norm(np.diff(grid, axis=axis), axis=2) / spacing - 1.0
        assert stretch.max() < 0.05
    assert sim.crossings() == 0
    assert np.abs(x[:, 2]).max() > 0.3  # the wind lifts it
