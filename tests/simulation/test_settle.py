"""A scene comes to rest before its clock starts."""

import numpy as np
import pytest
from physics_support import PRECISION

import taichi_sim as ts
from taichi_sim.common.errors import SceneError
from taichi_sim.outputs import export
from taichi_sim.reports.speed_error.command import read, settled_scene
from taichi_sim.reports.speed_error.resolution import finer
from taichi_sim.simulation.settling import Settled, require_tolerance, still
from tests.published.test_cantilever import G as EARTH
from tests.published.test_cantilever import reference

PIECES, SPAN, MASS, G = 12, 3.0, 0.4, 9.0
TOLERANCE = 1e-4 if PRECISION == "f64" else 2e-2


def bridge(**settings):
    """Balls on undamped springs between two pins, which would swing for ever, and a load that is led from the start on."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    x = np.stack([np.linspace(0, SPAN, PIECES + 1), np.zeros(PIECES + 1)], axis=1)
    balls = scene.add_balls(x, mass=MASS, radius=0.02, pinned=[0, PIECES], body=scene.new_body())
    scene.add_springs(np.stack([balls[:-1], balls[1:]], axis=1), stiffness=2000.0, rest_length=SPAN / PIECES)
    scene.add_probe("end", "tension", spring=0)
    scene.settings = {"dt": 1e-3, "contacts": "off", **settings}
    return scene


def balance(scene, x):
    """Largest net force [N] on a ball that is not pinned."""
    force = scene.mass[:, None] * scene.gravity
    i, j = scene.pairs.T
    r = x[j] - x[i]
    length = np.linalg.norm(r, axis=1, keepdims=True)
    pull = scene.stiffness[:, None] * (length - scene.rest_length[:, None]) * r / length
    np.add.at(force, i, pull)
    np.add.at(force, j, -pull)
    return np.linalg.norm(force[~scene.pinned], axis=1).max()


def test_a_bridge_rests_and_carries_its_weight(tmp_path):
    """The vertical part of the tension at an end is half of the weight of what hangs."""
    with ts.Simulation(bridge()) as sim:
        found = sim.settle(TOLERANCE)
        assert found.reached
        assert sim.time == 0.0
        assert found.residual == pytest.approx(balance(sim.scene, sim.position), rel=0.2, abs=TOLERANCE * MASS * G)
        assert balance(sim.scene, sim.position) < 1.2 * TOLERANCE * MASS * G
        x = sim.position
        slope = x[1] - x[0]
        lift = -sim.probe("end") * slope[1] / np.linalg.norm(slope)
        assert lift == pytest.approx((PIECES - 1) * MASS * G / 2, rel=2 * TOLERANCE)
        tension = sim.probe("end")
        sim.save(tmp_path / "state.npz")
        with ts.Simulation.restore(tmp_path / "state.npz", dt=5e-4) as again:
            assert again.settled == found
        sim.run(1.0)
        assert sim.probe("end") == pytest.approx(tension, rel=20 * TOLERANCE)
        assert np.abs(sim.position - x).max() < 20 * TOLERANCE * SPAN
        assert str(found).startswith("at rest, largest net force ")


def test_a_setting_does_it_and_the_summary_says_what_is_left():
    with ts.Simulation(bridge(settle=TOLERANCE)) as sim:
        assert sim.settled.reached
        summary = export(sim, None, fps=20, duration=0.1)
        assert any(line.startswith("start        at rest, largest net force") for line in summary.lines())
    left = 0.1
    with ts.Simulation(bridge(settle=left)) as sim:
        start = sim.position
    other, rest = settled_scene(bridge(settle=left))
    assert "settle" not in other.settings
    np.testing.assert_array_equal(rest, start)
    assert balance(other, other.position) < 0.1 * balance(other, rest)
    np.testing.assert_array_equal(other.rest_length, bridge().rest_length)


def tensions_of_meshes(file, settle):
    """Tension [N] in the middle of a cable with 24, 48 and 96 pieces, and with 24 where `settle` leaves it."""
    file.write_text(
        f"format = 1\ndim = 2\ngravity = [0.0, -9.0]\n[simulation]\nsettle = {settle}\ncontacts = 'off'\n"
        "[[rope]]\nstart = [0.0, 0.0]\nend = [6.0, 0.0]\nn = 25\nlength = 6.3\nmass_per_length = 0.4\nEA = 4e4\npinned = 'ends'\n"
        "[[probes]]\nname = 'mid'\nkind = 'tension'\nat = [3.0, -1.0]\n"
    )

    def tension(scene, x):
        spring = scene.probes[0].given["spring"]
        i, j = scene.pairs[spring]
        return scene.stiffness[spring] * (np.linalg.norm(x[j] - x[i]) - scene.rest_length[spring])

    _, coarse, plan = read(str(file), quantity="mid", resolutions=True, duration=0.1)
    scenes = [coarse, *(mesh.scene for mesh in finer(file))]
    return np.array([tension(scene, scene.position) for scene in scenes]), tension(coarse, plan.rest)


@pytest.mark.skipif(PRECISION == "f32", reason="rounding keeps the finer meshes from rest")
def test_settled_meshes_differ_by_their_spacing_alone(tmp_path):
    """The remainder of `settle` is a tenth of the difference between meshes and more, and no part of it in a report."""
    found, left = tensions_of_meshes(tmp_path / "s.toml", 3e-3)
    true, _ = tensions_of_meshes(tmp_path / "s.toml", 1e-6)
    assert np.diff(found) == pytest.approx(np.diff(true), rel=0.02)
    assert abs(left - true[0]) > 0.1 * abs(true[2] - true[1])


@pytest.mark.slow
def test_what_is_driven_stands_still_meanwhile():
    scene = bridge()
    scene.add_moving_pins([0], velocity=(0.5, 0.0))
    scene.add_motor([3], amplitude=0.1, frequency=2.0)
    assert not still(scene).moving_pins
    with ts.Simulation(scene) as sim:
        sim.settle(TOLERANCE)
        assert balance(sim.scene, sim.position) < 1.2 * TOLERANCE * MASS * G
        assert sim.position[0] == pytest.approx([0.0, 0.0])
        sim.run(0.1)
        assert sim.position[0, 0] == pytest.approx(0.05, rel=1e-4)
        with pytest.raises(SceneError, match="needs the clock at 0"):
            sim.settle()


@pytest.mark.slow
def test_a_heap_rests_on_its_floor():
    scene = ts.Scene(dim=2, gravity=(0, -G))
    scene.add_balls([[0.0, 0.3], [0.05, 0.55], [0.01, 0.9]], radius=0.1, mass=MASS)
    for normal, offset in (((0, 1), 0.0), ((1, 0), -0.2), ((-1, 0), -0.2)):
        scene.add_wall(normal, offset)
    with ts.Simulation(scene, dt=1e-3, settle=0.05) as sim:
        assert sim.settled.reached
        x = sim.position
        sim.run(0.5)
        assert np.abs(sim.position - x).max() < 5e-3
        assert sim.penetration() < 1e-3


def test_what_cannot_rest_says_so():
    scene = ts.Scene(dim=2, gravity=(0, -G))
    scene.add_balls([[0.0, 0.3]], radius=0.1)
    with (
        ts.Simulation(scene, dt=1e-3) as sim,
        pytest.warns(UserWarning, match="settle: not at rest, largest net force 9"),
    ):
        assert not sim.settle(longest=0.05).reached


@pytest.mark.skipif(PRECISION == "f64", reason="of single precision")
def test_what_rounding_keeps_from_rest_names_double_precision():
    with (
        ts.Simulation(bridge()) as sim,
        pytest.warns(UserWarning, match=r'allowed is 1.0e-06 %; single precision .*: try precision = "f64"$'),
    ):
        assert not sim.settle(1e-8).reached


@pytest.mark.skipif(PRECISION == "f64", reason="of single precision")
@pytest.mark.filterwarnings("ignore:precision")
def test_a_stiff_rod_bends_as_far_as_its_weight_bends_it():
    """In single precision places next to each other differ by more than its weight stretches it by, 19 times over."""
    n, length, young, radius, density = 20, 0.8, 7e9, 5e-4, 2000.0
    scene = ts.Scene(dim=3, gravity=(0, -EARTH, 0))
    area, piece = np.pi * radius**2, length / (n - 1)
    rod = {"young_modulus": young, "radius": radius, "mass_per_length": density * area, "pinned": [0, 1]}
    ts.shapes.rope(scene, start=(0, 0, 0), end=(0, 0, length), n=n, **rod)
    with ts.Simulation(scene) as sim:
        found = sim.settle(2e-3)
        tip = sim.position[-1] - sim.position[1]
    assert found.reached
    load = density * area * EARTH * (length - piece) ** 3 / (young * np.pi * radius**4 / 4)
    assert -tip[1] / tip[2] == pytest.approx(reference(load), rel=0.01)


@pytest.mark.once
@pytest.mark.parametrize("value", [2.0, -0.1, "yes", 1, np.array([0.1]), np.float32("nan"), np.array("x")])
def test_a_wrong_setting_is_named(value):
    with pytest.raises(SceneError, match=r"^settle: .* is not allowed; it must be true, false, or the part"):
        ts.Simulation(bridge(settle=value))


@pytest.mark.once
def test_numbers_of_any_kind_are_taken():
    assert require_tolerance(np.float32(0.25)) == require_tolerance(np.array(0.25)) == require_tolerance(0.25) == 0.25
    assert require_tolerance(np.True_) == require_tolerance(True) == 1e-3
    assert require_tolerance(np.False_) is require_tolerance(np.array(False)) is None


@pytest.mark.once
@pytest.mark.parametrize("wrong", [3, [1.0, 2.0], [1.0, 2.0, float("nan"), 3, True], [1.0, 2.0, 3.0, 4, 5], "abcde"])
def test_what_no_simulation_has_saved_is_refused(wrong):
    with pytest.raises(SceneError, match=r"^settled: "):
        Settled.of(wrong)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "stiffness", "dt"), [("implicit_euler", 2e5, 0.02), ("verlet", 500.0, 0.04)])
def test_the_force_that_is_left_is_what_balls_feel(tmp_path, method, stiffness, dt):
    """At any step of any method, told from the place alone; and the state can be saved at once."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0, 0], [0, -1]], radius=0.05, mass=2.0, pinned=[0])
    scene.add_springs([[0, 1]], stiffness=stiffness, rest_length=1.0)
    with ts.Simulation(scene, integrator=method, dt=dt, precision=PRECISION, arch="cpu") as sim:
        settled = sim.settle(0.02)
        left = abs(stiffness * (-sim.position[1, 1] - 1.0) - 20.0)
        assert settled.reached
        assert settled.residual == pytest.approx(left, rel=0.05, abs=0.02)
        sim.save(tmp_path / "state.npz")
    with ts.Simulation.restore(tmp_path / "state.npz") as sim:
        sim.step(1)


@pytest.mark.parametrize("kind", ["jelly", "cloth"])
def test_what_has_no_weight_and_no_strain_is_at_rest(kind):
    """All that pushes its balls is rounding, which is not compared with itself."""
    scene = ts.Scene(dim=3)
    if kind == "jelly":
        ts.shapes.jelly(scene, size=(0.3, 0.2, 0.2), resolution=(4, 3, 3), young_modulus=7e4, density=900.0)
    else:
        ts.shapes.cloth(scene, size=(0.3, 0.2), resolution=(6, 5), young_modulus=7e4, thickness=2e-3, mass_per_area=0.3)
    with ts.Simulation(scene) as sim:
        found = sim.settle(1e-3)
    assert found.reached
    assert found.stops == 1
