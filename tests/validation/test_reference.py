"""The reference checks itself: NumPy only, no Taichi. A fault here would make every other comparison worthless."""

import numpy as np
import pytest
import reference as ref

pytestmark = pytest.mark.once

METHODS = ("explicit_euler", "symplectic_euler", "verlet", "rk4")
K, H = 100.0, 1e-3


def pair(k=K, c=0.0, dim=2, w=(1.0, 1.0), stretch=0.1):
    """Two balls on a spring of rest length 1 along x, stretched, at rest; the relative motion is one oscillator."""
    net = ref.network(w, [[0, 1]], k, c, 1.0, np.zeros(dim))
    x = np.zeros((2, dim))
    x[1, 0] = 1.0 + stretch
    return net, x, np.zeros((2, dim))


def cloth(rng, dim, c=0.5, n=4):
    """A crumpled n x n lattice with diagonals, masses 0.1 to 10."""
    at = [(i, j) for i in range(n) for j in range(n)]
    pairs = [(a, b) for a in range(n * n) for b in range(a) if np.hypot(*np.subtract(at[a], at[b])) < 1.5]
    x = np.zeros((n * n, dim))
    x[:, :2] = np.array(at) + 0.1 * rng.standard_normal((n * n, 2))
    net = ref.network(10 ** rng.uniform(-1, 1, n * n), pairs, K, c, 1.0, np.zeros(dim))
    return net, x, rng.standard_normal((n * n, dim))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("method", METHODS)
def test_free_fall(method, dim):
    g, v0 = np.array([0.3, -9.81, 0.2])[:dim], np.array([1.0, 2.0, 3.0])[:dim]
    net = ref.network([1.0], [], [], [], [], g)
    x, v = ref.run(method, net, np.ones((1, dim)), [v0], H, 1000)
    expected_x, expected_v = ref.free_fall(method, np.ones(dim), v0, g, H, 1000)
    np.testing.assert_allclose(x[0], expected_x, rtol=1e-12)
    np.testing.assert_allclose(v[0], expected_v, rtol=1e-12)


@pytest.mark.parametrize("method", ["symplectic_euler", "verlet"])
def test_oscillator_frequency_and_modified_energy(method):
    h, omega = 0.02, np.sqrt(2 * K)
    net, x, v = pair()
    w = ref.discrete_frequency(omega, h)
    first = ref.modified_energy(method, 0.1, 0.0, omega, h)
    # x_n = A cos(w n h + phase), the phase from x_1: both schemes are x_(n+1) - 2 cos(w h) x_n + x_(n-1) = 0
    stretches = [0.1]
    for _ in range(1000):
        x, v = ref.STEPS[method](net, x, v, h)
        s, u = x[1, 0] - x[0, 0] - 1.0, v[1, 0] - v[0, 0]
        stretches.append(s)
        assert abs(ref.modified_energy(method, s, u, omega, h) - first) < 1e-12 * first
    n = np.arange(1001)
    sine = (stretches[1] - 0.1 * np.cos(w * h)) / np.sin(w * h)
    np.testing.assert_allclose(stretches, 0.1 * np.cos(w * h * n) + sine * np.sin(w * h * n), atol=1e-11)


def test_rk4_amplification():
    h, omega = 0.05, np.sqrt(2 * K)
    y = omega * h
    net, x, v = pair()
    x, v = ref.run("rk4", net, x, v, h, 100)
    z = (x[1, 0] - x[0, 0] - 1.0) - 1j * (v[1, 0] - v[0, 0]) / omega  # z' = i omega z
    assert abs(z - 0.1 * ref.rk4_amplification(y) ** 100) < 1e-12
    assert abs(abs(ref.rk4_amplification(y)) ** 2 - (1 - y**6 / 72 + y**8 / 576)) < 1e-14


@pytest.mark.parametrize(("method", "order"), list(zip(METHODS, (1, 1, 2, 4))))
@pytest.mark.parametrize("zeta", [0.0, 0.1, 0.5, 1.0, 3.0])
def test_order_on_the_damped_oscillator(method, order, zeta):
    """Verlet's pair damping too: second order for a lone pair, at any damping."""
    omega = np.sqrt(2 * K)
    net, x0, v0 = pair(c=zeta * omega)  # C = c / mu = 2 c, and 2 zeta omega = C
    v0[1, 0] = 0.5
    x_true, v_true = ref.damped_oscillator(0.05, omega, zeta, 0.1, 0.5)
    errors = []
    for steps in (20, 40, 80, 160, 320) if order == 4 else (100, 200, 400, 800, 1600):
        x, v = ref.run(method, net, x0, v0, 0.05 / steps, steps)
        errors.append(np.hypot(x[1, 0] - x[0, 0] - 1.0 - x_true, (v[1, 0] - v[0, 0] - v_true) / omega))
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] > 1e-14  # above round-off, or the slopes say nothing
    np.testing.assert_allclose(slopes, order, atol=0.15)


