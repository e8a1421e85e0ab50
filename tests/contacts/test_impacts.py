"""Impacts among others and under load: friction of what is pressed, energy of crowds, light balls under heavy ones."""

import numpy as np
import pytest
from physics_support import F64, box_mesh, each_dim, error, simulate, vector

import taichi_sim as ts
from taichi_sim.analysis import accuracy
from taichi_sim.analysis.preflight import cautions
from taichi_sim.shapes import jelly

pytestmark = pytest.mark.long_in("f32")

G = 10.0

# Friction of what forces press into a surface --------------------------------------------------------------------------

LOADS = (0.5, 1.5, 2.7, 4.0, 12.0, 50.0)  # on two feet, in units of their weight
MU, SPEED = 0.35, 2.5
METHODS = ("verlet", "rk4", "symplectic_euler", "explicit_euler", "implicit_euler", "tr_bdf2", "xpbd")


def sledges(floor):
    """Each two feet and a load above, joined by springs, which slide along x; one behind the other along z."""
    scene = ts.Scene(dim=3, gravity=(0.0, -G, 0.0))
    scene.add_material("rubber", friction=MU)
    if floor == "wall":
        scene.add_wall((0, 1, 0), 0.0, "rubber")
    else:
        middle, size = (0, -1, 0), (40, 2, 40)
        mesh = ts.Mesh(box_mesh(size, middle), material="rubber")
        scene.add_collider(ts.Box(middle, size, material="rubber") if floor == "box" else mesh)
    radius, stiffness = 0.04, 1.5e4
    for i, load in enumerate(LOADS):
        at = np.array([(-0.5, radius, i), (0.5, radius, i), (0.0, 0.3, i)])
        ball = scene.add_balls(
            at, radius=radius, mass=[1.0, 1.0, 2.0 * load], velocity=(SPEED, 0, 0), material="rubber"
        )
        pairs = [(ball[0], ball[1]), (ball[0], ball[2]), (ball[1], ball[2])]
        scene.add_springs(pairs, stiffness=stiffness, damping=1.4 * np.sqrt(stiffness * load))
    return scene


@pytest.mark.slow
@pytest.mark.parametrize(
    ("floor", "method"),
    [
        pytest.param(f, m, marks=[] if f == "wall" and m in ("verlet", "rk4") else [pytest.mark.long])
        for f in ("wall", "box", "mesh")
        for m in METHODS
        if f == "wall" or m in ("verlet", "implicit_euler")
    ],
)
def test_what_springs_press_down_slides_with_mu_times_its_weight(floor, method):
    """By the impulses of the whole fall: mu times what the floor gave upward, in each sledge within 1 %."""
    scene = sledges(floor)
    weight = scene.mass.reshape(-1, 3, 1)
    step = {"dt": 2e-4} if method == "explicit_euler" else {}
    with simulate(scene, integrator=method, **step) as sim:

        def mean():
            return (weight * sim.velocity.reshape(-1, 3, 3)).sum(axis=1) / weight.sum(axis=1)

        sim.step(round(0.1 / sim.dt))
        before, start = mean(), sim.time
        sim.step(round(0.4 / sim.dt))
        change, time = mean() - before, sim.time - start
    upward = change[:, 1] + G * time
    assert np.all(upward > 0.8 * G * time)
    np.testing.assert_allclose(-change[:, 0], MU * upward, rtol=0.01)


@pytest.mark.long
def test_a_jelly_stops_where_friction_holds_it():
    """On a slope of 15 degrees with mu = .4 it stays; its balls meet the wall all the time, pressed by springs."""
    slope = np.radians(15.0)
    scene = ts.Scene(dim=2, gravity=(G * np.sin(slope), -G * np.cos(slope)))
    scene.add_material("rubber", friction=0.4)
    scene.add_wall((0, 1), 0.0, "rubber")
    jelly(scene, (0.9, 0.5), (7, 5), position=(0, 0.04), material="rubber")
    with simulate(scene) as sim:
        sim.step(round(2.0 / sim.dt))
        assert abs(np.average(sim.velocity[:, 0], weights=scene.mass)) < 0.05


# At the moment of touch ---------------------------------------------------------------------------------------------------


