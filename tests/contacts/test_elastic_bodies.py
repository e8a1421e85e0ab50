"""Bodies of springs and elements that bounce without loss: forces that change within the step of an impact add no energy."""

import numpy as np
import pytest
from physics_support import F64, error, simulate

import taichi_sim as ts
from taichi_sim.shapes import cloth, jelly

pytestmark = pytest.mark.long_in("f32")

SPEED, COUNT, APART = 1.7, 6, 1.5


def thrown(kind, target):
    """Bodies that come down on a wall, each on a pinned ball or each on one of its own weight, at other parts of a step."""
    scene = ts.Scene(dim=2)
    scene.add_material("steel", restitution=1.0)
    if target == "wall":
        scene.add_wall((0, 1), 0.0, "steel")
        scene.add_probe("floor", "impulse", wall=0)
    made_of = {"stiffness": 1.4e4, "mass": 5.0}
    if kind == "bricks":
        made_of = {"young_modulus": 3e4, "poisson_ratio": 0.35, "density": 90.0}
    for k in range(COUNT):
        at = (APART * k, 0.06 + 0.0017 * k)
        if target != "wall":
            under = (at[0] + 0.13, -0.16)
            scene.add_balls([under], radius=0.16, mass=4.0, pinned=target == "pinned", material="steel")
        jelly(scene, (0.28, 0.22), (5, 4), position=at, velocity=(0, -SPEED), damping=0.0, material="steel", **made_of)
    return scene


@pytest.mark.parametrize(
    ("kind", "target", "method", "most"),
    [
        pytest.param("springs", "pinned", "verlet", 0.01, marks=pytest.mark.slow),
        pytest.param("bricks", "pinned", "verlet", 0.01, marks=pytest.mark.slow),
        pytest.param("bricks", "free", "verlet", 0.015, marks=pytest.mark.long),
        pytest.param("springs", "wall", "verlet", 0.01, marks=pytest.mark.long),
        pytest.param("bricks", "wall", "tr_bdf2", 0.03, marks=pytest.mark.slow),
        pytest.param("springs", "pinned", "tr_bdf2", 0.03, marks=pytest.mark.long),
        pytest.param("bricks", "free", "tr_bdf2", 0.03, marks=pytest.mark.long),
    ],
)
def test_an_elastic_impact_adds_no_energy(kind, target, method, most):
    """At the automatic step, of the energy of the fall; and momentum is what it was, or what the wall says."""
    with simulate(thrown(kind, target), integrator=method) as sim:
        start, momentum = sim.energy().total, sim.momentum()
        sim.run(0.3)
        if target != "pinned":
            given = [sim.probes()[f"floor.{axis}"] for axis in "xy"] if target == "wall" else 0.0
            assert error(sim.momentum() + given, momentum, COUNT * 5.0 * SPEED) < (1e-10 if F64 else 1e-4)
        if target != "free":
            assert np.all(sim.velocity.reshape(COUNT, -1, 2)[..., 1].mean(axis=1) > 0.2 * SPEED)
        assert abs(sim.energy().total / start - 1.0) < most


def struck(kind):
    """Bodies at rest, each with a ball that comes down between two to four balls of its upper side."""
    scene = ts.Scene(dim=3 if kind == "cloth" else 2)
    scene.add_material("steel", restitution=1.0)
    if kind == "cloth":
        yarns = {"warp": 340.0, "mass_per_area": 0.5, "damping": 0.0}
        cloth(scene, (1.0, 1.0), (9, 9), pinned="border", material="steel", **yarns)
        at = scene.position.mean(axis=0) + np.array([0.06, 0.11, 0.065])
        scene.add_balls([at], radius=0.05, mass=0.7, velocity=[(0, -SPEED, 0)], material="steel")
        return scene
    for k in range(COUNT):
        brick = {"young_modulus": 4e4, "poisson_ratio": 0.25, "density": 80.0}
        jelly(scene, (0.36, 0.18), (9, 5), position=(APART * k, 0.0), damping=0.0, material="steel", **brick)
        at = (APART * k + 0.18 + 0.004 * k, 0.27)
        scene.add_balls([at], radius=0.055, mass=1.1, velocity=[(0, -SPEED)], material="steel")
    return scene


@pytest.mark.parametrize(
    ("kind", "method", "loss"),
    [
        pytest.param("bricks", "verlet", 0.01, marks=pytest.mark.slow),
        pytest.param("cloth", "verlet", 0.01, marks=pytest.mark.slow),
        pytest.param("bricks", "tr_bdf2", 0.05, marks=pytest.mark.slow),
    ],
)
def test_two_impacts_in_one_step_add_no_energy(kind, method, loss):
    """Of one ball with two of a body, on average over the waves that go through it afterwards, of which TR-BDF2 damps the
    fastest."""
    with simulate(struck(kind), integrator=method) as sim:
        start, momentum = sim.energy().total, sim.momentum()
        sim.run(0.15)
        after = []
        for _ in range(20):
            sim.step(2)
            after.append(sim.energy().total)
        if kind == "bricks":
            assert error(sim.momentum(), momentum, COUNT * 1.1 * SPEED) < (1e-10 if F64 else 1e-4)
            assert np.all(sim.velocity.reshape(COUNT, -1, 2)[:, -1, 1] > 0.1 * SPEED)
        assert -loss < np.mean(after) / start - 1.0 < 0.01


def test_a_ball_on_a_spring_keeps_bouncing_off_another():
    """Thousands of times, at any part of a step: the energy that the method keeps does not drift."""
    scene, stiffness = ts.Scene(dim=2), np.array([400.0, 900.0, 2500.0])
    scene.add_material("steel", restitution=1.0)
    for k in range(3):
        anchor = scene.add_balls([(0.9, k)], radius=0.05, pinned=True, material="steel")
        ball = scene.add_balls([(0.13, k)], radius=0.05, mass=1.0, material="steel")
        scene.add_balls([(0.0, k)], radius=0.05, pinned=True, material="steel")
        scene.add_springs([(*anchor, *ball)], stiffness=stiffness[k], rest_length=0.83)
    step = 8e-3
    with simulate(scene, dt=step, substeps=1) as sim:
        parts = []
        for _ in range(80):
            sim.step(37)
            x, v = sim.position[1::3, 0], sim.velocity[1::3, 0]
            parts.append(0.5 * v**2 + 0.5 * stiffness * (x - 0.07) ** 2 * (1.0 - 0.25 * stiffness * step**2))
        for half in (parts[:40], parts[40:]):
            np.testing.assert_allclose(np.mean(half, axis=0), 0.5 * stiffness * 0.06**2, rtol=0.06)
