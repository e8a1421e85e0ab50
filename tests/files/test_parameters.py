"""Values that are set by their paths, and demos that are copied."""

import numpy as np
import pytest

from taichi_sim.cli.command import Job
from taichi_sim.cli.options import paths_and_values
from taichi_sim.common.errors import SceneError
from taichi_sim.files.source import copy_demo, open_scene, resolve
from taichi_sim.reports.speed_error import command

pytestmark = pytest.mark.once

FILE = """format = 1
dim = 2
gravity = [0.0, -10.0]
[[materials]]
name = "rubber"
restitution = 0.5
[[balls]]
name = "one"
position = [[0.0, 1.0]]
radius = 0.1
material = "rubber"
[[walls]]
normal = [0.0, 1.0]
"""
PYTHON = """import taichi_sim as ts

def scene(height=1.0):
    made = ts.Scene(dim=2, gravity=(0, -10))
    made.add_material("rubber", restitution=0.5)
    made.add_balls([[0, height]], radius=0.1, material="rubber")
    return made
"""
OPTIONS = dict.fromkeys(
    ("fps", "duration", "size", "dt", "arch", "threads", "allow_outside", "precision", "integrator")
)


@pytest.fixture
def files(tmp_path):
    (tmp_path / "s.toml").write_text(FILE)
    (tmp_path / "p.py").write_text(PYTHON)
    return tmp_path


def test_values_are_as_in_a_scene_file():
    texts = ["materials.rubber.restitution=0.25", "gravity=[0, -5]", "output.colour=speed", "a[0].b = true", "n=3"]
    wanted = {
        "materials.rubber.restitution": 0.25,
        "gravity": [0, -5],
        "output.colour": "speed",
        "a[0].b": True,
        "n": 3,
    }
    assert paths_and_values("--set", texts) == wanted


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        (["gravity"], "PATH=VALUE"),
        (["=3"], "PATH=VALUE"),
        (["a=1", "a=2"], "'a=2' is given twice; give a once"),
        ([f"a={'[' * 5000}"], "more than 16 deep"),
        (["friction=0.25\ndim=3"], "holds more than one value; give each a --set of its own"),
        (["friction=0.25\n[output]\nfps=3"], "holds more than one value"),
        (["colour=blue\nfps=3 4"], "holds several lines"),
        (["colour=\x1b[31m"], "characters that are not seen"),
    ],
)
def test_what_is_refused(texts, why):
    with pytest.raises(SceneError, match=rf"^--set: .*{why}"):
        paths_and_values("--set", texts)


@pytest.mark.parametrize("name", ["s.toml", "p.py"])
def test_a_path_changes_the_scene_of_a_file(files, name):
    made = open_scene(
        files / name, parameters={"materials.rubber.restitution": 0.75, "gravity[1]": -4.0, "simulation.dt": 2e-3}
    )
    assert made.materials[made.material[0]].restitution == 0.75
    np.testing.assert_array_equal(made.gravity, [0.0, -4.0])
    assert made.settings["dt"] == 2e-3


def test_a_python_file_that_failed_is_run_anew(files):
    """As in a notebook, once it is mended."""
    (files / "mended.py").write_text("1 / 0\n" + PYTHON)
    for _ in range(2):
        with pytest.raises(SceneError, match="division by zero"):
            open_scene(files / "mended.py")
    (files / "mended.py").write_text(PYTHON)
    assert len(open_scene(files / "mended.py").position) == 1


def test_arguments_of_a_python_scene(files):
    made = open_scene(files / "p.py", parameters={"height": 3.0, "balls[0].radius": 0.2})
    assert made.position[0, 1] == 3.0
    assert made.radius[0] == 0.2


