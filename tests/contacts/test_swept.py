"""Balls that move many radii in a step meet what lies on their way: balls, other fast balls, sticks, walls."""

import numpy as np
import pytest
from physics_support import F64, VARIANTS, each_dim, error, simulate, vector

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f32")

R, H = 0.05, 1e-3
SPEED = 10 * R / H
APART = 8.0  # m between two trials, none of which meets another


def directions(rng, n, dim):
    d = rng.normal(size=(n, dim))
    return d / np.linalg.norm(d, axis=1)[:, None]


def bullets(dim, n, seed):
    """3 n trials far apart: at a ball at rest, at a bullet that comes the other way, at a stick across.

    Returns the scene, directions, and the indices of bullets, of balls at rest, of the sticks' two ends.
    """
    rng = np.random.default_rng(seed)
    scene = ts.Scene(dim=dim)
    scene.add_material("m", restitution=0.5)
    side = int(np.ceil((3 * n) ** (1 / dim)))
    centre = APART * np.stack(np.unravel_index(np.arange(3 * n), (side,) * dim), axis=1)
    d = directions(rng, 3 * n, dim)
    across = directions(rng, 3 * n, dim)
    across -= np.sum(across * d, axis=1)[:, None] * d
    across /= np.linalg.norm(across, axis=1)[:, None]
    behind = rng.uniform(0.6, 1.5, (3 * n, 1))
    shot = scene.add_balls(centre - behind * d, radius=R, velocity=SPEED * d, material="m")
    aside = rng.uniform(0.0, 1.98 * R, (3 * n, 1)) * across  # all of them hit
    rest = scene.add_balls((centre + aside)[:n], radius=R, mass=10 ** rng.uniform(-2, 2, n), material="m")
    scene.add_balls(
        (centre + aside + rng.uniform(0.6, 1.5, (3 * n, 1)) * d)[n : 2 * n],
        radius=R,
        velocity=-SPEED * d[n : 2 * n],
        material="m",
    )
    middle = rng.uniform(-0.45, 0.45, (n, 1)) * across[2 * n :]
    ends = [
        scene.add_balls(centre[2 * n :] + middle + half * across[2 * n :], radius=0.01, mass=5.0, material="m")
        for half in (-0.5, 0.5)
    ]
    scene.add_springs(np.stack(ends, axis=1), stiffness=1e4, collides=True)
    return scene, d, shot, rest, ends


def check_bullets(dim, n, seed, variant=VARIANTS[0], **settings):
    scene, d, shot, rest, ends = bullets(dim, n, seed)
    with simulate(scene, variant, dt=H, **settings) as sim:
        p, scale = sim.momentum(), SPEED * scene.n_balls
        sim.step(12)
        x, v = sim.position, sim.velocity
        assert np.max(np.abs(sim.momentum() - p)) < 1e-6 * scale
        assert sim.energy().kinetic < 0.5 * SPEED**2 * 4 * n
    bent = np.linalg.norm(v[shot] - SPEED * d, axis=1) > 1e-3 * SPEED
    struck = np.linalg.norm(v[rest], axis=1) > 0.0
    assert np.all(struck), f"{np.sum(~struck)} of {n} passed a ball"
    assert np.all(bent[n : 2 * n]), f"{np.sum(~bent[n : 2 * n])} of {n} passed another bullet"
    assert np.all(bent[2 * n :]), f"{np.sum(~bent[2 * n :])} of {n} passed a stick"
    beyond = np.sum((x[shot[2 * n :]] - 0.5 * (x[ends[0]] + x[ends[1]])) * d[2 * n :], axis=1)
    assert np.max(beyond) < 0.0


@pytest.mark.slow_where(dim=2)
@each_dim
@pytest.mark.slow
@pytest.mark.long_where(dim=2)
def test_bullets_of_ten_radii_a_step_hit(dim):
    check_bullets(dim, 60, seed=1)


