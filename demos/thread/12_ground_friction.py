"""Ground friction stops each puck on its mark, v0 / f from where it set out; the last has f = 100, the first is on ice."""

import numpy as np

import taichi_sim as ts

rate = np.array([0.0, 1.25, 2.5, 5.0, 100.0])  # 1/s, of each puck against the floor
start = -0.5 * np.arange(5)  # m
SPEED = 5.0  # m/s
stop = start[1:] + SPEED / rate[1:]


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 4, "size": (1280, 360)}
    scene.add_material("floor", viscous_friction=100)
    scene.add_material("buffer", restitution=1)
    body = scene.new_body()
    for k, f in enumerate(rate):
        puck = scene.add_material(f"puck {k}", viscous_friction=f**2 / 100)  # two materials: sqrt(f1 f2)
        scene.add_balls([start[k], 0.2], velocity=(SPEED, 0), radius=0.2, material=puck, body=body)
    scene.add_balls(np.stack([stop, np.full(4, 0.2)], axis=1), radius=0.05, pinned=True, body=body)
    for normal, offset, material in (((0, 1), 0, "floor"), ((1, 0), -2.4, "buffer"), ((-1, 0), -4.4, "buffer")):
        scene.add_wall(normal, offset, material)
    return scene


def check(sim):
    np.testing.assert_allclose(sim.position[1:5, 0], stop - SPEED / rate[1:] * np.exp(-rate[1:] * 4), atol=1e-3)
    np.testing.assert_allclose(np.abs(sim.velocity[:5, 0]), SPEED * np.exp(-rate * 4), atol=1e-3)
    np.testing.assert_allclose(sim.position[:5, 1], 0.2, atol=1e-4)