@pytest.mark.parametrize(
    ("name", "path", "why"),
    [
        ("s.toml", "materials.ruber.restitution", r"s\.toml: materials\.ruber\.restitution: is not in this scene"),
        ("s.toml", "gravty", r"s\.toml: gravty: is not a known key; did you mean 'gravity'"),
        ("s.toml", "gravity[³]", r"s\.toml: 'gravity\[³\]' is no path; write it like"),
        ("s.toml", "gravity[\u0660]", "is no path"),
        ("s.toml", "gravity[-2]", "is no path"),
        (
            "s.toml",
            "balls[1].radius",
            r"balls\[1\]\.radius: is not in this scene; there is balls\[0\]; or, by name, one",
        ),
        ("s.toml", f"balls[{'7' * 4400}].radius", "is no path"),
        ("s.toml", "gravity[0", "is no path"),
        ("s.toml", "gravity.", "is no path"),
        ("s.toml", "balls..radius", "is no path"),
        ("s.toml", "balls.one.\x1b", "is no path"),
        ("s.toml", "rubber.friction", r"rubber is a name in materials; did you mean materials\.rubber\.friction\?"),
        ("p.py", "heigth", r"p\.py: heigth: is not a known key.*; arguments of scene\(\): height"),
    ],
)
def test_a_path_that_leads_nowhere_is_named(files, name, path, why):
    with pytest.raises(SceneError, match=why):
        open_scene(files / name, parameters={path: 1.0})


def test_only_a_path_that_leads_nowhere_brings_up_arguments(files):
    """A value may be wrong where scene() has nothing to do with it."""
    with pytest.raises(SceneError, match=r"p\.py: .*looks\[0\]: is for 3D; in 2D give `colour`, or a `stage`$"):
        open_scene(files / "p.py", parameters={"output.looks": [{"of": "one"}]})


@pytest.mark.parametrize(
    ("name", "path", "value", "why"),
    [
        ("s.toml", "gravity[0]", True, r"s\.toml: gravity: \[True, -10\.0\] is not a vector of 2 numbers"),
        ("s.toml", "balls[0].position[0][1]", False, r"s\.toml: balls\[0\]\.position: .* is not a list"),
        ("s.toml", "materials.rubber", 3, r"s\.toml: materials\[0\]: 3 is not allowed; it must be a table"),
        ("s.toml", "balls.one.radius", -1, r"s\.toml: balls\[0\]\.radius: -1(\.0)? is not allowed; it must be greater"),
        (
            "p.py",
            "balls[0].radius",
            -1,
            r"p\.py: balls\[0\]\.radius: -1(\.0)? is not allowed; it must be greater than 0$",
        ),
    ],
)
def test_a_value_that_is_not_allowed_is_named_without_a_line_that_holds_another(files, name, path, value, why):
    with pytest.raises(SceneError, match=why):
        open_scene(files / name, parameters={path: value})


@pytest.mark.parametrize("name", ["s.toml", "p.py"])
def test_a_camera_can_be_given_where_there_is_none(files, name):
    made = open_scene(files / name, parameters={"output.camera.width": 3.0, "output.camera.centre": [0, 1]})
    assert made.output["camera"] == {"width": 3.0, "centre": (0, 1)}


def test_names_may_hold_spaces(files):
    (files / "s.toml").write_text(FILE.replace('"one"', '"one ball"'))
    assert open_scene(files / "s.toml", parameters={"balls.one ball.radius": 0.3}).radius[0] == 0.3


def test_commands_take_it(files):
    job = Job(str(files / "s.toml"), {**OPTIONS, "set": ["balls.one.radius=0.3", "output.fps=25"]})
    assert job.scene.radius[0] == 0.3
    assert job.output["fps"] == 25
    _, made, plan = command.read(str(files / "s.toml"), parameters={"output.duration": 0.25, "balls.one.radius": 0.3})
    assert made.radius[0] == 0.3
    assert plan.duration == 0.25


def test_demos_are_copied_and_run_from_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert [path.name for path in copy_demo("cloth")] == ["cloth.py"]
    copied = open_scene(tmp_path / "cloth.py", parameters={"number": 5})
    assert copied.n_balls == 25
    with pytest.raises(FileExistsError, match=r"^cloth\.py: exists already"):
        copy_demo("cloth")
    with pytest.raises(FileNotFoundError, match="did you mean"):
        copy_demo("clooth")
    assert (tmp_path / "06_springs.py") == tmp_path / copy_demo("06_springs")[0]


def test_demos_take_arguments():
    small = open_scene(resolve("jelly"), parameters={"loose": 3, "mass": 10.0})
    assert small.n_balls == 11**3 + 3
