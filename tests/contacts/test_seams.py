"""Balls that slide over the seams of colliders whose surfaces lie in one plane: nothing lifts or brakes them."""

import numpy as np
import pytest
from physics_support import F64, box_mesh, simulate

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


def zigzag(side):
    """Vertices (60, 3) and triangles (116, 3) of a plate under y = 0, on one side of x = 0, where it has teeth of 6 cm."""
    z, n = np.linspace(-0.5, 0.5, 15), 15
    teeth = np.stack([0.06 * (np.arange(n) % 2 * 2 - 1), 0 * z, z], axis=1)
    top = np.concatenate([teeth, np.stack([np.full(n, 0.9 * side), 0 * z, z], axis=1)])
    k = np.arange(n - 1)
    above = np.concatenate([np.stack([k, k + 1, k + n + 1], axis=1), np.stack([k, k + n + 1, k + n], axis=1)])
    border = np.concatenate([np.arange(n), np.arange(2 * n - 1, n - 1, -1)])
    following = np.roll(border, -1)
    sides = [
        np.stack(three, axis=1)
        for three in ([border, border + 2 * n, following], [following, border + 2 * n, following + 2 * n])
    ]
    triangles = np.concatenate([above, above[:, ::-1] + 2 * n, *sides])
    return np.concatenate([top, top - [0.0, 0.01, 0.0]]), triangles[:, ::side]


@pytest.mark.slow
def test_nothing_is_felt_of_a_seam_of_meshes_by_balls_of_any_size():
    """Of 1.6 to 21 cells of the grid of distances; two plates with teeth, a box beside a mesh, and meshes that rise."""
    scene, radius = ts.Scene(dim=3, gravity=(0.0, -G, 0.0)), [0.022, 0.037, 0.075, 0.16, 0.3]
    scene.add_material("smooth", restitution=0.4)
    for side in (-1, 1):
        points, triangles = zigzag(side)
        scene.add_collider(ts.Mesh((points, triangles), material="smooth"))
        lifted = points + np.array([0.0, 2 * FAR, 0.0])
        scene.add_collider(ts.Mesh((lifted, triangles), velocity=(-0.2, LIFT, 0.0), material="smooth"))
    scene.add_collider(ts.Box((-0.44, FAR - 0.1, 0.0), (1.0, 0.2, 1.0), material="smooth"))
    scene.add_collider(ts.Mesh(box_mesh((0.84, 0.2, 1.0), (0.48, FAR - 0.1, 0.0)), material="smooth"))
    lane, r = (part.ravel() for part in np.meshgrid(np.arange(3), np.repeat(radius, 2), indexing="ij"))
    rise = np.where(lane == 2, LIFT, 0.0)
    x = np.stack([-0.35 - 0.1 * r, FAR * lane + r, 0.09 * (np.arange(len(r)) % 2) - 0.03], axis=1)
    v = np.stack([np.full(len(r), V), rise, np.full(len(r), 0.4)], axis=1)
    balls = scene.add_balls(x, radius=r, velocity=v, material="smooth", body=7)
    with simulate(scene, dt=H, spin=False) as sim:
        for _ in range(45):
            sim.step()
            x, speed = sim.position[balls], sim.velocity[balls]
            assert np.abs(speed - v).max() < (1e-6 if F64 else 5e-3)
            assert np.abs((x[:, 1] - FAR * lane - rise * sim.time) / r - 1).max() < (1e-6 if F64 else 5e-4)
        assert x[:, 0].min() > 0.3
