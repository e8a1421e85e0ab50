"""xpbd, implicit_euler and tr_bdf2: against dense matrices and closed forms, at any step, with contacts, in either driver."""

import re

import numpy as np
import pytest
import reference as ref
import reference_stiff as slow
from physics_support import F64, each_dim, error, simulate, vector

import taichi_sim as ts
from taichi_sim.analysis.methods import BUILT_IN_METHODS
from taichi_sim.integrators import TRBDF2, XPBD, ImplicitEuler
from tests.support.drag import Drag

pytestmark = pytest.mark.long_in("f32")

STIFF = ("xpbd", "implicit_euler", "tr_bdf2")
KINDS = {"xpbd": XPBD, "implicit_euler": ImplicitEuler, "tr_bdf2": TRBDF2}
each_stiff = pytest.mark.parametrize("method", STIFF)


def exactly(method):
    """The method with solutions to rounding."""
    return XPBD() if method == "xpbd" else KINDS[method](tolerance=1e-13 if F64 else 1e-6)


def net_of(scene):
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    return ref.network(w, scene.pairs, scene.stiffness, scene.damping, scene.rest_length, scene.gravity)


def random_net(dim, seed, n=20, stiffness=300.0):
    """Balls of unequal mass, some pinned, joined to their neighbours by springs that are not at rest."""
    rng = np.random.default_rng(seed)
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.3, -9.81, 1.0))
    x = rng.uniform(-1.0, 1.0, (n, dim))
    b = scene.add_balls(
        x,
        radius=0.01,
        velocity=rng.normal(0.0, 1.0, (n, dim)),
        mass=rng.uniform(0.2, 5.0, n),
        pinned=rng.uniform(size=n) < 0.1,
    )
    far = np.linalg.norm(x[:, None] - x[None], axis=2)
    pairs = np.array([(i, j) for i in range(n) for j in range(i) if j in np.argsort(far[i])[:5]])
    length = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    scene.add_springs(
        b[pairs],
        stiffness=stiffness * rng.uniform(0.1, 1.0, len(pairs)),
        damping=rng.uniform(0.0, 2.0, len(pairs)),
        rest_length=length * rng.uniform(0.8, 1.2, len(pairs)),
    )
    return scene


@pytest.mark.slow
def test_methods_that_no_spring_limits():
    assert tuple(name for name, method in BUILT_IN_METHODS.items() if not method.limit.by_springs) == STIFF
    scene = random_net(2, 0)
    for method in STIFF:
        with simulate(scene, integrator=method) as sim:
            assert sim.dt == 1e-3
            assert np.isinf(sim.stability().dt_any_shape)
            assert "any step" in sim.stability().reason


@pytest.mark.slow_where(dim=2)
@each_dim
@each_stiff
@pytest.mark.slow_where(method="tr_bdf2")
@pytest.mark.long_where(method="tr_bdf2", dim=2)
def test_agrees_with_dense_matrices(method, dim):
    for seed in range(2):
        scene = random_net(dim, seed)
        x, v = slow.RUN[method](net_of(scene), scene.position, scene.velocity, 5e-3, 20)
        with simulate(scene, integrator=exactly(method), dt=5e-3, contacts="off") as sim:
            sim.step(20)
            assert error(sim.position, x) < (1e-9 if F64 else 1e-4)
            assert error(sim.velocity, v) < (1e-8 if F64 else 1e-3)


@each_stiff
def test_lone_spring(method):
    """Implicit Euler decays by (1 + w^2 h^2)^-1/2 a step, xpbd, whose spring acts by halves, by 1 / (1 + w^2 h^2 / 2); tr_bdf2 is
    compared with its own dense form."""
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1.0, 0]], radius=0.01, mass=[1.0, 2.0])
    scene.add_springs([b], stiffness=100.0, rest_length=0.999)
    h, steps = 0.01, 100
    with simulate(scene, integrator=exactly(method), dt=h) as sim:
        sim.step(steps)
        stretch = sim.position[1, 0] - sim.position[0, 0] - 0.999
    if method == "tr_bdf2":
        x, _ = slow.tr_bdf2(net_of(scene), scene.position, scene.velocity, h, steps)
        expected = x[1, 0] - x[0, 0] - 0.999
    else:
        a = 150.0 * h * h  # omega^2 = k (1/m1 + 1/m2)
        left = 1.0 / (1.0 + a) if method == "implicit_euler" else (1.0 + 0.5 * a) ** -2  # of the predicted stretch
        step = np.array([[left, left * h], [(left - 1.0) / h, left]])
        assert np.allclose(np.abs(np.linalg.eigvals(step)), left**0.5)
        expected = (np.linalg.matrix_power(step, steps) @ [0.001, 0.0])[0]
    assert abs(stretch - expected) < (1e-11 if F64 else 2e-6)


