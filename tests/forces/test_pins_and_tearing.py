"""Pins that move along paths, springs that tear, attachments; in both drivers, saved and restored."""

import warnings

import numpy as np
import pytest
import taichi as ti
from own_methods import Declared
from physics_support import EPS, PRECISION, simulate, vector
from scene_files import assert_refused, assert_unchanged
from trajectories import pierced

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.forces import sum as forces_sum

pytestmark = pytest.mark.long_in("f64")

EACH_DRIVER = pytest.mark.parametrize("driver", ["fused", "parallel"])
PATH = [(0.0, (0.0, 0.0)), (0.1, (0.2, 0.1)), (0.3, (0.2, -0.3), 90.0)]


def driven(method_damping: float = 0.1) -> ts.Scene:
    """A chain of four in 2D, its first two balls driven along a path that rotates them."""
    scene = ts.Scene(dim=2, gravity=(0.0, -10.0))
    balls = scene.add_balls([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.5, 0.0]], radius=0.05, mass=0.2)
    scene.add_springs(np.stack([balls[:-1], balls[1:]], axis=1), stiffness=200.0, damping=method_damping)
    scene.add_moving_pins([0, 1], path=PATH)
    return scene


def place(time: float) -> np.ndarray:
    """Where the two driven balls of `driven` are, worked out by hand."""
    if time <= 0.1:
        by, angle = np.array([0.2, 0.1]) * time / 0.1, 0.0
    else:
        part = min(1.0, (time - 0.1) / 0.2)
        by, angle = np.array([0.2, 0.1 - 0.4 * part]), np.pi / 2 * part
    arm = 0.25 * np.array([np.cos(angle), np.sin(angle)])
    centre = np.array([0.25, 0.0]) + by
    return np.array([centre - arm, centre + arm])


@pytest.mark.slow_where(driver="fused")
@pytest.mark.slow_where(method=["implicit_euler", "symplectic_euler"])
@pytest.mark.parametrize("method", ["symplectic_euler", "verlet", "rk4", "implicit_euler"])
@EACH_DRIVER
def test_pins_follow_their_path(method, driver):
    if method == "rk4" and driver == "parallel":
        pytest.skip("rk4 leads pins by the same kernel as verlet; one driver is enough")
    with simulate(driven(), ("ordered", driver), integrator=method, dt=1e-3, contacts="off") as sim:
        for look in (lambda: sim.step(0), lambda: sim.set_velocity(np.ones((4, 2)))):
            np.testing.assert_allclose(sim.velocity[:2], [[2.0, 1.0]] * 2, atol=40 * EPS)
            look()
        sim.set_velocity(np.zeros((4, 2)))
        for _ in range(4):
            sim.step(100)
            np.testing.assert_allclose(sim.position[:2], place(sim.time), atol=40 * EPS)
        assert np.abs(sim.velocity[:2]).max() < 1e-12  # the path has ended
        assert np.all(np.isfinite(sim.position))


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, 3])
def test_a_moving_pin_pushes_what_it_meets(dim):
    """An elastic blow of a ball that nothing stops: the other leaves at twice its speed."""
    scene = ts.Scene(dim=dim)
    scene.add_material("steel", restitution=1.0)
    scene.add_balls([vector(dim), vector(dim, 1.0)], radius=0.1, material="steel")
    scene.add_moving_pins([0], velocity=vector(dim, 2.0))
    with simulate(scene, dt=1e-3) as sim:
        sim.run(1.0)
        np.testing.assert_allclose(sim.position[0], vector(dim, 2.0), atol=1e-5)
        np.testing.assert_allclose(sim.velocity[1], vector(dim, 4.0), rtol=1e-5, atol=1e-6)


@pytest.mark.long
def test_walls_do_not_hold_moving_pins():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [5.0, 0.0]], radius=0.1)
    scene.add_wall((0.0, 1.0), offset=-0.5)
    scene.add_moving_pins([0], velocity=(0.0, -2.0))
    with simulate(scene, dt=1e-3) as sim:
        sim.run(1.0)
        np.testing.assert_allclose(sim.position[0], [0.0, -2.0], atol=1e-5)


