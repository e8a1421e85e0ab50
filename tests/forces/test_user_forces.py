"""Forces and elements from outside the package: what they do, what their declared rates bound, what energy they tell."""

import numpy as np
import pytest
import taichi as ti
from physics_support import EPS, F64, PRECISION

import taichi_sim as ts
from taichi_sim.analysis.methods import BUILT_IN_METHODS
from taichi_sim.device.engine import CompilationError
from taichi_sim.reports import check

H = 1e-3


@ti.data_oriented
class Tether:
    """Pulls every ball to the origin; drags on it."""

    def __init__(self, stiffness, drag=0.0):
        self.stiffness, self.drag = stiffness, drag  # N/m, N s/m

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] -= h * (self.stiffness * ball[i].x + self.drag * ball[i].v)

    def energy(self, position, velocity):
        return 0.5 * self.stiffness * np.sum(position**2)

    def stiffness_rate(self, scene):
        return self.stiffness / scene.mass.min()

    def damping_rate(self, scene):
        return self.drag / scene.mass.min()


@ti.data_oriented
class Rod(ts.Element):
    """Three balls in a row stay straight: energy k / 2 |x_a - 2 x_b + x_c|^2."""

    def __init__(self, balls, stiffness):
        self.balls, self.columns = np.asarray(balls), {"stiffness": stiffness}  # (e, 3); N/m

    @ti.func
    def force(self, ball: ti.template(), row, time):
        bend = ball[row.a].x - 2.0 * ball[row.b].x + ball[row.c].x
        return -row.stiffness * ti.select(row.corner == 1, -2.0, 1.0) * bend

    def energies(self, position):
        a, b, c = (position[self.balls[:, k]] for k in range(3))
        return 0.5 * self.columns["stiffness"] * np.sum((a - 2.0 * b + c) ** 2, axis=1)

    def stiffness_rate(self, scene):
        return ts.largest_rate(scene, self.balls, [1.0, -2.0, 1.0], self.columns["stiffness"])


def simulation(scene, forces, **settings):
    return ts.Simulation(
        scene, **{"arch": "cpu", "precision": PRECISION, "contacts": "off", "forces": forces, **settings}
    )


def row(n=5, mass=1.0):
    scene = ts.Scene(dim=2)
    x = np.stack([np.arange(n) * 0.5, 0.1 * np.sin(np.arange(n) ** 2)], axis=1)
    scene.add_balls(x, radius=0.01, mass=mass)
    return scene


def rods(n=5, stiffness=1000.0):
    return Rod([[i, i + 1, i + 2] for i in range(n - 2)], stiffness)


@pytest.mark.parametrize("method", BUILT_IN_METHODS.values(), ids=str)
@pytest.mark.parametrize("drag", [0.0, 1e6])
def test_declared_rates_bound_the_step_of_every_method(method, drag):
    from taichi_sim.analysis.element_rates import declared_rates
    from taichi_sim.analysis.stability import stability

    scene = row(mass=0.5)
    found = stability(scene, method, None, declared_rates(scene, [Tether(200.0, drag)]))
    assert "user-defined" in found.reason
    if method.name == "explicit_euler":
        assert found.dt_any_shape == 0.0
    elif drag:
        assert found.dt_any_shape < 3.0 / 2e6
    else:
        assert found.dt_any_shape == pytest.approx(method.limit.undamped / 20.0)  # omega = 20 / s


def test_a_stiff_force_shortens_the_automatic_step():
    with simulation(row(), [Tether(1e8)]) as sim:
        assert sim.dt == pytest.approx(0.9 * 2.0 / 1e4)
        assert "user-defined forces" in sim.stability().reason
        start = sim.energy()
        assert start.spring == pytest.approx(0.5e8 * np.sum(sim.position**2))
        sim.step(500)
        assert sim.energy().total < 1.0 / (1.0 - 0.9**2) * start.total * (
            1.0 + 1e-3
        )  # Verlet's swing at 0.9 of its bound
        report = "\n".join(check.lines(sim))
    assert "is not known" not in report
    with pytest.warns(UserWarning, match=r"dt = 0.0003 s is above the safe bound of 0.0002 s.*user-defined forces"):
        simulation(row(), [Tether(1e8)], dt=3e-4).close()


@ti.data_oriented
class Silent:
    """Says nothing of how stiff it is."""

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] -= h * ball[i].x