@pytest.mark.parametrize("zeta", [0.1, 1.0, 3.0])
def test_damped_oscillator_satisfies_its_equation(zeta):
    t, d = np.linspace(0, 2, 50), 1e-5
    x, v = ref.damped_oscillator(t, 3.0, zeta, 0.7, -0.4)
    assert (x[0], v[0]) == pytest.approx((0.7, -0.4), abs=1e-14)
    ahead, behind = (
        ref.damped_oscillator(t + d, 3.0, zeta, 0.7, -0.4),
        ref.damped_oscillator(t - d, 3.0, zeta, 0.7, -0.4),
    )
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * d), v, atol=1e-8)
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * d), -6.0 * zeta * v - 9.0 * x, atol=1e-7)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dim", [2, 3])
def test_network_keeps_momentum(method, dim):
    net, x, v = cloth(np.random.default_rng(1), dim)
    m = 1 / net.w
    x1, v1 = ref.run(method, net, x, v, H, 50)
    scale = float(m @ np.linalg.norm(v, axis=1))
    assert np.abs(m @ v1 - m @ v).max() < 1e-13 * scale * np.sqrt(50)
    turned = np.abs(ref.angular_momentum(m, x1, v1) - ref.angular_momentum(m, x, v)).max()
    exact = method in ("symplectic_euler", "verlet")  # the others keep it only to their order
    assert turned < (1e-12 if exact else 1.0) * scale


def test_damping_never_adds_energy_and_is_exact():
    net, x, v = cloth(np.random.default_rng(2), 2, c=1e9)
    net = net._replace(k=0.0 * net.k, gravity=0.0 * net.gravity)
    after = ref.damped_kick(net, x, v, 1.0)
    assert ref.energy(net, x, after)[0] < ref.energy(net, x, v)[0]
    lone = ref.network([1.0, 0.25], [[0, 1]], K, 3.0, 0.7, [0.0, 0.0])
    v = np.array([[1.0, 5.0], [-2.0, 7.0]])
    after = ref.damped_kick(lone, np.array([[0.0, 0.0], [1.0, 0.0]]), v, 0.2)
    creep = -K * 0.3 / 3.0  # where the speed u ends: k s + c u = 0
    assert (after[1, 0] - after[0, 0]) == pytest.approx(creep + (-3.0 - creep) * np.exp(-3.0 * 1.25 * 0.2), rel=1e-13)
    assert np.array_equal(after[:, 1], v[:, 1])


def test_energy_is_what_the_forces_derive_from():
    net, x, v = cloth(np.random.default_rng(3), 3, c=0.0)
    force, d = ref.spring_forces(x, v, net.pairs, net.k, net.c, net.rest), 1e-6
    for i, axis in [(0, 0), (5, 1), (9, 2)]:
        step = np.zeros_like(x)
        step[i, axis] = d
        slope = (ref.energy(net, x + step, v)[1] - ref.energy(net, x - step, v)[1]) / (2 * d)
        assert force[i, axis] == pytest.approx(-slope, abs=1e-6)


def test_coincident_pair_and_rest_length_zero():
    x, v = np.zeros((2, 2)), np.zeros((2, 2))
    np.testing.assert_array_equal(ref.spring_forces(x, v, [[0, 1]], 10.0, 0.0, 1.0), [[-10.0, 0.0], [10.0, 0.0]])
    np.testing.assert_array_equal(ref.spring_forces(x, v, [[1, 0]], 10.0, 0.0, 1.0), [[-10.0, 0.0], [10.0, 0.0]])
    np.testing.assert_array_equal(ref.spring_forces(x, v, [[0, 1]], 10.0, 0.0, 0.0), np.zeros((2, 2)))
    x = np.array([[0.0, 0.0], [3.0, 4.0]])
    np.testing.assert_allclose(ref.spring_forces(x, v, [[0, 1]], 2.0, 0.0, 0.0), [[6.0, 8.0], [-6.0, -8.0]], rtol=1e-15)
    with np.errstate(invalid="ignore"):
        assert np.isnan(ref.wrong_direction(x[0], x[0])).all()


def test_rotating_pair():
    k, W, mu = 1e4, 3.0, 0.5
    d = ref.rotating_pair_length(1.0, mu, W, k)
    assert k * (d - 1.0) == pytest.approx(mu * W * W * d, rel=1e-12)  # the spring gives the centripetal force
    net = ref.network([1.0, 1.0], [[0, 1]], k, 0.0, 1.0, [0.0, 0.0])
    x, v = np.array([[-d / 2, 0.0], [d / 2, 0.0]]), np.array([[0.0, -W * d / 2], [0.0, W * d / 2]])
    x, v = ref.run("rk4", net, x, v, H / 4, 1000)
    assert np.linalg.norm(x[1] - x[0]) == pytest.approx(d, rel=1e-9)


