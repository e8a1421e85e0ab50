"""Damping of spring networks, weak and strong: decay rates, creep, momentum, steps that change, pins that turn corners."""

import functools

import numpy as np
import pytest
from physics_support import EPS, F64, simulate
from reference_damping import legendre_left

import taichi_sim as ts
from taichi_sim.analysis.damping import decay, lone, predicts_damping, softened, stages
from taichi_sim.analysis.methods import IMPLICIT_EULER, VERLET
from taichi_sim.analysis.slow_modes import slow_decays
from taichi_sim.analysis.stability import stability
from taichi_sim.common.quantities import measured
from taichi_sim.reports import check

pytestmark = pytest.mark.long_in("f32")

LINKS, GAP, LIGHT, HEAVY = 12, 0.25, 0.07, 75.0  # of a chain: springs, m, kg, times that at its end


def chain(strength, uneven=False):
    """A pinned chain along x with a load at its end, whose largest c h / m is `strength` at the automatic step."""
    rng = np.random.default_rng(5)
    mass = np.where(np.arange(LINKS + 1) == LINKS, HEAVY * LIGHT, LIGHT)
    part = rng.uniform(0.1, 1.0, (2, LINKS)) if uneven else np.ones((2, LINKS))
    part /= part.max(axis=1, keepdims=True)
    h = 1e-3
    for _ in range(40):  # the step depends on weak damping, which depends on the step
        scene = ts.Scene(dim=2)
        b = scene.add_balls(np.outer(np.arange(LINKS + 1), [GAP, 0.0]), radius=0.01, mass=mass, pinned=[0])
        scene.add_springs(
            np.stack([b[:-1], b[1:]], axis=1), stiffness=4e5 * part[0], damping=strength * LIGHT / h * part[1]
        )
        h = 0.9 * stability(scene, VERLET).dt_any_shape
    return scene


def motion_along_x(scene):
    """A (2 n, 2 n) with y' = A y of the free balls' places, less those at rest, and velocities along x."""
    n = scene.n_balls
    e = np.zeros((scene.n_springs, n))
    for row, (i, j) in zip(e, scene.pairs):
        row[i], row[j] = -1.0, 1.0
    free = ~scene.pinned
    w = 1.0 / scene.mass[free, None]
    K, D = (((e.T * c) @ e)[np.ix_(free, free)] * w for c in (scene.stiffness, scene.damping))
    return np.block([[np.zeros_like(K), np.eye(len(K))], [-K, -D]])


def set_along_x(sim, start):
    """Places and velocities of all but the first ball, along x."""
    x, v = sim.scene.position.copy(), np.zeros_like(sim.scene.position)
    x[1:, 0] += start[:LINKS]
    v[1:, 0] = start[LINKS:]
    sim.set_position(x)
    sim.set_velocity(v)


def along_x(sim):
    x, v = sim.position - sim.scene.position, sim.velocity
    return np.concatenate([x[1:, 0], v[1:, 0]])


@pytest.mark.parametrize("uneven", [False, True], ids=["even", "uneven"])
@pytest.mark.parametrize("strength", [0.01, 0.2, 4.0, 100.0])
def test_a_loaded_chain_decays_as_its_eigenvalue_says(strength, uneven):
    """The slowest of all motions, within 5 %, from far below critical damping to far above."""
    scene = chain(strength, uneven)
    values, vectors = np.linalg.eig(motion_along_x(scene))
    k = np.argmin(np.abs(values))
    rate = -values[k].real
    left = np.linalg.inv(vectors)[k]
    start = vectors[:, k] / np.abs(vectors[:LINKS, k]).max() * 0.02
    with simulate(scene, contacts="off") as sim:
        assert sim.dt < 9e-4  # stability sets the step
        assert strength == pytest.approx(sim.dt * scene.damping.max() / LIGHT, rel=1e-3)
        set_along_x(sim, start.real)
        first = abs(left @ along_x(sim))
        sim.step(int(np.clip(0.25 / rate / sim.dt, 20, 400_000)))
        found = np.log(first / abs(left @ along_x(sim))) / sim.time
    assert found == pytest.approx(rate, rel=0.05)


@pytest.mark.parametrize("strength", [3.0, 40.0])
def test_a_chain_creeps_where_it_is_overdamped(strength):
    """Ball by ball, after a fifth of the way back: damping apart from the kick would hold it where it is."""
    scene = chain(strength, uneven=True)
    A = motion_along_x(scene)
    start = np.concatenate([0.03 * np.random.default_rng(1).uniform(-1, 1, LINKS), np.zeros(LINKS)])
    values, vectors = np.linalg.eig(A)
    with simulate(scene, contacts="off") as sim:
        set_along_x(sim, start)
        sim.step(round(0.2 * LIGHT / sim.dt * scene.damping.max() / scene.stiffness.max() / LIGHT) + 20)
        exact = (vectors @ (np.exp(values * sim.time) * np.linalg.solve(vectors, start))).real
        found = along_x(sim)
    moved = np.abs(exact[:LINKS] - start[:LINKS]).max()
    assert moved > 0.005
    assert np.abs(found[:LINKS] - exact[:LINKS]).max() < 0.05 * moved


