"""Elastic bounces keep the energy: forces that change within the step of an impact, bodies of springs and elements,
several impacts in a step, by impacts in turn and by iterations over all contacts."""

import numpy as np
import pytest
from own_methods import Advancing
from physics_support import F64, GATHERED, VARIANTS, error, simulate

import taichi_sim as ts
from taichi_sim.shapes import cloth, jelly

pytestmark = pytest.mark.long_in("f32")

SPEED, COUNT, APART = 1.7, 6, 1.5
RATIOS = (1.0, 6.0, 30.0)
SPRINGS = {"stiffness": 9e3, "mass": 3.0}
BRICKS = {"young_modulus": 5e4, "poisson_ratio": 0.3, "density": 110.0}


def weightless(dim, restitution=1.0):
    scene = ts.Scene(dim=dim, gravity=np.zeros(dim))
    scene.add_material("steel", restitution=restitution)
    return scene


def thrown(kind, target):
    """Bodies that come down on a wall, each on a pinned ball or each on one of its own weight, at other parts of a step."""
    scene = weightless(2)
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
    ("kind", "target", "method", "rule", "most"),
    [
        pytest.param("springs", "pinned", "verlet", "gauss_seidel", 0.01, marks=pytest.mark.slow),
        pytest.param("bricks", "pinned", "verlet", "gauss_seidel", 0.01, marks=pytest.mark.slow),
        pytest.param("bricks", "free", "verlet", "gauss_seidel", 0.015, marks=pytest.mark.slow),
        pytest.param("springs", "free", "verlet", "jacobi", 0.015, marks=pytest.mark.slow),
        pytest.param("bricks", "free", "verlet", "jacobi", 0.015, marks=pytest.mark.long),
        pytest.param("springs", "wall", "verlet", "gauss_seidel", 0.01, marks=pytest.mark.long),
        pytest.param("bricks", "wall", "tr_bdf2", "gauss_seidel", 0.03, marks=pytest.mark.slow),
        pytest.param("springs", "pinned", "tr_bdf2", "gauss_seidel", 0.03, marks=pytest.mark.long),
        pytest.param("bricks", "free", "tr_bdf2", "gauss_seidel", 0.03, marks=pytest.mark.long),
    ],
)
def test_an_elastic_impact_adds_no_energy(kind, target, method, rule, most):
    """At the automatic step, of the energy of the fall; and momentum is what it was, or what the wall says."""
    with simulate(thrown(kind, target), integrator=method, contacts=rule) as sim:
        start, momentum = sim.energy().total, sim.momentum()
        for _ in range(10):
            sim.run(0.03)
            assert target != "free" or sim.energy().total < 1.01 * start
        if target != "pinned":
            given = [sim.probes()[f"floor.{axis}"] for axis in "xy"] if target == "wall" else 0.0
            assert error(sim.momentum() + given, momentum, COUNT * 5.0 * SPEED) < (1e-10 if F64 else 1e-4)
        speed = sim.velocity[:, 1] if target == "wall" else sim.velocity.reshape(COUNT, -1, 2)[..., 1]
        if target == "free":
            assert np.all(speed[:, 0] < -0.2 * SPEED)
        else:
            assert np.all(speed.reshape(COUNT, -1).mean(axis=1) > 0.2 * SPEED)
        assert abs(sim.energy().total / start - 1.0) < most