def test_a_force_that_declares_no_rate_is_named_where_the_step_is_chosen(recwarn):
    with pytest.warns(UserWarning, match='dt: "auto" does not count Silent, which declares neither'):
        sim = simulation(row(), [Silent(), Tether(1.0), Silent()])
    assert "that Silent needs is unknown" in "\n".join(check.lines(sim))
    sim.close()
    recwarn.clear()
    simulation(row(), [Silent()], dt=H).close()
    simulation(row(), [Tether(0.0)]).close()
    assert not recwarn.list


@pytest.mark.parametrize("rate", [-1.0, float("inf"), float("nan")])
def test_rates_are_not_negative_and_finite(rate):
    with pytest.raises(ValueError, match=r"forces: Tether.stiffness_rate gave"):
        simulation(row(), [Tether(rate)])


def test_elements_move_as_their_energy_says():
    """Against Verlet in NumPy with the gradient of the energy, by differences."""
    scene, force = row(), rods()
    with simulation(scene, [force], dt=H) as sim:
        x, v = sim.position, sim.velocity
        start = sim.energy()
        for _ in range(100):
            v = v + 0.5 * H * pull(force, x)
            x = x + H * v
            v = v + 0.5 * H * pull(force, x)
        sim.step(100)
        assert np.allclose(sim.position, x, rtol=0, atol=1e-7 if F64 else 1e-5)
        assert np.ptp(x - scene.position) > 0.05
        assert np.abs(sim.momentum()).max() < 1e4 * EPS
        assert sim.energy().spring == pytest.approx(force.energies(sim.position).sum())
        assert sim.energy().total == pytest.approx(start.total, rel=1e-2)
        assert "force.Rod" in sim.kernels()


def pull(force, x, d=1e-6):
    """-dE/dx (n, dim) by central differences; masses are 1 kg."""
    out = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        ends = []
        for sign in (d, -d):
            y = x.copy()
            y[index] += sign
            ends.append(force.energies(y).sum())
        out[index] = (ends[1] - ends[0]) / (2.0 * d)
    return out


def test_elements_bound_the_step_by_their_largest_eigenvalue():
    scene, force = row(7), rods(7, 1e7)
    g = np.zeros((5, 7))
    for e in range(5):
        g[e, e : e + 3] = 1.0, -2.0, 1.0
    exact = 2.0 / np.sqrt(1e7 * np.linalg.eigvalsh(g.T @ g)[-1])
    with simulation(scene, [force]) as sim:
        assert exact / 1.06 <= sim.stability().dt_any_shape <= exact  # power iteration, and its margin


def test_elements_tear_with_a_spring():
    scene = row(4)
    scene.add_springs([[1, 2]], stiffness=10.0, rest_length=0.1)
    scene.set_springs(break_strain=1.0)  # it is five times as long
    force = rods(4, np.array([1000.0, 500.0]))
    with simulation(scene, [force], dt=H) as sim:
        assert sim.energy().spring > 1.0
        sim.step(2)  # the last forces act half in the step after
        assert sim.torn.all()
        assert sim.energy().spring == 0.0
        v = sim.velocity
        sim.step(50)
        assert np.array_equal(sim.velocity, v)


def test_what_is_not_an_element_is_named():
    @ti.data_oriented
    class Empty(ts.Element):
        balls = np.array([[0, 1]])

    for force, words in (
        (Empty(), r"Empty has no function force\(ball, row, time\)"),
        (Rod([[0, 1, 9]], 1.0), r"Rod.balls\[0\]: \[0, 1, 9\] is not allowed"),
        (Rod([0, 1, 2], 1.0), r"Rod.balls: shape \(3,\) does not fit"),
    ):
        with pytest.raises(ValueError, match=words):
            simulation(row(), [force])


FILE = """format = 1
[[balls]]
position = [[0.0, 0.0], [0.5, 0.1], [1.0, 0.0]]
radius = 0.01
[[rods]]
balls = [[0, 1, 2]]
stiffness = 1000.0
"""


def test_a_scene_file_may_have_a_table_of_elements(tmp_path):
    rods, file = [], tmp_path / "rods.toml"

    def add(scene, balls, stiffness):
        if stiffness < 0.0:
            raise ts.SceneError(f"stiffness: {stiffness:g} is not allowed")
        rods.append(Rod(balls, stiffness))

    file.write_text(FILE)
    scene = ts.load_scene(file, tables={"rods": add})
    with simulation(scene, rods, dt=H) as sim:
        assert sim.energy().spring == pytest.approx(0.5 * 1000.0 * 0.2**2)
    for there, instead, words in (
        ("stiffness =", "weight = 1.0\nstiffness =", r"rods.toml, line 5: rods\[0\]: .*'weight'"),
        ("1000.0", "-1.0", r"rods.toml, line \d: rods\[0\].*stiffness: -1 is not allowed"),
        ("stiffness = 1000.0", "", r"rods.toml, line 5: rods\[0\]: .*'stiffness'"),
        ("stiffness = 1000.0", 'stiffness = 1.0\nname = "a"', r"rods.toml, line \d: rods\[0\].*name: is not allowed"),
    ):
        file.write_text(FILE.replace(there, instead))
        with pytest.raises(ts.SceneError, match=words):
            ts.load_scene(file, tables={"rods": add})
    with pytest.raises(ts.SceneError, match="rods"):
        ts.load_scene(file)


