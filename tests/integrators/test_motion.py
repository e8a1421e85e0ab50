"""Motion without contacts against closed forms: the scheme's own, to round-off, and the continuum's.

Compiling dominates, so all experiments of one kind lie side by side in one scene, and every test looks at its own balls.
"""

import functools
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
import reference as ref
import reference_damping
from physics_support import (
    DIMS,
    EPS,
    EXTREMES,
    F64,
    METHODS,
    VARIANTS,
    as_stored,
    discrete,
    each_dim,
    error,
    exact,
    observe,
    simulate,
    transfer,
    vector,
)

import taichi_sim as ts

H = 1e-3
LOOKS = (1, 2, 10, 100, 500, 1000)  # steps after which the state is compared
GRAVITY = (0.7, -9.81, 0.3)
# (dim, method, variant); in `make test` each method once
QUICK = {
    (2, "symplectic_euler", VARIANTS[0]),
    (2, "rk4", VARIANTS[0]),
    (3, "verlet", VARIANTS[0]),
    (3, "explicit_euler", VARIANTS[3]),
}
CASES = [
    pytest.param((d, m, v), id=f"{d}d-{m}-{'-'.join(v)}", marks=[] if (d, m, v) in QUICK else [pytest.mark.slow])
    for d, m, v in product(DIMS, METHODS, VARIANTS)
    if m == "verlet" or v in EXTREMES
]


# Without gravity: oscillators, rotating pairs, modes ------------------------------------------------------------------

OMEGAS, ZETAS = (2.0, 10.0, 40.0), (0.1, 0.5, 1.0, 3.0)
OSCILLATORS = [(w, 0.0) for w in OMEGAS] + [(40.0, z) for z in ZETAS]
X0, V0 = 0.4, 3.0  # m, m/s
TURN = 5.0  # 1/s
ROTATING_K, ROTATING_M = 300.0, (1.0, 3.0)
N, MODE_K, MODE_M, GAP = 5, 800.0, 0.5, 1.0
MODE_X0, MODE_V0 = 0.02, 0.1  # small, so that balls do not pass each other where explicit Euler grows


def rotating_pair(method):
    """Length, relative velocity (x along the spring, y across) with which the scheme itself rotates a pair steadily.

    x_(n+1) - 2 x_n + x_(n-1) = h^2 a makes the pair feel W' = 2 sin(W h / 2) / h in place of W.
    """
    mu = 1.0 / sum(1.0 / m for m in ROTATING_M)
    felt = TURN if method == "rk4" else 2.0 * np.sin(TURN * H / 2) / H
    d = ref.rotating_pair_length(1.0, mu, felt, ROTATING_K)
    t = TURN * H
    u = {
        "rk4": (0.0, d * TURN),
        "verlet": (0.0, d * np.sin(t) / H),
        "symplectic_euler": (d * (1 - np.cos(t)) / H, d * np.sin(t) / H),  # (x_0 - x_-1) / h
        "explicit_euler": (0.0, d * TURN),
    }[method]
    return d, u


@functools.cache
def free_scene(dim, method):
    scene = ts.Scene(dim=dim)
    at = SimpleNamespace(held=[], pair=[], mode=[])
    slant = vector(dim, 0.6, 0.8) if dim == 2 else np.array([0.48, 0.6, 0.64])
    at.axis = []
    for omega, zeta in OSCILLATORS:
        # a ball on a spring of rest length 0 to a pin at the origin: linear in every direction; damped along the first axis
        # only, since damping keeps angular momentum: a rotation of round-off would end in a circle of sqrt(L / omega) = 1e-9
        axis = slant if zeta == 0.0 else vector(dim, 1.0)
        at.axis.append(axis)
        b = scene.add_balls(
            [np.zeros(dim), X0 * axis], radius=0.01, velocity=[np.zeros(dim), V0 * axis], mass=2.0, pinned=[0]
        )
        scene.add_springs([b], stiffness=2.0 * omega**2, damping=2.0 * 2 * zeta * omega, rest_length=0.0)
        at.held.append(b[1])
        # two free balls of 1 and 3 kg on a spring of rest length 1 m, moving along it: mu = 3/4
        x = [[0.0] * dim, vector(dim, 1.0 + X0)]
        v = [vector(dim, -V0 * 0.75), vector(dim, V0 * 0.25)]
        b = scene.add_balls(x, radius=0.01, velocity=v, mass=[1.0, 3.0])
        scene.add_springs([b], stiffness=0.75 * omega**2, damping=0.75 * 2 * zeta * omega, rest_length=1.0)
        at.pair.append(b)
    d, u = rotating_pair(method)
    share = np.array(ROTATING_M[::-1]) / sum(ROTATING_M)  # the centre of mass stays at the origin
    x = np.outer([-share[0], share[1]], vector(dim, d))
    v = np.outer([-share[0], share[1]], vector(dim, *u))
    at.rotating = scene.add_balls(x, radius=0.01, velocity=v, mass=ROTATING_M)
    scene.add_springs([at.rotating], stiffness=ROTATING_K, rest_length=1.0)
    for p in range(1, N + 1):
        x = np.outer(np.arange(N + 2) * GAP, vector(dim, 1.0))
        shape = np.sin(np.arange(N + 2) * p * np.pi / (N + 1))
        x += np.outer(MODE_X0 * shape, vector(dim, 1.0))
        v = np.outer(MODE_V0 * shape, vector(dim, 1.0))
        b = scene.add_balls(x, radius=0.01, velocity=v, mass=MODE_M, pinned=[0, N + 1])
        scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=MODE_K, rest_length=GAP)
        at.mode.append(b)
    return scene, at