def struck(dim, restitution, made_of):
    """Bodies at rest, each with a ball of another mass that meets several of its balls at once; one where made_of is "cloth"."""
    scene = weightless(dim, restitution)
    size, counts = ((0.3, 0.25), (4, 4)) if dim == 2 else ((0.3, 0.25, 0.25), (4, 4, 3))
    for k, ratio in enumerate(RATIOS if made_of != "cloth" else RATIOS[1:2]):
        if made_of == "cloth":
            yarns = {"warp": 340.0, "mass_per_area": 0.5, "damping": 0.0}
            body = cloth(scene, (1.0, 1.0), (9, 9), pinned="border", material="steel", **yarns)
        else:
            at = 1.2 * k * np.eye(dim)[0]
            body = jelly(scene, size, counts, position=at, damping=0.0, material="steel", **made_of)
        x = scene.position[body.balls]
        above = x.mean(axis=0) + 0.02
        above[0] += 0.013 * k
        above[1] = x[:, 1].max() + 0.13 + 0.004 * k
        mass = ratio * scene.mass[body.balls].mean()
        scene.add_balls([above], radius=0.06, mass=mass, velocity=[-2.3 * np.eye(dim)[1]], material="steel")
    return scene


def gains(scene, time=0.3, variant=VARIANTS[0], rule="jacobi", **settings):
    """Changes of the energy, in parts of what it was, at ten moments."""
    with simulate(scene, variant, contacts=rule, **settings) as sim:
        start, found = sim.energy().total, []
        for _ in range(10):
            sim.run(0.1 * time)
            found.append(sim.energy().total / start - 1.0)
        return np.array(found)


@pytest.mark.parametrize(
    ("dim", "made_of", "rule", "variant", "method", "most"),
    [
        pytest.param(3, SPRINGS, "jacobi", VARIANTS[0], "verlet", 0.01, marks=pytest.mark.slow, id="3d"),
        pytest.param(2, BRICKS, "jacobi", GATHERED, "verlet", 0.01, marks=pytest.mark.long, id="gathered"),
        pytest.param(2, SPRINGS, "jacobi", VARIANTS[0], "tr_bdf2", 0.03, marks=pytest.mark.long, id="tr_bdf2"),
        pytest.param(2, BRICKS, "gauss_seidel", VARIANTS[0], "verlet", 0.01, marks=pytest.mark.slow, id="in turn"),
        pytest.param(3, "cloth", "gauss_seidel", VARIANTS[0], "verlet", 0.01, marks=pytest.mark.slow, id="cloth"),
        pytest.param(2, BRICKS, "gauss_seidel", VARIANTS[0], "tr_bdf2", 0.05, marks=pytest.mark.slow, id="bricks"),
    ],
)
def test_balls_of_any_mass_that_strike_bodies_give_them_no_energy(dim, made_of, rule, variant, method, most):
    """Of several impacts of one ball in a step, too; TR-BDF2 damps the fastest of the waves that go through bodies afterwards."""
    change = gains(struck(dim, 1.0, made_of), variant=variant, integrator=method, rule=rule)
    assert np.all(np.abs(change) < most), change


@pytest.mark.long
def test_what_bodies_lose_is_what_they_lose_in_turn():
    scene = struck(2, 0.8, SPRINGS)
    change, expected = (gains(scene, rule=rule)[-1] for rule in ("jacobi", "gauss_seidel"))
    assert expected < -0.07
    assert change == pytest.approx(expected, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["jacobi", pytest.param("gauss_seidel", marks=pytest.mark.long)])
def test_a_crowd_in_part_on_springs_keeps_its_energy(rule):
    """Discs of masses 1 to 4 between walls; the energy limiter takes nothing either."""
    scene, rng = weightless(2), np.random.default_rng(11)
    for normal, offset in (((0, 1), 0.0), ((1, 0), 0.0), ((0, -1), -1.6), ((-1, 0), -1.6)):
        scene.add_wall(normal, offset, "steel")
    x = np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1).reshape(-1, 2) * 0.19 + 0.13
    velocity = 1.5 * rng.normal(size=x.shape)
    balls = scene.add_balls(x, radius=0.05, mass=rng.uniform(1, 4, len(x)), velocity=velocity, material="steel")
    scene.add_springs(np.stack([balls[:-1:4], balls[1::4]], axis=1), stiffness=5e3)
    assert np.all(np.abs(gains(scene, 1.0, rule=rule, dt=5e-4)) < 1e-3)