@each_stiff
def test_free_fall(method):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0, 0]], radius=0.1, velocity=(1, 2))
    with simulate(scene, integrator=method, dt=0.01) as sim:
        sim.step(100)
        late = 0.0 if method == "tr_bdf2" else 0.05  # g t h / 2
        assert np.allclose(sim.position, [[1.0, 2.0 - 5.0 - late]], atol=1e-12 if F64 else 1e-6)


@pytest.mark.slow_where(method="tr_bdf2")
@each_stiff
def test_momentum(method):
    scene = random_net(3, 5)
    scene.gravity = np.zeros(3)
    scene.set_balls(pinned=False)
    with simulate(scene, integrator=exactly(method), dt=2e-3, contacts="off") as sim:
        p, L = sim.momentum(), sim.angular_momentum()
        sim.step(200)
        size = np.sum(scene.mass * np.linalg.norm(sim.velocity, axis=1))
        assert np.allclose(sim.momentum(), p, atol=(1e-10 if F64 else 2e-4) * size)
        if method == "xpbd":  # its impulses act along the springs as they will be, not as they are
            assert np.allclose(sim.angular_momentum(), L, atol=0.05 * size)


def free_net(kind, power, h):
    """A net without gravity and pins whose springs have K h^2, or C h, of ten to that power; and the slowest of its springs."""
    scene = random_net(2, 7)
    scene.gravity = np.zeros(2)
    scene.set_balls(pinned=False)
    scene.set_springs(stiffness=10.0**power / h**2 if kind == "elastic" else 1.0)
    scene.set_springs(damping=10.0**power / h if kind == "damping" else 0.0)
    return scene


def closing_speed(scene, x, v):
    """RMS of the speeds along the springs."""
    i, j = scene.pairs.T
    r = x[j] - x[i]
    return float(np.sqrt(np.mean((np.sum((v[j] - v[i]) * r, axis=1) / np.linalg.norm(r, axis=1)) ** 2)))


@pytest.mark.slow_where(method="tr_bdf2")
@pytest.mark.slow_where(power=[2, 4])
@pytest.mark.parametrize("power", [2, 4, 6])
@each_stiff
def test_any_stiffness(method, power):
    """Springs that are far from rest: bounded by the energy they start with, all of it shared out within the body."""
    scene = free_net("elastic", power, 0.01)
    start = sum(ref.energy(net_of(scene), scene.position, scene.velocity))
    finely = ImplicitEuler(tolerance=1e-5) if method == "implicit_euler" else method
    with simulate(scene, integrator=finely, dt=0.01, contacts="off") as sim:
        momentum = sim.momentum()
        size = np.sqrt(2.0 * scene.mass.sum() * start)
        energy = [start]
        for _ in range(50):
            sim.step(1)
            energy.append(sim.energy().total)
        energy = np.array(energy)
        assert np.all(np.isfinite(energy))
        assert np.all(energy[1:] < start)
        if method == "implicit_euler":  # its potential falls in each step
            assert np.all(np.diff(energy) < 1e-5 * energy[:-1])
        assert np.allclose(sim.momentum(), momentum, atol=(1e-9 if F64 else 1e-4) * size)


