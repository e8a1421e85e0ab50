"""Colliders against closed forms: bounces, rest, inclines, curved rooms, pistons, conveyors, drums, and bullets at each shape.

One scene for each dimension holds them all, far apart and of one body, because contact kernels are slow to compile.
"""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from physics_colliders import ROOM, SHOTS, SPEED, TURNTABLE, G, H, Laboratory, R, block, drum_scene, ring
from physics_support import DIMS, EPS, F64, METHODS, box_mesh, simulate, vector

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.shapes import jelly

pytestmark = pytest.mark.long_in("f32")

STILL = EPS * G * H  # m/s: one kick of gravity, to its rounding
BULLET_STEPS, STEPS = 16, 1400


@pytest.fixture(scope="module", params=[pytest.param(2, marks=pytest.mark.slow), 3], ids=["2d", "3d"])
def laboratory(request):
    """Bullets for a few steps, then everything from the start again with the bullets far away."""
    lab = Laboratory(request.param)
    shot = np.concatenate([target.balls for target in lab.targets])
    with simulate(lab.scene, dt=H, spin=False) as sim:
        flight = [(sim.position, sim.velocity)]
        for _ in range(BULLET_STEPS):
            sim.step()
            flight.append((sim.position, sim.velocity))
        start = lab.scene.position.copy()
        start[shot, 1] += 40.0
        v = lab.scene.velocity.copy()
        v[shot] = 0.0
        sim.resume(ts.Snapshot(start, v))
        x, v = [start], [v]
        overlap = []
        for _ in range(STEPS):
            sim.step()
            x.append(sim.position)
            v.append(sim.velocity)
        overlap = sim.penetration()
        kernels = sim.kernels()
    return SimpleNamespace(
        lab=lab,
        flight=flight,
        x=np.array(x),
        v=np.array(v),
        t=H * np.arange(STEPS + 1),
        overlap=overlap,
        kernels=kernels,
    )


def path(run, name):
    """Positions from where the experiment stands, and velocities, (k, dim) each."""
    ball = run.lab.ball[name]
    place = run.lab.scene.position[ball]
    c = run.lab.at[min(run.lab.at, key=lambda key: abs(run.lab.at[key][0] - place[0]))]
    return run.x[:, ball] - c, run.v[:, ball]


@pytest.mark.slow
def test_no_bullet_ends_a_step_in_a_collider_or_beyond_it(laboratory):
    """10 radii a step at every shape, from outside and within; each hits something on its way."""
    lab = laboratory.lab
    for target in lab.targets:
        collider = lab.scene.colliders[target.collider]
        centre = lab.scene.colliders[target.collider].motion.positions[0]
        hits = np.zeros(SHOTS, dtype=bool)
        for step in range(1, BULLET_STEPS + 1, 5 if collider.name == "mesh" else 1):
            x, v = (part[target.balls] for part in laboratory.flight[step])
            # a mesh is round to about a cell of its grid at sharp places; what turns is met at a chord of its way
            allowed = (0.05 if target.moves else 0.2 if collider.name == "mesh" else 0.001) * R
            assert (collider.distance(x, step * H) - R).min() > -allowed - 200 * EPS * ROOM * lab.next
            hits |= np.linalg.norm(v - laboratory.flight[0][1][target.balls], axis=1) > 0.1 * SPEED
            if collider.hollow:
                assert np.linalg.norm(x - centre, axis=1).max() < 1.5
        assert hits.mean() > (0.3 if collider.name == "mesh" else 0.6)
        if not target.moves:
            speed = np.linalg.norm(laboratory.flight[-1][1][target.balls], axis=1)
            assert np.abs(speed / SPEED - 1).max() < 2 * G * BULLET_STEPS * H / SPEED