@pytest.fixture(scope="module", params=CASES)
def free(request):
    dim, method, variant = request.param
    scene, at = free_scene(dim, method)
    x, v = observe(scene, method, variant, LOOKS, contacts="off")
    return SimpleNamespace(dim=dim, method=method, at=at, x=x, v=v)


def _compare(free, k, x, v, omega, zeta, x0=X0, v0=V0, scale=None):
    expected = discrete(free.method, omega, zeta, H, LOOKS, x0, v0)
    size = max(float(np.max(np.abs(expected[:, 0]))), scale or 0.0)
    found = max(
        error(x, expected[:, 0], size), error(v, expected[:, 1], max(omega * size, np.abs(expected[:, 1]).max()))
    )
    assert found < exact(LOOKS[-1]), f"oscillator {k}, omega {omega}, zeta {zeta}: relative error {found:.2e}"


@pytest.mark.long_in("f32")
def test_oscillators_follow_the_closed_form_of_the_scheme(free):
    for k, (omega, zeta) in enumerate(OSCILLATORS):
        i, axis = free.at.held[k], free.at.axis[k]
        _compare(free, k, free.x[:, i] @ axis, free.v[:, i] @ axis, omega, zeta)
        across = free.x[:, i] - np.outer(free.x[:, i] @ axis, axis)
        assert np.max(np.abs(across)) < 1e3 * EPS


def test_pairs_follow_the_closed_form_of_the_scheme(free):
    for k, (omega, zeta) in enumerate(OSCILLATORS):
        i, j = free.at.pair[k]
        x, v = free.x[:, j, 0] - free.x[:, i, 0] - 1.0, free.v[:, j, 0] - free.v[:, i, 0]
        _compare(free, k, x, v, omega, zeta, scale=1.0 + X0)  # stretch is a difference of positions of that size
        centre = 0.25 * free.x[:, i] + 0.75 * free.x[:, j]
        assert error(centre, centre[:1] * 0 + 0.75 * (1 + X0) * vector(free.dim, 1.0)) < exact(LOOKS[-1])


def test_longitudinal_modes(free):
    for p, b in enumerate(free.at.mode, start=1):
        omega = ref.chain_mode(MODE_K, MODE_M, N, p)
        shape = np.sin(np.arange(1, N + 1) * p * np.pi / (N + 1))
        rest = np.arange(1, N + 1) * GAP
        expected = discrete(free.method, omega, 0.0, H, LOOKS, MODE_X0, MODE_V0)
        x = free.x[:, b[1:-1], 0] - rest
        v = free.v[:, b[1:-1], 0]
        # explicit Euler multiplies round-off as it does every motion: by the growth of the fastest mode
        fastest = ref.chain_mode(MODE_K, MODE_M, N, N)
        growth = (1 + (fastest * H) ** 2) ** (LOOKS[-1] / 2) if free.method == "explicit_euler" else 1.0
        tolerance = exact(LOOKS[-1]) * growth * (1 + N) * GAP
        assert np.max(np.abs(x - np.outer(expected[:, 0], shape))) < tolerance
        assert np.max(np.abs(v - np.outer(expected[:, 1], shape))) < tolerance * fastest


def test_pinned_balls_stay(free):
    pins = [b[0] for b in free.at.mode] + [b[-1] for b in free.at.mode]
    scene = free_scene(free.dim, free.method)[0]
    start = scene.position[pins] if F64 else scene.position[pins].astype(np.float32)
    assert np.array_equal(free.x[-1, pins], start)
    assert np.all(free.v[:, pins] == 0.0)