@pytest.mark.slow
def test_balls_come_back_from_pinned_ones_as_high_as_they_fell():
    scene = ts.Scene(dim=2, gravity=(0.0, -10.0))
    scene.add_material("steel", restitution=1.0)
    for k in range(12):
        scene.add_balls([(float(k), 0.0)], radius=0.1, pinned=True, material="steel")
        scene.add_balls([(float(k), 0.5 + 0.0031 * k)], radius=0.1, material="steel")
    assert np.all(np.abs(gains(scene, 3.0, dt=2e-3)) < 1e-3)


@pytest.mark.long
@pytest.mark.parametrize("made_of", ["sticks", "triangles"])
def test_what_strikes_sticks_and_triangles_gains_no_energy(made_of):
    """Balls meet ropes that are held at their ends, or one a membrane, between balls of these."""
    scene, count, most = weightless(2 if made_of == "sticks" else 3), 1, 0.01
    if made_of == "sticks":
        count, most = 6, 0.003
        for k in range(count):
            x = np.stack([np.linspace(0.0, 1.0, 9) + 1.5 * k, np.zeros(9)], axis=1)
            rope = scene.add_balls(x, radius=0.02, mass=0.2, material="steel")
            scene.set_balls(rope[[0, -1]], pinned=True)
            scene.add_springs(np.stack([rope[:-1], rope[1:]], axis=1), stiffness=4e3, collides=True)
    else:
        sheet = {"stiffness": 400.0, "damping": 0.0, "bending_stiffness": 0.0, "mass": 0.3, "surface_collision": True}
        cloth(scene, (1.0, 1.0), (9, 9), pinned="border", material="steel", **sheet)
    velocity = np.array([0.0, -2.0, 0.0])[: scene.dim]
    for k in range(count):
        above = np.array([0.43 + 1.52 * k, 0.15, 0.53])[: scene.dim]
        scene.add_balls([above], radius=0.05, mass=1.0, velocity=[velocity], material="steel")
    change = gains(scene)
    assert np.all(np.abs(change) < most), change


def test_a_ball_on_a_spring_keeps_bouncing_off_another():
    """Thousands of times, at any part of a step: the energy that the method keeps does not drift."""
    scene, stiffness = weightless(2), np.array([400.0, 900.0, 2500.0])
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


@pytest.mark.parametrize("method", ["explicit_euler", Advancing()], ids=["explicit_euler", "own"])
def test_methods_that_solve_contacts_in_one_go_throw_back_sprung_balls(method):
    """A ball that strikes one on a spring leaves it as two free bodies part, before the spring pulls; viscous friction takes
    1 - exp(-f h) of the speed along their surfaces."""
    restitution, rate, h = 0.7, 30.0, 1e-3
    scene = ts.Scene(dim=2, gravity=(0.0, 0.0))
    scene.add_material("rough", restitution=restitution, viscous_friction=rate)
    scene.add_balls(
        [[0.0, 0.0], [-1.0, 0.0], [0.2031, 0.0]],
        velocity=[[0.0, 0.0], [0.0, 0.0], [-1.2, 0.5]],
        mass=[3.0, 1.0, 2.0],
        radius=0.1,
        material="rough",
    )
    scene.add_springs([[0, 1]], stiffness=1e-4)
    with simulate(scene, dt=h, substeps=1, integrator=method, spin=False) as sim:
        while sim.velocity[2, 0] < 0.0 and sim.time < 0.01:
            sim.step(1)
        v = sim.velocity
    u = np.array([-1.2, 0.5])
    x = np.array([0.2031, 0.0])
    t = (-x @ u - np.sqrt((x @ u) ** 2 - (u @ u) * (x @ x - 0.04))) / (u @ u)
    n = (x + t * u) / 0.2
    p = 1.2 * ((1.0 + restitution) * (u @ n) * n + (1.0 - np.exp(-rate * h)) * (u - (u @ n) * n))
    assert error(v[[0, 2]], [p / 3.0, u - p / 2.0]) < (1e-9 if F64 else 1e-5)
