"""Balls of any size that hit edges and corners of meshes: direction, place and energy after the impact in closed form."""

import numpy as np
import pytest
from physics_support import F64, box_mesh, simulate

import taichi_sim as ts

H, SPEED = 1 / 300, 6.0
SIZE = np.array([0.8, 1.2, 1.0])  # m
STEPS = 70


def strikes():
    """Radius (n), direction to the centre at impact (n, 3) and nearest point of a block (n, 3): at its edge, then its corner."""
    radius, part = (q.ravel() for q in np.meshgrid([0.05, 0.1, 0.3], np.linspace(0.08, 0.85, 6), indexing="ij"))
    along = np.linspace(-0.3, 0.3, len(part))
    turn = np.linspace(0.2, 1.3, len(part))
    edge = np.stack([part, np.sqrt(1 - part**2), 0 * part], axis=1)
    corner = np.stack([part * np.cos(turn), np.sqrt(1 - part**2), part * np.sin(turn)], axis=1)
    at_edge = SIZE / 2 * np.stack([1 + 0 * along, 1 + 0 * along, 2 * along], axis=1)
    at_corner = SIZE / 2 * np.ones((len(part), 3))
    return np.tile(radius, 2), np.concatenate([edge, corner]), np.concatenate([at_edge, at_corner])


@pytest.mark.slow
def test_impacts_at_edges_and_corners_have_the_direction_from_the_nearest_point():
    """Balls of 0.7 to 16 cells; of each resolution one block stands and one moves, each in a group of its own."""
    scene = ts.Scene(dim=3)
    scene.add_material("elastic", restitution=1.0)
    radius, n, point = strikes()
    balls, own = [], []
    for k, (resolution, moves) in enumerate([(16, 0.0), (64, 0.0), (16, 1.3), (64, 1.3)]):
        velocity = np.array([0.4, 1.0, -0.7]) * moves
        scene.add_collider(
            ts.Mesh(box_mesh(SIZE), velocity=velocity, resolution=resolution, material="elastic", group=f"m{k}")
        )
        time = 0.1 + 0.07 * np.sin(7.0 * np.arange(len(n)))  # of the impact
        down = velocity - [0.0, SPEED, 0.0]
        x = point + radius[:, None] * n + time[:, None] * (velocity - down)
        balls.append(
            scene.add_balls(
                x, radius=radius, velocity=down, material="elastic", body=1, group=f"b{k}", collides_with=[f"m{k}"]
            )
        )
        own.append((velocity, time))
    with simulate(scene, dt=H, spin=False) as sim:
        sim.step(STEPS)
        position, speed = sim.position, sim.velocity
    end, fall = STEPS * H, np.array([0.0, -SPEED, 0.0])
    for b, (velocity, time) in zip(balls, own):
        after = fall - 2 * (n @ fall)[:, None] * n
        found = speed[b] - velocity
        angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(found, after), axis=1), np.sum(found * after, axis=1)))
        expected = point + radius[:, None] * n + (end - time)[:, None] * after + end * velocity
        assert angle.max() < (1e-5 if F64 else 0.01)
        assert np.abs(np.linalg.norm(found, axis=1) / SPEED - 1).max() < (1e-12 if F64 else 1e-5)
        assert np.abs(position[b] - expected).max() < (1e-6 if F64 else 1e-4)