@pytest.mark.parametrize("power", [2, 4, 6])
@each_stiff
@pytest.mark.slow
def test_any_damping(method, power):
    """Relative velocity along the springs decays at once, momentum is kept."""
    scene = free_net("damping", power, 0.01)
    start = sum(ref.energy(net_of(scene), scene.position, scene.velocity))
    before = closing_speed(scene, scene.position, scene.velocity)
    with simulate(scene, integrator=method, dt=0.01, contacts="off") as sim:
        momentum = sim.momentum()
        sim.step(50)
        assert sim.energy().total < start
        assert closing_speed(scene, sim.position, sim.velocity) < 0.05 * before
        assert np.allclose(sim.momentum(), momentum, atol=1e-9 if F64 else 2e-3)


@pytest.mark.parametrize("method", ["implicit_euler", "tr_bdf2"])
@pytest.mark.slow_where(method="tr_bdf2")
def test_heavy_end(method):
    """A chain of 20 whose last ball is 1e4 times heavier: the static stretch within 1 %. By xpbd, once per step and spring, it
    sinks for many seconds."""
    n, k, m = 20, 1e7, 1.0
    scene = ts.Scene(dim=2, gravity=(0, -10))
    mass = np.full(n + 1, m)
    mass[-1] = 1e4
    b = scene.add_balls(
        np.stack([np.zeros(n + 1), -0.1 * np.arange(n + 1)], axis=1), radius=0.01, mass=mass, pinned=[0]
    )
    scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=k, damping=np.sqrt(k * 1e4))
    stretch = sum(10.0 * mass[i:].sum() / k for i in range(1, n + 1))
    with simulate(scene, integrator=method, dt=0.02, contacts="off") as sim:
        sim.run(20.0)
        assert np.max(np.abs(sim.velocity)) < 1e-2
        assert abs(-sim.position[-1, 1] - 0.1 * n - stretch) < 0.01 * stretch


def hanging_sheet(along, across, stiffness, steps):
    """A sheet held along one side, and where its balls are after so many steps of 0.5 ms, by RK4."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(along, across), stiffness=stiffness, damping=0.05, mass=0.3)
    scene.set_balls(sheet.balls[:across], pinned=True)
    return scene, ref.run("rk4", net_of(scene), scene.position, scene.velocity, 5e-4, steps)[0]


@pytest.mark.slow
def test_xpbd_by_colours_is_what_a_device_does():
    """The same bits in either driver, all springs once, and as far from the exact motion as in turn."""
    scene, exact = hanging_sheet(9, 7, 2e3, 400)
    found = []
    for accumulate, driver in (("gather", "fused"), ("gather", "parallel"), ("ordered", "parallel")):
        with simulate(scene, (accumulate, driver), integrator="xpbd", dt=2e-3, contacts="off") as sim:
            assert ("springs.colours" in sim.kernels()) == (accumulate == "gather")
            sim.step(100)
            found.append(sim.position)
    np.testing.assert_array_equal(found[0], found[1])
    by_colours, in_turn = (float(np.sqrt(np.mean((x - exact) ** 2))) for x in (found[0], found[2]))
    assert 1e-4 < by_colours < 1.1 * in_turn
    assert np.abs(found[0] - found[2]).max() > 1e-6  # another order


@pytest.mark.slow
def test_xpbd_by_colours_with_motors_gas_and_springs_that_tear():
    """Both orders come to what Verlet does, by half with half the step, and tear the same springs."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(7, 6), stiffness=1500, damping=0.05, mass=0.3)
    scene.set_balls(sheet.balls[:6], pinned=True)
    scene.add_motor(list(range(10, 22)), amplitude=0.1, frequency=2.0)
    scene.set_springs(slice(0, 5), break_strain=0.006)
    ends = scene.add_balls(
        [[-1, 0, 0], [-1, -0.5, 0]], radius=0.01, mass=0.5, velocity=[[0, 0, 0], [0, -2, 0]], pinned=[True, False]
    )
    scene.add_springs([ends], stiffness=100.0, break_strain=0.3)
    ts.shapes.balloon(scene, (3, 0, 0), 0.3, subdivisions=1)
    end = 0.2

    def after(method, dt, *rules):
        with simulate(scene, *rules, integrator=method, dt=dt, contacts="off") as sim:
            sim.step(round(end / dt))
            return sim.position, sim.torn

    exact, torn = after("verlet", 2.5e-5)
    assert torn.any()
    off = {}
    for accumulate in ("gather", "ordered"):
        for dt in (1.25e-4, 6.25e-5):
            x, broken = after("xpbd", dt, (accumulate, "parallel"))
            np.testing.assert_array_equal(broken, torn)
            off[accumulate, dt] = float(np.sqrt(np.mean((x - exact) ** 2)))
        assert 1e-5 < off[accumulate, 6.25e-5] < 0.7 * off[accumulate, 1.25e-4], accumulate
    assert off["gather", 6.25e-5] < 1.1 * off["ordered", 6.25e-5]


