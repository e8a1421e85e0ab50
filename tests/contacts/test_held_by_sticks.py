"""Loose sticks that carry something: what lies on them stays there, whatever it weighs."""

import numpy as np
import pytest

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f32")

R = 0.04


def bridge(heavy, restitution=0.0, drop=0.0, at=(0.1,)):
    """A stick of two balls of 2 kg on two pinned balls, and others on it."""
    scene = ts.Scene(2, (0.0, -9.0))
    scene.add_material("m", restitution=restitution)
    scene.add_balls([[-0.3, 0.0], [0.35, 0.0]], radius=R, pinned=[0, 1], material="m")
    scene.add_balls([[-0.45, R], [0.5, R]], radius=0.008, mass=2.0, material="m")
    scene.add_balls(
        [[x, 2 * R + (1e-3 if drop else 0.0)] for x in at], radius=R, mass=heavy, velocity=(0.0, -drop), material="m"
    )
    scene.add_springs([[2, 3]], stiffness=2e5, damping=80.0, collides=True)
    return scene


def depth(sim, stick=(2, 3), first=4):
    """How deep balls from `first` on are in a stick, in radii."""
    x = np.asarray(sim.position, dtype=float)
    a, b = x[stick[0]], x[stick[1]]
    t = np.clip(((x[first:] - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float((1.0 - np.linalg.norm(x[first:] - a - t[:, None] * (b - a), axis=1) / R).max())


def run(scene, seconds, look, **settings):
    """The simulation, and the largest of what `look` says on the way."""
    sim = ts.Simulation(scene, arch="cpu", **{"integrator": "verlet", **settings})
    worst = -np.inf
    for _ in range(round(seconds / sim.dt)):
        sim.step(1)
        worst = max(worst, look(sim))
    return sim, worst


@pytest.mark.slow
@pytest.mark.parametrize(
    ("heavy", "settings"),
    [(600.0, {}), (50.0, {"integrator": "symplectic_euler"}), (50.0, {"contacts": "jacobi"})],
    ids=["verlet", "symplectic", "jacobi"],
)
@pytest.mark.long_where(heavy=50.0)
def test_a_heavy_ball_rests_on_a_loose_stick(heavy, settings):
    sim, worst = run(bridge(heavy), 0.4, depth, **settings)
    assert worst < 0.02
    assert np.abs(np.asarray(sim.velocity)[2:]).max() < 1e-3
    sim.close()


@pytest.mark.long
def test_a_stick_rests_on_a_stick():
    scene = bridge(1.0, at=())
    scene.add_balls([[-0.2, R + 0.02], [0.25, R + 0.02]], radius=0.02, mass=1.0)
    scene.add_balls([[0.03, 2 * R + 0.02]], radius=R, mass=25.0)
    scene.add_springs([[4, 5]], stiffness=2e5, damping=80.0, collides=True)
    sim, worst = run(scene, 0.8, lambda sim: depth(sim, (4, 5), 6))
    assert worst < 0.02
    assert np.abs(np.asarray(sim.velocity)[2:]).max() < 0.05
    sim.close()


@pytest.mark.slow_where(restitution=0.0)
@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.slow
@pytest.mark.long_where(restitution=0.0)
def test_what_falls_on_a_stick_gains_nothing(restitution):
    scene = bridge(40.0, restitution, drop=1.5, at=(-0.12, 0.1))

    def energy(sim):
        x, v = (np.asarray(a, dtype=float) for a in (sim.position, sim.velocity))
        stretch = np.linalg.norm(x[3] - x[2]) - scene.rest_length[0]
        kinetic = 0.5 * (scene.mass[2:] * (v[2:] ** 2).sum(axis=1)).sum()
        return kinetic + 9.0 * (scene.mass[2:] * x[2:, 1]).sum() + 0.5 * scene.stiffness[0] * stretch**2

    fallen = 0.5 * 80.0 * 1.5**2
    least = [np.inf]

    def gained(sim):
        now = energy(sim)
        least[0] = min(least[0], now)
        return now - least[0]

    sim, worst = run(scene, 0.5, gained, dt=1e-3)
    assert worst < 0.015 * fallen
    assert depth(sim) < 0.02
    sim.close()
