"""Section 3 of the physics notes, by row: what the article's rule fails and ours passes.

Other files hold the rows of free flight (1: integrators/test_motion), of the ends of sticks and of coincident balls (5, 11:
contacts/test_balls_and_sticks), of viscous friction, rest and elastic bounces (6, 9, 12: contacts/test_walls). That each rule of
the article fails: test_reference.
"""

import numpy as np
import pytest
import reference as ref
from physics_sticks import stick_run
from physics_support import EPS, F64, VARIANTS, each_dim, record, simulate, vector

import taichi_sim as ts

pytestmark = [pytest.mark.long_in("f32"), pytest.mark.slow_where(dim=2)]

H, G, R = 1e-3, 10.0, 0.05
NEAR = 1e-12 if F64 else 2e-6


def one_step(scene, **settings):
    """Velocities after one step of symplectic Euler: contacts are solved where the balls are at the start."""
    with simulate(scene, integrator="symplectic_euler", dt=H, **settings) as sim:
        sim.step()
        return sim.velocity


def touching(dim, v, mass=(1.0, 1.0), **material):
    """Two balls that overlap a little along the first axis."""
    scene = ts.Scene(dim=dim)
    scene.add_material("m", **material)
    scene.add_balls([vector(dim), vector(dim, 1.98 * R)], radius=R, velocity=v, mass=mass, material="m")
    return scene


@each_dim
@pytest.mark.slow
@pytest.mark.long_where(dim=2)
def test_row_2_friction_sees_only_the_relative_velocity(dim):
    """Two balls that touch, and move sideways together, keep that velocity whatever the friction."""
    together, n, f = vector(dim, 0.0, 3.0, 1.0), vector(dim, 1.0), 200.0
    v = np.array([together + 0.5 * n, together - 0.5 * n])

    after = one_step(touching(dim, v, viscous_friction=f, friction=0.5))
    assert np.max(np.abs(after - together)) < NEAR


@each_dim
@pytest.mark.slow
@pytest.mark.long_where(dim=2)
def test_row_3_impulse_is_shared_by_inverse_mass(dim):
    m, n = np.array([1.0, 10.0]), vector(dim, 1.0)
    v = np.array([1.0 * n, -1.0 * n])

    scene = touching(dim, v, m, restitution=1.0)
    # beside it the same with the second ball pinned: it takes nothing, the other all
    x = scene.position + vector(dim, 0.0, 10.0)
    scene.add_balls(x, radius=R, velocity=[n, 0 * n], mass=m, material="m", pinned=[1])
    after = one_step(scene)
    free, held = after[:2], after[2:]
    assert np.max(np.abs(m @ free - m @ v)) < 10 * NEAR
    assert abs(m @ np.sum(free**2, axis=1) - m @ np.sum(v**2, axis=1)) < 10 * NEAR
    assert np.max(np.abs(held - np.array([-n, 0 * n]))) < NEAR


@pytest.mark.slow
@each_dim
@pytest.mark.long_where(dim=2)
def test_row_4_stick_keeps_momentum_and_energy(dim):
    """e = 1, unit masses."""
    run = stick_run(dim, VARIANTS[0])
    for b, n, _ in run.at.worked:
        v = np.outer([-1.0, 0.0, 0.0], n)
        after = run.one.v[b]
        assert abs(np.sum(after**2) - 1.0) < 20 * NEAR
        assert np.max(np.abs(after.sum(axis=0) - v.sum(axis=0))) < 20 * NEAR


@each_dim
def test_row_7_damping_is_stable_for_any_coefficient(dim):
    """C h = 3, 100 and 1e6 for the relative motion of a pair: momentum kept, the relative speed decays, never reverses."""
    n, rates = vector(dim, 1.0), (3.0, 100.0, 1e6)
    scene = ts.Scene(dim=dim)
    body = scene.new_body()  # pairs do not touch each other
    for rate in rates:
        b = scene.add_balls([vector(dim), n], radius=0.01, velocity=[-0.25 * n, 0.75 * n], mass=[3.0, 1.0], body=body)
        scene.add_springs([b], stiffness=0.0, damping=0.75 * rate / H)
    with simulate(scene, dt=H) as sim:
        speeds = record(sim, 20)[1].reshape(21, len(rates), 2, dim)
    for rate, v in zip(rates, np.moveaxis(speeds, 1, 0)):
        u = v[:, 1, 0] - v[:, 0, 0]
        assert np.max(np.abs(u[:4] - np.exp(-rate * np.arange(4)))) < NEAR
        assert np.all(u >= -4 * EPS)
        assert np.max(np.abs(3.0 * v[:, 0] + v[:, 1])) < 20 * EPS