@each_dim
@pytest.mark.parametrize("restitution", [1.0, 0.8])
def test_an_impact_runs_through_a_row_that_touches(dim, restitution):
    """Rows on a floor that touch but for rounding, hit at one end: each ball passes (1 + e) / 2 of its speed on, wherever within
    a step the first is hit."""
    length, radius, number, rng = 7, 0.06, 20, np.random.default_rng(8)
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -6.0))
    scene.add_material("m", restitution=restitution)
    scene.add_wall(vector(dim, 0.0, 1.0), 0.0, "m")
    speed, gap = rng.uniform(0.7, 2.8, number), rng.uniform(0.4, 1.4, number)
    for k in range(number):
        x, v = np.zeros((length, dim)), np.zeros((length, dim))
        x[:, 0], x[:, 1] = 2.0 * radius * np.arange(length), radius
        x[0, 0] -= gap[k] * radius
        x[:, 0] += 1.6 * (k - number / 2)
        v[0, 0] = speed[k]
        scene.add_balls(x, radius=radius, velocity=v, material="m")
    with simulate(scene, dt=1e-3) as sim:
        sim.run(0.16)
        along = sim.velocity[:, 0].reshape(number, length)
    last = ((1.0 + restitution) / 2.0) ** (length - 1) * speed
    assert error(along[:, -1], last, 1.0) < (1e-12 if F64 else 1e-5)
    if restitution == 1.0:
        assert error((along**2).sum(axis=1), speed**2, 1.0) < (1e-12 if F64 else 1e-5)


@pytest.mark.slow_where(dim=3)
@each_dim
def test_pairs_that_do_not_bounce_keep_their_angular_momentum(dim):
    """They overlap by half a radius when they are found; pushed apart again they turn as much more slowly."""
    scene, *_ = encounters(dim, 4, 2e-3, 0.0, 0.35)
    rng = np.random.default_rng(3)
    spin = 5.0 * rng.normal(size=(scene.n_balls, 1 if dim == 2 else 3))
    with simulate(scene, dt=2e-3, substeps=1) as sim:
        sim.resume(ts.Snapshot(scene.position, scene.velocity, surface_speed=spin))
        turning = sim.angular_momentum()
        sim.step(25)
        assert error(sim.angular_momentum(), turning, turning_scale(scene)) < (1e-13 if F64 else 1e-6)


def encounters(dim, n, step, restitution, friction):
    """n pairs of balls of any masses that meet at up to three radii a step, at any part of one, in frames that move as fast: the
    scene, both, where they touch (2, n, dim), when (n,), velocities afterwards (2, n, dim), and the speeds at which they meet."""
    rng, radius = np.random.default_rng(7), np.array([0.04, 0.05])
    scene = ts.Scene(dim=dim)
    scene.add_material("m", restitution=restitution, friction=friction)
    mass = np.stack([np.full(n, 1.3), 1.3 * 10 ** rng.uniform(-3.0, 3.0, n)])
    aside = rng.uniform(-0.99, 0.99, n)
    normal, relative = np.zeros((n, dim)), np.zeros((n, dim))
    normal[:, 0], normal[:, 1] = np.sqrt(1 - aside**2), aside
    speed = rng.uniform(0.1, 3.0, n) * radius[0] / step
    relative[:, 0] = speed
    frame = rng.uniform(-1.0, 1.0, (n, dim)) * speed[:, None]
    part = rng.uniform(0.0, 1.0, (n, 1))
    before = np.stack([(1 - part) * relative, -part * relative]) + frame
    place = 6.0 * np.stack(np.unravel_index(np.arange(n), (int(np.ceil(n ** (1 / dim))),) * dim), axis=1)
    at = place + np.stack([-radius[0] * normal, radius[1] * normal])
    when = rng.uniform(2.0, 4.0, n) * step
    start = at - before * when[:, None]
    balls = [
        scene.add_balls(start[k], radius=radius[k], mass=mass[k], velocity=before[k], material="m") for k in (0, 1)
    ]
    reduced = 1 / (1 / mass).sum(axis=0)
    along = np.sum(relative * normal, axis=1)
    slip = relative - along[:, None] * normal
    held, pressed = reduced / (3.0 if dim == 2 else 3.5), (1.0 + restitution) * along * reduced
    rubbed = np.minimum(1.0, friction * pressed / (np.linalg.norm(slip, axis=1) * held))[:, None] * slip * held[:, None]
    impulse = pressed[:, None] * normal + rubbed
    after = before + np.stack([-impulse / mass[0, :, None], impulse / mass[1, :, None]])
    return scene, np.stack(balls), at, when, after, speed


