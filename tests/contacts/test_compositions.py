"""Compositions of several parts keep the laws of each: solids that collide, fabrics that tear, Jacobi, seams of meshes."""

import numpy as np
import pytest
from element_blocks import mesh
from physics_support import F64, box_mesh, error, simulate

import taichi_sim as ts
from taichi_sim.analysis import diagnostics

pytestmark = [pytest.mark.slow, pytest.mark.long_in("f32")]


def skin(corners):
    """Outer faces (t, 3) of tetrahedra (e, 4)."""
    faces = np.concatenate([corners[:, three] for three in ([1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1])])
    _, at, often = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[at[often == 1]]


def test_solids_with_colliding_surfaces_push_each_other_away():
    """A block flies into another: momenta stay, energy does not grow, no surface crosses one, and they part."""
    points, corners = mesh((2, 2, 2), 0.1)
    scene, size = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0)), 0.1
    blocks = []
    for place, speed in (((0.0, 0.0, 0.0), 0.0), ((0.23, 0.07, 0.04), -1.3)):
        x = size * points + place
        balls = scene.add_balls(x, radius=0.008, mass=0.02, velocity=(speed, 0.0, 0.0), body=scene.new_body())
        scene.add_solids(balls[corners], young_modulus=2e4, poisson_ratio=0.4)
        scene.add_triangles(balls[skin(corners)], collides=True)
        blocks.append(balls)
    with simulate(scene) as sim:
        start, momentum, turning = sim.energy().total, sim.momentum(), sim.angular_momentum()
        for _ in range(15):
            sim.run(0.01)
            assert sim.crossings() == 0
            assert sim.energy().total < 1.01 * start
        scale = 27 * 0.02 * 1.3
        assert error(sim.momentum(), momentum, scale) < (1e-10 if F64 else 1e-4)
        assert error(sim.angular_momentum(), turning, scale) < 0.01
        speed = [sim.velocity[balls, 0].mean() for balls in blocks]
    assert speed[0] < speed[1] - 0.1  # they part
    assert speed[0] < -0.4


def test_a_fabric_tears_across_and_then_holds_nothing():
    """Pulled apart by pins it comes into two pieces without strain; its energy is that of what is whole."""
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    sheet = ts.shapes.cloth(
        scene,
        (0.8, 0.3),
        (9, 4),
        warp=300.0,
        weft=200.0,
        shear=50.0,
        damping=0.02,
        mass_per_area=0.2,
        break_strain=0.15,
    )
    x = scene.position
    left, right = (sheet.balls[np.abs(x[:, 0] - end) < 1e-6] for end in (0.0, 0.8))
    scene.set_balls(left, pinned=True)
    scene.add_moving_pins(right, path=[(0.0, (0, 0, 0)), (1.0, (0.6, 0, 0))])
    with simulate(scene, contacts="off") as sim:
        stored = []
        for _ in range(30):
            sim.run(1 / 30)
            stored.append(sim.energy().spring)
        torn, x, v = sim.torn, sim.position, sim.velocity
        expected = diagnostics.energy(scene, x, v, torn=torn).spring
        assert sim.energy().spring == pytest.approx(expected, rel=1e-6 if F64 else 1e-3, abs=1e-6)
    assert 0 < np.count_nonzero(torn) < scene.n_springs
    pairs = scene.pairs[~torn]
    joined = np.arange(scene.n_balls)
    for _ in range(scene.n_balls):
        np.minimum.at(joined, pairs[:, 0], joined[pairs[:, 1]])
        np.minimum.at(joined, pairs[:, 1], joined[pairs[:, 0]])
    assert not np.isin(joined[right], joined[left]).any()
    assert stored[-1] < 0.05 * max(stored)


@pytest.mark.parametrize(("made_of", "radius"), [(ts.Box, 0.04), (ts.Mesh, 0.02), (ts.Mesh, 0.04)])
def test_balls_slide_over_the_seam_of_two_thin_plates(made_of, radius):
    """Plates thinner than a tenth of a ball: nothing lifts, brakes or lets through what slides across."""
    scene, thick = ts.Scene(dim=3, gravity=(0.0, -10.0, 0.0)), 0.002
    scene.add_material("smooth", restitution=0.4)
    for low, high in ((-1.0, 0.0), (0.0, 1.0)):
        middle, size = (0.5 * (low + high), -0.5 * thick, 0.0), (1.0, thick, 1.0)
        placed = (middle, size) if made_of is ts.Box else (box_mesh(size, middle),)
        scene.add_collider(made_of(*placed, material="smooth"))
    k = np.arange(9)
    x = np.stack([-0.3 - 0.011 * k, np.full(9, radius), 0.1 * (k - 4)], axis=1)
    balls = scene.add_balls(x, radius=radius, velocity=(4.0, 0.0, 0.3), material="smooth", body=3)
    with simulate(scene, dt=1e-3, spin=False) as sim:
        for _ in range(15):
            sim.step(10)
            x, v = sim.position[balls], sim.velocity[balls]
            assert np.abs(x[:, 1] / radius - 1.0).max() < 1e-3
            assert np.abs(v - (4.0, 0.0, 0.3)).max() < 1e-3
        assert x[:, 0].min() > 0.2