@pytest.mark.slow
def test_elastic_bullets_are_mirrored_about_the_analytic_normal(laboratory):
    """The change of velocity at a first bounce is along the line from the nearest point of the shape to the centre."""
    lab = laboratory.lab
    target = lab.targets[0]  # the sphere
    centre = lab.scene.colliders[target.collider].motion.positions[0]
    x, v = (part[target.balls] for part in laboratory.flight[0])
    x = x - centre
    b, c = np.sum(x * v, axis=1), np.sum(x * x, axis=1) - (1.0 + R) ** 2
    root = b * b - SPEED**2 * c
    hit = root > (0.05 * SPEED) ** 2
    t = (-b[hit] - np.sqrt(root[hit])) / SPEED**2
    n = (x[hit] + t[:, None] * v[hit]) / (1.0 + R)
    expected = v[hit] - 2 * np.sum(v[hit] * n, axis=1)[:, None] * n
    found = laboratory.flight[BULLET_STEPS // 2][1][target.balls][hit]
    assert hit.sum() > 0.8 * SHOTS
    assert np.abs(found - expected).max() < 1e-3 * SPEED  # gravity bends the way before


def test_resting_balls_stay_where_they_are(laboratory):
    for name in laboratory.lab.ball:
        if name.startswith("rests"):
            x, v = path(laboratory, name)
            assert np.abs(v).max() <= STILL, name
            assert np.all(x[1:] == x[1]), name


def test_a_dropped_ball_comes_to_rest(laboratory):
    x, v = path(laboratory, "dropped on a box")
    flights = np.flatnonzero((v[1:, 1] > 0.1) & (v[:-1, 1] < -0.1)) + 1
    speed = np.sqrt(2 * G * 0.2)
    assert np.abs(v[flights[0], 1] - 0.5 * speed) < 2 * G * H
    assert np.abs(v[-1]).max() <= STILL
    assert abs(x[-1, 1] - R) < (2e-5 * R if F64 else 0.02 * R)


def test_a_mesh_thinner_than_the_cells_of_its_grid_holds_what_falls_on_it(laboratory):
    """A plate whose corners are turned, not its collider, so that its grid lies askew to it."""
    if laboratory.lab.dim == 2:
        return
    plate = next(c for c in laboratory.lab.scene.colliders if c.resolution == 16)
    for k in range(3):
        ball = laboratory.lab.ball[f"dropped on a thin plate {k}"]
        x, v = laboratory.x[:, ball], laboratory.v[:, ball]
        gap = plate.distance(x[::20], 0.0) - R
        assert np.abs(gap[-10:]).max() < (2e-4 if F64 else 2e-3) * R, k
        assert gap.min() > -2e-3 * R, k
        assert np.abs(v[-1]).max() < 2 * G * H


def test_walls_and_colliders_hold_a_ball_together(laboratory):
    x, v = path(laboratory, "rolls into a corner")
    assert np.abs(v[-1]).max() < (1e-12 if F64 else 1e-6)
    assert np.abs(x[-1, :2] - [-0.5 + R, R]).max() < (2e-5 * R if F64 else 0.02 * R)


def test_slope_slides_iff_steeper_than_friction(laboratory):
    for name in laboratory.lab.ball:
        if name.startswith("slope"):
            _, degrees, part = name.split()
            x, _ = path(laboratory, name)
            a = max(0.0, G * np.sin(np.radians(float(degrees))) * (1 - float(part)))
            way = np.linalg.norm(x[500] - x[0])
            assert abs(way - a * 0.5**2 / 2) < (1e-9 if F64 else 2e-4), name


def test_sliding_in_a_curved_room_keeps_the_energy(laboratory):
    """To second order of the step; chords keep the speed, where a projection onto the surface would lose it."""
    for name in ("swings in a sphere", "swings in a capsule", "bounces on a sphere", "slides off a sphere"):
        x, v = path(laboratory, name)
        energy = G * x[:, 1] + 0.5 * np.sum(v * v, axis=1)
        change = np.abs(energy - energy[0]).max() / G
        assert change < ((1e-12 if "bounces" in name else 5e-6) if F64 else 5e-3), f"{name}: {change:.2e}"
    x, _ = path(laboratory, "swings in a sphere")
    assert x[:, 0].min() < -0.9 * x[0, 0]  # it does swing
    assert np.abs(np.linalg.norm(x, axis=1) - (1 - R)).max() < 0.02 * R


def test_a_ball_leaves_a_smooth_sphere_at_two_thirds_of_its_height(laboratory):
    x, _ = path(laboratory, "slides off a sphere")
    gap = np.linalg.norm(x, axis=1) - (1.0 + R)
    left = int(np.argmax(gap > (2e-5 if F64 else 1e-3)))
    cosine = x[left, 1] / np.linalg.norm(x[left])
    assert cosine == pytest.approx(2 / 3 * np.cos(0.1), abs=0.03 if F64 else 0.12)


def test_a_piston_gives_an_elastic_ball_twice_its_speed(laboratory):
    _, v = path(laboratory, "pushed by a piston")
    assert v[-1, 0] == pytest.approx(4.0, rel=1e-12 if F64 else 1e-6)
    assert v[:, 0].max() == v[-1, 0]


def test_a_conveyor_brings_a_ball_to_its_speed(laboratory):
    """Friction mu = 0.2: u / (mu g) seconds, u^2 / (2 mu g) behind; then it rides along."""
    x, v = path(laboratory, "carried by a conveyor")
    a, t = 0.2 * G, laboratory.t
    rides = 1.0 / a
    before, after = t < rides - 2 * H, t > rides + 2 * H
    tolerance = 1e-10 if F64 else 2e-4
    assert np.abs(v[before, 0] - a * t[before]).max() < tolerance
    assert np.abs(v[after, 0] - 1.0).max() < tolerance
    assert np.abs(x[after, 0] - (t[after] - 0.5 / a)).max() < a * H**2 + (0.0 if F64 else 2e-3)


def test_a_lift_carries_a_ball_up_and_lets_it_fly_when_it_stops(laboratory):
    x, v = path(laboratory, "raised by a lift")
    t, y = laboratory.t, x[:, 1] - R
    rising = (t > 0.22) & (t < 0.69)
    assert np.abs(y[rising] - (t[rising] - 0.2)).max() < (1e-6 if F64 else 5e-4)
    assert np.abs(v[rising, 1] - 1.0).max() < (1e-10 if F64 else 1e-4)
    assert y.max() == pytest.approx(0.5 + 1 / (2 * G), abs=2e-3)
    assert y[-1] == pytest.approx(0.5, abs=1e-3)
    assert np.abs(v[-1]).max() < 2 * G * H


def test_what_friction_holds_on_a_turntable_goes_round_in_a_circle(laboratory):
    """It is carried along chords of the circle; along tangents it would creep out by exp(W^2 h t / 2) - 1, half a hundredth."""
    if laboratory.lab.dim == 2:
        return
    x, _ = path(laboratory, "held on a turntable")
    out = np.hypot(x[2:, 0], x[2:, 2])
    angle = np.unwrap(np.arctan2(-x[2:, 2], x[2:, 0]))
    far = 200 * EPS * ROOM * laboratory.lab.next  # places are rounded far from the origin
    assert np.abs(out - out[0]).max() < far
    assert np.abs(angle - angle[0] - TURNTABLE * H * np.arange(len(out))).max() < far


@pytest.mark.slow
def test_what_rolls_on_a_turntable_circles_with_two_sevenths_of_its_speed():
    """A solid sphere that starts as fast as the table, on a box and on a mesh: a circle, to second order of the step."""
    rate, h, radius = 4.0, 0.01, 0.06
    scene = ts.Scene(dim=3, gravity=(0.0, -G, 0.0))
    scene.add_material("rubber", friction=1.0)
    turns = {"material": "rubber", "rotation_rate": (0.0, float(np.degrees(rate)), 0.0)}
    scene.add_collider(ts.Box((0.0, -1.0, 0.0), (10.0, 2.0, 10.0), **turns))
    mesh = box_mesh((10.0, 2.0, 10.0), (30.0, -1.0, 0.0))
    scene.add_collider(ts.Mesh(mesh, resolution=16, pivot=(30.0, 0.0, 0.0), **turns))
    far = np.array([0.0, 30.0])
    at = np.stack([far + 0.5, [radius] * 2, [0.0] * 2], axis=1)
    scene.add_balls(at, radius=radius, velocity=(0.0, 0.0, -0.5 * rate), material="rubber", body=1)
    with warnings.catch_warnings(), simulate(scene, dt=h, substeps=1) as sim:
        warnings.simplefilter("ignore")  # the rim moves by some radii a step
        x = []
        for _ in range(550):
            sim.step(1)
            x.append(sim.position)
    x = np.array(x)
    centre = far + 0.5 - 0.5 * 7 / 2
    way = x[:, :, 0] - centre - 1j * x[:, :, 2]
    out, angle = np.abs(way), np.unwrap(np.angle(way), axis=0)
    assert np.abs(out / out[0] - 1.0).max() < 1e-3
    assert (angle[-1] - angle[0]) / (549 * h) == pytest.approx(np.full(2, 2 / 7 * rate), rel=5e-4)


def test_pinned_balls_ignore_colliders(laboratory):
    for name in ("pinned", "pinned before a piston"):
        x, v = path(laboratory, name)
        assert np.all(x[1:] == x[1])
        assert np.all(v == 0.0)


def test_overlap_counts_colliders(laboratory):
    assert laboratory.overlap < 0.02 * R
    lab = laboratory.lab
    x = lab.scene.position.copy()
    ball = lab.ball["rests on a box"]
    x[ball, 1] -= 0.4 * R
    deepest = max(diagnostics.collider_depth(lab.scene, c, x, 0.0).max() for c in lab.scene.colliders)
    assert deepest == pytest.approx(0.4 * R)
    assert "colliders" in laboratory.kernels


# Several balls, spin, drivers -----------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_pile_in_a_turning_drum_is_lifted_and_stays_within():
    scene = drum_scene(2)
    with simulate(scene, dt=2e-3) as sim:
        highest, deepest = -1.0, 0.0
        sim.run(0.5)  # it has settled at the bottom
        for _ in range(40):
            sim.run(0.05)
            x = sim.position
            highest = max(highest, x[:, 1].max())
            deepest = max(deepest, sim.penetration())
            assert np.linalg.norm(x, axis=1).max() < 0.6 - 0.04 + 0.004
        assert highest > 0.0
        assert deepest < 0.1 * 0.04
        assert x[:, 0].mean() > 0.05  # the heap leans to the side that rises


@pytest.mark.slow
def test_a_lone_ball_in_a_drum_soon_rolls_without_slipping():
    """Friction turns and carries it until both surfaces have one speed where they touch."""
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("rubber", friction=0.5)
    scene.add_collider(ts.Sphere((0, 0), 1.0, hollow=0.1, rotation_rate=np.degrees(0.5), material="rubber"))
    scene.add_balls([[0.0, -1.0 + R]], radius=R, material="rubber")
    with simulate(scene, dt=H) as sim:
        for _ in range(5):
            sim.run(0.1)
            x, v, turn = sim.position[0], sim.velocity[0], sim.snapshot().surface_speed[0, 0]
            n = -x / np.linalg.norm(x)
            along = np.array([n[1], -n[0]])
            assert v @ along + turn == pytest.approx(0.5, rel=1e-3)
            assert np.linalg.norm(x) == pytest.approx(1.0 - R, abs=0.01 * R)
        assert turn > 0.25


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_pushed_and_carried(method):
    """A piston at an elastic ball, a lift under another, in each method and driver."""
    for driver in ("fused", "parallel"):
        scene = ts.Scene(dim=2, gravity=(0.0, -G))
        scene.add_material("elastic", restitution=1.0)
        scene.add_collider(ts.Box((-0.5, 0.0), (1, 1), velocity=(2.0, 0.0)))
        scene.add_collider(ts.Box((8.0, -0.5), (1, 1), velocity=(0.0, 0.5)))
        scene.add_balls([[0.3, 0.0]], radius=R, material="elastic", body=1)
        scene.add_balls([[8.0, R]], radius=R, body=1)
        with simulate(scene, ("ordered", driver), integrator=method, dt=H) as sim:
            sim.step(500)
            assert sim.velocity[0, 0] == pytest.approx(4.0, rel=1e-6)
            assert sim.position[1, 1] == pytest.approx(R + 0.25, abs=2e-3 * R + 2 * H * 0.5)
            assert sim.velocity[1, 1] == pytest.approx(0.5, abs=2 * G * H)


@pytest.mark.long
@pytest.mark.parametrize("dim", DIMS)
def test_nothing_passes_through_a_collider_that_moves_fast(dim):
    """Balls at rest before a box, a ball, a turning blade and, in 3D, a mesh that move 10 radii a step or turn 0.1 rad."""
    rng = np.random.default_rng(0)
    scene = ts.Scene(dim=dim)
    body, n, groups = scene.new_body(), 200, []
    spin = 100.0 if dim == 2 else (0.0, 0.0, 100.0)
    v, wide = vector(dim, SPEED), block(dim, 1.0, 4.0, 4.0)
    back = vector(dim, -6.0)
    apart = [vector(dim, 0.0, 100.0 * k) for k in range(4)]
    scene.add_collider(ts.Box(apart[0] + back, wide, velocity=v))
    scene.add_collider(ts.Sphere(apart[1] + back, 2.0, velocity=v))
    scene.add_collider(ts.Box(apart[2], block(dim, 6.0, 0.3, 4.0), rotation_rate=np.degrees(spin)))
    if dim == 3:
        scene.add_collider(
            ts.Mesh(ring(wide=1.5, thick=0.5), position=apart[3] + back, rotation=(0, 90, 0), velocity=v)
        )
    for k, collider in enumerate(scene.colliders):
        x = vector(dim, -3.0) + 0.5 * rng.uniform(-1, 1, (n, dim))
        if k == 2:
            x = rng.uniform(-3, 3, (n, dim))
            x[:, 1] = np.where(x[:, 1] < 0, -1, 1) * (np.abs(x[:, 1]) + 0.3)
        assert collider.distance(x + apart[k], 0.0).min() > R
        groups.append(scene.add_balls(x + apart[k], radius=R, body=body))
    with simulate(scene, dt=H) as sim:
        for step in range(30):
            sim.step()
            x = sim.position
            for collider, balls in zip(scene.colliders, groups):
                # what turns: 0.1 that is allowed; by 3 m (0.1)^2 / 2, .3 of them, a tip's way bends in a step
                bend = 0.1 if np.any(collider.motion.turns) else 0.01
                allowed = 0.5 if collider.name == "mesh" else bend
                assert (collider.distance(x[balls], sim.time) - R).min() > -allowed * R, (step, collider.name)
        assert np.all(sim.velocity[groups[0], 0] == pytest.approx(SPEED))
        assert np.all(x[groups[0], 0] > scene.colliders[0].motion.at(sim.time)[0][0, 0])


@pytest.mark.long
@pytest.mark.parametrize("shape", [ts.Sphere((1e4, 0.0), 1.0), ts.Box((0.0, -9.5), (1e6, 1.0))], ids=["far", "wide"])
def test_a_far_or_wide_collider_lifts_no_ball(shape):
    """How finely a contact is known depends on that contact alone."""
    scene = ts.Scene(dim=2, gravity=(0.0, -10.0))
    scene.add_material("default", restitution=0.5)
    scene.add_balls([[0.0, 0.2], [3.0, -8.8]], radius=0.1)
    scene.add_wall((0, 1), -9.0)
    scene.add_wall((0, 1), 0.0, group="upper", collides_with="upper")
    scene.set_group([0], "upper")
    scene.add_collider(shape)
    with simulate(scene, dt=1e-3) as sim:
        sim.run(3.0)
        assert sim.position[:, 1] == pytest.approx([0.1, -8.9], abs=2e-5)


@pytest.mark.slow
def test_a_ball_that_rolls_in_a_hollow_box_meets_the_next_face():
    """Each in its own box: they come to the floor, and to the wall beside it before or just after."""
    scene = ts.Scene(2, (0.0, -9.0))
    r, h = 0.03, 2e-3
    rng = np.random.default_rng(3)
    v = np.stack([np.exp(rng.uniform(-4.0, 1.5, 40)), -np.exp(rng.uniform(-3.5, 0.0, 40))], axis=1)
    lands, meets = rng.uniform(0.0, 12.0, 40) * h, rng.uniform(0.0, 1.5, 40) * h
    half = np.array([0.45, 0.35])
    for k in range(40):
        centre = np.array([2.0 * k, 0.0])
        x = (half[0] - r - v[k, 0] * (lands[k] + meets[k]), r - half[1] - v[k, 1] * lands[k])
        scene.add_balls([centre + x], radius=r, velocity=v[k])
        scene.add_collider(ts.Box(centre, 2 * half, hollow=0.1))
    way = np.linalg.norm(v, axis=1) * h + 9.0 * h**2
    with simulate(scene, dt=h) as sim:
        for _ in range(40):
            sim.step()
            deep = [r - c.distance(x[None], 0.0)[0] for c, x in zip(scene.colliders, sim.position)]
            assert (np.array(deep) < 0.1 * way + 100 * EPS).all()


@pytest.mark.parametrize("method", ["verlet", *(pytest.param(m, marks=pytest.mark.slow) for m in ("rk4", "tr_bdf2"))])
def test_what_rests_on_a_floor_that_leaves_at_once_falls_from_then_on(method):
    """One floor drops, another one that has risen stops; a ball lies on each, and a body of springs on the first."""
    h, kink, g, speed = 1 / 160, 16 / 160, 7.0, 2.5
    scene = ts.Scene(dim=2, gravity=(0, -g))
    x = [0.0, 0.5, 0.7, 3.0]
    scene.add_balls([[a, R] for a in x], radius=R, velocity=[[0, 0]] * 3 + [[0, speed]])
    scene.add_springs([[1, 2]], stiffness=300.0, damping=2.0)
    if method == "rk4":  # none meets another
        scene.set_balls(body=1)
    rest, way = (0.0, 0.0), (0.0, kink * speed)
    drops = [(0.0, rest), (kink, rest), (kink + 0.4, (0.0, -0.4 * speed))]
    stops = [(0.0, rest), (kink, way), (1.0, way)]
    for place, keyframes in ((0.3, drops), (3.0, stops)):
        scene.add_collider(ts.Box((place, -0.5), (2.0, 1.0), path=keyframes))
    with simulate(scene, integrator=method, dt=h, substeps=1) as sim:
        sim.step(16)
        y, v = sim.position[:, 1] - R, np.array([0, 0, 0, speed])
        assert np.abs(sim.velocity[:, 1] - v).max() < 100 * EPS * speed
        for k in range(1, 4):
            sim.step()
            fallen = y + k * h * v - 0.5 * g * (k * h) ** 2
            assert np.abs(sim.position[:, 1] - R - fallen).max() < 100 * EPS
            assert np.abs(sim.velocity[:, 1] - (v - g * k * h)).max() < 100 * EPS * speed


@pytest.mark.slow_where(friction=0.4)
@pytest.mark.skipif(not F64, reason="a balance to rounding")
@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("method", ["implicit_euler", pytest.param("tr_bdf2", marks=pytest.mark.slow)])
def test_a_collider_receives_what_a_soft_body_loses(method, friction):
    scene = ts.Scene(dim=2, gravity=(1.0, -8.0))
    scene.add_material("rough", friction=friction)
    made = jelly(
        scene, (0.3, 0.15), (3, 2), density=700.0, young_modulus=2e4, poisson_ratio=0.25, radius=0.02, material="rough"
    )
    place = scene.position - scene.position.min(axis=0) + np.array([0.0, 0.05])
    scene.set_balls(made.balls, position=place, velocity=(-0.4, -0.8))
    if not friction:  # its balls do not meet each other
        scene.set_balls(body=1)
    scene.add_collider(ts.Box((0.0, -0.5), (4.0, 1.0), material="rough", rotation=-7.0))
    scene.add_probe("push", "impulse", collider=0)
    mass, lost = scene.mass, []
    with simulate(scene, integrator=method, dt=0.003) as sim:
        start = mass @ sim.velocity
        for _ in range(100):
            sim.step(1)
            given = mass.sum() * sim.time * np.array([1.0, -8.0])
            received = sim.snapshot().impulses[0]
            lost.append(start + given - mass @ sim.velocity - received)
    assert np.abs(received).max() > 0.1 * mass.sum()
    assert np.abs(lost).max() < 1e-11 * mass.sum()