def strip(break_strain=0.5) -> ts.Scene:
    """Three balls in a row, pulled apart: the second spring is the weaker one and tears."""
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], radius=0.01)
    scene.add_springs([[0, 1], [1, 2]], stiffness=[400.0, 100.0], damping=[1.0, 1.0], break_strain=break_strain)
    scene.add_moving_pins([0], velocity=(-1.0, 0.0))
    scene.add_moving_pins([2], velocity=(1.0, 0.0))
    return scene


ORDERS = [("verlet", "fused"), ("verlet", "parallel"), ("xpbd", "fused"), ("implicit_euler", "parallel")]


@pytest.mark.slow_where(method="implicit_euler")
@pytest.mark.parametrize(("method", "driver"), ORDERS, ids="-".join)
def test_a_spring_tears_at_its_strain_and_pulls_no_more(method, driver):
    with simulate(strip(), ("ordered", driver), integrator=method, dt=1e-3, contacts="off") as sim:
        before = 0.0
        while not sim.torn.any():
            before = float(np.linalg.norm(sim.position[2] - sim.position[1]))
            sim.step()
            assert sim.time < 2.0
        assert 1.48 < before <= 1.5 + 1e-6
        assert sim.torn.tolist() == [False, True]
        frame = sim.frame()
        assert frame.springs.tolist() == [[0, 1]]
        assert len(frame.strain) == 1
        x, v = sim.position, sim.velocity
        stretch = np.linalg.norm(x[1] - x[0]) - 1.0
        assert sim.energy().spring == pytest.approx(0.5 * 400.0 * stretch**2, rel=1e-5)
        sim.step(20)
        pull = (sim.velocity[1] - v[1])[0] / 0.02
        assert pull < -0.5 * 400.0 * stretch  # only the spring to the left acts
        sim.step(1000)
        assert sim.torn.tolist() == [False, True]


def test_atomic_sums_tear_alike():
    with simulate(strip(), ("atomic", "parallel"), dt=1e-3, contacts="off") as sim:
        sim.run(1.5)
        assert sim.torn.tolist() == [False, True]


def test_torn_springs_are_saved(tmp_path):
    with simulate(strip(), dt=1e-3, contacts="off") as sim:
        sim.run(1.0)
        assert sim.torn.any()
        sim.save(tmp_path / "state.npz")
        sim.step(100)
        end = sim.position
    with ts.Simulation.restore(tmp_path / "state.npz") as again:
        assert again.torn.tolist() == [False, True]
        again.step(100)
        np.testing.assert_array_equal(again.position, end)


def test_torn_springs_limit_no_step():
    """The stiffer one of a chain tears: the safe step is that of the other, in every shape and in this one."""
    scene = strip()
    scene.set_springs(stiffness=[100.0, 900.0], break_strain=[np.inf, 0.05])
    weaker = strip()
    weaker.set_springs(stiffness=[100.0, 0.0], damping=[1.0, 0.0])
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        before = sim.stability()
        while not sim.torn.any():
            sim.step()
            assert sim.time < 2.0
        after = sim.stability()
    with simulate(weaker, dt=1e-3, contacts="off") as alone:
        expected = alone.stability()
    assert after.spring == 0
    assert after.dt_any_shape == expected.dt_any_shape > 1.5 * before.dt_any_shape
    assert after.dt_present >= after.dt_any_shape


def test_a_spring_without_length_is_held_where_others_tear():
    scene = strip()
    scene.add_balls([[0.0, 0.0]], radius=0.01)
    scene.attach([3], [0], stiffness=1000.0, damping=1.0)
    assert scene.rest_length[-1] == 0.0
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        sim.run(1.0)
        assert sim.torn.tolist() == [False, True, False]


@pytest.mark.slow
def test_a_state_without_torn_springs_is_whole():
    """Reports and the window begin one simulation again and again."""
    with simulate(strip(), dt=1e-3, contacts="off") as sim:
        sim.run(1.0)
        assert sim.torn.any()
        sim.resume(ts.Snapshot(sim.scene.position, sim.scene.velocity))
        assert not sim.torn.any()
        sim.step(150)
        assert sim.position[1, 0] == pytest.approx(strip_middle(), rel=1e-5)


