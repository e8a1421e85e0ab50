"""A net catches ten thousand balls."""

import numpy as np

import taichi_sim as ts

SIDE, NUMBER, RADIUS, SLACK = 2.8, 65, 0.035, 1.15


def scene(slack=SLACK, stiffness=3000.0, layers=5):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    near = (
        {"time": 0.2, "eye": (4.4, 4.3, 7.2), "target": (0, 1.5, 0)},
        {"time": 1.2, "eye": (2.7, 3.0, 4.4), "target": (0, 1.3, 0)},
    )
    scene.output = {"fps": 60, "duration": 4, "size": (1280, 720), "camera": {"path": near}}
    scene.add_material("rubber", restitution=0.2, friction=0.3)
    knots = np.stack(np.meshgrid(np.arange(NUMBER), np.arange(NUMBER), indexing="ij"), axis=-1).reshape(-1, 2)
    edge = np.any((knots == 0) | (knots == NUMBER - 1), axis=1)
    mesh = SIDE / (NUMBER - 1)
    # every other knot lies higher, by what brings slack cords to their length: pressed flat they would fling the net about
    height = 1.6 + mesh * np.sqrt(slack**2 - 1.0) * (knots.sum(axis=1) % 2 - 0.5)
    place = np.insert((knots / (NUMBER - 1) - 0.5) * SIDE, 1, height, axis=1)
    index = scene.add_balls(
        place, radius=0.02, mass=0.02, pinned=edge, material="rubber", body=scene.new_body(), colour=(0.25, 0.22, 0.2)
    ).reshape(NUMBER, NUMBER)
    cords = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:])]
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in cords])
    scene.add_springs(pairs, stiffness=stiffness, damping=0.6, rest_length=slack * mesh, collides=True)
    for k, colour in enumerate(
        ((0.9, 0.3, 0.25), (0.95, 0.72, 0.25), (0.2, 0.55, 0.6), (0.9, 0.88, 0.82), (0.5, 0.35, 0.6))[:layers]
    ):
        ts.shapes.pile(
            scene, (20, 5, 20), RADIUS, mass=0.01, jitter=0.07, seed=k, spacing=0.075, material="rubber", colour=colour,
            position=(-0.71, 1.75 + 0.4 * k, -0.71),
        )  # fmt: skip
    scene.add_wall((0, 1, 0), material="rubber")
    return scene


def check(sim):
    loose = sim.position[NUMBER**2 :]
    assert np.mean(loose[:, 1] > 0.3) > 0.98  # caught
    assert sim.position[: NUMBER**2, 1].min() < 1.5  # it sags