@pytest.mark.long
@pytest.mark.parametrize("contacts", ["gauss_seidel", "jacobi"])
@each_dim
def test_ten_thousand_bullets(dim, contacts):
    check_bullets(dim, 3334, seed=2, variant=("ordered", "parallel"), contacts=contacts)


@pytest.mark.long
def test_a_swung_stick_takes_balls_at_rest_along():
    """Its ends move three radii of the small balls a step; the balls themselves are slow."""
    scene = ts.Scene(dim=2)
    ends = scene.add_balls([[-0.5, 0.0], [0.5, 0.0]], radius=0.1, mass=100.0, velocity=[0.0, 60.0])
    scene.add_springs([ends], stiffness=1e5, collides=True)
    small = scene.add_balls(np.stack([np.linspace(-0.35, 0.35, 9), np.full(9, 0.2)], axis=1), radius=0.02, mass=0.01)
    with simulate(scene, dt=H) as sim:
        sim.step(20)
        x = sim.position
        assert np.min(x[small, 1] - x[ends, 1].mean()) > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("variant", [VARIANTS[0], VARIANTS[1]], ids="-".join)
@pytest.mark.long_where(variant=VARIANTS[0])
def test_a_ball_before_the_wall_is_hit_and_not_run_through_twice(variant):
    """A bullet that would reach the wall behind a ball and come back through it within one step."""
    scene = ts.Scene(dim=2)
    scene.add_material("m", restitution=1.0)
    scene.add_wall((1, 0), 0.0, "m")
    bullet = scene.add_balls([[1.0, 0.0]], radius=R, velocity=[-2000.0, 0.0], material="m")
    target = scene.add_balls([[0.3, 0.0]], radius=R, material="m")
    with simulate(scene, variant, dt=H) as sim:
        for _ in range(5):
            sim.step(1)
            assert sim.position[bullet[0], 0] > sim.position[target[0], 0]
        assert sim.energy().kinetic == pytest.approx(0.5 * 2000.0**2, rel=1e-6)


@each_dim
@pytest.mark.long
def test_a_bullet_leaves_the_stick_that_it_hit(dim):
    """What stopped at a stick in one step lies just at the distance of touch in the next, and must not be held there."""
    across = [0.0] * (dim - 2)
    scene = ts.Scene(dim=dim)
    scene.add_material("default", restitution=1.0)
    ends = scene.add_balls([[-0.5, 0.0, *across], [0.5, 0.0, *across]], radius=0.02, mass=1.0)
    scene.add_springs([ends], stiffness=1e5, collides=True)
    scene.add_balls([[0.1, 1.0, *across]], radius=0.01, mass=0.1)
    start, rng = scene.position, np.random.default_rng(0)
    with simulate(scene, dt=H) as sim:
        for _ in range(20):
            speed = 10 ** rng.uniform(1.5, 4)
            sim.set_position(start)
            sim.set_velocity([[0.0] * dim] * 2 + [[0.0, -speed, *across]])
            sim.step(int(np.ceil(1.0 / speed / H)) + 2)
            height, upward = sim.position[2, 1], sim.velocity[2, 1]
            assert upward > 0.5 * speed
            sim.step(10)
            assert sim.position[2, 1] - height == pytest.approx(10 * H * upward, rel=0.2)


@pytest.mark.slow
def test_a_row_of_bullets_stops_one_by_one():
    """A hundred and fifty, each in the way of the one behind it: in their order after one step, however many rounds it takes."""
    scene = ts.Scene(dim=2)
    n, r = 150, 0.1
    scene.add_balls([[0.0, 0.0]], radius=r, pinned=True)
    scene.add_balls(np.stack([-0.3 - 0.205 * np.arange(n), np.zeros(n)], axis=1), radius=r, velocity=(5000.0, 0.0))
    with simulate(scene, dt=H) as sim:
        sim.step()
        x = sim.position[:, 0]
        assert np.all(np.diff(x) < -r)
        assert sim.penetration() < r


