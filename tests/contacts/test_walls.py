"""Walls: bounces, friction, rest, inclines, corners and wedges against closed forms."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest
import reference as ref
from physics_support import (
    CONTACT_CASES,
    EPS,
    F64,
    METHODS,
    VARIANTS,
    each_dim,
    each_extreme,
    exact,
    record,
    simulate,
    vector,
)

import taichi_sim as ts
from taichi_sim.device.engine import ti

pytestmark = pytest.mark.long_in("f32")

H, G, R = 1e-3, 10.0, 0.05
STILL = EPS * G * H  # m/s: one kick of gravity, to its rounding

# One floor ------------------------------------------------------------------------------------------------------------

BOUNCES = (0.9, 0.7, 0.5, 0.0)
COULOMB = (0.1, 0.3, 1.0)
VISCOUS = (1.0, 50.0, 3000.0)  # 1/s; the last has f h = 3
SPEED = 2.0  # m/s
EVERY, STEPS = 10, 3000


@functools.cache
def floor_scene(dim):
    """Balls of one body, which do not touch each other. The floor's friction is 1, so a pair's is the root of the ball's."""
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -G))
    scene.add_wall(vector(dim, 0.0, 2.0), 0.0, scene.add_material("floor", friction=1.0, viscous_friction=1.0))
    at, body = SimpleNamespace(bounce=[], coulomb=[], viscous=[]), scene.new_body()

    def ball(y, material, v=(), **more):
        return int(
            scene.add_balls(
                [vector(dim, 0.0, y)], radius=R, velocity=vector(dim, *v), material=material, body=body, **more
            )[0]
        )

    for e in BOUNCES:
        at.bounce.append(ball(R + 1.0, scene.add_material(f"e{e}", restitution=e), mass=10 ** (4 * e - 2)))
    along = (SPEED, 0.0) if dim == 2 else (0.6 * SPEED, 0.0, 0.8 * SPEED)
    for mu in COULOMB:
        at.coulomb.append(ball(R, scene.add_material(f"mu{mu}", friction=mu**2), along, mass=3.0))
    for f in VISCOUS:
        at.viscous.append(ball(R, scene.add_material(f"f{f}", viscous_friction=f**2), along, mass=0.3))
    at.resting = ball(R, "e0.5")
    at.light, at.heavy = ball(R, "e0.9", mass=1e-4), ball(R, "mu0.3", mass=1e4)
    at.pinned = ball(0.5 * R, "e0.9", pinned=True)
    return scene, at


@pytest.fixture(scope="module", params=CONTACT_CASES)
def floor(request):
    dim, method, variant = request.param
    scene, at = floor_scene(dim)
    with simulate(scene, variant, integrator=method, dt=H, spin=False, contact_iterations=4) as sim:
        x, v = record(sim, STEPS, EVERY)
    return SimpleNamespace(dim=dim, method=method, at=at, x=x, v=v, t=np.arange(len(x)) * EVERY * H)


def test_bounce_heights(floor):
    """The n-th flight reaches e^(2n) h0; for the first-order methods to the order of their step."""
    for e, ball in zip(BOUNCES, floor.at.bounce):
        height = floor.x[:, ball, 1] - R + floor.v[:, ball, 1] ** 2 / (2 * G)
        fall = np.sqrt(2.0 / G)
        start, n, seen = -fall, 0, 0
        exactly = floor.method in (
            "verlet",
            "rk4",
        )  # the others are late by up to a step in each flight and at each bounce
        while e**n * np.sqrt(2 * G) > 0.2 and start < floor.t[-1]:
            end = start + 2 * fall * e**n
            late = 3 * H if exactly else (3 + 2 * n) * H
            inside = (floor.t > max(start, 0.0) + late) & (floor.t < min(end, floor.t[-1]) - 3 * H)
            speed = np.sqrt(2 * G) * e**n
            tolerance = (1e-9 if F64 else 3e-4) if exactly else 3.0 * (n + 1) * G * H / speed
            found = np.abs(height[inside] / ref.bounces(1.0, G, e, n)[0] - 1)
            assert np.all(found < tolerance), f"e = {e}, flight {n}: {found.max():.2e}"
            seen += int(inside.any())
            start, n = end, n + 1
            if e == 0.0:
                break
        assert seen >= {0.9: 4, 0.7: 4, 0.5: 4, 0.0: 1}[e]


