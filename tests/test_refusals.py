"""Objects and arguments that do not fit are refused before anything is compiled, in one sentence that names the place and what is
allowed, and leave the scene as it was."""

import inspect
import itertools
import pickle
import re

import numpy as np
import pytest
import taichi as ti
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim.outputs import open_outputs

pytestmark = pytest.mark.once


def three_balls():
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [2, 0, 0]], radius=0.1)
    return scene


@ti.data_oriented
class Rod(ts.Element):
    def __init__(self, balls, **columns):
        self.balls, self.columns = balls, columns

    @ti.func
    def force(self, ball: ti.template(), row, time):
        return -row.stiffness * ball[row.a].x + ball[row.c].x


@ti.data_oriented
class NoTaichi:
    def accumulate(self, model, ball, impulse, h, time):
        pass


class NoTime:
    def accumulate(self, model, ball, impulse, h):
        pass


class Method(ts.Integrator):
    def __init__(self, method):
        self.method = method

    @ti.func
    def substep(self, h, time):
        pass


class Solid(ts.ColliderShape):
    @ti.func
    def distance(self, p):
        return p[0]

    def surface(self):
        return np.zeros((3, 3))


class SolidOfTwo(Solid):
    @ti.func
    def distance(self, p, q):
        return p[0] - q[0]


def of_number(rod):
    rod.columns[5] = 1.0
    return rod


class Silent(ts.Output):
    needs_image = False


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"forces": [NoTaichi()]}, "forces: NoTaichi.accumulate is not a Taichi function; write @ti.func above it"),
        ({"forces": [NoTaichi]}, "forces: NoTaichi is a class; give an object, NoTaichi(...)"),
        ({"forces": 3}, "forces: 3 is not allowed; it must be a list of forces"),
        (
            {"forces": [NoTime()]},
            "forces: NoTime.accumulate takes (model, ball, impulse, h); it must take (model, ball, impulse, h, time)",
        ),
        ({"forces": [object()]}, "forces: object has no function accumulate(model, ball, impulse, h, time)"),
        (
            {"forces": [Rod([[0, 1, 2]])]},
            "Rod.columns.stiffness: is read by force, but it is no column and no corner of its 3; there are corner, a, b, c",
        ),
        (
            {"forces": [Rod([[0, 1]], stiffness=1.0)]},
            "Rod.columns.c: is read by force, but it is no column and no corner of its 2; there are corner, a, b, stiffness",
        ),
        (
            {"forces": [Rod([[0, 1, 2]], stiffness=[1.0, 2.0])]},
            "Rod.columns.stiffness: shape (2,) does not fit; it must be one number or 1 of them",
        ),
        (
            {"forces": [Rod([[0, 1, 2], [2, 0, 2]], stiffness=1.0)]},
            "Rod.balls[1]: [2, 0, 2] names a ball twice; give 3 different",
        ),
        (
            {"forces": [Rod([[0, 1, 2]], **{"stiffness": 1.0, "rest length": 2.0})]},
            "Rod.columns: 'rest length' is not allowed; it must be the name of a number, which `force` reads as row.name",
        ),
        (
            {"forces": [of_number(Rod([[0, 1, 2]], stiffness=1.0))]},
            "Rod.columns: 5 is not allowed; it must be the name of a number, which `force` reads as row.name",
        ),
        ({"forces": [Rod([[0, 1], [2]])]}, "Rod.balls: shape () does not fit; it must be (e, k), k from 2 to 8"),
        ({"integrator": Method("verlet")}, "integrator: Method.method must be a ts.Method, not 'verlet'"),
        (
            {"integrator": Method(ts.Method("mine", limit=2.0))},
            "integrator: the limit of Method.method must be a ts.StabilityLimit",
        ),
        ({"dt": np.array([1e-3, 2e-3])}, "dt: [0.001, 0.002] is not one number"),
        ({"substeps": np.array([2])}, "substeps: [2] is not allowed; it must be a whole number from 1 to 2147483647"),
    ],
)
def test_arguments_of_a_simulation(settings, message):
    with pytest.raises(ts.SceneError) as caught:
        ts.Simulation(three_balls(), **settings)
    assert str(caught.value) == message