def turning_scale(scene):
    """Sum of the sizes of angular momenta [kg m^2/s]."""
    return np.sum(scene.mass * np.linalg.norm(scene.position, axis=1) * np.linalg.norm(scene.velocity, axis=1))


@pytest.mark.parametrize(
    ("dim", "restitution", "friction"),
    [
        (2, 0.85, 0.2),
        pytest.param(2, 1.0, 0.6, marks=pytest.mark.slow),
        pytest.param(3, 0.55, 0.25, marks=pytest.mark.slow),
    ],
)
def test_pairs_part_as_two_bodies_do_however_fast(dim, restitution, friction):
    """Whatever their masses, and where one is shifted by several radii: none passes, none takes another direction. What moves by
    less than a radius a step goes on from where it touched, though impacts are found up to a step late."""
    step = 1e-3
    scene, balls, at, when, after, speed = encounters(dim, 300, step, restitution, friction)
    with simulate(scene, dt=step, substeps=1) as sim:
        turning = sim.angular_momentum()
        sim.step(8)
        off = np.linalg.norm(sim.velocity[balls] - after, axis=2) / speed
        aside = np.linalg.norm(sim.position[balls] - at - after * (sim.time - when)[:, None], axis=2)
        assert error(sim.angular_momentum(), turning, turning_scale(scene)) < (1e-13 if F64 else 1e-6)
    assert off.max() < (1e-9 if F64 else 2e-2)
    assert np.median(off) < (1e-11 if F64 else 1e-4)
    slow = np.linalg.norm(scene.velocity[balls], axis=2).max(axis=0) * step < scene.radius.min()
    assert slow.sum() > 60
    assert aside[:, slow].max() < (1e-12 if F64 else 1e-4)


@pytest.mark.slow
def test_heights_above_a_pinned_ball():
    """A bounce found late, up to 8 mm deep in the pinned ball, gives the height of one at the moment of touch."""
    n, e, top = 12, 0.8, np.linspace(0.4, 0.9, 12)
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("m", restitution=e)
    across = np.arange(n, dtype=float)
    scene.add_balls(np.stack([across, 0.1 + top], axis=1), radius=0.05, material="m")
    scene.add_balls(np.stack([across, 0.0 * across], axis=1), radius=0.05, pinned=True, material="m")
    with simulate(scene, dt=2e-3, substeps=1) as sim:
        sim.step(round(0.7 / sim.dt))
        x, v = sim.position[:n, 1] - 0.1, sim.velocity[:n, 1]
        speed = np.sqrt(2 * G * top)
        since = sim.time - speed / G  # one bounce each: this long ago
        assert np.all((since > 0) & (since < 2 * e * speed / G))
        assert error(x, e * speed * since - 0.5 * G * since**2, 1.0) < 5e-5
        assert error(v, e * speed - G * since, 1.0) < 5e-4


@pytest.mark.slow
@each_dim
def test_impacts_move_no_centre_of_mass(dim):
    """Of a crowd with friction, most of which has several impacts in a step; and it never gains energy."""
    rng, n = np.random.default_rng(8), 60
    scene = ts.Scene(dim=dim)
    scene.add_material("m", restitution=0.9, friction=0.4)
    side = int(np.ceil(n ** (1 / dim)))
    x = np.stack(np.unravel_index(np.arange(n), (side,) * dim), axis=1) * 0.25 + rng.uniform(-0.02, 0.02, (n, dim))
    scene.add_balls(x, radius=0.1, mass=rng.uniform(1.0, 3.0, n), velocity=-6.0 * (x - x.mean(axis=0)), material="m")
    with simulate(scene, dt=4e-3, substeps=1) as sim:
        momentum, energy = sim.momentum(), sim.energy().total
        centre = scene.mass @ sim.position / scene.mass.sum()
        for _ in range(60):
            sim.step()
            assert sim.energy().total <= energy * (1 + (1e-13 if F64 else 1e-6))
            energy = sim.energy().total
        assert error(sim.momentum(), momentum, 600.0) < (1e-14 if F64 else 1e-6)
        now = scene.mass @ sim.position / scene.mass.sum()
        assert error(now, centre + momentum / scene.mass.sum() * sim.time, 1.0) < (1e-13 if F64 else 1e-5)