def test_a_lone_spring_creeps_by_its_law():
    """A ball on a spring that is damped sixty times over critical sinks to its place as the slower of two exponentials."""
    scene = ts.Scene(dim=2, gravity=(0.0, -5.0))
    b = scene.add_balls([[0.0, 0.0], [0.0, -1.0]], radius=0.01, mass=0.3, pinned=[0])
    k, c = 2.7e4, 11000.0
    scene.add_springs([b], stiffness=k, damping=c, rest_length=0.98)
    slow, depth = np.roots([0.3, c, k]).real.max(), 0.98 + 0.3 * 5.0 / k
    with simulate(scene, contacts="off") as sim:
        assert lone(scene).all()
        assert sim.dt * c / 0.3 > 30.0
        sim.step(400)
        left = (-sim.position[1, 1] - depth) / (1.0 - depth)
        assert left == pytest.approx(np.exp(slow * sim.time), rel=2e-3)
    assert 0.2 < left < 0.5


def test_stages_are_stable_and_make_no_ball_lighter():
    """The halves between two drifts leave R of a velocity; H = z (1 + R) / (1 - R), z of one half, is the mass with which the
    places move on, in units of the balls' own."""
    for h in 10.0 ** np.linspace(-4, 3, 15):
        scene = ts.Scene(dim=2)
        b = scene.add_balls(np.outer(np.arange(5.0), [1.0, 0.0]), radius=0.1, mass=[1.0, 2.0, 1.0, 0.5, 4.0])
        scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=1.0, damping=[3.0, 1.0, 0.2, 2.0])
        both, soft = stages(scene, 0.5 * h), softened(scene, 0.5 * h)
        scene.set_springs(damping=soft)
        values = np.linalg.eigvals(motion_of_all(scene))
        assert np.all((soft == [3.0, 1.0, 0.2, 2.0]) | (h > 100.0))
        z = np.linspace(1e-4, 1.0, 2000) * np.abs(values).max() * 0.5 * h
        left, few = decay(both, z), len(both.after)
        if few > 2:
            assert left == pytest.approx(legendre_left(few, z) ** 2, rel=1e-9)
        assert np.all((left > 0.0) & (left < 1.0))
        assert np.all(z * (1.0 + left) - (1.0 - left) > -1e-14)  # H > 1, up to rounding
        z = np.array([1e-3, 2e-3])
        off = decay(both, z) - np.exp(-2.0 * z)
        assert off[1] / off[0] == pytest.approx(8.0, rel=0.02)  # of third order


def motion_of_all(scene):
    """W D along x, no ball pinned."""
    n = scene.n_balls
    e = np.zeros((scene.n_springs, n))
    for row, (i, j) in zip(e, scene.pairs):
        row[i], row[j] = -1.0, 1.0
    return ((e.T * scene.damping) @ e) / scene.mass[:, None]


@functools.cache
def thrown_net(strength):
    """A sheet of 6 x 5 unequal balls that flies and turns in 3D, damped so that z of half a step of 1 ms is about `strength`."""
    rng = np.random.default_rng(3)
    at = np.array([(i, j) for j in range(5) for i in range(6)])
    scene = ts.Scene(dim=3)
    x = np.column_stack([0.1 * at, 0.01 * rng.normal(size=30)])
    b = scene.add_balls(x, radius=0.01, mass=rng.uniform(0.1, 0.4, 30), velocity=rng.normal(0.0, 1.0, (30, 3)))
    pairs = [(p, q) for p in range(30) for q in range(p) if np.hypot(*(at[p] - at[q])) < 1.5]
    scene.add_springs(b[np.array(pairs)], stiffness=2000.0, damping=strength * rng.uniform(0.2, 1.0, len(pairs)) * 12.0)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("strength", [1.0, 60.0])
def test_momentum(strength):
    scene = thrown_net(strength)
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        p, angular = sim.momentum(), sim.angular_momentum()
        sim.step(60)
        size = float(scene.mass @ np.linalg.norm(scene.velocity, axis=1))
        assert np.abs(sim.momentum() - p).max() < 400 * EPS * size
        assert np.abs(sim.angular_momentum() - angular).max() < 400 * EPS * size


def test_stages_follow_the_step():
    """A step that is set later gives the bits of one that was there from the start."""
    ends = []
    for first in (1e-3, 1e-4):
        with simulate(thrown_net(60.0), dt=first, contacts="off") as sim:
            sim.set_dt(1e-3)
            sim.step(20)
            ends.append(sim.position)
    assert np.array_equal(*ends)


# Said before a run ----------------------------------------------------------------------------------------------------


