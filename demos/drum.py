"""A turning drum with four blades lifts discs of two sizes until they fall."""

import numpy as np

import taichi_sim as ts

RADIUS, TURN = 1.2, 69.0  # m, degrees per second


def scene(turn=TURN, friction=0.6, restitution=0.2):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.output = {"fps": 60, "duration": 5, "size": (960, 720)}
    scene.settings = {"dt": 0.002, "substeps": 3}
    rubber = scene.add_material("rubber", restitution=restitution, friction=friction)
    small = {"resolution": (17, 11), "radius": 0.04, "jitter": 0.1, "position": (-0.74, -0.5)}
    large = {"resolution": (6, 2), "radius": 0.09, "mass": 5.0, "jitter": 0.1, "position": (-0.55, 0.54)}
    for grains in (small, large):
        ts.shapes.pile(scene, material=rubber, **grains)
    scene.add_collider(ts.Sphere((0, 0), RADIUS, hollow=0.1, rotation_rate=turn, material=rubber))
    for angle in np.radians([0, 90, 180, 270]):
        out = np.array([np.cos(angle), np.sin(angle)])
        blade = {"start": RADIUS * out, "end": 0.8 * RADIUS * out, "radius": 0.05, "pivot": (0, 0)}
        scene.add_collider(ts.Capsule(**blade, rotation_rate=turn, material=rubber))
    return scene


def check(sim):
    out = np.linalg.norm(sim.position, axis=1) + sim.scene.radius
    assert out.max() < RADIUS + 0.1 * 0.04  # none left the drum
    assert sim.penetration() < 0.1 * 0.04
    assert sim.position[:, 1].max() > 0.3  # lifted above half of the drum
    assert sim.position[:, 0].mean() > 0.05  # a heap on the side that rises
