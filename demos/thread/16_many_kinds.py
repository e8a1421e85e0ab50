"""Many kinds: heavy and light balls on a net of sticks, held up by springs that nothing collides with."""

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.spring_units import spring_from_rates

WEIGHT = 10 * (21 * 0.5 + 3 * 2 + 12 * 0.2)  # N, of all balls that are not pinned


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.settings = {"dt": 0.001}
    scene.output = {"fps": 60, "duration": 6, "size": (1280, 720)}
    scene.add_material("rope", friction=0.3)
    scene.add_material("rubber", restitution=0.3, friction=0.3)
    across = np.linspace(-2, 2, 21)
    net = scene.add_balls(np.stack([across, 0.15 * across**2], axis=1), mass=0.5, radius=0.04, material="rope")
    hooks = scene.add_balls([[-2.4, 1.3], [2.4, 1.3]], radius=0.08, pinned=True)
    scene.add_springs(np.stack([net[:-1], net[1:]], axis=1), collides=True, **spring_from_rates(100000, 400, 0.5, 0.5))
    scene.add_springs([[net[0], hooks[0]], [net[-1], hooks[1]]], stiffness=3000, damping=200, rest_length=0.7)
    scene.add_balls([[-0.8, 1.1], [0, 1.4], [0.8, 1.1]], mass=2, radius=0.2, material="rubber")
    light = np.stack([np.tile(np.linspace(-1.2, 1.2, 6), 2), np.repeat([1.8, 2.1], 6)], axis=1)
    scene.add_balls(light, mass=0.2, radius=0.09, material="rubber")
    scene.add_wall((0, 1), -1)
    return scene


def check(sim):
    r = np.diff(sim.position[sim.scene.pairs[-2:]], axis=1)[:, 0]
    length = np.linalg.norm(r, axis=1)
    lift = np.sum(3000 * (length - 0.7) * r[:, 1] / length)
    np.testing.assert_allclose(lift, WEIGHT, rtol=0.03)
    assert np.linalg.norm(sim.velocity, axis=1).max() < 0.5