def test_bounces_end_at_the_time_of_rest(floor):
    """sqrt(2 h0 / g) (1 + e) / (1 - e), less what the threshold of 2 g h cuts off; then exactly at rest."""
    for e, ball in list(zip(BOUNCES, floor.at.bounce))[1:]:
        expected = ref.bounces(1.0, G, e, 0)[1]
        moving = np.any(np.abs(floor.v[:, ball]) > STILL, axis=1)
        last = floor.t[np.flatnonzero(moving)[-1]]
        cut = 2 * (2 * G * H) / G / (1 - e)
        bounces = np.log(2 * G * H / np.sqrt(2 * G)) / np.log(e) if e > 0.0 else 0.0
        shift = (
            0.0 if floor.method in ("verlet", "rk4") else 2 * H * bounces
        )  # a step in each flight and at each bounce
        assert expected - cut - (EVERY + 2) * H - shift < last < expected + 3 * H + shift, (e, last, expected)
        assert abs(floor.x[-1, ball, 1] - R) < max(1e-5 * R, 4 * EPS)


def test_resting_balls_have_speed_0_and_stay(floor):
    """Exactly 0 for 1 kg; for any mass the rounding of one kick at most, and no drift at all."""
    assert np.all(floor.v[:, floor.at.resting] == 0.0)
    for ball in (floor.at.resting, floor.at.light, floor.at.heavy):
        assert np.max(np.abs(floor.v[:, ball])) <= STILL
        assert np.all(floor.x[:, ball] == floor.x[0, ball])


def test_pinned_ball_takes_nothing(floor):
    assert np.all(floor.v[:, floor.at.pinned] == 0.0)
    assert np.all(floor.x[:, floor.at.pinned] == floor.x[0, floor.at.pinned])


def test_coulomb_slide_stops_and_stays(floor):
    for mu, ball in zip(COULOMB, floor.at.coulomb):
        way = np.linalg.norm(floor.x[:, ball] - floor.x[0, ball], axis=1)
        speed = np.linalg.norm(floor.v[:, ball], axis=1)
        stop = SPEED / (mu * G)
        before, after = floor.t < stop - 2 * H, floor.t > stop + 2 * H
        assert np.max(np.abs(speed[before] - (SPEED - mu * G * floor.t[before]))) < (
            1e-10 if F64 else exact(STEPS) * SPEED
        )
        assert np.max(np.abs(floor.v[after, ball])) <= STILL
        assert np.max(np.abs(floor.x[after, ball] - floor.x[-1, ball])) <= 2 * EPS * np.abs(floor.x[-1, ball]).max()
        expected = ref.coulomb_stop_distance(SPEED, mu, G)
        first_order = 0.0 if floor.method in ("verlet", "rk4") else SPEED * H  # friction acts between two moves
        tolerance = mu * G * H**2 + first_order + (0.0 if F64 else exact(STEPS) * expected)
        assert abs(way[-1] - expected) < tolerance, f"mu = {mu}: {way[-1]:.9f} m, expected {expected:.9f} m"


def test_viscous_slide(floor):
    """v0 exp(-f t) for any f h, exactly; the way to the order of the step."""
    for f, ball in zip(VISCOUS, floor.at.viscous):
        speed = np.linalg.norm(floor.v[:, ball], axis=1)
        expected = np.array([ref.viscous_slide(SPEED, f, t) for t in floor.t])
        found = np.max(np.abs(speed - expected[:, 0])) / SPEED
        assert found < exact(STEPS), f"f = {f}: {found:.2e}"
        way = np.linalg.norm(floor.x[:, ball] - floor.x[0, ball], axis=1)
        assert np.max(np.abs(way - expected[:, 1])) < SPEED * H


