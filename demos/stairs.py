"""A jelly cow tumbles down a staircase."""

import numpy as np

import taichi_sim as ts
from taichi_sim.geometry.level_set import level_set

STEPS, RISE, TREAD = 7, 0.3, 0.75


def body(p):
    """Negative inside: ellipsoids, as (centre, half axes), that melt into each other."""
    parts = [
        ((0, 0.55, 0), (0.45, 0.26, 0.24)),
        ((0.5, 0.78, 0), (0.2, 0.17, 0.15)),
        ((0.66, 0.72, 0), (0.13, 0.11, 0.11)),
    ]
    parts += [((0.42, 0.95, z), (0.05, 0.1, 0.05)) for z in (-0.13, 0.13)]
    parts += [((x, 0.22, z), (0.09, 0.27, 0.09)) for x in (-0.28, 0.28) for z in (-0.15, 0.15)]
    return -np.log(sum(np.exp(14 - 14 * np.linalg.norm((p - c) / r, axis=-1)) for c, r in map(np.array, parts)))


def scene(young_modulus=2e6, poisson_ratio=0.4, friction=0.5, speed=2.6):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 4, "size": (1280, 720)}
    scene.add_material("jelly", restitution=0.1, friction=friction)
    scene.add_wall((0, 1, 0), material="jelly")
    for k in range(STEPS):
        top, first = RISE * (STEPS - k), 0.0 if k else 1.0  # the landing is longer
        place, size = (TREAD * (k + 0.5) - first / 2, top / 2, 0), (TREAD + first, top, 2.4)
        scene.add_collider(ts.Box(place, size, material="jelly", colour=(0.8, 0.78, 0.74)))
    cow = ts.shapes.jelly(
        scene,
        mesh=level_set(body, (-0.7, -0.2, -0.5), (1.0, 1.3, 0.5), 0.038),
        density=300,
        young_modulus=young_modulus,
        poisson_ratio=poisson_ratio,
        spacing=0.08,
        radius=0.04,
        self_collision=True,
        material="jelly",
        position=(-0.2, RISE * STEPS + 0.35, 0),
        rotation=(0, 0, -18),
        colour=(0.95, 0.85, 0.8),
    )
    scene.output["camera"] = {"azimuth": 32, "elevation": 20, "distance": 6.5, "follow": cow.balls.tolist()}
    scene.set_balls(velocity=(speed, 0, 0.1))
    return scene


def check(sim):
    assert sim.inverted() == 0
    assert sim.position[:, 0].mean() > 2 * TREAD  # it came down
    assert sim.position[:, 1].min() > 0.0