def test_a_file_name_is_no_scene():
    with pytest.raises(ts.SceneError, match=r"scene: 'x.toml' is no Scene; ts.load_scene reads one from a file"):
        ts.Simulation("x.toml")


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (SolidOfTwo((0, 0, 0)), "colliders[0]: SolidOfTwo.distance takes (p, q); it must take (p)"),
        (Solid, "colliders[0]: Solid is a class; give an object, Solid(...)"),
        (Solid((0, 0, 0)), "colliders[0].surface(): [[0.0, 0.0, 0.0]"),
    ],
)
def test_colliders(shape, message):
    scene = three_balls()
    with pytest.raises(ts.SceneError) as caught:
        scene.add_collider(shape)
    assert str(caught.value).startswith(message)
    assert not scene.colliders


@pytest.mark.parametrize(
    ("output", "given", "message"),
    [
        ("a.npz", {}, "output: 'a.npz' is not allowed; it must be a ts.Output, as ts.open_output(path) gives"),
        (Silent(), {}, "output: Silent has no function write(index, frame, image)"),
        (None, {"fps": "fast"}, "fps: 'fast' is not a number"),
        (None, {"fps": 0}, "fps: 0.0 is not allowed; it must be greater than 0"),
        (None, {"duration": -1}, "duration: -1.0 is not allowed; it must be at least 0"),
    ],
)
def test_arguments_of_an_export(output, given, message):
    with ts.Simulation(three_balls(), dt=1e-3, arch="cpu") as simulation:
        with pytest.raises(ts.SceneError) as caught:
            ts.export(simulation, output, **given)
        assert str(caught.value).startswith(message)
        assert simulation.time == 0.0


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (lambda s: ts.shapes.cloth(s, break_strain=-1.0), "cloth.break_strain: -1.0 is not allowed"),
        (lambda s: ts.shapes.cloth(s, damping=-1.0), "cloth.damping: -1.0 is not allowed"),
        (
            lambda s: ts.shapes.cloth(s, size=[1.0, [2.0]]),
            "cloth.size: [1.0, [2.0]] is not allowed; it must be 2 lengths",
        ),
        (lambda s: ts.shapes.cloth(s, resolution=[4, [4]]), "cloth.resolution: [4, [4]] is not allowed"),
        (lambda s: ts.shapes.jelly(s, surface_collision=3), "jelly.surface_collision"),
        (lambda s: ts.shapes.tower(s, mass=-1.0), "tower.mass: -1.0 is not allowed"),
        (lambda s: ts.shapes.pile(s, radius=0.1, resolution=(2, 2, 2), material="jam"), "pile.material"),
        (lambda s: ts.shapes.rope(s, (0, 0, 0), (1, 0, 0), material="jam"), "rope.material: 'jam' is not a material"),
    ],
)
def test_shapes_are_added_whole_or_not_at_all(add, message):
    scene = three_balls()
    assert_unchanged(scene, add, f"^{re.escape(message)}")
    assert ts.shapes.cloth(scene, resolution=(2, 2)).balls.tolist() == [3, 4, 5, 6]
    assert scene.body.tolist() == [0, 0, 0, 1, 1, 1, 1]  # no number of a body was used up


ADDED = {  # arguments with which each is added to eight balls at the corners of a box
    "add_balls": {"position": [[5.0, 5.0, 5.0]], "radius": 0.1},
    "add_springs": {"pairs": [[0, 1]], "stiffness": 3.0},
    "attach": {"one": [0], "other": [1], "stiffness": 3.0},
    "add_membranes": {"corners": [[0, 1, 2]], "warp": 3.0},
    "add_cells": {"corners": [[0, 1, 2, 4]], "bulk_modulus": 3.0},
    "add_bending": {"corners": [[1, 1, 0, 3]], "weights": [[-1, -1, 1, 1]], "stiffness": 3.0},
    "add_bricks": {"corners": [range(8)], "young_modulus": 3.0, "poisson_ratio": 0.3},
    "add_solids": {"corners": [[0, 1, 2, 4]], "young_modulus": 3.0, "poisson_ratio": 0.3},
    "add_wind": {"velocity": (1.0, 0.0, 0.0)},
}