@pytest.mark.slow_where(dim=3)
@each_dim
def test_elastic_bounces_keep_the_energy(dim):
    """Verlet, e = 1, 1000 bounces: 1e-9. The article's reflection at the end of the step does not."""
    height, h = 0.02, H
    steps = round(1000 * 2 * np.sqrt(2 * height / G) / h)
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -G))
    scene.add_material("ideal", restitution=1.0)
    scene.add_wall(vector(dim, 0.0, 1.0), 0.0, "ideal")
    scene.add_balls([vector(dim, 0.0, R + height)], radius=R, velocity=vector(dim, 0.3), material="ideal")
    start = G * height
    worst, bounced = 0.0, 0
    with simulate(scene, dt=h) as sim:
        for _ in range(500):
            sim.step(steps // 500)
            y, v = sim.position[0, 1] - R, sim.velocity[0, 1]
            bounced += v > 0
            worst = max(worst, abs((G * y + 0.5 * v * v) / start - 1))
            assert abs(sim.velocity[0, 0] - 0.3) < 4 * EPS
    assert bounced > 100
    assert worst < (1e-9 if F64 else 1e-2), f"{worst:.2e}"
    y, v, wrong = height, 0.0, 0.0
    for _ in range(steps):
        y, v = ref.wrong_bounce_step(y, v, G, h, 1.0)
        wrong = max(wrong, abs((G * y + 0.5 * v * v) / start - 1))
    assert wrong > 1e-2


# Inclines, corners, wedges, coplanar walls ----------------------------------------------------------------------------


@pytest.mark.slow_where(dim=2)
@pytest.mark.slow_where(method=["explicit_euler", "symplectic_euler", "rk4"])
@pytest.mark.parametrize("method", METHODS)
@each_extreme
@each_dim
def test_incline_slides_iff_steeper_than_friction(dim, method, variant):
    """Two planes of 20 and 40 degrees; friction 0.9 and 1.1 of tan(angle). Those that slide have a = g (sin - mu cos)."""
    if method != "verlet" and variant != VARIANTS[0]:
        return
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -G))
    scene.add_material("plane", friction=1.0)
    body, found = scene.new_body(), []
    for angle, side in ((np.radians(20), 1.0), (np.radians(40), -1.0)):
        n = vector(dim, -side * np.sin(angle), np.cos(angle))
        down = vector(dim, -side * np.cos(angle), -np.sin(angle))
        scene.add_wall(n, 0.0, "plane")
        for part in (0.9, 1.1):
            mu = part * np.tan(angle)
            material = scene.add_material(f"{side} {part}", friction=mu**2)
            b = scene.add_balls([R * n - 5.0 * down], radius=R, material=material, body=body, mass=2.0)
            found.append((int(b[0]), max(0.0, G * (np.sin(angle) - mu * np.cos(angle))), down))
    steps = 500
    with simulate(scene, variant, integrator=method, dt=H, spin=False, contact_iterations=2) as sim:
        start = sim.position
        sim.step(steps)
        way, v = sim.position - start, sim.velocity
    t = steps * H
    for ball, a, down in found:
        if a == 0.0:
            assert np.max(np.abs(way[ball])) < (1e-12 if F64 else 1e-6)
            assert np.max(np.abs(v[ball])) < (1e-12 if F64 else 1e-6)
        else:
            order = 0.0 if method in ("verlet", "rk4") else a * t * H  # a step late or early
            assert abs(way[ball] @ down - a * t * t / 2) < order + (1e-9 if F64 else 1e-4)
            assert abs(v[ball] @ down - a * t) < (1e-9 if F64 else 1e-4)