@each_dim
@pytest.mark.slow
@pytest.mark.long_where(dim=2)
def test_row_8_many_contacts_share_the_mass(dim):
    """Two coplanar wall pieces, and a dense pack in one pass: the plain sum over-corrects."""
    scene = ts.Scene(dim=dim)
    scene.add_material("ideal", restitution=1.0)
    for _ in range(2):
        scene.add_wall(vector(dim, 0.0, 1.0), 0.0, "ideal")
    scene.add_balls([vector(dim, 0.0, 0.9 * R)], radius=R, velocity=vector(dim, 0.0, -3.0), material="ideal")
    assert abs(one_step(scene, contacts="sum", contact_iterations=1)[0, 1] - 9.0) < 1e-5  # energy x 9
    assert abs(one_step(scene, contact_iterations=1)[0, 1] - 3.0) < 1e-5

    rng = np.random.default_rng(2)
    scene = ts.Scene(dim=dim)
    scene.add_material("ideal", restitution=1.0)
    side = 1.0 if dim == 2 else 0.45
    x = rng.uniform(0, side, (120, dim))
    scene.add_balls(x, radius=R, velocity=rng.normal(size=(120, dim)), material="ideal")
    start = np.sum(scene.velocity**2)
    assert np.sum(one_step(scene, contacts="sum", contact_iterations=1) ** 2) > 1.5 * start
    assert np.sum(one_step(scene, contacts="jacobi", contact_iterations=1) ** 2) < start * (1 + NEAR)


@each_dim
@pytest.mark.slow
@pytest.mark.long_where(dim=2)
def test_row_10_push_out_gives_no_speed(dim):
    """Inside the slop nothing moves and the energy stays; deeper, position is corrected and velocity never sees it."""
    depth = 0.005 * R
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -G))
    scene.add_wall(vector(dim, 0.0, 1.0))
    scene.add_balls([vector(dim, 0.0, R - depth), vector(dim, 1.0, 0.7 * R)], radius=R)
    n = vector(dim, 0.6, 0.8)
    scene.add_balls([vector(dim, 0.0, 5.0), vector(dim, 0.0, 5.0) + 1.5 * R * n], radius=R, mass=[1.0, 4.0])
    with simulate(scene, dt=H) as sim:
        x, v = record(sim, 100)
    assert np.all(x[:, 0] == x[0, 0])
    assert np.all(v[:, :2] == 0.0)
    assert abs(x[-1, 1, 1] - 0.99 * R) < 1e-3 * R
    centre = 0.2 * x[:, 2] + 0.8 * x[:, 3]  # weighted by 1/m, so their centre of mass falls as if nothing were
    expected, _ = ref.free_fall("verlet", centre[0], vector(dim), scene.gravity, H, 100)
    assert np.max(np.abs(centre[-1] - expected)) < 1000 * EPS
    assert np.max(np.abs(v[:, 3] - v[:, 2])) < 100 * EPS
    assert np.linalg.norm(x[-1, 3] - x[-1, 2]) > 1.98 * R


def test_units_of_the_article():
    """K = 10000 and C = 200 belong to the relative motion of two unit masses: k = K / 2, c = C / 2, exactly critical."""
    K, C = 10_000.0, 200.0
    omega, zeta = np.sqrt(K), C / (2 * np.sqrt(K))
    assert zeta == 1.0
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1.1, 0]], radius=0.01)
    spring = ts.spring_from_rates(K, C)
    assert spring == {"stiffness": K / 2, "damping": C / 2}
    scene.add_springs([b], rest_length=1.0, **spring)
    with simulate(scene, dt=1e-4) as sim:
        sim.step(200)
        stretch = sim.position[1, 0] - sim.position[0, 0] - 1.0
    assert stretch == pytest.approx(float(ref.damped_oscillator(0.02, omega, 1.0, 0.1, 0.0)[0]), rel=1e-4)