@pytest.mark.parametrize("method", ADDED)
def test_none_is_refused_where_it_is_not_the_default(method):
    scene = ts.Scene(dim=3)
    for _ in range(2):  # the table of balls has room for more
        scene.add_balls(list(itertools.product((0.0, 2.0), repeat=3)), radius=0.1)
    add = getattr(ts.Scene, method)
    for name, argument in inspect.signature(add).parameters.items():
        if name != "self" and argument.default is not None:
            assert_unchanged(scene, lambda s, n=name: add(s, **{**ADDED[method], n: None}), rf"^\w+\.{name}: \[?None")
    add(scene, **ADDED[method])


class _Fails(ts.Scene):
    """A scene whose triangles are refused: the balls and springs of the shape are there by then."""

    def add_triangles(self, *_, **__):
        raise ts.SceneError("triangles", says="are refused")


def test_what_a_shape_had_added_is_taken_back():
    scene = _Fails(dim=3)
    scene.add_balls([[0, 0, 0]], radius=0.1)
    with pytest.raises(ts.SceneError, match="cloth: are refused"):
        ts.shapes.cloth(scene)
    assert (scene.n_balls, scene.n_springs, len(scene.position)) == (1, 0, 1)


def test_a_setting_of_a_scene_file_is_refused_with_its_line(tmp_path):
    file = tmp_path / "a.toml"
    text = "format = 1\n[[balls]]\nposition = [[0, 0]]\nradius = 0.1\n\n[simulation]\nintegrator = 'verlet'\n"
    file.write_text(text + "tolerance = 1e-3\ndt = 1e-3\n")
    with pytest.raises(ts.SceneError) as caught:
        ts.Simulation(ts.load_scene(file))
    assert (caught.value.path, caught.value.file, caught.value.line) == (("simulation", "tolerance"), file, 8)
    file.write_text(text + "dt = 1e-300\n")
    scene = ts.load_scene(file)
    with pytest.raises(ts.SceneError, match=r"a.toml, line 8: simulation.dt: 1e-300 is not allowed"):
        ts.Simulation(scene)
    with pytest.raises(ts.SceneError, match=r"^dt: 1e-301 is not allowed"):  # not the file's
        ts.Simulation(scene, dt=1e-301)


@pytest.mark.parametrize(
    "add",
    [
        lambda s: s.add_balls([0, 0, 1], radius=0.1, group="new", collides_with=[3]),
        lambda s: s.add_balls([0, 0, 1], radius=-0.1, group="new"),
        lambda s: s.add_wall((0, 1, 0), group="new", collides_with=[3]),
        lambda s: s.add_collider(ts.Box((0, 0, -9), (1, 1, 1), group="new", collides_with=["q", 3])),
        lambda s: s.set_group([0], "new", collides_with=["q", 3]),
    ],
)
def test_what_is_refused_leaves_no_group(add):
    scene = three_balls()
    with pytest.raises(ts.SceneError):
        add(scene)
    assert scene.groups.names == ["default"]


def test_a_tolerance_that_rounding_hides_is_refused_with_its_line(tmp_path):
    file = tmp_path / "a.toml"
    file.write_text("format = 1\n[[balls]]\nposition = [[3, 0]]\nradius = 0.1\n[simulation]\ntolerance = 1e-30\n")
    with pytest.raises(
        ts.SceneError, match=r"a.toml, line 6: simulation.tolerance: 1e-30 is less than what rounding leaves"
    ):
        ts.Simulation(ts.load_scene(file))


def test_errors_go_between_processes():
    error = ts.UnstableError("ball 3 left the world", 1.5, 3, None, 0.01)
    same = pickle.loads(pickle.dumps(error))
    assert (str(same), same.time, same.ball, same.spring, same.safe_dt) == ("ball 3 left the world", 1.5, 3, None, 0.01)


@pytest.mark.parametrize("paths", [[""], ["x.csv", ""]])
def test_an_output_without_a_name_is_refused(paths, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"^the name of the output is empty"):
        open_outputs(paths)
    assert not list(tmp_path.iterdir())
