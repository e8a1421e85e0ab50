"""Only loose balls roll by themselves: what lies elsewhere in a scene does not make the feet of a body of springs roll."""

import numpy as np
import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.simulation.choices import turning
from taichi_sim.simulation.settings import Settings

pytestmark = pytest.mark.long_in("f32")

V, MU, G, R = 1.6, 0.25, 10.0, 0.05
STEPS, H = 300, 1e-3  # it has slipped for .3 s, and slides yet


def base(scene: ts.Scene, ground: str) -> None:
    """A floor whose top is at y = 0, on which all friction is MU."""
    scene.add_material("rough", friction=MU)
    if ground == "wall":
        scene.add_wall((0, 1, 0)[: scene.dim], 0.0, material="rough")
    elif ground == "box":
        size = (60.0, 1.0, 60.0)[: scene.dim]
        scene.add_collider(ts.Box((0, -0.5, 0)[: scene.dim], size, material="rough"))
    elif ground == "stick":
        ends = scene.add_balls([(-9.0, -0.01), (9.0, -0.01)], mass=1.0, radius=0.01, pinned=[0, 1], material="rough")
        scene.add_springs([ends], stiffness=1.0, collides=True)


def dumbbell(ground: str, dim: int) -> ts.Scene:
    """Two feet that a spring joins, slipping along the ground, and a loose ball far away."""
    scene = ts.Scene(dim=dim, gravity=(0, -G, 0)[:dim])
    base(scene, ground)
    at = np.zeros((2, dim))
    at[:, 0], at[:, 1] = (0.0, 0.3), R
    velocity = np.zeros((2, dim))
    velocity[:, 0] = V
    feet = scene.add_balls(at, mass=0.7, radius=R, velocity=velocity, material="rough")
    scene.add_springs([feet], stiffness=400.0, damping=2.0)
    scene.add_balls([(-5.0, R, 0.0)[:dim]], mass=1.0, radius=R, velocity=(V, 0, 0)[:dim], material="rough")
    return scene


@pytest.mark.long
@pytest.mark.parametrize(
    ("ground", "dim", "contacts"),
    [
        ("wall", 2, "gauss_seidel"),
        ("wall", 3, "gauss_seidel"),
        ("wall", 3, "jacobi"),
        ("box", 2, "jacobi"),
        ("box", 3, "gauss_seidel"),
        ("stick", 2, "gauss_seidel"),
        ("stick", 2, "jacobi"),
    ],
)
def test_a_bystander_does_not_make_feet_roll(ground, dim, contacts):
    """The feet lose mu g t, and only the loose ball turns: it rolls on at 2/3 (a disc) or 5/7 of its speed."""
    with simulate(dumbbell(ground, dim), contacts=contacts, dt=H) as sim:
        sim.step(STEPS)
        v = sim.velocity[-3:, 0]
        turned = np.abs(sim.snapshot().surface_speed).max(axis=1)
    assert v[:2] == pytest.approx(V - MU * G * STEPS * H, rel=0.01)
    rolls = V * {2: 2 / 3, 3: 5 / 7}[dim]
    assert v[2] == pytest.approx(rolls, rel=0.01)
    assert turned[-1] == pytest.approx(rolls, rel=0.01)
    assert not turned[:-1].any()


@pytest.mark.slow
@pytest.mark.parametrize("contacts", ["gauss_seidel", "jacobi", "sum"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.long_where(dim=2)
@pytest.mark.long_where(contacts=["jacobi", "sum"])
def test_a_loose_ball_rolls_on_one_that_does_not(dim, contacts):
    """A rough impact of a loose ball with one on a spring: each pair of masses gives and takes the same momentum, the sliding
    speed ends as 0 where friction is enough, and only the loose one turns."""
    scene = ts.Scene(dim=dim, gravity=None)
    scene.add_material("sticky", friction=5.0)
    m, M, r, R = 0.3, 0.8, 0.05, 0.07
    at = np.zeros((3, dim))
    at[1:, 0] = r + R + 1e-4, 5.0
    loose, held, far = scene.add_balls(at, mass=[m, M, 1.0], radius=[r, R, r], material="sticky")
    scene.set_balls(loose, velocity=[2.0, 0.6, 0.0][:dim])
    scene.add_springs([(held, far)], stiffness=1e-9)
    with simulate(scene, contacts=contacts, dt=1e-4, contact_iterations=4) as sim:
        sim.step(20)
        v, turn = sim.velocity, sim.snapshot().surface_speed
    turning = {2: 2.0, 3: 2.5}[dim]
    p = 0.6 / ((1 + turning) / m + 1 / M)  # which stops the slip of .6 m/s
    assert v[loose, 1] == pytest.approx(0.6 - p / m, rel=5e-3)
    assert v[held, 1] == pytest.approx(p / M, rel=5e-3)
    assert np.abs(turn[loose]).max() == pytest.approx(turning * p / m, rel=5e-3)
    assert not turn[held].any()
    assert not turn[far].any()


def test_a_disc_rolls_down_a_round_ground_and_leaves_it():
    """With so much friction it rolls until nothing presses it any more, v^2 = g D cos, where 3/4 (v^2 - v0^2) = g D (1 - cos).
    What friction has accumulated has to turn with the surface: else it holds the disc on it (the speed is then off by 5 %)."""
    large, small, push = 0.6, 0.2, 0.3
    scene = ts.Scene(dim=2, gravity=(0, -G))
    scene.add_material("sticky", friction=20.0)
    scene.add_balls([(0.0, large + small)], radius=small, velocity=[(push, 0.0)], material="sticky")
    scene.add_collider(ts.Sphere((0.0, 0.0), large, material="sticky"))
    fall = G * (large + small)
    cosine = 4 / 7 * (1 + 0.75 * (2 / 3 * push) ** 2 / fall)  # it starts without spin, and rolls at once
    with simulate(scene, dt=1e-3) as sim:
        sim.run(1.2)
        assert np.linalg.norm(sim.position[0]) > large + small + 0.01
        assert sim.velocity[0, 0] == pytest.approx(np.sqrt(fall * cosine) * cosine, rel=3e-3)


@pytest.mark.slow
def test_balls_that_a_brick_joins_do_not_rub_each_other():
    """A turning block of jelly whose balls overlap, and may touch those of other places, keeps its angular momentum."""
    scene = ts.Scene(dim=3)
    scene.add_material("rough", friction=0.7)
    more = {"radius": 0.06, "self_collision": True, "material": "rough"}
    block = ts.shapes.jelly(scene, size=(0.3, 0.2, 0.2), resolution=(4, 3, 3), density=400, young_modulus=5e5, **more)
    assert len(scene.bricks) > 0
    scene.set_balls(velocity=np.cross((0.0, 0.0, 2.0), scene.position - scene.position[block.balls].mean(axis=0)))
    with ts.Simulation(scene) as sim:
        before = sim.angular_momentum()[2]
        sim.step(20)
        assert sim.angular_momentum()[2] == pytest.approx(before, rel=1e-3)


@pytest.mark.parametrize(("friction", "loose"), [(MU, True), (0.0, False)])
def test_loose_balls_turn_where_there_is_friction(friction, loose):
    """A loose ball, a pinned one and two that a spring joins."""
    scene = ts.Scene(dim=2)
    scene.add_material("rubber", friction=friction)
    scene.add_balls([[0, 0], [1, 0], [2, 0], [3, 0]], radius=R, material="rubber", pinned=[1])
    scene.add_springs([[2, 3]], stiffness=1.0)
    assert turning(scene, Settings.resolve(scene, {})).tolist() == [loose, False, False, False]
