"""Where real runs begin to grow: one damped oscillator against the exact limits on omega h, networks against the advised step."""

import functools

import numpy as np
import pytest
from physics_support import F64, add_network, simulate

import taichi_sim as ts
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import stability
from taichi_sim.integrators import ImplicitEuler

pytestmark = pytest.mark.skipif(not F64, reason="growth by 1e-4 a step drowns in the rounding of single precision")


# One oscillator -------------------------------------------------------------------------------------------------------

ZETAS = (0.0, 0.1, 0.5, 1.0, 2.0, 10.0)
LEAST, MOST = 0.04, 5.0  # omega h, between which the limit is sought


def verlet_limit(zeta):
    """Kick and damping together leave delta = exp(-zeta y) of the velocity and take y^2 (1 - delta) / (2 zeta y) of the place:
    trace 1 + delta^2 - y^2 (1 - delta^2) / (2 zeta y), determinant delta^2, so that the first eigenvalue to leave the unit circle
    does it at -1, where y tanh(zeta y) = 4 zeta: at 2 or later, or never."""
    y = np.linspace(2.0, MOST, 100_000)
    beyond = y * np.tanh(zeta * y) > 4.0 * zeta
    return 2.0 if zeta == 0.0 else y[np.argmax(beyond)] if beyond.any() else np.inf


EXACT = {
    "explicit_euler": (0.0, 0.2, 1.0, 2.0, 0.536, 0.1),
    "symplectic_euler": (2.0, 1.810, 1.236, 0.828, 0.472, 0.1),
    "verlet": tuple(verlet_limit(zeta) for zeta in ZETAS),
    "rk4": (2.828, 2.951, 2.623, 2.785, 0.746, 0.140),
}


def grows(method, y, zeta, chunk, rounds):
    """Which of the oscillators with these omega h and damping ratios grow, by a run at h = 1 s.

    Each hangs on a pinned ball by a spring of length 0, so it is linear; scaled back to size 1 after each chunk, whatever the
    growth. What grows has a higher maximum in the last quarter of the rounds than in the second. Chunks of random length:
    those of a fixed one can fall into step with the motion.
    """
    rng, n = np.random.default_rng(0), len(y)
    scene = ts.Scene(dim=2)
    held = scene.add_balls(np.zeros((n, 2)), radius=0.01, pinned=True)
    free = scene.add_balls(np.tile([1.0, 0.0], (n, 1)), radius=0.01)
    scene.add_springs(np.stack([held, free], axis=1), stiffness=y**2, damping=2.0 * zeta * y, rest_length=0.0)
    size, log = np.zeros(n), np.zeros((rounds, n))
    with simulate(scene, integrator=method, dt=1.0, contacts="off") as sim:
        for k in range(rounds):
            sim.step(rng.integers(1, 2 * chunk))
            x, v = sim.position, sim.velocity
            now = np.hypot(y * x[free, 0], v[free, 0])
            size += np.log(now)
            log[k] = size
            x[free] /= now[:, None]
            v[free] /= now[:, None]
            sim.set_position(x)
            sim.set_velocity(v)
    quarter = rounds // 4
    return log[-quarter:].max(axis=0) > log[quarter : 2 * quarter].max(axis=0) + 0.05


def limits(method, zetas=ZETAS, least=LEAST, most=MOST, longer=1):
    """The least omega h that grows, for each zeta: sections of [least, most], then of the place between those found.

    longer: times longer chunks there, for a method whose first step after each is not like the others.
    """
    low, high = np.full(len(zetas), least), np.full(len(zetas), most)
    for sections, chunk, rounds in ((32, longer, 400), (64, 5 * longer, 800)):
        y = np.exp(np.linspace(np.log(low), np.log(high), sections + 1, axis=1))
        found = grows(method, y.ravel(), np.repeat(zetas, sections + 1), chunk, rounds).reshape(y.shape)
        assert np.all(np.diff(found.astype(int), axis=1) >= 0), "stable again beyond the limit"
        first = sections + 1 - found.sum(axis=1)
        each = np.arange(len(zetas))
        low, high = y[each, np.maximum(first - 2, 0)], y[each, np.minimum(first + 1, sections)]
    middle = np.sqrt(y[each, np.maximum(first - 1, 0)] * y[each, np.minimum(first, sections)])
    return np.where(first == 0, 0.0, np.where(first > sections, np.inf, middle))


