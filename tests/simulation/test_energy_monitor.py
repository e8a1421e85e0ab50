"""The watch: what grows without a cause is warned of once, or taken back where dt is "auto"; what is healthy is not."""

import contextlib
import warnings

import numpy as np
import pytest
import taichi as ti
from element_blocks import mesh
from physics_support import F64, PRECISION, each_dim, simulate, vector

import taichi_sim as ts
from taichi_sim.analysis.methods import IMPLICIT_EULER, SYMPLECTIC_EULER, TR_BDF2, VERLET
from taichi_sim.analysis.stability import present_limit
from taichi_sim.simulation import run_checks
from taichi_sim.simulation.energy_monitor import EnergyMonitor, Growth
from taichi_sim.simulation.state_probe import StateSample

pytestmark = pytest.mark.long_in("f64")


def stiffening(amplitude=1.0):
    """A ball between two pins on slack springs: across them they are soft, and stiff where it is far aside."""
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[-1, 0], [0, amplitude], [1, 0]], radius=0.01, pinned=[0, 2])
    scene.add_springs([b[:2], b[1:]], stiffness=1e4, rest_length=0.2)
    return scene


def net(dim=2):
    """Six balls, unequal, swinging under gravity."""
    rng = np.random.default_rng(3)
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -10.0))
    b = scene.add_balls(rng.uniform(-1, 1, (6, dim)), radius=1e-3, mass=rng.uniform(0.5, 2.0, 6), pinned=[0])
    scene.add_springs([[b[i], b[j]] for i in range(6) for j in range(i)], stiffness=200.0, damping=0.1)
    return scene


def run_quietly(sim, seconds):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.run(seconds)


def break_it(sim):
    for _ in range(200):
        with contextlib.suppress(ts.UnstableError):
            sim.step(4)


@pytest.mark.parametrize("driver", ["fused", "parallel"])
def test_a_look_is_what_numpy_sums(driver):
    scene = ts.Scene(dim=2, gravity=(1, -10))
    rng = np.random.default_rng(0)
    x, v = rng.uniform(-9, 9, (2000, 2)), rng.normal(size=(2000, 2))
    b = scene.add_balls(x, radius=0.01, mass=2.0, velocity=v, pinned=[5])
    scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=30.0, rest_length=1.0)
    with simulate(scene, ("ordered", driver), dt=1e-3, contacts="off") as sim:
        want, seen = sim.energy(), sim.parts.state_probe.sample()
        assert seen.bad is None
        assert seen[2:5] == pytest.approx(want[:3], rel=1e-12 if F64 else 1e-5)
        assert seen.speed == pytest.approx(np.linalg.norm(sim.velocity, axis=1).max(), rel=1e-6)
        v = sim.velocity
        v[1234, 1] = np.float32(1e15)
        sim.set_velocity(v)
        assert sim.parts.state_probe.sample().bad == 1234


@pytest.mark.parametrize(
    ("variant", "rule"), [(("ordered", "fused"), "gauss_seidel"), (("gather", "parallel"), "jacobi")]
)
def test_a_look_measures_what_overlap_may_lift(variant, rule):
    """The upper ball of a pair by the height that it overlaps, what stands in the floor by its depth, a wall aside by none."""
    scene, g = ts.Scene(dim=2, gravity=(0, -8.0)), 8.0
    scene.add_balls([[0, 0.27], [0.3, 0.67], [3, 2.0], [3.35, 2.0]], radius=0.3, mass=[1.0, 2.0, 3.0, 4.0])
    scene.add_balls([[6, 0.1], [6, 0.3]], radius=0.2, mass=5.0, pinned=[1])
    scene.add_wall((0, 1))
    scene.add_wall((-1, 0), -6.1)
    with simulate(scene, variant, dt=1e-3, contacts=rule) as sim:
        sim.step(0)
        seen = sim.parts.state_probe.sample().lift
    assert seen == pytest.approx(g * (1.0 * 0.03 + 2.0 * 0.1 * 0.8 + 5.0 * 0.1), rel=1e-4)