# Crowds -----------------------------------------------------------------------------------------------------------------


def crowd(dim, n, filled, gravity, speed, seed):
    """Elastic balls at random places in a box of walls, without friction."""
    rng, radius = np.random.default_rng(seed), 0.04
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -gravity))
    scene.add_material("steel", restitution=1.0)
    side = (n * (np.pi * radius**2 if dim == 2 else 4 / 3 * np.pi * radius**3) / filled) ** (1 / dim)
    for axis in range(dim):
        scene.add_wall(np.eye(dim)[axis], 0.0, "steel")
        scene.add_wall(-np.eye(dim)[axis], -side, "steel")
    at = []
    while len(at) < n:
        x = rng.uniform(1.01 * radius, side - 1.01 * radius, dim)
        if all(np.linalg.norm(x - y) > 2.02 * radius for y in at):
            at.append(x)
    v = rng.normal(size=(n, dim))
    v *= speed / np.sqrt((v**2).sum(axis=1).mean())
    scene.add_balls(at, radius=radius, velocity=v, material="steel")
    return scene


def energy(scene, sim):
    """Kinetic and in all [J]."""
    kinetic = 0.5 * float(scene.mass @ (sim.velocity**2).sum(axis=1))
    return kinetic, kinetic - float(scene.mass @ (sim.position @ scene.gravity))


@pytest.mark.parametrize(
    ("dim", "n", "filled", "gravity", "speed", "method"),
    [
        (2, 60, 0.15, 10.0, 3.0, "verlet"),
        pytest.param(2, 60, 0.15, 0.003, 1.0, "symplectic_euler", marks=pytest.mark.long),
        pytest.param(2, 150, 0.3, 5.0, 3.0, "verlet", marks=pytest.mark.long),
        pytest.param(2, 50, 0.05, 10.0, 3.0, "rk4", marks=pytest.mark.long),
        pytest.param(3, 80, 0.1, 10.0, 4.0, "verlet", marks=pytest.mark.long),
        pytest.param(3, 200, 0.2, 1.0, 1.0, "verlet", marks=pytest.mark.long),
    ],
)
@pytest.mark.slow
def test_elastic_crowds_keep_their_energy(dim, n, filled, gravity, speed, method):
    """99.5 % of what moves, in 2 s, whatever gravity."""
    scene = crowd(dim, n, filled, gravity, speed, seed=7)
    with simulate(scene, integrator=method) as sim:
        kinetic, before = energy(scene, sim)
        sim.step(round(2.0 / sim.dt))
        assert abs(energy(scene, sim)[1] - before) < 5e-3 * kinetic


@pytest.mark.long
def test_lossless_balls_that_overlap_at_rest_come_apart():
    """Side by side on the floor, where nothing presses them together and nothing ever will."""
    scene, radius = ts.Scene(dim=2, gravity=(0.0, -G)), 0.06
    scene.add_material("steel", restitution=1.0)
    scene.add_wall((0, 1), 0.0, "steel")
    scene.add_balls([(0.0, radius), (1.6 * radius, radius)], radius=radius, material="steel")
    with simulate(scene, dt=1e-3) as sim:
        before = sim.energy().total
        sim.step(150)
        assert sim.penetration() < 0.01 * radius
        assert sim.energy().total == pytest.approx(before, rel=1e-5)


@pytest.mark.long
def test_light_balls_between_walls_and_heavy_ones_keep_their_energy():
    """Without gravity, masses 1 to 2000: what a corner and a heavy ball close in bounces in turn, and is not stopped there."""
    scene = crowd(3, 24, 0.12, 0.0, 12.0, seed=3)
    scene.set_balls(mass=2000.0 ** np.random.default_rng(5).uniform(0.0, 1.0, 24))
    with simulate(scene, dt=1e-3, substeps=1) as sim:
        _, before = energy(scene, sim)
        sim.step(100)
        assert energy(scene, sim)[1] == pytest.approx(before, rel=1e-9 if F64 else 1e-5)