@pytest.mark.slow_where(method=["explicit_euler", "symplectic_euler"])
@pytest.mark.parametrize("method", EXACT)
@pytest.mark.slow_where(method="rk4")
def test_limits_of_one_oscillator(method):
    """Within 1 %."""
    found = limits(method)
    print(method, np.round(found, 4), np.round(EXACT[method], 4))
    np.testing.assert_allclose(found, EXACT[method], rtol=0.01)


@pytest.mark.slow
def test_limits_of_verlet_with_weak_damping():
    """At predicted velocities, y^2 + 8 zeta y = 4; and the advice is just that."""
    zetas = np.array([0.01, 0.025, 0.05])
    exact = np.sqrt(16.0 * zetas**2 + 4.0) - 4.0 * zetas
    found = limits("verlet", zetas, 1.6, 2.1, 8)
    print(np.round(found, 4), np.round(exact, 4))
    np.testing.assert_allclose(found, exact, rtol=0.01)
    for zeta, limit in zip(zetas, exact):
        scene = ts.Scene(dim=2)
        pair = scene.add_balls([[0, 0], [1, 0]], radius=0.01, pinned=[True, False])
        scene.add_springs([pair], stiffness=1.0, damping=2.0 * zeta, rest_length=0.0)
        assert stability(scene, named("verlet")).dt_any_shape == pytest.approx(limit, rel=1e-6)


# Hanging cloths -------------------------------------------------------------------------------------------------------


def sheet(scene, side, damped, scale=1.0):
    """A square cloth of 1 kg/m^2 hung at its upper edge, masses over two decades; as slow as `scale` says under the same gravity:
    lengths grow by scale^2, stiffness falls by it."""
    start = scene.n_balls
    ts.shapes.cloth(
        scene,
        size=(1, 1),
        resolution=(side, side),
        mass=1.0,
        stiffness=1e3 / scale**2,
        damping=damped * 0.3 / side / scale,
        rotation=(90, 0, 0),
        scale=scale**2,
        pinned=range(0, side**2, side),
    )
    scene.set_balls(
        slice(start, None), mass=scene.mass[start:] * 10.0 ** np.random.default_rng(side).uniform(-1, 1, side**2)
    )
    return scene


@functools.cache
def hung(side):
    """Positions (n, 3) at rest. Light balls buckle, so it is nudged out of its plane first."""
    scene = sheet(ts.Scene(dim=3, gravity=(0, -10, 0)), side, False)
    with simulate(scene, integrator=ImplicitEuler(tolerance=1e-8), dt=1.0, contacts="off") as sim:
        x = sim.position
        x[:, 2] += 1e-3 * np.random.default_rng(0).normal(size=len(x)) * ~scene.pinned
        sim.set_position(x)
        for _ in range(20):
            sim.step(5)
            if np.max(np.abs(sim.velocity)) < 1e-7:
                break
        return sim.position