def test_chain_stretch_and_modes():
    n, k, m, g = 5, 200.0, 0.3, 9.81
    y = -np.arange(n + 1.0)
    below = np.array([m * g * (n - s) / k for s in range(n)])  # spring s carries n - s balls
    y[1:] -= np.cumsum(below)
    assert -y[-1] - n == pytest.approx(ref.chain_stretch(m, g, n, k), rel=1e-12)
    springs = [[i, i + 1] for i in range(n)]
    net = ref.network([0.0] + [1 / m] * n, springs, k, 0.0, 1.0, [0.0, -g])
    x = np.stack([np.zeros(n + 1), y], axis=1)
    np.testing.assert_allclose(ref.acceleration(net, x, np.zeros_like(x)), 0.0, atol=1e-11)
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    np.testing.assert_allclose(
        np.sqrt(np.linalg.eigvalsh(k / m * stiffness)),
        [ref.chain_mode(k, m, n, p) for p in range(1, n + 1)],
        rtol=1e-12,
    )


def test_bounces_and_slides():
    height, rest = ref.bounces(2.0, 9.81, 0.5, 3)
    fall = np.sqrt(2 * 2.0 / 9.81)
    assert height == pytest.approx(2.0 / 64)
    assert rest == pytest.approx(fall + sum(2 * fall * 0.5**i for i in range(1, 60)), rel=1e-12)
    speed, way = ref.viscous_slide(3.0, 2.0, 0.7)
    assert way == pytest.approx((3.0 - speed) / 2.0, rel=1e-14)  # dv = -f dx
    assert ref.coulomb_stop_distance(3.0, 0.3, 10.0) == pytest.approx(1.5)