# Light under heavy ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_nothing_comes_back_where_nothing_bounces():
    """e = 0: a heavy ball falls on a light one on the floor, or on two: no rebound above .02 of its speed, no gain."""
    scene, radius, speed = ts.Scene(dim=2, gravity=(0.0, -G)), 0.06, 2.5
    scene.add_wall((0, 1), 0.0)
    columns = []
    for k, (below, mass) in enumerate([(1, 1.0), (1, 3.0), (1, 12.0), (1, 50.0), (1, 100.0), (2, 1.0), (2, 8.0)]):
        at = [(k, (2 * j + 1) * radius) for j in range(below)]
        at.append((k, (2 * below + 1) * radius + 0.013))
        ball = scene.add_balls(at, radius=radius, mass=[1.0] * below + [mass])
        scene.set_balls(ball[-1], velocity=(0.0, -speed))
        columns.append(ball)
    top = np.array([ball[-1] for ball in columns])
    scale = 0.5 * scene.mass[top] * speed**2
    with simulate(scene, dt=1e-3) as sim:

        def each():
            total = 0.5 * scene.mass * (sim.velocity**2).sum(axis=1) + G * scene.mass * sim.position[:, 1]
            return np.array([total[ball].sum() for ball in columns])

        fastest, gain, last = np.full(len(top), -np.inf), np.zeros(len(top)), each()
        for _ in range(200):
            sim.step(1)
            now = each()
            fastest = np.maximum(fastest, sim.velocity[top, 1])
            gain, last = np.maximum(gain, (now - last) / scale), now
        assert np.all(np.abs(sim.velocity[top]) < 0.05)
    assert np.all(fastest < 0.02 * speed), fastest / speed
    assert np.all(gain < 1e-3), gain


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "accumulate", "sticks", "most"),
    [
        ("jacobi", "ordered", False, 0.08),
        pytest.param("gauss_seidel", "ordered", True, 0.1, marks=pytest.mark.long),
    ],
)
def test_little_comes_back_by_iterations_over_all_contacts(rule, accumulate, sticks, most):
    """e = 0, impacts not in turn: no more of the speed than is said, the upper ball at 12 heights, its mass 1 to 6 times."""
    scene, radius, speed = ts.Scene(dim=2, gravity=(0.0, -G)), 0.07, 2.5
    scene.add_wall((0, 1), 0.0)
    for k in range(12):
        at = [(0.5 * k, radius), (0.5 * k, 3 * radius + 0.001 * (k + 1))]
        scene.add_balls(at, radius=radius, mass=[1.0, 1.0 + 5.0 * (k % 2)], velocity=[(0, 0), (0, -speed)])
    if sticks:
        ends = scene.add_balls([(-3.0, 3.0), (-3.5, 3.0)], radius=0.01, pinned=True)
        scene.add_springs([ends], stiffness=100.0, collides=True)
    fastest = 0.0
    with simulate(scene, (accumulate, "fused"), dt=7e-4, contacts=rule) as sim:
        setup = sim.setup
        for _ in range(90):
            sim.step(1)
            fastest = max(fastest, sim.velocity[1:24:2, 1].max() / speed)
    assert fastest < most
    told = next(f for f in accuracy.findings(scene, setup) if f.subject == "rebound")
    assert ("sticks" in told.cure) is sticks
    said = float(told.what.split("up to ")[1].split()[0])
    assert 0.2 * said < fastest < 1.1 * said
    for ratio, number in (6.0, 0), (60.0, rule == "gauss_seidel"):
        scene.set_balls(1, mass=ratio)
        warned = [caution for caution in cautions(scene, setup) if caution.startswith("rebound: ")]
        assert len(warned) == number


@pytest.mark.slow
def test_unequal_piles_by_iterations_do_not_rest_inside_each_other():
    """Masses 1 to 8 by Jacobi: what holds less of an impact still carries the heavier balls."""
    rng = np.random.default_rng(8)
    for _ in range(4):
        scene, radius = ts.Scene(dim=2, gravity=(0.0, -G)), 0.04
        scene.add_material("stone", restitution=0.4, friction=0.3)
        for normal, offset in (((0, 1), 0.0), ((1, 0), 0.0), ((-1, 0), -0.8)):
            scene.add_wall(normal, offset, "stone")
        at = np.stack(np.divmod(np.arange(60), 8)[::-1], axis=1) * 0.096 + 0.056 + rng.uniform(-0.007, 0.007, (60, 2))
        speed = rng.uniform(-1.0, 1.0, (60, 2))
        scene.add_balls(at, radius=radius, mass=8.0 ** rng.uniform(0, 1, 60), velocity=speed, material="stone")
        with simulate(scene, dt=1e-3, contacts="jacobi") as sim:
            sim.step(3000)
            assert sim.penetration() < 0.05 * radius
            assert np.abs(sim.velocity).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("contacts", "e", "missing"), [("auto", 0.6, 0.01), ("jacobi", 0.4, 0.05)])