@pytest.mark.slow_where(dim=2)
@pytest.mark.slow_where(method=["symplectic_euler", "rk4"])
@pytest.mark.parametrize("method", METHODS)
@each_dim
def test_corner_brings_to_rest_in_two_passes(dim, method):
    """Walls along every axis, no restitution: a ball thrown into the corner, and one that lies in it; once they lie there they
    are still at every step, where a cycle of two would hide from a look at every second one."""
    scene = ts.Scene(dim=dim, gravity=np.full(dim, -G))
    for axis in np.eye(dim):
        scene.add_wall(axis)
    body = scene.new_body()
    x = [np.full(dim, R), R + np.arange(1, dim + 1) * 0.02]
    scene.add_balls(x, radius=R, velocity=[-np.arange(1.0, dim + 1), -np.ones(dim)], body=body)
    with simulate(scene, integrator=method, dt=H, contact_iterations=2) as sim:
        sim.step(2)
        assert np.max(np.abs(sim.velocity[0])) < (1e-9 if F64 else 1e-6)
        sim.step(198)
        x, v = record(sim, 60)
    assert np.max(np.abs(v)) < (1e-12 if F64 else 1e-6)
    assert np.max(np.abs(x - R)) < max(1e-5 * R, 4 * EPS)


@pytest.mark.slow_where(dim=2)
@pytest.mark.slow_where(method="symplectic_euler")
@pytest.mark.parametrize("method", ["symplectic_euler", "verlet"])
@each_dim
def test_two_coplanar_wall_pieces_act_as_one(dim, method):
    """Bounce, rest and push-out of a ball are those of one wall; the plain sum would turn v into -3 v."""
    ends = []
    for copies in (1, 2):
        scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -G))
        scene.add_material("ideal", restitution=0.8)
        for _ in range(copies):
            scene.add_wall(vector(dim, 0.0, 1.0), 0.0, "ideal")
        y = [R + 0.1, R, 0.9 * R, R]
        v = [vector(dim), vector(dim), vector(dim), vector(dim, 0.0, -3.0)]
        scene.add_balls([vector(dim, 0.0, h) for h in y], radius=R, velocity=v, body=1)
        with simulate(scene, integrator=method, dt=H) as sim:
            ends.append(record(sim, 300, 20))
    assert np.max(np.abs(ends[0][0] - ends[1][0])) < (1e-9 if F64 else 1e-5)
    assert np.max(np.abs(ends[0][1] - ends[1][1])) < (1e-9 if F64 else 1e-3)


# Springs that bounce ---------------------------------------------------------------------------------------------------


@ti.data_oriented
class Trap:
    """Pulls every ball to the origin with 3 N/m."""

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += -3.0 * h * ball[i].x

    def energy(self, position, velocity):
        return 1.5 * np.sum(position**2)


@pytest.mark.parametrize("forces", [(), pytest.param((Trap(),), marks=pytest.mark.slow)], ids=["springs", "own"])
def test_stiff_springs_that_bounce_keep_their_energy(forces):
    """80 spinning and shaking pairs between walls and a sphere, omega h = 0.26, at e = 1: with the whole second half of the kick
    each impact on average adds h^2 k u^2 / 6 (0.02 of all in 3 s)."""
    n, rng = 80, np.random.default_rng(3)
    scene = ts.Scene(dim=2, gravity=(0.0, -3.0))
    bouncy = scene.add_material("bouncy", restitution=1.0)
    angle = rng.uniform(0.0, 2 * np.pi, n)
    one = np.array([0.0, 0.5]) + rng.uniform(-0.3, 0.3, (n, 2))
    x = np.stack([one, one + 0.15 * np.stack([np.cos(angle), np.sin(angle)], axis=1)], axis=1).reshape(-1, 2)
    settings = {"mass": np.tile([1.0, 0.4], n), "radius": 0.02, "material": bouncy}
    balls = scene.add_balls(x, velocity=rng.normal(0.0, 1.5, (2 * n, 2)), body=scene.new_body(), **settings)
    scene.add_springs(balls.reshape(-1, 2), stiffness=2e4)
    for normal, offset in (((1, 0), -0.6), ((-1, 0), -0.6), ((0, 1), -0.2)):
        scene.add_wall(normal, offset, bouncy)
    scene.add_collider(ts.Sphere((0.0, 0.0), 0.1, material=bouncy))
    with simulate(scene, dt=1e-3, substeps=1, forces=forces) as sim:
        start = sim.energy().total
        sim.run(3.0)
        assert sim.energy().total == pytest.approx(start, rel=5e-3)


