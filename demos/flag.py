"""A flag in a storm tears, thread by thread."""

import numpy as np

import taichi_sim as ts

SIZE, NUMBER = (1.5, 1.0), (61, 41)


def patches(seed, size=6):
    """Random numbers in 0..1 for all balls, smooth over patches of about so many balls: cloth tears along weak lines."""
    noise = np.random.default_rng(seed).uniform(size=NUMBER)
    for axis, number in enumerate(NUMBER):
        far = np.arange(number)[:, None] - np.arange(number)
        noise = np.moveaxis(np.tensordot(np.exp(-((far / size) ** 2)), noise, (1, axis)), 0, axis)
    return (noise - noise.min()) / np.ptp(noise)


def scene(wind=10.0, weakest=0.1, strongest=0.3, seed=7):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 6, "size": (1280, 720)}
    scene.output["looks"] = [{"of": "cloth_0", "pattern": "weave", "repeat": 200, "hem": 0.03}]
    flag = ts.shapes.cloth(
        scene,
        size=SIZE,
        resolution=NUMBER,
        stiffness=300,
        damping=0.02,
        position=(0, 2.2, 0),
        rotation=(90, 0, 0),
        pinned=np.arange(0, NUMBER[1], 3),
        surface_collision=True,
        colour=(0.8, 0.15, 0.2),
    )
    along, down = np.divmod(scene.pairs[flag.springs].max(axis=1), NUMBER[1])
    strength = weakest + (strongest - weakest) * patches(seed)[along, down]  # cloth is not as strong everywhere
    strength[(along < 2) | (along < 6) & (down < 6)] = np.inf  # the hem at the pole and the upper corner are sewn on
    scene.set_springs(flag.springs, break_strain=strength)
    scene.add_collider(ts.Capsule((-0.06, 0.0, 0), (-0.06, 2.4, 0), 0.025))
    scene.add_wall((0, 1, 0))
    scene.add_wind((wind, 0, 0.15 * wind), gust=0.8, gust_length=2.0)
    return scene


def check(sim):
    assert 20 < np.count_nonzero(sim.torn) < 0.5 * sim.scene.n_springs
    assert np.all(np.isfinite(sim.position))
