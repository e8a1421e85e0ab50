"""A jelly cube lands on an edge among loose balls, bounces, wobbles and sends them rolling."""

import numpy as np

import taichi_sim as ts

SIDE, MASS, LOOSE = 0.8, 60.0, 75


def scene(mass=MASS, stiffness=1800.0, damping=0.15, loose=LOOSE):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 4.5, "size": (1280, 720), "subdivide": 1, "stage": "paper"}
    scene.output["looks"] = [{"of": "jelly_0", "gloss": 0.6, "translucency": 0.4}]
    scene.output["camera"] = {"target": (0.1, 0.45, 0.0), "distance": 6.4, "azimuth": 30.0, "elevation": 18.0}
    scene.settings = {"dt": 1 / 1200}  # at 1 ms a loose ball that the cube pinches sinks in by half its radius
    scene.add_material("jelly", restitution=0.2, friction=0.3)
    scene.add_material("rubber", restitution=0.6, friction=0.02)
    scene.add_wall((0, 1, 0), material="jelly")
    ts.shapes.jelly(
        scene,
        size=(SIDE, SIDE, SIDE),
        resolution=(11, 11, 11),
        mass=mass,
        stiffness=stiffness,
        damping=damping,
        material="jelly",
        position=(-0.2, 0.6, -0.5),
        rotation=(18, 25, 28),
        colour=(0.86, 0.22, 0.32),
    )
    turn = np.pi * (3 - 5**0.5) * np.arange(loose)  # the golden angle: an even spread over a disc
    reach = 0.12 * np.sqrt(np.arange(loose) + 0.5)
    radius = 0.045 + 0.009 * (np.arange(loose) * 7 % 5)
    place = np.stack([reach * np.cos(turn), radius, reach * np.sin(turn)], axis=1)
    for k, colour in enumerate(((0.95, 0.72, 0.25), (0.2, 0.58, 0.6), (0.93, 0.9, 0.82))):
        own = slice(k, None, 3)
        mass = 1200 * radius[own] ** 3
        scene.add_balls(place[own], radius=radius[own], mass=mass, material="rubber", colour=colour)
    return scene


def check(sim):
    jelly, loose = np.split(sim.position, [11**3])
    np.testing.assert_allclose(jelly[:, 1].mean(), SIDE / 2 + 0.036, rtol=0.08)  # it stands on its lowest balls
    assert jelly[:, 1].min() > 0.02
    assert np.abs(sim.frame().strain).mean() < 0.02  # the cube has its shape back
    assert sim.energy().total < 0.6 * MASS * 10 * 1.1  # of what it fell with
    assert np.linalg.norm(loose[:, [0, 2]], axis=1).max() > 1.2