@pytest.mark.parametrize(
    ("damping", "brick"), [(0.0, False), (3.0, False), pytest.param(3.0, True, marks=pytest.mark.slow)]
)
def test_what_impulse_probes_of_all_walls_sum_is_what_bodies_lost(damping, brick):
    """Of a spring that bounces, and, beside damped ones, of a brick that shares balls with springs."""
    scene = ts.Scene(dim=2, gravity=(0, -7))
    scene.add_material("rubber", restitution=0.6, friction=0.2)
    pair, mass = [[0.3, 0.4], [0.6, 0.5]], [1.2, 2.5]
    scene.add_balls(pair, radius=0.04, mass=mass, velocity=[[3, -2], [-1, 4]], material="rubber")
    scene.add_springs([[0, 1]], stiffness=2e4, damping=damping)
    if brick:
        four = [[0.1, 0.7], [0.1, 0.84], [0.31, 0.7], [0.31, 0.84]]
        balls = scene.add_balls(four, radius=0.03, mass=0.6, velocity=(0.5, -5), material="rubber")
        scene.add_bricks(balls, young_modulus=4e3, poisson_ratio=0.3)
        scene.add_springs([balls[:2], balls[1:3]], stiffness=50.0, damping=4.0)
    walls = {"floor": ((0, 1), 0), "lid": ((0, -1), -1), "left": ((1, 0), 0), "right": ((-1, 0), -1)}
    for name, (normal, offset) in walls.items():
        scene.add_wall(normal, offset, "rubber")
        scene.add_probe(name, "impulse", wall=len(scene.walls) - 1)
    with simulate(scene, dt=5e-4, substeps=1) as sim:
        sim.run(0.5)
        given = [sum(sim.probes()[f"{name}.{axis}"] for name in walls) for axis in "xy"]
        lost = scene.mass @ scene.velocity + scene.mass.sum() * scene.gravity * 0.5 - scene.mass @ sim.velocity
    assert np.abs(given).max() > 2.0
    np.testing.assert_allclose(given, lost, atol=1e-11 if F64 else 1e-3)


@pytest.mark.skipif(not F64, reason="a balance to rounding")
@pytest.mark.parametrize("method", ["verlet", pytest.param("tr_bdf2", marks=pytest.mark.slow)])
def test_probes_count_what_stops_a_ball_that_bounces_too_often_in_a_step(method):
    """Springs press balls so hard that their bounces in one step take any part of it: the moves of some of them end early."""
    e, h, mass, stiffness, gravity = 0.86, 0.003, 0.4, 1500.0, np.array([0.0, -4.0])
    scene = ts.Scene(dim=2, gravity=gravity)
    scene.add_material("hard", restitution=e, friction=0.15)
    normal, offset, pull = np.array([-0.28, 0.96]), np.array([9.0, 9.0]), 300.0
    turned = np.degrees(np.arctan2(0.28, 0.96))
    scene.add_wall(normal, 0.0, "hard")
    scene.add_collider(ts.Box(offset - 0.5 * normal, (40.0, 1.0), material="hard", rotation=turned))
    scene.add_probe("wall", "impulse", wall=0)
    scene.add_probe("box", "impulse", collider=0)
    along = np.array([0.96, 0.28])
    for foot in (np.zeros(2), offset):
        for k, flight in enumerate(np.linspace(0.05, 0.25, 9)):  # of a step, after the first bounce
            low = foot + (k - 4) * along + (R + 1e-9) * normal
            fall = 0.5 * flight * h * pull / e
            pair = scene.add_balls(
                [low, low + 0.5 * normal], radius=R, mass=mass, velocity=0.6 * along - fall * normal, material="hard"
            )
            scene.add_springs([pair], stiffness=stiffness, rest_length=0.5 + pull * mass / stiffness)
    if method != "verlet":  # none meets another
        scene.set_balls(body=1)
    lost = []
    with simulate(scene, integrator=method, dt=h, substeps=1) as sim:
        for _ in range(6):
            sim.step()
            given = scene.mass @ scene.velocity + scene.mass.sum() * sim.time * gravity
            received = sim.snapshot().impulses
            lost.append(given - scene.mass @ sim.velocity - received.sum(axis=0))
    assert (np.linalg.norm(received, axis=1) > 1.0).all()
    assert np.abs(lost).max() < 1e-12 * np.abs(received).max()