@each_dim
def test_a_look_counts_spin(dim):
    scene = ts.Scene(dim=dim)
    scene.add_balls([vector(dim, 0, 3)], radius=0.5, mass=2.0, velocity=[vector(dim, 1)])
    scene.add_wall(vector(dim, 0, 1), 0.0)
    with simulate(scene, spin=True) as sim:
        sim.resume(
            ts.Snapshot(
                scene.position, scene.velocity, surface_speed=np.array([[2.0] + [0.0] * (0 if dim == 2 else 2)])
            )
        )
        want = 1.0 + 0.5 * 2.0 * 2.0**2 * (0.5 if dim == 2 else 0.4)
        assert sim.parts.state_probe.sample().kinetic == pytest.approx(sim.energy().kinetic) == pytest.approx(want)


def test_energy_from_nowhere_is_warned_of_once():
    scene = net()
    safe = simulate(scene, dt=1e-3, contacts="off")
    limit = safe.stability().dt_present
    safe.close()
    with simulate(scene, dt=1.3 * limit, contacts="off") as sim:
        with pytest.warns(UserWarning, match="energy grew") as seen:
            break_it(sim)
        said = [str(w.message) for w in seen if "energy grew" in str(w.message)]
        assert len(said) == 1
        for part in ("t = ", " J to ", "spring ", "in this shape", "limits verlet to"):
            assert part in said[0]


@pytest.mark.once
def test_explicit_euler_says_what_it_adds():
    """A thrown ball gains m g^2 h^2 / 2 a step."""
    scene, g, h = ts.Scene(dim=2, gravity=(0, -9.0)), 9.0, 0.15
    scene.add_balls([0, 0], velocity=(2, 8), radius=0.1, mass=3.0)
    with ts.Simulation(scene, integrator="explicit_euler", dt=h) as sim:
        before = sim.energy().total
        with pytest.warns(
            UserWarning, match="energy grew .*, as explicit_euler adds m a.2 dt.2 / 2 to a ball of accelerat"
        ):
            [sim.step() for _ in range(12)]
        assert sim.energy().total - before == pytest.approx(12 * 3.0 * (g * h) ** 2 / 2.0, rel=1e-5)
    scene.add_springs([scene.add_balls([[3, 0], [4, 0]], radius=0.1)], stiffness=5.0)
    with pytest.warns(UserWarning, match="^no step is safe here, dt = 0.15 s included: spring 0 .* is undamped"):
        ts.Simulation(scene, integrator="explicit_euler", dt=h).close()


def test_a_shape_that_stiffens_is_warned_of(monkeypatch):
    """The step is below the bound of the first shape, above that for every shape, and the ball then swings aside."""
    scene = net()
    monkeypatch.setattr(run_checks, "LOOKS_PER_BOUND", 1)
    stretched = scene.position.copy()
    stretched[1:] *= 10.0  # springs that are long are stiff in all directions
    first, later = (present_limit(scene, VERLET, x)[0] for x in (scene.position, stretched))
    between = 0.5 * (first + later)
    assert later < between < first
    with simulate(scene, dt=between, contacts="off") as sim:
        run_quietly(sim, between)
        sim.set_position(stretched)
        with pytest.warns(
            UserWarning, match=r"not safe: in this shape spring \d+ \(balls \d and \d\) limits verlet to 0\.0"
        ):
            sim.step(1)


def test_automatic_steps_are_taken_back_and_shortened():
    """The bound is made to lie fourfold, as if it had missed a spring: the run must find out."""
    scene = net()
    with simulate(scene, contacts="off", substeps=1) as sim:
        own = sim._stepper
        lie = 2.2 * sim.stability().dt_present / sim.dt
        sim.dt = own.dt = sim.dt * lie
        sim.parts.set_step(own.h)
        start = sim.energy().total
        with pytest.warns(
            UserWarning, match=r"taken back to t = .* s and repeated with substeps of .* which are kept"
        ) as seen:
            sim.run(400 * sim.dt)
        assert len(seen) == 1
        assert sim.substeps in (2, 4, 8)
        assert sim.time == pytest.approx(400 * sim.dt)
        assert np.all(np.isfinite(sim.position))
        assert sim.energy().total < start + 8.0 * abs(start)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            sim.run(2000 * sim.dt)