def test_neighbours_take_nothing_from_a_bounce(contacts, e, missing):
    """Spheres that roll side by side into a wall, touching each other and the floor, come back like one alone: with e. By Jacobi
    (1 + e) (1 - 1 / 4)^16 = 0.014 of the speed is missing from the middle one, 0.035 of what e gives."""
    speed, radius = 1.7, 0.07
    scene = ts.Scene(dim=3, gravity=(0.0, -G, 0.0))
    scene.add_material("wood", restitution=e, friction=0.25)
    scene.add_wall((0, 1, 0), 0.0, "wood")
    scene.add_wall((-1, 0, 0), -1.0, "wood")
    at = [(0.6, radius, 2 * radius * k) for k in range(3)] + [(0.6, radius, 1.0)]
    scene.add_balls(at, radius=radius, velocity=(speed, 0, 0), material="wood")
    with simulate(scene, dt=1e-3, contacts=contacts) as sim:
        rolls = sim.velocity
        while np.all(sim.velocity[:, 0] > 0.0):
            assert sim.time < 1.0
            rolls = sim.velocity
            sim.step(1)
        sim.step(2)
        np.testing.assert_allclose(-sim.velocity[:, 0], e * rolls[:, 0], rtol=missing)


PILED, SIDE = 0.04, 0.4  # m: radius of the balls of a pile, width of its box


def unequal_pile(seed, n=60):
    """Balls of masses 1 to 120 that bounce and rub, above a box that is ten radii wide."""
    rng, at = np.random.default_rng(seed), []
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("mix", restitution=0.5, friction=0.35)
    for normal, offset in (((0, 1), 0.0), ((1, 0), 0.0), ((-1, 0), -SIDE)):
        scene.add_wall(normal, offset, "mix")
    while len(at) < n:
        x = np.array([rng.uniform(1.01 * PILED, SIDE - 1.01 * PILED), rng.uniform(1.1 * PILED, 70 * PILED)])
        if all(np.linalg.norm(x - y) > 2.02 * PILED for y in at):
            at.append(x)
    scene.add_balls(at, radius=PILED, mass=120.0 ** rng.uniform(0.0, 1.0, n), material="mix")
    return scene


@pytest.mark.slow
def test_piles_of_unequal_masses_come_to_rest():
    """In each of six starts nothing moves after 8 s, and nothing sinks into another."""
    with simulate(unequal_pile(0), dt=1e-3) as sim:
        for seed in (1, 8, 13, 22, 30, 40):
            scene = unequal_pile(seed)
            sim.reset(scene)
            sim.run(8.0)
            assert np.average((sim.velocity**2).sum(axis=1), weights=scene.mass) < 1e-6
            assert sim.penetration() < 0.1 * PILED


@pytest.mark.long
@pytest.mark.parametrize(("e", "mu"), [(0.0, 0.0), (0.5, 0.0), (0.6, 0.2)])
def test_crowds_of_unequal_balls_do_not_fall_through_each_other(e, mu):
    """Masses 1 to 100 and radii 1 to 3: no overlap above the radius of the smaller ball in any of eight crowds, little of it left
    at rest, but for a few that have not come to it after 3 s."""
    deepest, last = np.array([overlaps_of_unequal_balls(seed, e, mu) for seed in range(8)]).T
    assert deepest.max() < 1.0
    assert np.median(last) < 0.1


def overlaps_of_unequal_balls(seed, e, mu):
    """Of a crowd that falls into a box: the largest in 3 s, and that at the end, in radii of the smaller ball."""
    rng, n, side = np.random.default_rng(seed), 60, 1.2
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("mix", restitution=e, friction=mu)
    for normal, offset in (((0, 1), 0.0), ((1, 0), 0.0), ((-1, 0), -side)):
        scene.add_wall(normal, offset, "mix")
    big = rng.random(n) < 0.5
    radius, at = np.where(big, 0.09, 0.03), []
    while len(at) < n:
        x, own = np.array([rng.uniform(0.1, side - 0.1), rng.uniform(0.1, 4.0)]), radius[len(at)]
        if all(np.linalg.norm(x - y) > 1.01 * (own + r) for y, r in zip(at, radius)):
            at.append(x)
    scene.add_balls(at, radius=radius, mass=np.where(big, 100.0, 1.0), material="mix")

    def overlap(x):
        apart = np.linalg.norm(x[:, None] - x[None], axis=2) + 9.0 * np.eye(n)
        return np.max((radius[:, None] + radius - apart) / np.minimum(radius[:, None], radius))

    with simulate(scene) as sim:
        deepest = 0.0
        while sim.time < 3.0:
            sim.step(5)
            deepest = max(deepest, overlap(sim.position))
        return deepest, overlap(sim.position)