def test_rotating_pair_keeps_its_length(free):
    if free.method == "explicit_euler":  # it spirals outward; its drift is what validation/test_orders measures
        return
    i, j = free.at.rotating
    r = free.x[:, j] - free.x[:, i]
    d, _ = rotating_pair(free.method)
    # RK4 has no closed form here: the continuum's, and an error of its order
    tolerance = max(exact(LOOKS[-1]), 1e-8 if free.method == "rk4" else 0.0)
    assert error(np.linalg.norm(r, axis=1), d) < tolerance
    angle = np.arctan2(r[:, 1], r[:, 0])
    expected = TURN * H * np.array(LOOKS)
    assert np.max(np.abs(np.exp(1j * angle) - np.exp(1j * expected))) < tolerance


@pytest.mark.parametrize("method", ["symplectic_euler", "verlet"])
@pytest.mark.parametrize("omega", OMEGAS)
def test_the_closed_form_oscillates_at_the_discrete_frequency(method, omega):
    rotation = np.abs(np.angle(np.linalg.eigvals(transfer(method, omega, 0.0, H)))) / H
    np.testing.assert_allclose(rotation, ref.discrete_frequency(omega, H), rtol=1e-9)


def test_rk4_amplification():
    """Energy of an oscillator shrinks by 1 - y^6/72 + y^8/576 a step; explicit Euler's grows by 1 + y^2."""
    omega, h, steps = 40.0, 0.02, 500
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1, 0]], radius=0.01, pinned=[0])
    scene.add_springs([b], stiffness=omega**2, rest_length=0.0)
    y = omega * h
    x, v = observe(scene, "rk4", VARIANTS[0], (steps,), h)
    found = x[0, 1] @ x[0, 1] + v[0, 1] @ v[0, 1] / omega**2
    expected = (1 - y**6 / 72 + y**8 / 576) ** steps
    assert abs(found / expected - 1) < exact(steps)


@pytest.mark.long_in("f32")
@pytest.mark.slow_where(dim=2)
@each_dim
@pytest.mark.parametrize("method", ["symplectic_euler", "verlet"])
def test_modified_energy_over_1e5_steps(dim, method):
    omega, h = 20.0, 0.01
    scene = ts.Scene(dim=dim)
    b = scene.add_balls(
        [np.zeros(dim), vector(dim, 0.5)], radius=0.01, velocity=[np.zeros(dim), vector(dim, 2.0)], pinned=[0]
    )
    scene.add_springs([b], stiffness=omega**2, rest_length=0.0)
    start = ref.modified_energy(method, 0.5, 2.0, omega, h)
    worst = 0.0
    with simulate(scene, integrator=method, dt=h, contacts="off") as sim:
        for _ in range(100):
            sim.step(1000)
            now = ref.modified_energy(method, sim.position[1, 0], sim.velocity[1, 0], omega, h)
            worst = max(worst, abs(float(now / start) - 1.0))
    assert worst < (1e-12 if F64 else 2e-4), f"drift {worst:.2e}"


# Under gravity: free balls, bodies, a chain, a random network ---------------------------------------------------------

CHAIN_N, CHAIN_M, CHAIN_K, CHAIN_L = 8, 0.5, 200.0, 0.25
NETWORK_STEPS = 200
THROWS = ((0.0, 0.0, 0.0), (1.0, 2.0, 3.0), (-4.0, 9.0, 0.5))


def random_network(dim, seed=7):
    """24 balls, 60 springs; masses .1 to 10 kg, k 10 to 1000, c 0 to 5 N s/m, pins, rest length 0, a pair that coincides."""
    rng = np.random.default_rng(seed)
    n, m = 24, 60
    x = rng.uniform(-1, 1, (n, dim))
    v = rng.normal(size=(n, dim))
    pairs = np.array([rng.choice(n, 2, replace=False) for _ in range(m)])
    rest = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) * rng.uniform(0.8, 1.2, m)
    rest[:8] = 0.0
    x[15], v[15] = x[9], v[9]  # 9 + 15 is a multiple of 2 and 3: program and reference push along the first axis
    pairs[8], rest[8] = (9, 15), 0.3
    pairs[9], rest[9] = (9, 15), 0.0
    pinned = np.zeros(n, dtype=bool)
    pinned[[0, 5]] = True
    v[pinned] = 0.0
    k, c = 10 ** rng.uniform(1, 3, m), rng.choice([0.0, 0.5, 5.0], m)
    return SimpleNamespace(x=x, v=v, mass=10 ** rng.uniform(-1, 1, n), pairs=pairs, k=k, c=c, rest=rest, pinned=pinned)