@ti.data_oriented
class Pump:
    """Negative drag: energy grows as exp(40 t), rightly."""

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += h * 20.0 * ball[i].v


def test_work_is_no_fault():
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1, 0]], radius=0.01, velocity=[[0.01, 0], [0.01, 0]])
    scene.add_springs([b], stiffness=100.0)
    with simulate(scene, dt=1e-3, forces=[Pump()], contacts="off") as sim:
        before = sim.energy().total
        run_quietly(sim, 0.6)
        assert sim.energy().total > 1e6 * before


@pytest.mark.long
@pytest.mark.parametrize("method", ["verlet", "symplectic_euler", "rk4", "xpbd", "implicit_euler", "tr_bdf2"])
def test_healthy_motion_is_not_warned_of(method):
    """Swinging nets, landing, and balls that overlap at the start, all at automatic steps."""
    scene = net()
    scene.add_material("rubber", restitution=1.0)
    if method == "verlet":  # contacts take long to compile
        scene.add_balls([[5, 0.0], [5.05, 0.1], [5, 0.2]], radius=0.1, material="rubber")
        scene.add_wall((0, 1), -3.0, material="rubber")
    with simulate(scene, integrator=method) as sim:
        run_quietly(sim, 3.0)
        assert np.all(np.isfinite(sim.position))


def look(kinetic, elastic=0.0, gravity=0.0, lift=0.0):
    return StateSample(None, 0.0, kinetic, elastic, gravity, abs(gravity), lift)


def test_the_rule():
    scene = stiffening()
    watch = EnergyMonitor(scene, VERLET, 0.5, closed=True, contacts=False, precision="f64")
    assert watch.limit == 8.0
    watch.begin(look(0.0, 0.0, 10.0))
    assert watch.judge(look(9.0, 1.0, 0.0)) is None  # fell, and none is lost
    assert watch.judge(look(1.0, 0.0, 0.0)) is None  # damped
    assert watch.judge(look(7.9)) is None  # a method's own swing
    assert watch.judge(look(8.1)) == (1.0, 8.1, True)
    assert EnergyMonitor(
        scene, SYMPLECTIC_EULER, 0.9, closed=True, contacts=False, precision="f64"
    ).limit == pytest.approx(28.5)
    driven = EnergyMonitor(scene, VERLET, 0.5, closed=False, contacts=False, precision="f64")
    driven.begin(look(1.0))
    assert driven.judge(look(99.0)) is None
    assert driven.judge(look(9901.0)) == (99.0, 9901.0, False)
    driven.begin(look(0.0, 1e-24))  # a spring's rounding: work adds to nothing
    assert driven.judge(look(0.1)) is None
    assert driven.judge(look(11.0)) == (0.1, 11.0, False)
    crowd = EnergyMonitor(net(), VERLET, 0.5, closed=True, contacts=True, precision="f64")
    crowd.begin(look(0.0))
    assert crowd.judge(look(0.9 * crowd.slack)) is None


@pytest.mark.once
def test_a_swing_that_turns_around_at_rest_may_be_off_by_a_part_of_its_largest_energy():
    """At its highest point a pendulum hardly moves, and what a method is off by there is more than all of its motion."""
    watch = EnergyMonitor(net(), VERLET, 0.5, closed=True, contacts=False, precision="f64")
    watch.begin(look(1e-6, 0.0, 6.0))
    for high in (0.0, 1.0, 3.0, 5.97, 6.0, 6.02):
        assert watch.judge(look(max(6.02 - high, 1e-4), 0.0, high)) is None
    assert watch.judge(look(0.05, 0.0, 6.02)) == pytest.approx((6.000001, 6.07, True))