@pytest.mark.slow
def test_what_was_taken_back_is_whole_again():
    """The watch halves a step at which energy grew: what tore in the chunk that is repeated has not torn."""
    with simulate(strip(), dt=1e-3, contacts="off") as sim:
        sim.step(100)
        parts, stepper = sim.parts, sim._stepper
        stepper.keep(goes_on=True)
        stepper._launch(800)
        assert parts.tearing.springs_torn.any()
        stepper.go_back()
        assert not parts.tearing.springs_torn.any()
        assert float(np.sum(parts.forces.springs.spring.stiffness.to_numpy())) > 0
        sim.step(50)
        assert sim.position[1, 0] == pytest.approx(strip_middle(), rel=1e-5)


def strip_middle() -> float:
    with simulate(strip(None), dt=1e-3, contacts="off") as sim:
        sim.step(150)
        return float(sim.position[1, 0])


def test_triangles_with_a_torn_side_are_gone_when_it_gapes():
    """Two that share a side, of which one tears, and apart from them one of whose sides two tear one after the other."""
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], radius=0.01)
    scene.add_balls([[5, 0, 0], [6, 0, 0], [5, 1, 0]], radius=0.01, pinned=[0, 1])
    scene.add_springs([[0, 1], [1, 2], [0, 2], [1, 3], [2, 3]], stiffness=10.0, break_strain=[np.inf] * 4 + [0.2])
    scene.add_springs([[4, 5], [5, 6], [4, 6]], stiffness=10.0, break_strain=[np.inf, 0.1, 0.1])
    scene.add_triangles([[0, 1, 2], [2, 1, 3], [4, 5, 6]])
    scene.add_moving_pins([3], velocity=(1.0, 1.0, 0.0))
    scene.add_moving_pins([6], velocity=(0.0, 0.3, 0.0))
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        assert len(sim.frame().triangles) == 3
        sim.run(0.5)
        assert sim.torn.tolist() == [False] * 4 + [True, False, False, True]
        assert len(sim.frame().triangles) == 3
        assert len(sim.frame().torn_triangles) == 0
        sim.run(0.5)
        frame = sim.frame()
        assert sim.torn.tolist() == [False] * 4 + [True, False, True, True]
        assert frame.triangles.tolist() == [[0, 1, 2]]
        assert frame.torn_triangles.tolist() == [[2, 1, 3], [4, 5, 6]]
        assert frame.torn_springs.tolist() == [[2, 3], [5, 6], [4, 6]]
        sim.run(0.01)
        assert sim.frame().triangles is frame.triangles


@pytest.mark.parametrize("driver", ["fused", "parallel"])
@pytest.mark.slow
def test_what_a_torn_spring_held_together_lets_go(driver):
    """A strip with bending and wind, torn across: the halves part as if nothing joined them, and whole again after a restore."""
    scene = ts.Scene(dim=3)
    strip = {"stretch_stiffness": 50.0, "bending_rigidity": 0.01, "damping": 0.3}
    sheet = ts.shapes.cloth(scene, size=(1, 0.2), resolution=(6, 3), **strip)
    x = scene.position[scene.pairs[sheet.springs]][:, :, 0]
    scene.set_springs(sheet.springs[(x.min(axis=1) < 0.5) & (x.max(axis=1) > 0.5)], break_strain=0.1)
    scene.add_wind((0.0, 0.0, 0.0))
    scene.add_moving_pins(sheet.balls[:3], velocity=(-1.0, 0.0, 0.0))
    scene.add_moving_pins(sheet.balls[-3:], velocity=(1.0, 0.0, 0.0))
    with simulate(scene, ("ordered", driver), contacts="off") as sim:
        sim.run(1.0)
        assert sim.torn.sum() == np.isfinite(scene.break_strain).sum()
        assert sim.energy().spring < 1e-3  # 1 J and more, where bending elements reach across
        middle = sim.velocity[6:12, 0]
        assert np.abs(middle - np.repeat([-1.0, 1.0], 3)).max() < 0.2
        parts = sim.parts
        assert all(force.gone.to_numpy().any() for force in parts.forces.elements)
        parts.tearing.tear(np.zeros(scene.n_springs, dtype=bool))
        assert not any(force.gone.to_numpy().any() for force in parts.forces.elements)