def blow_up(method, side, damped, ratios):
    """(the step of the first cloth that grows) / (the advised one), the cloths at these ratios to it, side by side at 1 ms:
    moved by 1e-6 m off rest, what comes a thousand times further grows."""
    rest = hung(side)
    alone = sheet(ts.Scene(dim=3, gravity=(0, -10, 0)), side, damped)
    advised = stability(alone, named(method), rest).dt_present
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scales = 1e-3 / (ratios * advised)
    for scale in scales:
        sheet(scene, side, damped, scale)
    place = scales[:, None, None] ** 2 * rest
    nudge = 1e-6 * np.random.default_rng(1).normal(size=rest.shape) * ~alone.pinned[:, None]
    x, grown = place + scales[:, None, None] ** 2 * nudge, np.zeros(len(ratios), bool)
    with simulate(scene, integrator=method, dt=1e-3, contacts="off") as sim:
        sim.set_position(x.reshape(-1, 3))
        for _ in range(100):
            sim.step(5)
            x, v = (a.reshape(place.shape) for a in (sim.position, sim.velocity))
            far = np.max(np.abs(x - place), axis=(1, 2)) > 1e-3 * scales**2
            if far.any():  # before it is no number any more
                grown |= far
                x[far], v[far] = place[far], 0.0
                sim.set_position(x.reshape(-1, 3))
                sim.set_velocity(v.reshape(-1, 3))
    assert np.all(np.diff(grown.astype(int)) >= 0), grown
    return ratios[np.argmax(grown)] if grown.any() else np.inf


CLOTHS = [
    pytest.param(
        method,
        side,
        damped,
        id=f"{method}-{side}x{side}" + damped * "-damped",
        marks=[pytest.mark.long] * (side == 100 or (damped and method != "symplectic_euler")),
    )
    for side in (10, 100)
    for method, damped in (
        ("symplectic_euler", False),
        ("symplectic_euler", True),
        ("verlet", False),
        ("rk4", False),
        ("rk4", True),
        ("verlet", True),
    )
]


@pytest.mark.slow
@pytest.mark.parametrize(("method", "side", "damped"), CLOTHS)
def test_advised_step_of_a_hanging_cloth(method, side, damped):
    """It holds, and at most a quarter more does."""
    ratio = blow_up(method, side, damped, np.linspace(0.98, 1.6, 63 if side == 10 else 32))
    print(f"{method} {side} {damped}: blows up at {ratio:.2f} of the advised step")
    assert 1.0 < ratio < 1.25


# Random networks ------------------------------------------------------------------------------------------------------


def add_resting_network(scene, seed, damped, unit):
    add_network(scene, np.random.default_rng(seed), 12, damped, unit)
    i, j = scene.pairs.T
    scene.set_springs(rest_length=np.linalg.norm(scene.position[i] - scene.position[j], axis=1))
    return scene


def networks(dim, method, damped):
    """A hundred random nets at rest, some of each pinned, their time scales such that the advised step of each is 1 ms."""
    scene = ts.Scene(dim=dim)
    for seed in range(100):
        alone = add_resting_network(ts.Scene(dim=dim), seed, damped, 1.0)
        add_resting_network(scene, seed, damped, 1e-3 / stability(alone, named(method), alone.position).dt_present)
    return scene


@pytest.mark.slow_where(method="symplectic_euler", dim=2)
@pytest.mark.slow_where(method="rk4")
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("method", "damped"),
    [
        ("symplectic_euler", True),
        ("verlet", False),
        *(pytest.param(name, True, marks=pytest.mark.long) for name in ("verlet", "rk4", "explicit_euler")),
    ],
)
def test_no_advised_step_blows_up(method, damped, dim):
    """Nets moved by 1e-6 m off rest stay near it for 5000 steps. At 1.5 of the step they do not, but by explicit Euler, whose
    advice is for the worst mode that there could be."""
    scene = networks(dim, method, damped)
    x = scene.position + 1e-6 * np.random.default_rng(0).normal(size=scene.position.shape)
    with simulate(scene, integrator=method, dt=1e-3, contacts="off") as sim:
        sim.set_position(x)
        sim.step(5000)
        assert np.max(np.abs(sim.position - scene.position)) < 1e-3
    if method != "explicit_euler":
        with simulate(scene, integrator=method, dt=1.5e-3, contacts="off") as sim:
            sim.set_position(x)
            with pytest.raises(ts.UnstableError):
                sim.step(500)