@pytest.mark.slow
def test_solver_of_implicit_methods_is_public():
    scene = net()
    with simulate(scene, integrator="tr_bdf2", dt=0.01, contacts="off") as sim:
        run_quietly(sim, 1.0)
        found = sim.solver()
        assert found.stages == 201  # two in a step, and one that opens
        assert found.passes > found.stages
        assert found.misses == 0
        assert 0.0 < found.worst <= 10 * found.tolerance
        sim.parts.integrator.solver.tally.misses[0] = 3.0
        with pytest.warns(UserWarning, match="of the impulses of a stage unsolved"):
            sim.step(2)
        run_quietly(sim, 0.02)  # once
    with ts.Simulation(scene, arch="cpu", precision=PRECISION, dt=1e-3, contacts="off") as sim:
        assert sim.solver() is None


@pytest.mark.slow
def test_xpbd_says_what_sinks():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    b = scene.add_balls([[0, 0], [0, -0.1], [0, -0.2]], radius=0.01, mass=[1.0, 1.0, 1e4], pinned=[0])
    scene.add_springs([b[:2], b[1:]], stiffness=1e7, damping=10.0)
    with pytest.warns(
        UserWarning, match=r"xpbd: spring 1 carries 1e\+05 N at ball 2 and is left about 0.05 m too long"
    ):
        ts.Simulation(scene, arch="cpu", precision=PRECISION, integrator="xpbd", dt=1e-3).close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ts.Simulation(scene, arch="cpu", precision=PRECISION, integrator="xpbd", dt=1e-4).close()


@pytest.mark.slow
def test_stretch_that_single_precision_does_not_show():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    b = scene.add_balls([[100, 0], [100, -1]], radius=0.1, pinned=[0])
    scene.add_springs([b], stiffness=1e7, damping=1.0)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        ts.Simulation(scene, arch="cpu", precision=PRECISION).close()
    said = any("the weight at spring 0 stretches it by 1e-06 m" in str(w.message) for w in seen)
    assert said == (not F64)


@ti.data_oriented
class Push:
    """The same acceleration for all."""

    def __init__(self, acceleration):
        self.acceleration = acceleration

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += h * self.acceleration / model.inverse_mass[i] * ti.Vector([1.0, 0.0])

    def stiffness_rate(self, scene):
        return 0.0


@ti.data_oriented
class Drag:
    def __init__(self, coefficient):
        self.coefficient = coefficient

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += -h * self.coefficient * ball[i].v