def test_an_attachment_is_a_spring():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0], [0, 2], [1, 2]], radius=0.1)
    springs = scene.attach([0, 1], [2, 3], stiffness=5.0, break_strain=1.0)
    assert scene.pairs[springs].tolist() == [[0, 2], [1, 3]]
    assert scene.rest_length.tolist() == [2.0, 2.0]


def test_tolerance_and_tearing_exclude_each_other():
    with pytest.raises(ValueError, match=r"tolerance.*tear"):
        ts.Simulation(strip(), tolerance=1e-2, precision=PRECISION)


@pytest.mark.slow
@pytest.mark.parametrize("torn", [(0, 1), (1, 3)], ids=["owner", "other"])
def test_a_torn_triangle_lets_through_and_its_neighbour_bears(torn):
    """Two triangles share an edge; one loses a side. Balls fall on the middle of either, and on the edge."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]])
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.add_balls(corners, radius=0.02, pinned=True)
    pairs = [[0, 1], [1, 2], [0, 2], [1, 3], [2, 3]]
    long = [1.0 if tuple(pair) == torn else np.inf for pair in pairs]
    scene.add_springs(pairs, stiffness=10.0, rest_length=0.4, break_strain=long)
    scene.add_triangles([[0, 1, 2], [2, 1, 3]], collides=True)
    middles = [corners[[0, 1, 2]].mean(axis=0), corners[[2, 1, 3]].mean(axis=0), [0.48, 0.0, 0.5], [0.52, 0.0, 0.5]]
    scene.add_balls(np.add(middles, [0, 0.06, 0]), radius=0.02)
    with simulate(scene, dt=1e-3) as sim:
        sim.run(0.5)
        assert sim.torn.sum() == 1
        gone, whole = (0, 1) if torn == (0, 1) else (1, 0)
        x, y, z = sim.position[4:].T
        assert y[gone] < -0.5
        assert y[whole] == pytest.approx(0.04, abs=2e-3)
        assert y[2 + whole] == pytest.approx(0.04, abs=2e-3)  # beside the edge, on what is left
        assert y[2 + gone] < -0.2
        away = (x + z - 1.0) * [-1, 1, -1, 1]  # from the edge
        assert away[2 + gone] > 0.1  # it slid off the edge, and did not fall beside it
        assert away[:2] == pytest.approx(1 / 3, abs=1e-6)


@pytest.mark.long
@pytest.mark.long_in("f64")
def test_cloth_that_tears_collides_with_what_tears_it():
    """A ball goes through a sheet where it tears, without piercing what is left, and stays on one that holds."""
    with simulate(pierced(weak=None), dt=1e-3) as sim:
        sim.run(0.8)
        assert sim.position[-1, 1] > sim.position[:-1, 1].min()
    with simulate(pierced(), dt=1e-3) as sim:
        for _ in range(40):
            sim.run(0.02)
            assert sim.crossings() == 0
        assert sim.torn.sum() > 5
        assert sim.position[-1, 1] < sim.position[:-1, 1].min() - 0.15
        assert len(sim.frame().torn_triangles) > 5


@pytest.mark.slow
def test_springs_tear_by_methods_that_look_for_no_contacts():
    """Also where triangles collide, and springs are else looked at before contacts are found."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.add_balls(
        [[0, 0, 0], [0, -1, 0], [3, 0, 0], [4, 0, 0], [3, 0, 1]], radius=0.01, pinned=[True, False, True, True, True]
    )
    scene.add_springs([[0, 1]], stiffness=1.0, rest_length=1.0, break_strain=0.5)
    scene.add_triangles([[2, 3, 4]], collides=True)
    with simulate(scene, integrator=Declared(), dt=1e-3) as sim:
        sim.run(0.6)
        assert sim.torn.tolist() == [True]