def test_xpbd_keeps_an_order_where_a_ball_has_too_many_springs_for_colours():
    """Atomic sums would vary in the last bits, and split the masses of all."""
    scene = ts.Scene(dim=2)
    around = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    scene.add_balls([[0, 0], *np.stack([np.cos(around), np.sin(around)], axis=1)], radius=0.01)
    scene.add_springs([(0, k) for k in range(1, 41)], stiffness=10.0)
    with simulate(scene, ("gather", "parallel"), integrator="xpbd", dt=1e-3, contacts="off") as sim:
        assert "springs.batches" in sim.kernels()


@pytest.mark.slow
@each_stiff
@pytest.mark.long_where(method=["implicit_euler"])
def test_atomic_sums_agree(method):
    scene = random_net(2, 9)
    found = []
    for accumulate in ("ordered", "atomic"):
        integrator = method if method == "xpbd" else exactly(method)
        with simulate(scene, (accumulate, "fused"), integrator=integrator, dt=1e-4, contacts="off") as sim:
            sim.step(500)
            found.append(sim.position)
    bound = 2e-3 if method == "xpbd" else (1e-9 if F64 else 1e-4)  # two splittings of one method, of order 1
    assert error(found[1], found[0]) < bound


@each_stiff
@pytest.mark.slow
@pytest.mark.long_where(method=["implicit_euler"])
def test_a_jelly_lands_and_rests(method):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_material("rubber", restitution=0.3, friction=0.4)
    ts.shapes.jelly(
        scene, size=(0.6, 0.4), resolution=(5, 4), position=(0, 0.3), stiffness=2e4, damping=20.0, material="rubber"
    )
    scene.add_wall((0, 1), 0.0, material="rubber")
    with simulate(scene, integrator=method, dt=4e-3) as sim:
        start = sim.energy().total
        sim.run(3.0)
        assert np.max(np.abs(sim.velocity)) < 0.01
        assert sim.penetration() < 0.02 * scene.radius.max()
        assert sim.energy().total < start


@pytest.mark.slow_where(method=["tr_bdf2", "xpbd"])
@each_stiff
def test_zero_length(method):
    """Coincident balls on a spring with a length: finite, apart along an axis, the centre of mass fixed."""
    scene = ts.Scene(dim=3)
    b = scene.add_balls([[0, 0, 0], [0, 0, 0]], radius=0.01, mass=[1.0, 3.0])
    scene.add_springs([b], stiffness=1e4, rest_length=0.5)
    with simulate(scene, integrator=method, dt=0.01, contacts="off") as sim:
        sim.step(100)
        x = sim.position
    assert np.all(np.isfinite(x))
    assert 0.1 < np.linalg.norm(x[1] - x[0]) < 1.0
    assert np.allclose(scene.mass @ x, 0.0, atol=1e-9 if F64 else 1e-4)


@each_stiff
def test_pinned_balls_keep_still(method):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    b = scene.add_balls([[0, 0], [1, 0], [0, 1]], radius=0.1, pinned=True)
    scene.add_springs([b[:2], b[1:]], stiffness=10.0, damping=1.0, rest_length=0.5)
    with simulate(scene, integrator=method, dt=0.01) as sim:
        sim.step(10)
        assert np.array_equal(sim.velocity, np.zeros_like(sim.velocity))


