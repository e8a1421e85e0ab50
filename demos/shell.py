"""A rubber ring, a hollow shell of triangles, drops on its rim, bounces, wobbles and topples over."""

import numpy as np

import taichi_sim as ts
from taichi_sim.geometry.mesh import Surface

AROUND, ACROSS = 48, 24  # vertices
LARGE, SMALL, MASS = 0.5, 0.2, 2.0


def ring():
    u, v = np.meshgrid(np.arange(AROUND), np.arange(ACROSS), indexing="ij")
    a, b = 2 * np.pi * u / AROUND, 2 * np.pi * (v + u / 2) / ACROSS  # skewed: nearly equilateral triangles
    reach = LARGE + SMALL * np.cos(b)
    vertices = np.stack([reach * np.cos(a), reach * np.sin(a), SMALL * np.sin(b)], axis=-1).reshape(-1, 3)
    here = u * ACROSS + v
    right, up, across = (np.roll(here, shift, (0, 1)) for shift in ((-1, 0), (0, -1), (-1, -1)))
    corners = [(here, right, up), (right, across, up)]
    return Surface(vertices, np.concatenate([np.stack([c.ravel() for c in three], axis=1) for three in corners]))


def scene(mass=MASS, stiffness=6000.0, bending_stiffness=4000.0, restitution=0.5, friction=0.4):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 4, "size": (1280, 720)}
    scene.add_material("rubber", restitution=restitution, friction=friction)
    scene.add_wall((0, 1, 0), material="rubber")
    ts.shapes.cloth(
        scene,
        mesh=ring(),
        mass=mass,
        stiffness=stiffness,
        bending_stiffness=bending_stiffness,
        damping=0.05,
        radius=0.02,
        material="rubber",
        position=(0, 1.2, 0),
        rotation=(-25, 30, 0),
        colour=(0.95, 0.62, 0.2),
    )
    return scene


def check(sim):
    height = sim.position[:, 1]
    assert height.min() > 0.01
    np.testing.assert_allclose(height.mean(), SMALL + 0.02, rtol=0.05)  # it lies on its side, round as before
    np.testing.assert_allclose(np.ptp(height), 2 * SMALL, rtol=0.05)
    assert sim.energy().spring < 0.01 * MASS * 10 * 1.2  # of what it fell with