# Thresholds belong to the scene -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_without_gravity_everything_bounces():
    """A ball at 3 mm/s comes back from a wall, and from a ball, at e times its speed: nothing makes it rest."""
    scene, radius = ts.Scene(dim=2), 0.01
    scene.add_material("glass", restitution=0.8)
    scene.add_wall((1, 0), 0.0, "glass")
    scene.add_balls([(radius + 1e-4, 0.0)], radius=radius, velocity=(-3e-3, 0.0), material="glass")
    scene.add_balls([(1.0, 0.0), (1.0 + 2 * radius + 1e-4, 0.0)], radius=radius, material="glass")
    scene.set_balls(2, velocity=(-3e-3, 0.0))
    with simulate(scene, dt=1e-3) as sim:
        sim.step(100)
        v = sim.velocity[:, 0]
    tolerance = 1e-9 if F64 else 1e-4
    np.testing.assert_allclose(v, [2.4e-3, -2.7e-3, -0.3e-3], rtol=tolerance)


def test_a_ball_in_a_hollow_box_meets_the_next_face_in_time():
    """It slides along the floor of the box and comes back from the side without entering it."""
    scene, radius, speed = ts.Scene(dim=2, gravity=(0.0, -G)), 0.05, 3.0
    scene.add_material("ice", restitution=0.7)
    scene.add_collider(ts.Box((0, 0.5), (2.0, 1.0), hollow=0.1, material="ice"))
    scene.add_balls([(0.5 + 1e-3 * k, radius) for k in range(1)], radius=radius, velocity=(speed, 0.0), material="ice")
    with simulate(scene, dt=2e-3) as sim:
        furthest = 0.0
        for _ in range(150):
            sim.step(1)
            furthest = max(furthest, float(sim.position[0, 0]))
        assert furthest < 1.0 - radius + 0.01 * radius
        np.testing.assert_allclose(sim.velocity[0, 0], -0.7 * speed, rtol=1e-6 if F64 else 1e-3)


# The same seen from what moves -----------------------------------------------------------------------------------------


def pinched(floor, speed):
    """Velocities (n, 2) from a floor that moves with `speed` [m/s], of light balls that fall on it, each under a heavy one."""
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("rubber", friction=0.3)
    r, x = 0.04, np.arange(6) * 1.0
    light = np.stack([x, np.full(6, r)], axis=1)
    heavy = light + np.stack([0.02 + 0.004 * x, 2.05 * r - 0.002 * x], axis=1)
    moves = np.array((0.4, speed))
    for at, mass, falls in ((light, 0.8, -1.7), (heavy, 7.0, -0.9)):
        scene.add_balls(at, radius=r, mass=mass, velocity=np.array((0.2, falls)) + moves, material="rubber")
    if floor == "box":
        box = ts.Box((2.5, -0.5), (20, 1), material="rubber", path=[(0.0, (0, 0)), (10.0, tuple(10 * moves))])
        scene.add_collider(box)
    else:
        below = scene.add_balls(light - (0, 2 * r), radius=r, material="rubber", pinned=range(6))
        scene.add_moving_pins(below, path=[(0.0, (0, 0)), (10.0, tuple(10 * moves))])
    with simulate(scene, dt=1e-3, substeps=1) as sim:
        sim.step(4)
        return sim.velocity[:12] - moves


@pytest.mark.slow_where(floor="box")
@pytest.mark.skipif(not F64, reason="balls that are pinched amplify the rounding of single precision")
@pytest.mark.parametrize("floor", ["box", "pins"])
def test_a_ball_pinched_by_what_moves_goes_as_seen_from_there(floor):
    still = pinched(floor, 0.0)
    for speed in (1.2, -1.2):
        np.testing.assert_allclose(pinched(floor, speed), still, atol=1e-9)