def two_slow_balls(speed):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0]], radius=0.01, mass=1.0, velocity=[[speed, 0], [speed, 0]])
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, {"dt": 1e-3}], ids=["auto", "1 ms"])
def test_work_of_ones_own_force_is_no_growth(settings):
    """From almost nothing a hundred million times the energy: halved steps give the same."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with ts.Simulation(two_slow_balls(1e-3), forces=[Push(10.0)], contacts="off", **settings) as sim:
            sim.run(1.0)
            assert sim.substeps == 1
            np.testing.assert_allclose(sim.velocity[:, 0], 10.001, rtol=1e-4)


def stirred(speed):
    """A few unlike discs at rest that a shaken floor throws about: after a while their energy is another with another step."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    scene.add_material("m", friction=0.4, restitution=0.3)
    x = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 3), [0.4, 0.6]), axis=-1).reshape(-1, 2)
    scene.add_balls(x, radius=np.linspace(0.03, 0.06, 6), mass=np.linspace(0.1, 0.4, 6), material="m", velocity=speed)
    pins = scene.add_balls([[8.0, 1.6], [9.7, 1.5]], radius=0.03, pinned=True)
    scene.add_springs([pins], stiffness=700.0)
    shaken = [(0.0, (0, 0)), (0.07, (0, 0.1)), (0.2, (0, 0))]
    scene.add_collider(ts.Box((0, 0), (3.0, 0.4), path=shaken, repeat=True, material="m"))
    for normal, offset in (((1, 0), -0.9), ((-1, 0), -0.9)):
        scene.add_wall(normal, offset, "m")
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("speed", [(0.0, 0.0), (0.0, -0.02)], ids=["from rest", "from almost rest"])
def test_work_on_a_crowd_is_no_growth(speed):
    """Nothing limits the step, for the only spring joins two pins; rounding of its length is no energy that could grow."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with ts.Simulation(stirred(speed), precision=PRECISION, arch="cpu", spin=False) as sim:
            sim.run(4.2)  # a chunk
            assert sim.substeps == 1
            assert sim.decisions() == []
            assert sim.energy().kinetic > 100 * 0.5 * 1.5 * speed[1] ** 2


@pytest.mark.slow
@pytest.mark.parametrize(("method", "c"), [("verlet", 110.0), ("implicit_euler", 210.0)])
def test_drag_that_blows_up_is_warned_of(method, c):
    scene = two_slow_balls(1.0)
    with ts.Simulation(scene, forces=[Drag(c)], contacts="off", dt=0.01, integrator=method) as sim:
        with_words = r"energy grew from 1 J to .* wide in a step of 0\.01 s; half of it gives another energy"
        with pytest.warns(UserWarning, match=with_words):
            sim.run(1.0)
        fast = np.abs(sim.velocity).max()
    assert fast > 1e3  # as it would be without the look


def test_drag_that_blows_up_gets_shorter_steps():
    with ts.Simulation(two_slow_balls(1.0), forces=[Drag(1100.0)], contacts="off") as sim:
        with pytest.warns(UserWarning, match=r"a ball left the world .* repeated with substeps of 0\.0005 s"):
            sim.run(1.0)
        assert np.abs(sim.velocity).max() < 1e-6


@pytest.mark.slow
def test_a_free_net_keeps_its_momentum_in_an_implicit_method():
    """Impulses of its springs are a million times larger and cancel: what rounding leaves of them is no momentum."""
    rng, n = np.random.default_rng(7), 20
    scene = ts.Scene(dim=2)
    scene.add_balls(
        rng.uniform(-1, 1, (n, 2)), radius=0.01, velocity=rng.normal(0, 1, (n, 2)), mass=rng.uniform(0.2, 5, n)
    )
    pairs = np.array([(i, j) for i in range(n) for j in range(i + 1, min(n, i + 4))])
    length = np.linalg.norm(scene.position[pairs[:, 1]] - scene.position[pairs[:, 0]], axis=1)
    scene.add_springs(pairs, stiffness=1e10, rest_length=length * rng.uniform(0.8, 1.2, len(pairs)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that this is too stiff for single precision
        with simulate(scene, integrator="implicit_euler", dt=0.01, contacts="off") as sim:
            before = sim.momentum()
            sim.step(50)
            whole = float(np.sum(scene.mass * np.linalg.norm(scene.velocity, axis=1)))
            assert np.max(np.abs(sim.momentum() - before)) < (1e-12 if F64 else 1e-6) * whole


@pytest.mark.slow
def test_what_two_passes_leave_of_a_sheet_is_said_of_xpbd():
    """A long step stretches a sheet with bending, which limits longer steps only, until its springs hold more than it fell."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    ts.shapes.cloth(scene, resolution=(22, 22))
    scene.set_springs(damping=0.0)
    scene.set_balls([0, 21], pinned=True)
    settings = {"integrator": "xpbd", "dt": 1 / 28, "substeps": 1, "contacts": "off"}
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        with simulate(scene, **settings) as sim:
            sim.run(2.0)
    said = [str(w.message) for w in seen if "energy grew" in str(w.message)]
    assert len(said) == 1
    assert said[0].endswith(
        ", as xpbd goes through the springs twice in a step and leaves them stretched; 0.0357143 s is used: take shorter steps"
    )


@pytest.mark.once
def test_what_works_on_a_scene_is_named():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 1.0], [0.7, 1.0]], radius=0.1)
    with ts.Simulation(scene, dt=1e-3, contacts="off") as sim:
        assert sim.scales().drivers == ()
    with ts.Simulation(scene, dt=1e-3, contacts="off", forces=[Drag(0.3)]) as sim:
        assert sim.scales().drivers == ("forces of your own",)
    scene = ts.Scene(dim=3)
    scene.add_balls([[0.0, 1.0, 0.0]], radius=0.1)
    scene.add_wind(velocity=(1, 0, 0))
    with ts.Simulation(scene, dt=1e-3, contacts="off") as sim:
        assert sim.scales().drivers == ("wind",)