@functools.cache
def network_reference(dim, method):
    net = random_network(dim)
    w = np.where(net.pinned, 0.0, 1.0 / net.mass)
    w, k, c, rest, g, x, v = (as_stored(a) for a in (w, net.k, net.c, net.rest, np.array(GRAVITY[:dim]), net.x, net.v))
    step = reference_damping.run_weakly_split if method == "verlet" else functools.partial(ref.run, method)
    return step(ref.network(w, net.pairs, k, c, rest, g), x, v, H, NETWORK_STEPS)


@functools.cache
def falling_scene(dim):
    scene = ts.Scene(dim=dim, gravity=GRAVITY[:dim])
    at = SimpleNamespace()
    at.thrown = scene.add_balls(
        np.ones((len(THROWS), dim)), radius=0.01, velocity=np.array(THROWS)[:, :dim], mass=[1, 1e-3, 1e3]
    )
    net = random_network(dim)
    at.network = scene.add_balls(net.x, radius=0.01, velocity=net.v, mass=net.mass, pinned=net.pinned)
    scene.add_springs(at.network[net.pairs], stiffness=net.k, damping=net.c, rest_length=net.rest)
    at.body = scene.add_balls(net.x, radius=0.01, velocity=net.v + 1.0, mass=net.mass)
    scene.add_springs(at.body[net.pairs], stiffness=net.k, damping=net.c, rest_length=net.rest)
    # gravity is slanted, and so the chain hangs along it
    g = float(np.linalg.norm(scene.gravity))
    load = CHAIN_M * g * np.arange(CHAIN_N, 0, -1) / CHAIN_K
    depth = np.concatenate([[0.0], np.cumsum(CHAIN_L + load)])
    at.chain = scene.add_balls(np.outer(depth, scene.gravity / g), radius=0.01, mass=CHAIN_M, pinned=[0])
    scene.add_springs(np.stack([at.chain[:-1], at.chain[1:]], axis=1), stiffness=CHAIN_K, rest_length=CHAIN_L)
    return scene, at


@pytest.fixture(scope="module", params=CASES)
def falling(request):
    dim, method, variant = request.param
    scene, at = falling_scene(dim)
    x, v = observe(scene, method, variant, (NETWORK_STEPS, 1000), contacts="off")
    return SimpleNamespace(dim=dim, method=method, scene=scene, at=at, x=x, v=v)


def test_free_fall(falling):
    for ball, v0 in zip(falling.at.thrown, THROWS):
        x, v = ref.free_fall(falling.method, np.ones(falling.dim), v0[: falling.dim], falling.scene.gravity, H, 1000)
        found = max(error(falling.x[1, ball], x), error(falling.v[1, ball], v))
        assert found < exact(1000), f"v0 {v0}: relative error {found:.2e}"


def test_centre_of_mass_falls_as_one_ball(falling):
    """The body keeps its angular momentum about it, too."""
    scene, b = falling.scene, falling.at.body
    m = scene.mass[b] / scene.mass[b].sum()
    x, v = ref.free_fall(falling.method, m @ scene.position[b], m @ scene.velocity[b], scene.gravity, H, 1000)
    found = max(error(m @ falling.x[1, b], x), error(m @ falling.v[1, b], v))
    assert found < exact(1000), f"relative error {found:.2e}"
    if falling.method in ("symplectic_euler", "verlet"):  # the others keep it to the order of their step only
        turning = [
            ref.angular_momentum(m, x - m @ x, v - m @ v)
            for x, v in ((scene.position[b], scene.velocity[b]), (falling.x[1, b], falling.v[1, b]))
        ]
        assert error(turning[1], turning[0], 1.0) < exact(1000)


def test_vertical_chain_stretch(falling):
    """At rest it is longer by m g N (N + 1) / (2 k), and stays so."""
    scene, b = falling.scene, falling.at.chain
    g = float(np.linalg.norm(scene.gravity))
    long = CHAIN_N * CHAIN_L + ref.chain_stretch(CHAIN_M, g, CHAIN_N, CHAIN_K)
    down = falling.x[:, b] @ (scene.gravity / g)
    assert error(down[:, -1], long) < exact(1000)
    assert np.max(np.abs(falling.v[:, b])) < exact(1000) * long * np.sqrt(CHAIN_K / CHAIN_M) * 2


def test_random_network_follows_the_reference(falling):
    x, v = network_reference(falling.dim, falling.method)
    b = falling.at.network
    found = max(error(falling.x[0, b], x), error(falling.v[0, b], v))
    assert found < exact(NETWORK_STEPS), f"relative error {found:.2e}"