@pytest.mark.slow
def test_tr_bdf2_takes_forces_of_ones_own_to_second_order():
    """Linear drag on a swinging spring, which is explicit, against the closed form by matrix exponential."""
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1.0, 0]], radius=0.01, pinned=[0], velocity=[[0, 0], [0.01, 0]])
    scene.add_springs([b], stiffness=30.0)
    A = np.array([[0.0, 1.0], [-30.0, -0.8]])
    w, V = np.linalg.eig(A)
    exact = ((V * np.exp(w * 0.64)) @ np.linalg.solve(V, [0.0, 0.01])).real
    e = []
    for n in (64, 128, 256):
        with simulate(scene, integrator=exactly("tr_bdf2"), dt=0.64 / n, forces=[Drag(0.8)]) as sim:
            sim.step(n)
            e.append(abs(sim.position[1, 0] - 1.0 - exact[0]))
    if F64:
        assert np.all(np.abs(np.log2(np.divide(e[:-1], e[1:])) - 2.0) < 0.15), e
    else:
        assert e[0] < 1e-5


@pytest.mark.parametrize("method", [ImplicitEuler, TRBDF2, XPBD])
@pytest.mark.parametrize("tolerance", [0, 0.6, 0.0501, float("nan"), "a", [0.1], 1j, True])
def test_a_tolerance_out_of_range_is_refused(method, tolerance):
    """At 0.6 nothing that a stage leaves is ten times as much, so that no miss would be counted."""
    says = f"tolerance: {tolerance!r} is not allowed; it must be above 0 and at most 0.05"
    with pytest.raises(ts.SceneError, match=re.escape(says)):
        method(tolerance=tolerance)


@pytest.mark.slow_where(method="tr_bdf2")
@pytest.mark.parametrize("method", ["implicit_euler", "tr_bdf2"])
@pytest.mark.slow
def test_free_fall_is_solved_at_once(method):
    """The guess has all of gravity in it; what is left is measured by what acted, not by itself."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls(np.stack([0.1 * np.arange(50), np.zeros(50)], axis=1), radius=0.01, mass=0.1)
    scene.add_springs([(i, i + 1) for i in range(49)], stiffness=1e3, rest_length=0.1)
    with simulate(scene, integrator=method, dt=1e-2, contacts="off") as sim:
        sim.step(20)
        found = sim.solver()
        assert found.misses == 0
        assert found.passes < 6 * found.stages
        np.testing.assert_allclose(sim.velocity[:, 1], -2.0, rtol=1e-5)


@pytest.mark.slow
def test_nothing_that_acts_is_no_miss():
    scene = ts.Scene(dim=2)
    scene.add_balls(np.stack([0.1 * np.arange(40), np.zeros(40)], axis=1), radius=0.01, mass=0.1)
    scene.add_springs([(i, i + 1) for i in range(39)], stiffness=1e3, rest_length=0.1)
    with simulate(scene, integrator="implicit_euler", dt=1e-2, contacts="off") as sim:
        sim.step(20)
        assert sim.solver().misses == 0


@pytest.mark.slow
@pytest.mark.parametrize("k", [1e7, 1e10] if F64 else [1e7])
def test_a_very_stiff_rope_swings(k):
    """Blocks of springs in a line are nearly singular: in single precision they are summed and inverted in double."""
    scene, n = ts.Scene(dim=3, gravity=(0, 0, -9.81)), 64
    along = np.array([1.0, 0.7, 0.3]) / np.linalg.norm([1.0, 0.7, 0.3])
    scene.add_balls(0.05 * np.arange(n)[:, None] * along, radius=0.005, mass=0.01, pinned=np.arange(n) == 0)
    scene.add_springs([(i, i + 1) for i in range(n - 1)], stiffness=k, rest_length=0.05)
    with simulate(scene, integrator="implicit_euler", dt=1e-2, contacts="off") as sim:
        sim.step(10)
        found = sim.solver()
        assert found.misses == 0 or not F64
        assert np.isfinite(sim.position).all()
        assert -1.5 < sim.velocity[-1, 2] < -0.5  # it swings, about 9.81 times 0.1 s
        if k == 1e7:
            assert sim.position[-1, 2] == pytest.approx(0.698, abs=5e-4 if F64 else 5e-3)