def resting(kind: str, dim: int) -> ts.Scene:
    """Bricks or solids at rest, with nothing to move them."""
    points, corners = mesh((2, 1, 1)[:dim])
    scene = ts.Scene(dim=dim, gravity=(0.0,) * dim)
    scene.add_balls(points * 0.7 + 0.1, mass=2.0, radius=0.01)
    material = {"young_modulus": 370.0, "poisson_ratio": 0.42}
    if kind == "solids":
        scene.add_solids(corners, **material)
    else:
        layers = np.arange(scene.n_balls).reshape(3, -1)
        scene.add_bricks(np.hstack([layers[:-1], layers[1:]]), **material)
    return scene


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["bricks", "solids"])
def test_rest_is_no_growth(kind, dim):
    with simulate(resting(kind, dim), dt=1e-3, contacts="off") as sim, warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(8):
            sim.step()


@pytest.mark.once
def test_energy_below_0_by_rounding_is_judged():
    watch = EnergyMonitor(stiffening(), VERLET, 0.5, closed=True, contacts=False, precision="f32")
    watch.begin(look(0.0, -1e-20))
    assert watch.judge(look(0.5, -1e-20)) == (-1e-20, 0.5 - 1e-20, True)


@pytest.mark.once
@pytest.mark.parametrize("start", [(0.0, -2e-13), (0.0, 0.0), (0.0, 3e-20)])
def test_what_is_back_at_its_start_has_not_risen(start):
    """Nor does what is held so firmly that nothing moves, whose sums are below 0 by rounding."""
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 1]], radius=0.1)
    watch = EnergyMonitor(scene, IMPLICIT_EULER, 0.0, closed=True, contacts=False, precision="f32")
    watch.start_at(look(*start))
    assert watch.rise(look(*start)) is None
    assert watch.rise(look(0.5, -2e-13)) == (start[1], 0.5 - 2e-13, True)
    assert watch.rise(look(*start)) is None


def landing_jelly():
    """A block of undamped jelly falls flat on a floor off which its balls bounce without loss."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    scene.add_material("gel", restitution=1.0)
    scene.add_wall((0, 1), material="gel")
    block = {"size": (0.3, 0.2), "resolution": (5, 4), "position": (0, 0.5), "damping": 0.0, "material": "gel"}
    ts.shapes.jelly(scene, **block, density=350.0, young_modulus=3.5e4, poisson_ratio=0.3)
    return scene


def assert_told_of_gains(sim, seconds, gains):
    """A run warns once of a step that gained energy, or never; no stage is missed."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        sim.run(seconds)
    told = [str(one.message) for one in said if "largest kinetic energy in one step" in str(one.message)]
    assert len(told) == gains
    assert (sim.scales().gained > 0.01) == gains
    assert sim.solver().misses == 0


@pytest.mark.slow
def test_an_implicit_step_that_gains_energy_is_told():
    """Steps of 1/240 s by which a jelly lands gain 0.07 of its kinetic energy; those of 1/2000 s gain none. No stage is missed
    in either."""
    for dt, gains in ((1 / 240, True), (1 / 2000, False)):
        with simulate(landing_jelly(), integrator="tr_bdf2", dt=dt, substeps=1) as sim:
            assert_told_of_gains(sim, 0.6, gains)