@pytest.mark.long
def test_a_ball_slides_fast_along_a_stick():
    """Further than its radius in a step, just at the distance of touch."""
    scene = ts.Scene(dim=2)
    ends = scene.add_balls([[-0.5, 0.0], [0.5, 0.0]], radius=0.02, pinned=True)
    scene.add_springs([ends], stiffness=1e5, collides=True)
    scene.add_balls([[0.1, 0.00996]], radius=0.01, velocity=[20.0, 0.0])
    with simulate(scene, dt=H) as sim:
        sim.step(5)
        assert sim.position[2, 0] == pytest.approx(0.2, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("own", [True, False], ids=["that_moves", "beside_one_that_moves"])
@pytest.mark.long_where(own=False)
def test_a_bullet_that_bounces_off_a_collider_meets_what_lies_behind(own):
    """Within one step: a path with a bend is never taken for its chord, whatever moves."""
    scene = ts.Scene(dim=2)
    scene.add_material("default", restitution=1.0)
    scene.add_balls([[-0.205, 0.215]], radius=0.01, velocity=[400.0, -400.0], mass=0.1)
    target = scene.add_balls([[-0.1, 0.11]], radius=0.03)[0]
    scene.add_collider(ts.Box((0, -0.5), (4, 1), velocity=(0.5, 0.1) if own else None))
    scene.add_collider(ts.Sphere((50, 50), 0.5, velocity=(0.1, 0)))
    with simulate(scene, dt=H) as sim:
        sim.step(10)
        assert np.linalg.norm(sim.velocity[target]) > 50.0


# Between walls -----------------------------------------------------------------------------------------------------------

SLOT, START, ALONG, ASIDE = 0.9, 0.31, -53.0, 3.0  # width and start [m], speeds [m/s]


def between_walls(dim, others, spring, gap=SLOT):
    """A bullet that goes to and fro between two walls, free or on a spring to a pin, alone or with balls that it never meets."""
    scene = ts.Scene(dim=dim)
    scene.add_material("m", restitution=1.0)
    scene.add_wall(vector(dim, 1.0), 0.0, "m")
    scene.add_wall(vector(dim, -1.0), -gap, "m")
    ball = scene.add_balls([vector(dim, START, 0.0)], radius=R, velocity=[vector(dim, ALONG, ASIDE)], material="m")
    if spring:
        pin = scene.add_balls([vector(dim, 0.4, 1.5)], radius=R, pinned=True, material="m")
        scene.add_springs([(ball[0], pin[0])], stiffness=2000.0, rest_length=1.2)
    if others:
        scene.add_balls([vector(dim, 0.3, -60.0), vector(dim, 0.6, -60.0)], radius=R, material="m")
    return scene


def place_between(t, gap=SLOT):
    """Position of the free bullet across the slot."""
    free = gap - 2 * R
    there = (START - R + ALONG * t) % (2 * free)
    return R + min(there, 2 * free - there)


RULES = ["gauss_seidel", "jacobi", "sum"]


@pytest.mark.parametrize(
    ("dim", "contacts", "method"),
    [
        pytest.param(3, "gauss_seidel", "verlet"),
        *[pytest.param(2, rule, "verlet", marks=pytest.mark.slow) for rule in RULES],
        pytest.param(2, "gauss_seidel", "symplectic_euler", marks=pytest.mark.long),
        *[pytest.param(3, rule, "rk4", marks=pytest.mark.long) for rule in RULES],
    ],
)
def test_a_bullet_between_walls_loses_no_time(dim, contacts, method):
    """It moves one or two radii a step, or further than from wall to wall, with other balls in the scene."""
    for step, gap in ((H, SLOT), (2 * H, SLOT), (10 * H, 0.5 * SLOT)):
        scene = between_walls(dim, True, False, gap)
        with simulate(scene, dt=step, substeps=1, contacts=contacts, integrator=method) as sim:
            sim.step(150)
            expected = vector(dim, place_between(sim.time, gap), ASIDE * sim.time)
            assert error(sim.position[0], expected, 1.0) < (1e-11 if F64 else 1e-3)
            assert np.abs(sim.velocity[0, :2]) == pytest.approx([-ALONG, ASIDE], rel=1e-12 if F64 else 1e-6)


def slit(radius, gap, spacing, along, across, restitution, gravity):
    """Four balls in a row between two walls that are `gap` [m] apart."""
    scene = ts.Scene(dim=2, gravity=gravity)
    scene.add_material("m", restitution=restitution)
    scene.add_wall(across, 0.0, "m")
    scene.add_wall(-across, -gap, "m")
    scene.add_balls(np.outer(spacing * np.arange(4.0), along) + 0.5 * gap * across, radius=radius, material="m")
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("contacts", RULES[:2])
@pytest.mark.long_where(contacts="jacobi")
def test_bullets_in_a_slit_go_on(contacts):
    """Bullets that bounce off both walls several times a step, near others: they waited at a wall, or beside a ball that did, for
    ever, while gravity made them faster."""
    r, gap, rng = 0.04, 3.3 * 0.04, np.random.default_rng(8)
    along, across = np.array([0.8, -0.6]), np.array([0.6, 0.8])
    for restitution in (1.0, 0.6):
        scene = slit(r, gap, 2.6 * r, along, across, restitution, (0.0, -8.0))
        start = scene.position
        with simulate(scene, dt=H, substeps=1, contacts=contacts) as sim:
            for _ in range(8):
                aside = rng.uniform(1.05 * r, gap - 1.05 * r, 4) - 0.5 * gap
                v = np.outer(rng.uniform(-1, 1, 4), along) + np.outer(rng.choice([-1, 1], 4), across)
                sim.set_position(start + np.outer(aside, across))
                sim.set_velocity(v * rng.uniform(70, 500, (4, 1)))
                energy, stood = sim.energy().total, np.zeros(4, dtype=bool)
                for _ in range(60):
                    before = sim.position
                    sim.step()
                    fast = np.linalg.norm(sim.velocity, axis=1) > 10.0
                    stands = fast & (np.linalg.norm(sim.position - before, axis=1) < 1e-4 * r)
                    assert not np.any(stood & stands)
                    stood = stands
                    assert sim.energy().total < 1.001 * energy


@pytest.mark.slow
@pytest.mark.parametrize("contacts", RULES[:2])
@pytest.mark.long_where(contacts="jacobi")
def test_a_stick_far_away_gives_bullets_in_a_slit_nothing(contacts):
    """A scene with a stick bounces at all contacts at once: walls that face each other asked a ball that touches another for
    speeds that contradict each other, and each sweep over them made it faster."""
    r, rng = 0.03, np.random.default_rng(3)
    along, across = np.array([0.6, -0.8]), np.array([0.8, 0.6])
    for restitution, gap in ((1.0, 2.8 * r), (0.7, 3.2 * r)):
        scene = slit(r, gap, 2.4 * r, along, across, restitution, (3.0, -7.0))
        ends = np.outer([-42.0 * r, -41.0 * r], along) + 0.5 * gap * across
        stick = scene.add_balls(ends, radius=0.2 * r, pinned=True, material="m")
        scene.add_springs([stick], stiffness=1e3, collides=True)
        start = scene.position
        with simulate(scene, dt=H, substeps=1, contacts=contacts) as sim:
            for _ in range(10):
                x, v = start.copy(), np.zeros_like(start)
                x[:4] += np.outer(rng.uniform(1.05 * r, gap - 1.05 * r, 4) - 0.5 * gap, across)
                v[:4] = np.outer(rng.uniform(-1, 1, 4), along) + np.outer(rng.choice([-1, 1], 4), across)
                v[:4] *= rng.uniform(50, 300, (4, 1))
                sim.set_position(x)
                sim.set_velocity(v)
                energy = sim.energy().total
                for _ in range(40):
                    sim.step()
                    assert sim.energy().total < 1.001 * energy


@pytest.mark.slow
def test_only_bullets_near_surfaces_wait_at_walls():
    """One far from all triangles loses no time where it turns; one whose way leads to a triangle turns there."""
    gap, behind = 0.7 * SLOT, 20.0
    scene = between_walls(3, True, False, gap)
    near = scene.add_balls([(0.1, 0.0, behind)], radius=R, velocity=(1.3 * ALONG, 0.0, 0.0), material="m")
    middle = 0.5 * gap
    corners = [(middle, -1.0, behind - 1.0), (middle, 2.0, behind), (middle, -1.0, behind + 1.0)]
    sail = scene.add_balls(corners, radius=0.02, pinned=True, material="m")
    scene.add_triangles([sail], collides=True)
    corners = [(0.2, 14.0, 30.0), (0.4, 14.0, 30.0), (0.3, 14.0, 30.2)]
    kite = scene.add_balls(corners, radius=0.02, velocity=(0.3, 0.0, 0.1), material="m", body=9)
    scene.add_triangles([kite], collides=True)
    with simulate(scene, dt=5 * H, substeps=1, contacts="gauss_seidel") as sim:
        for _ in range(10):
            sim.step(7)
            expected = vector(3, place_between(sim.time, gap), ASIDE * sim.time)
            assert error(sim.position[0], expected, 1.0) < (1e-11 if F64 else 1e-3)
            assert 0.99 * R < sim.position[near[0], 0] < middle  # it may sink in, but does not come through


@pytest.mark.slow
@pytest.mark.parametrize("contacts", RULES)
@pytest.mark.long_where(contacts="sum")
def test_a_bullet_on_a_spring_goes_as_if_alone(contacts):
    """With balls in the scene that it never meets: the same path, bit by bit, and the energy of its start."""
    for step in (0.5 * H, 2 * H):
        ends = []
        for others in (False, True):
            with simulate(between_walls(2, others, True), dt=step, substeps=1, contacts=contacts) as sim:
                start = sim.energy().total
                sim.step(round(0.5 / step))
                assert sim.energy().total == pytest.approx(start, rel=0.01)
                ends.append(sim.position[0])
        assert error(ends[1], ends[0], 1.0) < (1e-9 if F64 else 2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("contacts", RULES[:2])
def test_walls_take_what_crowds_of_bullets_give(contacts):
    """A wall that a bullet does not reach, as another ball stops it, takes no momentum and turns nothing."""
    rng = np.random.default_rng(5)
    scene = ts.Scene(dim=2)
    scene.add_material("m", restitution=0.9, friction=0.3)
    lattice = np.stack(np.meshgrid(np.arange(6), np.arange(6)), axis=-1).reshape(-1, 2)
    scene.add_balls(0.2 + 0.32 * lattice, radius=R, velocity=rng.normal(size=(36, 2)) * 3 * R / H, material="m")
    for k, normal in enumerate(np.eye(2)):
        for side, n in enumerate((normal, -normal)):
            scene.add_wall(n, -2.0 * side, "m")
            scene.add_probe(f"w{k}{side}", "impulse", wall=2 * k + side)
    with simulate(scene, dt=H, substeps=1, contacts=contacts) as sim:
        start, energy = sim.momentum(), sim.energy().total
        for _ in range(40):
            sim.step()
            given = sum(
                np.array([sim.probes()[f"w{k}{side}.{axis}"] for axis in "xy"]) for k in (0, 1) for side in (0, 1)
            )
            assert error(sim.momentum() + given, start, 36 * 3 * R / H) < (1e-12 if F64 else 1e-5)
            assert sim.energy().total < energy * (1 + (1e-12 if F64 else 1e-6))
            energy = sim.energy().total
            assert np.all(np.abs(sim.position - 1.0) < 1.0)