@pytest.mark.long
def test_a_stick_beside_a_spring_that_tears_still_collides():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]])
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.add_balls(corners, radius=0.02, pinned=True)
    scene.add_triangles([[0, 1, 2], [2, 1, 3]], collides=True)
    ends = scene.add_balls([[0.5, 0.1, -0.5], [0.5, 0.1, 1.5]], radius=0.02)
    scene.add_springs([ends], stiffness=1e4, rest_length=2.0, collides=True)
    scene.add_springs([ends], stiffness=1.0, rest_length=1.0, break_strain=0.5)
    with simulate(scene, dt=1e-3) as sim:
        sim.run(0.4)
        assert sim.torn.tolist() == [False, True]
        assert sim.position[4:, 1] == pytest.approx(0.02, abs=2e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"balls": [0], "path": [(0, (1, 0)), (1, (2, 0))]}, r"moving_pins\[0\].path\[0\].*jump"),
        ({"balls": [0], "path": [(0, (0, 0)), (0, (2, 0))]}, r"moving_pins\[0\].path\[1\].time.*times must rise"),
        ({"balls": [0], "path": [(0, (0, 0)), (1, (np.inf, 0))]}, r"moving_pins\[0\].path\[1\].position"),
        ({"balls": [0], "path": [(0, (0, 0))]}, r"moving_pins\[0\].path: has one keyframe"),
        ({"balls": [9], "velocity": (1, 0)}, r"moving_pins\[0\].balls\[0\]"),
        ({"balls": [], "velocity": (1, 0)}, r"moving_pins\[0\].balls: is empty"),
        ({"balls": [0]}, r"moving_pins\[0\]: does not move"),
        ({"balls": [0, 0], "velocity": (1, 0)}, r"ball 0 is named twice"),
        ({"balls": [0], "velocity": (1, 0), "path": PATH}, r"moving_pins\[0\].velocity.*together with a path"),
    ],
)
def test_wrong_paths_are_named(arguments, words):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0]], radius=0.1)
    assert_unchanged(scene, lambda scene: scene.add_moving_pins(**arguments), words)


def test_a_pin_that_leaps_and_a_wind_on_nothing_are_warned_of():
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0]], radius=0.1)
    scene.add_moving_pins([0], path=[(0, (0, 0, 0)), (1, (0, 0, 0)), (1.001, (3, 0, 0))])
    scene.add_wind((1.0, 0.0, 0.0))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ts.Simulation(scene, precision=PRECISION, dt=1e-3).close()
    words = [str(warning.message) for warning in told]
    assert any("moving_pins[0].path[1]: from there on balls are led at 3e+03 m/s, 30 radii" in word for word in words)
    assert any(word == "wind: acts on triangles, and this scene has none" for word in words)


def test_a_turn_by_half_or_more_is_refused_from_the_first_keyframe_on():
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0]], radius=0.1)
    with pytest.raises(ts.SceneError, match=r"moving_pins\[0\].path\[1\].rotation.*less than half a turn"):
        scene.add_moving_pins([0, 1], path=[(0, (0, 0, 0)), (1, (0, 0, 0), (0, 270, 0))])


FILE = """
format = 1
dim = 3
[[rope]]
name = "line"
start = [0.0, 0.0, 0.0]
end = [1.0, 0.0, 0.0]
n = 5
[[rope]]
name = "other"
start = [0.0, 1.0, 0.0]
end = [1.0, 1.0, 0.0]
n = 5
[[attachments]]
one = "line"
one_members = [4]
other = "other"
other_members = [4]
stiffness = 3.0
break_strain = 0.5
[[moving_pins]]
balls = "line"
members = [0]
path = [{ time = 0.0, position = [0.0, 0.0, 0.0] }, { time = 1.0, position = [0.0, 0.0, 1.0] }]
[wind]
velocity = [1.0, 0.0, 0.0]
"""


def test_scene_files_name_groups_and_members(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(FILE)
    scene = ts.load_scene(file)
    assert scene.pairs[-1].tolist() == [4, 9]
    assert scene.moving_pins[0].balls.tolist() == [0]
    assert scene.wind.velocity == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('balls = "line"', 'balls = "lime"', r"line 22: moving_pins\[0\].balls: 'lime' is not a name"),
        ("members = [0]\npath", "members = [7]\npath", r"line 23: moving_pins\[0\].members\[0\]: 7"),
        ("other_members = [4]", "other_members = [3, 4]", r"attachments\[0\].other: names 2 balls"),
        ("velocity = [1.0, 0.0, 0.0]", "velocity = [1.0, 0.0]", r"wind.velocity"),
        ("[wind]", "[wind]\nspeed = 3", r"wind.speed: is not a known key"),
    ],
)
def test_mistakes_in_scene_files_are_named(tmp_path, old, new, words):
    with warnings.catch_warnings():
        assert_refused(tmp_path, FILE, old, new, words)