@pytest.mark.skipif(not F64, reason="a balance to rounding")
def test_probes_count_what_stops_a_ball_that_waits_on_a_long_way():
    """It flies so far along a tube in a step, and so near to it, that its way is looked at in part."""
    scene, h, speed, pull, mass = ts.Scene(dim=2, gravity=(45.0, 0.0)), 2e-3, 150.0, 45.0, 0.25
    scene.add_balls([(-0.8, -0.1973)], radius=0.0025, mass=mass, velocity=(speed, 0.0))
    scene.add_collider(ts.Capsule((-2.0, 0.0), (2.0, 0.0), 0.2, hollow=0.1))
    scene.add_probe("tube", "impulse", collider=0)
    with simulate(scene, dt=h, substeps=1) as sim:
        sim.run(3 * h)
        assert sim.position[0, 0] + 0.8 < 2.5 * h * speed  # it waited
        lost = mass * (speed + pull * sim.time - sim.velocity[0, 0])
        received = sim.snapshot().impulses[0]
    assert lost > 0.1 * mass * pull * h
    np.testing.assert_allclose(received, (lost, 0.0), atol=1e-14 * mass * speed)


@pytest.mark.slow_where(dim=2)
@each_dim
def test_an_oblique_bounce_is_rubbed_by_coulombs_law(dim):
    """Without gravity: friction takes mu (1 + e) times the normal speed of what slides, and all of what it can stop."""
    scene, mu, e = ts.Scene(dim=dim, gravity=(0.0,) * dim), (0.05, 0.2, 0.9), 0.6
    scene.add_material("floor", restitution=e, friction=1.0)
    scene.add_wall(vector(dim, 0.0, 1.0), 0.0, "floor")
    down, along = 2.5, 1.9
    for k, one in enumerate(mu):
        scene.add_material(f"m{k}", restitution=e, friction=one**2)  # with the floor's: the geometric mean
        scene.add_balls(
            [vector(dim, k, 0.14)], radius=0.1, mass=0.7, velocity=vector(dim, along, -down), material=f"m{k}"
        )
    with simulate(scene, dt=1e-3, spin=False) as sim:
        sim.step(40)
        found = sim.velocity
    for v, one in zip(found, mu):
        expected = vector(dim, max(0.0, along - one * (1 + e) * down), e * down)
        assert np.abs(v - expected).max() < (1e-12 if F64 else 1e-5) * down


@pytest.mark.slow
@pytest.mark.once
def test_a_ball_that_meets_more_walls_in_a_step_than_are_followed_goes_through_none():
    """Some forty impacts a step."""
    low, room, r = 0.3, 0.02, 0.15
    scene = ts.Scene(dim=2, gravity=(0, -6.0))
    scene.add_material("steel", restitution=1.0)
    scene.add_balls([[0.0, low + r + 0.4 * room]], radius=r, velocity=[[2.0, -80.0]], material="steel")
    scene.add_wall((0, 1), low, "steel")
    scene.add_wall((0, -1), -(low + 2.0 * r + room), "steel")
    with simulate(scene, dt=0.01, substeps=1) as sim:
        before = sim.energy().total
        for _ in range(20):
            sim.step()
            assert -EPS * 10 <= sim.position[0, 1] - low - r <= room + EPS * 10
            assert sim.energy().total <= before * (1.0 + EPS * 100)
        assert 0.0 < sim.position[0, 0] < 0.5 * 2.0 * sim.time  # it waits most of the time
