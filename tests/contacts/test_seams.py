"""Balls that slide over the seams of colliders whose surfaces lie in one plane: nothing lifts or brakes them."""

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f64")  # rounding is what made seams felt at short steps

G, H, V, R = 10.0, 1e-3, 17.0, 0.08
LIFT = 0.6  # m/s
FAR = 6.0  # m between lanes, one above the other: no lane's ball gets to another's
NOTHING_UP = 1e-6 if F64 else 1e-4  # m/s, where the edge of the next collider gave 0.2


def lanes():
    """A scene of lanes and their heights: two boxes, steps of 5 cm, a wall beside a box, boxes that rise, two of one place turned
    by a quarter, the tops of discs and boxes; the ball of each starts at x = -0.3."""
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("smooth", restitution=0.4)
    scene.add_wall((0.0, 1.0), 0.0, "smooth")
    top = [FAR * k for k in range(5)]
    scene.add_collider(ts.Box((10.0, -0.5), (20.0, 1.0), material="smooth"))
    for x in (-10.0, 10.0):
        scene.add_collider(ts.Box((x, top[1] - 0.5), (20.0, 1.0), material="smooth"))
        scene.add_collider(ts.Box((x, top[2] - 0.5), (19.5, 1.0), material="smooth"))
        scene.add_collider(ts.Box((x, top[3] - 0.5), (20.0, 1.0), velocity=(-0.2, LIFT), material="smooth"))
        scene.add_collider(ts.Box((x, top[4] - 0.5), (1.0, 20.0), rotation=90, material="smooth"))
    for k in range(10):
        scene.add_collider(ts.Box((0.05 * k - 0.225, top[2] - 0.5), (0.05, 1.0), material="smooth"))
    balls = []
    for k, y in enumerate(top):
        x = np.stack([-0.3 - 0.0137 * np.arange(4), np.full(4, y + R)], axis=1)
        v = (V, LIFT if k == 3 else 0.0)
        balls.append(scene.add_balls(x, radius=R, velocity=v, material="smooth", body=7))
    return scene, np.concatenate(balls), np.repeat(top, 4), np.repeat([0.0, 0.0, 0.0, LIFT, 0.0], 4)


def test_nothing_is_felt_of_a_seam():
    scene, balls, top, rise = lanes()
    with simulate(scene, dt=H, spin=False) as sim:
        for _ in range(45):
            sim.step()
            x, v = sim.position[balls], sim.velocity[balls]
            assert np.abs(v[:, 1] - rise).max() < NOTHING_UP
            assert np.abs(x[:, 1] - R - top - rise * sim.time).max() < (1e-6 if F64 else 2e-4) * R
        assert np.abs(v[:, 0] / V - 1).max() < 1e-6
        assert x[:, 0].min() > 0.3


@pytest.mark.slow
def test_a_step_up_is_still_felt_and_a_crowd_slides_on():
    """A train of balls that touch crosses a seam and stays on the plane; where the next box is higher by a hundredth of the
    radius, a ball is thrown up by the slope of its edge."""
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("smooth")
    for x in (-10.0, 10.0):
        scene.add_collider(ts.Box((x, -0.5), (20.0, 1.0), material="smooth"))
        scene.add_collider(ts.Box((x, FAR - 0.5 + 0.01 * R * (x > 0)), (20.0, 1.0), material="smooth"))
    train = np.stack([-0.2 - 2 * R * np.arange(6), np.full(6, R)], axis=1)
    balls = scene.add_balls(train, radius=R, velocity=(5.0, 0.0), material="smooth")
    lone = scene.add_balls([[-0.2, FAR + R]], radius=R, velocity=(5.0, 0.0), material="smooth")
    up, thrown = 0.0, 0.0
    with simulate(scene, dt=H) as sim:
        for _ in range(250):
            sim.step()
            v = sim.velocity
            up, thrown = max(up, v[balls, 1].max()), max(thrown, v[lone[0], 1])
        x = sim.position
    assert up < 0.01
    assert np.abs(x[balls, 1] - R).max() < 0.005 * R
    slope = np.sqrt(2 * 0.01)  # of the edge where the ball meets it
    assert thrown == pytest.approx(5.0 * slope, rel=0.1)
    assert x[balls, 0].min() > 0.0
