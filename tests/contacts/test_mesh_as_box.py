"""A block as a mesh acts as the box of its size, and as one seen in flight: crowds in a cell, large balls, spinning bullets."""

import numpy as np
import pytest
from physics_support import F64, box_mesh, simulate

import taichi_sim as ts

H, STEPS = 1 / 300, 60
SIZE = np.array([0.8, 1.2, 1.0])  # m
VELOCITY, ALONG = np.array([0.5, -0.3, 0.4]), np.array([1.7, 0.6, -1.1])  # m/s
TURNING = np.array([40.0, -70.0, 55.0])  # degrees/s
CROWD, LARGE, BULLETS = 40, 12, 40
RADIUS = np.repeat([0.004, 1.7, 0.03], [CROWD, LARGE, BULLETS])  # m, beside cells of 75 mm and a block of up to 1.2 m
NEAR = 1e-8 if F64 else 1e-4  # of the speed


def shots():
    """Positions, velocities and speeds of the surface by spin (n, 3): of balls that fall on one cell, of some larger than the
    block, and of bullets of ten radii a step."""
    rng = np.random.default_rng(11)
    above = np.array([0.1, SIZE[1] / 2 + 0.05, 0.1]) + rng.uniform(-0.02, 0.02, (CROWD, 3))
    falls = np.tile([0.2, -2.5, 0.1], (CROWD, 1)) + rng.uniform(-0.5, 0.5, (CROWD, 3))
    out = rng.normal(size=(LARGE + BULLETS, 3))
    out /= np.linalg.norm(out, axis=1)[:, None]
    x = out * np.repeat([2.6, 2.0], [LARGE, BULLETS])[:, None]
    aim = rng.uniform(-0.3, 0.3, out.shape) * SIZE
    v = (aim - x) / np.linalg.norm(aim - x, axis=1)[:, None]
    v *= np.repeat([5.0, 10 * 0.03 / H], [LARGE, BULLETS])[:, None]
    return np.concatenate([above, x]), np.concatenate([falls, v]) + VELOCITY, 2.0 * rng.normal(size=(len(RADIUS), 3))


@pytest.mark.slow
def test_a_mesh_acts_as_the_box_of_its_shape_and_as_one_seen_in_flight():
    scene = ts.Scene(dim=3)
    scene.add_material("rubber", restitution=0.7, friction=0.4)
    x, v, surface = shots()
    moves = {"rotation_rate": TURNING, "material": "rubber"}
    block = box_mesh(SIZE)
    scene.add_collider(ts.Box((0, 0, 0), SIZE, velocity=VELOCITY, group="m0", **moves))
    scene.add_collider(ts.Mesh(block, resolution=16, velocity=VELOCITY, group="m1", **moves))
    scene.add_collider(ts.Mesh(block, resolution=16, velocity=VELOCITY + ALONG, group="m2", **moves))
    balls = [
        scene.add_balls(x, radius=RADIUS, velocity=v + (k == 2) * ALONG, material="rubber", body=3, group=f"b{k}",
                        collides_with=[f"m{k}"])
        for k in range(3)
    ]  # fmt: skip
    with simulate(scene, dt=H) as sim:
        sim.resume(ts.Snapshot(scene.position, scene.velocity, surface_speed=np.tile(surface, (3, 1))))
        sim.step(STEPS)
        position, velocity, turning = sim.position, sim.velocity, sim.angular_velocity
    box, mesh, flying = (np.stack([position[b], velocity[b]]) for b in balls)
    flying -= np.stack([np.tile(STEPS * H * ALONG, (len(x), 1)), np.tile(ALONG, (len(x), 1))])
    met = np.linalg.norm(box[1] - v, axis=1) > 0.1
    assert met.sum() > 0.8 * len(met)
    speed = np.linalg.norm(v, axis=1)[:, None]
    for other, b in ((mesh, balls[1]), (flying, balls[2])):
        assert np.abs((other[1] - box[1]) / speed).max() < NEAR
        assert np.abs((other[0] - box[0]) / speed).max() < NEAR
        assert np.abs((turning[b] - turning[balls[0]]) * RADIUS[:, None] / speed).max() < NEAR


def bin_mesh(half, wall, height):
    """Vertices and triangles of a square bin, open at the top, its inner side 2 (half - wall) wide and its floor at 0 [m]."""

    def ring(a, y):
        return [(-a, y, -a), (a, y, -a), (a, y, a), (-a, y, a)]

    corners = [*ring(half, -wall), *ring(half, height), *ring(half - wall, height), *ring(half - wall, 0.0)]
    triangles = [(0, 1, 2), (0, 2, 3), (12, 14, 13), (12, 15, 14)]
    for first in (0, 4, 8):
        for k in range(4):
            p, q = first + k, first + (k + 1) % 4
            triangles += [(p, p + 4, q), (q, p + 4, q + 4)]
    return np.array(corners), np.array(triangles)


@pytest.mark.slow
@pytest.mark.long_in("f64")  # which has no tolerance of its own
def test_balls_wider_than_cells_come_to_rest_in_the_corners_of_a_bin():
    """Distances halfway between two faces are those of the nearer one, at any depth of the corner: values that interpolate
    across that threw such balls out."""
    scene, half, wall = ts.Scene(dim=3, gravity=(3.0, -9.0, 0.0)), 0.6, 0.1
    scene.add_material("rubber", restitution=0.2, friction=0.2)
    scene.add_collider(ts.Mesh(bin_mesh(half, wall, 0.5), material="rubber"))
    radius = np.array([0.045, 0.07, 0.11])  # 2 to 6 cells
    inner = half - wall
    start = np.stack([inner - radius - 0.03, radius + 0.02, np.array([-0.4, -0.1, 0.3])], axis=1)
    scene.add_balls(start, radius=radius, mass=1.0, material="rubber", body=1)
    with simulate(scene, dt=5e-4) as sim:
        energies = [sim.energy().total]
        for _ in range(60):
            sim.run(0.02)
            energies.append(sim.energy().total)
        assert np.diff(energies).max() < 2e-3
        assert np.linalg.norm(sim.velocity, axis=1).max() < 0.01
        x = sim.position
    assert np.abs(x[:, 0] - (inner - radius)).max() < 2e-3
    assert np.abs(x[:, 1] - radius).max() < 2e-3
