"""A flag in a storm that rises until the flag tears off its pole."""

import numpy as np

import taichi_sim as ts

SIZE, NUMBER = (1.5, 1.0), (61, 41)


def scene():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 6, "size": (1280, 720)}
    flag = ts.shapes.cloth(
        scene,
        size=SIZE,
        resolution=NUMBER,
        stiffness=300,
        damping=0.02,
        position=(0, 2.2, 0),
        rotation=(90, 0, 0),
        colour=(0.8, 0.15, 0.2),
    )
    rng = np.random.default_rng(7)
    scene.break_strain[flag.springs] = rng.uniform(0.1, 0.3, len(flag.springs))  # cloth is not as strong everywhere
    scene.add_moving_pins(flag.balls[: NUMBER[1] : 4], path=[(0, (0, 0, 0)), (2, (0, 0, 0)), (2.05, (0, 0.1, 0)), (2.1, (0, 0, 0))])
    scene.add_collider(ts.Capsule((-0.06, 0.0, 0), (-0.06, 2.4, 0), 0.025))
    scene.add_wall((0, 1, 0))
    scene.add_wind((9, 0, 1.5), gust=0.7, gust_length=2.0)
    return scene


def check(sim):
    assert 20 < np.count_nonzero(sim.torn) < 0.5 * sim.scene.n_springs
    assert np.all(np.isfinite(sim.position))
