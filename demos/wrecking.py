"""A wrecking ball on a chain swings into a wall of trusses."""

import numpy as np

import taichi_sim as ts

CELL, COLUMNS, ROWS, WALLS = 0.22, 4, 12, 3
PIVOT, LINKS, LENGTH = (-0.8, 4.6), 16, 2.9


def scene(mass=150.0, break_strain=0.03, stiffness=20000.0):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.output = {"fps": 60, "duration": 5, "size": (1280, 720)}
    scene.settings = {"spin": False}
    scene.add_material("steel", restitution=0.1, friction=0.5)
    scene.add_wall((0, 1), material="steel")
    scene.add_wall((-1, 0), offset=-4.9, material="steel")
    for wall in range(WALLS):
        index = np.arange((COLUMNS + 1) * (ROWS + 1)).reshape(COLUMNS + 1, ROWS + 1)
        place = np.argwhere(index >= 0) * CELL + (wall * 1.3, 0.11)
        colour = ((0.75, 0.45, 0.3), (0.6, 0.55, 0.45), (0.45, 0.5, 0.55))[wall]
        balls = scene.add_balls(place, radius=0.105, mass=0.4, material="steel", colour=colour)
        sides = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:])]
        sides += [(index[:-1, :-1], index[1:, 1:]), (index[:-1, 1:], index[1:, :-1])]
        pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in sides])
        scene.add_springs(balls[pairs], stiffness=stiffness, damping=5, break_strain=break_strain)
    down = np.array([-0.92, -0.39])  # the chain at the start
    links = np.array(PIVOT) + np.linspace(0, LENGTH, LINKS)[:, None] * down
    chain = scene.add_balls(links, radius=0.04, mass=0.5, pinned=[0], material="steel", body=scene.new_body())
    ball = scene.add_balls(links[-1] + 0.34 * down, radius=0.3, mass=mass, material="steel", colour=(0.2, 0.2, 0.22))
    joined = np.append(chain, ball)
    scene.add_springs(np.stack([joined[:-1], joined[1:]], axis=1), stiffness=200000, damping=60)
    return scene


def check(sim):
    assert np.count_nonzero(sim.torn) > 20  # it broke something
    assert sim.position[:, 1].min() > -0.01