def test_slow_decays_are_what_a_run_shows():
    """Of a loaded chain: the springs' own with verlet; what implicit Euler adds, as a run has it; where stages end."""
    scene, place = chain(4.0), chain(4.0).position
    h = 0.9 * stability(scene, VERLET).dt_any_shape
    right, wrong = (slow_decays(scene, method, h, place)[0] for method in (VERLET, IMPLICIT_EULER))
    assert right.found == pytest.approx(right.exact, rel=0.01)
    assert right.exact == pytest.approx(-np.linalg.eigvals(motion_along_x(scene)).real.max(), rel=1e-6)
    assert wrong.found > 1.02 * wrong.exact
    values, vectors = np.linalg.eig(motion_along_x(scene))
    k = np.argmin(np.abs(values))
    left = np.linalg.inv(vectors)[k]
    with simulate(scene, integrator="implicit_euler", dt=h, contacts="off") as sim:
        set_along_x(sim, (vectors[:, k] / np.abs(vectors[:LINKS, k]).max() * 0.02).real)
        first = abs(left @ along_x(sim))
        sim.step(round(0.5 / wrong.exact / h))
        assert np.log(first / abs(left @ along_x(sim))) / sim.time == pytest.approx(wrong.found, rel=0.02)
    rounded = slow_decays(scene, VERLET, h, (place + 1.0 / 3.0).astype(np.float32).astype(float))[
        0
    ]  # not motion across the chain
    assert rounded.exact == pytest.approx(right.exact, rel=1e-3)
    scene.set_springs(damping=scene.damping * 1e5)
    beyond = slow_decays(scene, VERLET, h, place)[0]
    assert beyond.found > 1.5 * beyond.exact
    assert "without damping, does not swing and falls to 1/e in " in next(check.damping(scene, VERLET, h, place))
    assert "take tr_bdf2" in "".join(check.damping(scene, VERLET, h, place))
    said = "".join(check.damping(chain(0.2), IMPLICIT_EULER, h, place))
    found = slow_decays(chain(0.2), IMPLICIT_EULER, h, place)[0].found
    assert f"with this step falls to 1/e in {measured(1.0 / found, unit='s')}" in said
    assert "omega^2 h / 2" in said


# Pins -----------------------------------------------------------------------------------------------------------------

CORNERS = ((0.08, 0.3), (0.16, -0.9), (0.5, 0.2))  # until then, at this speed
END = 0.4  # s


def drawn(damping):
    """Two balls in a row behind a driven pin, along x and around corners."""
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0.0, 0.0], [0.3, 0.0], [0.6, 0.0]], radius=0.01, mass=[1.0, 0.4, 0.7])
    scene.add_springs([b[:2], b[1:]], stiffness=60.0, damping=damping)
    times = np.array([0.0, *(t for t, _ in CORNERS)])
    x = np.cumsum([0.0, *(np.diff(times) * [v for _, v in CORNERS])])
    scene.add_moving_pins([0], path=[(t, (a, 0.0)) for t, a in zip(times, x)])
    return scene


def drawn_exactly(scene):
    """The same balls at the end, by the exponential of the linear motion between corners."""
    w, k, c = 1.0 / scene.mass[1:, None], scene.stiffness[0], scene.damping[0]
    shape = np.array([[2.0, -1.0], [-1.0, 1.0]]) * w
    A = np.zeros((6, 6))  # places, velocities, place and speed of the pin
    A[:2, 2:4], A[2:4, :2], A[2:4, 2:4], A[4, 5] = np.eye(2), -k * shape, -c * shape, 1.0
    A[2, 4:] = w[0, 0] * np.array([k, c])
    y, begin = np.zeros(6), 0.0
    for end, speed in CORNERS:
        y[5] = speed
        step = A * (min(end, END) - begin) / 2**20
        power = np.eye(6) + step + step @ step / 2.0
        for _ in range(20):
            power = power @ power
        y, begin = power @ y, end
    return y


@pytest.mark.slow_where(method="verlet", damping=0.2)
@pytest.mark.slow_where(method="tr_bdf2", damping=6.0)
@pytest.mark.skipif(not F64, reason="rounding hides the small steps")
@pytest.mark.parametrize(("method", "damping"), [("verlet", 0.2), ("verlet", 6.0), ("tr_bdf2", 0.2), ("tr_bdf2", 6.0)])
@pytest.mark.slow_where(method="tr_bdf2")
def test_order_2_behind_a_pin_that_turns_corners_f64(method, damping):
    scene = drawn(damping)
    assert predicts_damping(scene) == (damping < 1.0)
    exact, off = drawn_exactly(scene), []
    for h in (4e-3, 2e-3):
        with simulate(scene, integrator=method, dt=h, contacts="off") as sim:
            sim.step(round(END / h))
            x, v = sim.position[1:, 0] - scene.position[1:, 0], sim.velocity[1:, 0]
        off.append(np.hypot(np.linalg.norm(x - exact[:2]), np.linalg.norm(v - exact[2:4]) / 10.0))
    assert np.log2(off[:-1] / np.array(off[1:])) == pytest.approx(2.0, abs=0.2)