@ti.data_oriented
class Link(ts.Element):
    """A spring without a length of its own."""

    def __init__(self, balls, stiffness):
        self.balls, self.columns = balls, {"stiffness": stiffness}

    @ti.func
    def force(self, ball: ti.template(), row, time):
        return row.stiffness * (ball[row.a].x - ball[row.b].x) * ti.select(row.corner == 0, -1.0, 1.0)


@pytest.mark.slow
@pytest.mark.long_in("f64")
def test_what_an_element_joins_does_not_roll_like_casters():
    """As what a spring joins: two balls that are pulled to each other slide on the floor, x'' = mu g - 2 k x / m."""
    found = []
    for own in (True, False):
        scene = ts.Scene(dim=2, gravity=(0, -10))
        scene.add_material("rough", friction=0.4)
        scene.add_balls([[-1, 0.1], [1, 0.1]], radius=0.1, material="rough")
        scene.add_wall((0, 1), 0.0, "rough")
        forces = [Link([[0, 1]], 8.0)] if own else []
        if not own:
            scene.add_springs([[0, 1]], stiffness=8.0, rest_length=0.0)
        with simulation(scene, forces, contacts="auto") as sim:
            sim.run(0.15)
            assert not sim.angular_velocity.any()
            found.append(sim.position)
    rest = 0.4 * 10.0 / (2 * 8.0)  # m, where friction holds the pull
    exact = rest + (1.0 - rest) * np.cos(4.0 * 0.15)
    assert found[0] == pytest.approx(found[1], abs=1e-5)
    assert found[0][1, 0] == pytest.approx(exact, abs=1e-4)


@ti.data_oriented
class Shaker:
    """Force 3 N cos(9 t / s) along x on each ball."""

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i].x += h * 3.0 * ti.cos(9.0 * time)

    def stiffness_rate(self, scene):
        return 0.0


@pytest.mark.skipif(not F64, reason="rounding hides the small steps")
@pytest.mark.slow_where(method=["explicit_euler", "symplectic_euler", "implicit_euler", "xpbd"])
@pytest.mark.parametrize("method", BUILT_IN_METHODS)
def test_a_force_that_depends_on_time_leaves_each_method_its_order(method):
    """A ball on a spring to a pin, shaken: x'' = -25 x + 1.5 cos(9 t), which is at rest at first."""
    scene = ts.Scene(dim=2, gravity=(0.0, 0.0))
    balls = scene.add_balls([[0.0, 0.0], [1.0, 0.0]], radius=0.01, mass=2.0, pinned=[0])
    scene.add_springs([balls], stiffness=50.0, rest_length=1.0)
    errors = []
    for steps in (100, 200, 400):
        with simulation(scene, [Shaker()], integrator=method, dt=0.8 / steps, substeps=1) as sim:
            sim.step(steps)
            exact = 1.5 / (25.0 - 81.0) * (np.cos(9.0 * 0.8) - np.cos(5.0 * 0.8))
            errors.append(abs(sim.position[1, 0] - 1.0 - exact))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert order == pytest.approx(BUILT_IN_METHODS[method].order, abs=0.15)


@pytest.mark.once
@pytest.mark.parametrize("by", [2, 4])
def test_a_force_of_another_dimension_is_an_error_that_names_both(by):
    """It ended the process, in C++."""

    @ti.data_oriented
    class Lift:
        @ti.func
        def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
            for i in range(model.n):
                if ti.static(by == 2):
                    impulse[i] -= h * ti.Vector([0.5] * by)
                else:
                    ti.atomic_add(impulse[i], ti.Vector([0.5] * by))

    scene = ts.Scene(dim=3)
    scene.add_balls([0, 0, 0], radius=0.1)
    with ts.Simulation(scene, forces=[Lift()], dt=H, arch="cpu", precision=PRECISION) as sim:
        with pytest.raises(Exception, match=rf"shape \({by},\) does not fit one of \(3,\)") as told:
            sim.step()
        assert isinstance(told.value, CompilationError)
        assert "in accumulate" in str(told.value)