@pytest.mark.parametrize("m1", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("m2", [1e-4, 0.3, 1e4])
@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_contact_law_on_two_balls(m1, m2, e):
    v, n = np.array([[1.0, 0.5], [-2.0, 0.25]]), np.array([0.6, 0.8])
    after, lam = ref.contact_impulse([-1, 1], [1 / m1, 1 / m2], v, n, e)
    np.testing.assert_allclose(after, ref.two_body_collision(m1, m2, *v, n, e), rtol=1e-12)
    m, u = np.array([m1, m2]), n @ (v[1] - v[0])
    np.testing.assert_allclose(m @ after, m @ v, rtol=1e-12)
    assert n @ (after[1] - after[0]) == pytest.approx(-e * u, abs=1e-12)
    lost = 0.5 * m @ ((v**2).sum(1) - (after**2).sum(1))
    assert lost == pytest.approx((1 - e * e) * u * u / (2 * (1 / m1 + 1 / m2)), rel=1e-7, abs=1e-11 * max(m1, m2))
    assert lam > 0
    assert ref.contact_impulse([-1, 1], [1 / m1, 1 / m2], v, -n, e)[1] == 0.0  # they separate


@pytest.mark.parametrize(
    ("t", "speeds", "kept"),
    [
        (0.5, (1 / 3, -2 / 3, -2 / 3), 1 / 3),
        (0.25, (3 / 13, -12 / 13, -4 / 13), 0.39),
        (0.0, (0, -1, 0), 0.56),
    ],
)
def test_contact_law_on_a_stick(t, speeds, kept):
    v, n = np.array([[0.0, -1.0], [0.0, 0.0], [0.0, 0.0]]), np.array([0.0, 1.0])
    after, _ = ref.contact_impulse([1, -(1 - t), -t], np.ones(3), v, n, 1.0)
    np.testing.assert_allclose(after[:, 1], speeds, atol=1e-15)
    assert (after**2).sum() == pytest.approx(1.0, abs=1e-12)
    wrong = ref.wrong_stick(v, t, n, 1.0)
    assert wrong[:, 1].sum() - v[:, 1].sum() == pytest.approx(2 / 3)  # j / 3, j = 2
    assert (wrong**2).sum() == pytest.approx(kept, abs=0.005)


def test_pinned_balls_take_nothing():
    v = np.array([[1.0, 0.0], [0.0, 0.0]])
    after, _ = ref.contact_impulse([-1, 1], [1.0, 0.0], v, [1.0, 0.0], 1.0)
    np.testing.assert_array_equal(after, [[-1.0, 0.0], [0.0, 0.0]])
    assert ref.contact_impulse([-1, 1], [0.0, 0.0], v, [1.0, 0.0], 1.0)[1] == 0.0
    np.testing.assert_array_equal(ref.contact_offset([-1, 1], [0.0, 0.0], [1.0, 0.0], 0.1), np.zeros((2, 2)))
    offsets = ref.contact_offset([-1, 1], [1.0, 0.25], [1.0, 0.0], 0.1)
    assert offsets[1, 0] - offsets[0, 0] == pytest.approx(0.1)
    np.testing.assert_allclose([1.0, 4.0] @ offsets, 0.0, atol=1e-16)  # the centre of mass stays


def test_contact_finding():
    x = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.2], [1.05, 0.1], [3.0, 0.1]])
    radius = np.array([0.01, 0.01, 0.3, 0.3, 0.3])
    (stick,) = list(ref.stick_contacts(x, radius, [(0, 1)]))  # ball 3 lies beyond the end: not this contact
    assert stick.balls == (2, 0, 1)
    np.testing.assert_allclose([*stick.g, *stick.normal, stick.depth], [1, -0.5, -0.5, 0, 1, 0.1], atol=1e-15)
    assert ref.wrong_stick_distance(x[4], x[0], x[1]) < 0.3  # the line's rule hits two lengths away
    assert [c.balls for c in ref.ball_contacts(x, radius)] == [(1, 3), (2, 3)]
    assert [c.balls for c in ref.ball_contacts(x, radius, joined=[(3, 1)])] == [(2, 3)]
    (wall,) = ref.wall_contacts(x, radius, [((-1.0, 0.0), -3.1)])
    assert wall.balls == (4,)
    assert wall.depth == pytest.approx(0.2)
    (on,) = ref.stick_contacts(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.0]]), np.array([0.1, 0.1, 0.1]), [(0, 1)])
    assert abs(on.normal[1]) == 1.0


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("split", ["count", "tensor"])
def test_split_masses_never_add_energy_and_keep_momentum(dim, split):
    rng = np.random.default_rng(4)
    x, v = rng.uniform(0, 4 if dim == 2 else 2, (40, dim)), rng.standard_normal((40, dim))
    radius, w = rng.uniform(0.3, 0.5, 40), 10 ** rng.uniform(-1, 1, 40)
    contacts = ref.ball_contacts(x, radius) + ref.stick_contacts(x, radius, [(0, 1), (2, 3)])
    assert len(contacts) > 60
    after = ref.contact_pass(contacts, v, w, 1.0, split)
    m = 1 / w
    np.testing.assert_allclose(m @ after, m @ v, atol=1e-12)
    np.testing.assert_allclose(ref.angular_momentum(m, x, after), ref.angular_momentum(m, x, v), atol=1e-11)
    assert m @ (after**2).sum(1) <= m @ (v**2).sum(1)
    assert m @ (ref.contact_pass(contacts, v, w, 1.0, "none") ** 2).sum(1) > m @ (v**2).sum(1)  # the article's sum


def test_the_wrong_rules_fail():
    n, v = np.array([1.0, 0.0]), np.array([0.0, 3.0])
    sideways = ref.wrong_ball_ball(v, v, n, 1.0, 0.1)  # no relative motion at all
    assert np.abs(sideways[0] - sideways[1]).max() > 0.1
    halves = ref.wrong_equal_halves(np.array([1.0, 0.0]), np.zeros(2), n, 1.0)
    assert abs(1.0 * halves[0][0] + 3.0 * halves[1][0] - 1.0) > 0.5  # masses 1 and 3
    assert ref.wrong_decay(v, 3.0, 1.0)[1] < -3.0
    floor = ref.wall_contacts(np.zeros((1, 2)), np.array([0.1]), [((0.0, 1.0), 0.0)] * 2)
    down, w = np.array([[0.0, -1.0]]), np.ones(1)
    assert ref.contact_pass(floor, down, w, 1.0, "none")[0, 1] == pytest.approx(3.0)
    assert ref.contact_pass(floor, down, w, 1.0, "count")[0, 1] == pytest.approx(1.0)
    y, v1, speeds = 0.0, 0.0, []
    for _ in range(100):
        y, v1 = ref.wrong_resting_step(y, v1, 10.0, H, 0.0)
        speeds.append(abs(v1))
    assert max(speeds[10:]) >= 10.0 * H * 0.999
    assert 10.0 * (ref.wrong_push_out(-0.01) + 0.01) == pytest.approx(0.1)  # energy of 1 kg from nothing
    y, v1, energies = 1.0, 0.0, []
    for _ in range(20000):
        y, v1 = ref.wrong_bounce_step(y, v1, 10.0, H, 1.0)
        energies.append(10.0 * y + v1 * v1 / 2)
    assert abs(np.array(energies) / 10.0 - 1).max() > 1e-3
    np.testing.assert_array_equal(ref.wrong_drift(v, 0.5), 1.5 * v)