@pytest.mark.slow
@pytest.mark.skipif(not F64, reason="single precision leaves stages of so stiff a chain unsolved, and says so")
def test_an_implicit_step_of_a_stiff_chain_that_gains_energy_is_told():
    """Its stages are solved to 0.03 of the impulses, which says little of springs so stiff. Those of a hundredth of the
    stiffness gain nothing."""
    x = 0.15 * np.arange(5.0)
    for stiffness, gains in ((1e8, True), (1e6, False)):
        scene = ts.Scene(dim=2, gravity=(0, -9.81))
        balls = scene.add_balls(np.stack([x * np.cos(0.2), x * np.sin(0.2)], 1), radius=0.01, mass=0.08, pinned=[0])
        scene.add_springs(np.stack([balls[:-1], balls[1:]], 1), stiffness=stiffness)
        with simulate(scene, integrator="implicit_euler", dt=0.05, substeps=1, contacts="off") as sim:
            assert_told_of_gains(sim, 1.5, gains)


def test_a_gain_of_a_step_counts_beyond_rounding_and_lift():
    scene = net()
    watch = EnergyMonitor(scene, VERLET, 0.0, closed=True, contacts=False, precision="f64")
    assert watch.gain_of_step(look(1.0), look(1.004), 1.0) == 0.0
    assert watch.gain_of_step(look(1.0), look(1.02), 2.0) == pytest.approx(0.01)
    deep = 0.3  # J, by what overlaps
    assert watch.gain_of_step(look(1.0, lift=deep), look(1.02, gravity=deep), 2.0) == pytest.approx(0.01)
    assert watch.gain_of_step(look(1.0, lift=deep), look(1.0, gravity=deep), 2.0) == 0.0
    assert watch.gain_of_step(look(1.0, lift=deep), look(1.0, gravity=deep + 0.02), 2.0) == pytest.approx(0.01)
    assert watch.gain_of_step(look(1.0), look(1.0, gravity=0.02), 2.0) == pytest.approx(0.01)  # nothing overlapped
    assert watch.gain_of_step(look(1.0, gravity=deep, lift=deep), look(1.02 + deep), 2.0) == pytest.approx(0.01)


def test_small_gains_count_together():
    """Three bodies gained 0.062 of their kinetic energy by implicit Euler, each step less than 0.005."""
    watch = EnergyMonitor(net(), VERLET, 0.0, closed=True, contacts=False, precision="f64")
    before, after = look(1.0, lift=0.1), look(1.003, gravity=0.2)
    assert watch.climb(before, after) == pytest.approx(0.103)
    assert watch.gain_of_step(look(1.0), look(1.003), 1.0) == 0.0
    assert watch.gain_of_step(look(1.0), look(1.003), 1.0, 0.003) == pytest.approx(0.003)
    assert watch.gain_of_step(look(1.0), look(0.999), 1.0, 0.3) == 0.0
    assert not watch.is_climb(0.004, after, 1.0)
    assert watch.is_climb(0.006, after, 1.0)


def test_what_rises_again_is_told_though_the_start_had_more():
    """Two stacked jellies lost 0.9 J and gained 0.6 J, and nobody said so: the start alone was compared with."""
    for method, tells in ((TR_BDF2, True), (VERLET, False)):
        watch = EnergyMonitor(net(), method, 0.0, closed=True, contacts=True, precision="f64")
        watch.start_at(look(1.0, gravity=10.0))
        assert watch.rise(look(0.3, 0.3, 9.0)) is None
        assert watch.rise(look(0.3, 0.3, 9.0, lift=0.5)) is None
        assert watch.rise(look(0.3, 0.3, 9.5)) is None
        assert watch.rise(look(0.3, 0.39, 9.0)) is None
        assert watch.rise(look(0.5, 0.3, 9.0)) == ((9.6, 9.8, True) if tells else None)
        assert watch.rise(look(0.1, 0.0, 9.0)) is None
        assert watch.risen == pytest.approx(0.2)


@pytest.mark.once
@pytest.mark.parametrize(
    ("before", "after", "said"),
    [(-71.0, -70.99964, "from -71 J to -70.99964 J"), (1.0, 30.12345, "from 1 J to 30.12 J"), (5e4, 5e4, "to 5e+04 J")],
)
def test_energies_in_words_show_their_difference(before, after, said):
    """However far below the zero of height the scene is."""
    assert said in str(Growth(before, after, True))