@pytest.mark.slow
def test_friction_holds_a_ball_on_a_turning_surface_of_pins():
    """Where that takes more than half of what friction can give: both contact solves of a step bring the ball round. It would
    creep out by exp(W^2 h t / 2) - 1, half a hundredth."""
    rate, friction, radius = 2.2, 0.7, 0.04
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    scene.add_material("rough", friction=friction)
    plate = scene.add_balls(
        [[x, -0.01, z] for x in (-2, 2) for z in (-2, 2)], radius=0.01, pinned=True, material="rough"
    )
    scene.add_triangles(plate[[[0, 1, 3], [0, 3, 2]]], collides=True)
    scene.add_moving_pins(plate, rotation_rate=(0, np.degrees(rate), 0), pivot=(0, 0, 0))
    arm = np.array([0.9, 0.0, 0.35])
    pull = rate**2 * np.linalg.norm(arm)
    assert 0.5 * friction * 9.81 < pull < friction * 9.81
    start = arm + vector(3, 0.0, radius)
    ball = scene.add_balls([start], radius=radius, velocity=np.cross([0, rate, 0], arm), material="rough")
    with simulate(scene, dt=2e-3, spin=False) as sim:
        sim.run(0.1)
        x = sim.position[ball[0]]
        out, angle = np.hypot(x[0], x[2]), np.arctan2(-x[2], x[0])
        sim.run(1.0)
        x = sim.position[ball[0]]
    turned = (np.arctan2(-x[2], x[0]) - angle - rate * 1.0 + np.pi) % (2 * np.pi) - np.pi
    assert abs(np.hypot(x[0], x[2]) - out) < (1e4 * EPS)
    assert abs(turned) < (1e4 * EPS)


def test_what_tore_is_not_counted_as_inverted_and_took_energy():
    scene = ts.Scene(dim=2, gravity=(0.0, 0.0))
    corner = np.array([[0.0, 0.0], [0.8, 0.0], [0.0, 0.6], [0.9, 0.7]])
    scene.add_balls(corner, mass=0.3, radius=0.01, velocity=[[0, 0], [0, 0], [0, 0], [-4.0, -4.0]])
    scene.add_springs([[1, 3]], stiffness=1.0, break_strain=0.1)
    scene.add_solids([[0, 1, 2], [1, 3, 2]], young_modulus=10.0, poisson_ratio=0.3)
    scene.set_balls(pinned=[True, True, True, False])
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        assert "tearing" not in sim.scales().takers
        sim.set_position(corner + np.array([[0, 0], [0, 0], [0, 0], [0.5, 0.5]]))
        sim.set_velocity(np.array([[0, 0], [0, 0], [0, 0], [-4.0, -4.0]]))
        sim.run(0.6)
        assert sim.torn.tolist() == [True]
        assert diagnostics.inverted(sim.scene, sim.position) == 1
        assert sim.inverted() == 0
        assert "tearing" in sim.scales().takers


@ti.data_oriented
class Draught:
    """A constant force [N] on every ball, no element of corners."""

    name, elastic = "wind", False

    def __init__(self, model, fields):
        pass

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += h * ti.Vector([0.0, 0.0, 3.0])


def test_a_built_in_force_that_is_no_list_of_corners_lets_springs_tear(monkeypatch):
    monkeypatch.setattr(forces_sum, "_kernels", {"wind": Draught}.__getitem__)
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 1, 0]], radius=0.01, mass=2.0)
    scene.add_springs([[0, 1]], stiffness=10.0, break_strain=0.5)
    scene.add_triangles([[0, 1, 2]])
    scene.add_wind((0.0, 0.0, 1.0))
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        sim.run(0.2)
        assert sim.velocity[:, 2] == pytest.approx(0.3, rel=1e-4)
