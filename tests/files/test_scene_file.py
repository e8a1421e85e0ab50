"""Scene files: read, written back bit for bit, and every bad one refused in one message that says where and why."""

from pathlib import Path

import numpy as np
import pytest

from taichi_sim import Scene, SceneError, shapes
from taichi_sim.common.errors import key_name
from taichi_sim.files.toml_lines import line_of
from taichi_sim.files.toml_reader import load_scene

pytestmark = pytest.mark.once

GOOD = """format = 1
dim = 2
gravity = [0.0, -10.0]
[simulation]
dt = 0.001
integrator = "verlet"
[[materials]]
name = "rubber"
restitution = 0.5
[[balls]]
name = "pair"
position = [
  [0.0, 1.0],  # left
  [1.0, 1.0],
]
mass = 1.0
radius = 0.05
pinned = [0]
material = "rubber"
[[springs]]
balls = "pair"
pairs = [[0, 1]]
stiffness = 100.0
[[walls]]
normal = [0.0, 1.0]
[output]
fps = 30
size = [640, 360]
"""

COLUMNS = [
    "gravity",
    "position",
    "velocity",
    "mass",
    "radius",
    "pinned",
    "material",
    "body",
    "colour",
    "pairs",
    "stiffness",
    "damping",
    "rest_length",
    "collides",
    "triangles",
    "solid",
]


def load(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def same(one: Scene, other: Scene) -> bool:
    """Bit for bit."""
    columns = all(
        getattr(one, name).dtype == getattr(other, name).dtype
        and getattr(one, name).tobytes() == getattr(other, name).tobytes()
        for name in COLUMNS
    )
    parts = ("dim", "materials", "walls", "settings", "output")
    return columns and all(getattr(one, name) == getattr(other, name) for name in parts)


def test_good(tmp_path):
    scene = load(tmp_path, GOOD)
    assert scene.position.tolist() == [[0, 1], [1, 1]]
    assert scene.pinned.tolist() == [True, False]
    assert scene.materials[1].restitution == 0.5
    assert scene.material.tolist() == [1, 1]
    assert scene.rest_length.tolist() == [1]
    assert scene.walls[0].normal == (0.0, 1.0)
    assert scene.settings == {"dt": 0.001, "integrator": "verlet"}
    assert scene.output == {"fps": 30.0, "size": (640, 360)}


def test_groups_count_within_and_without_a_name_over_all(tmp_path):
    text = """format = 1
[[balls]]
position = [[0.0, 0.0]]
radius = 0.1
[[balls]]
name = "b"
position = [[1.0, 0.0], [2.0, 0.0]]
radius = 0.1
[[rope]]
name = "rope"
start = [0.0, 1.0]
end = [1.0, 1.0]
n = 4
[[springs]]
balls = "b"
pairs = [0, 1]
stiffness = 1
[[springs]]
pairs = [[0, 2]]
stiffness = 2
[[springs]]
balls = "rope"
pairs = [[0, 3]]
stiffness = 3
"""
    scene = load(tmp_path, text)
    assert scene.pairs[3:].tolist() == [[1, 2], [0, 2], [3, 6]]


def test_shapes_take_the_arguments_of_their_functions(tmp_path):
    (tmp_path / "tent.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    text = """format = 1
dim = 3
[[cloth]]
size = [1.0, 2.0]
resolution = [3, 4]
pinned = [0]
[[cloth]]
mesh = "tent.obj"
self_collision = true
[[jelly]]
resolution = [2, 2, 2]
[[wheel]]
centre = [0.0, 0.0, 0.0]
radius = 1.0
[[pile]]
resolution = [1, 2, 3]
radius = 0.1
"""
    expected = Scene(dim=3)
    shapes.cloth(expected, (1.0, 2.0), (3, 4), pinned=[0])
    shapes.cloth(expected, mesh=tmp_path / "tent.obj", self_collision=True)
    shapes.jelly(expected, resolution=(2, 2, 2))
    shapes.wheel(expected, (0.0, 0.0, 0.0), 1.0)
    shapes.pile(expected, (1, 2, 3), 0.1)
    assert same(load(tmp_path, text), expected)


def test_arrays_beside_the_file(tmp_path):
    (tmp_path / "data").mkdir()
    np.savez(tmp_path / "data" / "b.npz", left_position=[[0.0, 0.0], [1.0, 0.0]], left_radius=[0.1, 0.2], right_mass=1)
    np.savez(tmp_path / "springs.npz", pairs=[[0, 1]])
    text = """format = 1
[[balls]]
file = "data/b.npz"
prefix = "left_"
mass = 3.0
[[springs]]
file = "springs.npz"
stiffness = 1.0
"""
    scene = load(tmp_path, text)
    assert scene.position.tolist() == [[0, 0], [1, 0]]
    assert scene.radius.tolist() == [0.1, 0.2]
    assert scene.mass.tolist() == [3, 3]
    assert scene.pairs.tolist() == [[0, 1]]


def rich_scene(dim: int) -> Scene:
    rng = np.random.default_rng(1)
    scene = Scene(dim=dim, gravity=[0.1, -9.81, 0.3][:dim])
    scene.settings = {"dt": 1e-3, "spin": False, "integrator": "rk4"}
    scene.output = {"fps": 24.0, "size": (320, 240)}
    scene.add_material("default", restitution=0.1)
    scene.add_material("ice", friction=0.01, viscous_friction=0.2, colour=(0.5, 0.75, 1.0))
    for _ in range(20):
        scene.add_wall(rng.normal(size=dim), rng.normal(), "ice")
    scene.add_balls(
        rng.normal(size=(300, dim)),
        radius=rng.uniform(0.1, 1, 300),
        mass=rng.uniform(0.1, 1, 300),
        velocity=rng.normal(size=(300, dim)),
        pinned=rng.random(300) < 0.9,
        material="ice",
    )
    scene.add_balls(rng.normal(size=(3, dim)), radius=0.1, colour=(0.1, 0.2, 0.3), pinned=True)
    scene.add_balls([0.0] * dim, radius=0.1, velocity=[1.0] * dim)
    scene.add_springs([[0, 1], [2, 3]], stiffness=[1.0, 2.0], collides=[True, False], rest_length=0.7)
    shapes.jelly(scene, pinned=[0])
    for side in (3, 4):
        shapes.jelly(scene, resolution=(side,) * dim, poisson_ratio=0.45)  # in 2D its cells act together
    shapes.rope(scene, [0.0] * dim, [1.0] * dim, 5, EI=1e-3, pinned=[0, 1])
    if dim == 3:
        shapes.cloth(scene, resolution=(3, 3), surface_collision=True)
    return scene


@pytest.mark.parametrize("dim", [2, 3])
def test_round_trip_is_identical(tmp_path, dim):
    scene = rich_scene(dim)
    scene.save(tmp_path / "a.toml")
    again = load_scene(tmp_path / "a.toml")
    assert same(scene, again)
    assert again.new_body() > scene.body.max()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.toml", "a_arrays.npz"]
    again.save(tmp_path / "b.toml")
    assert same(load_scene(tmp_path / "b.toml"), scene)


def test_a_small_scene_needs_no_array_file(tmp_path):
    load(tmp_path, GOOD).save(tmp_path / "again.toml")
    assert same(load_scene(tmp_path / "again.toml"), load_scene(tmp_path / "scene.toml"))
    assert not (tmp_path / "again_arrays.npz").exists()


def test_saving_where_there_is_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        load(tmp_path, GOOD).save(tmp_path / "none" / "a.toml")


def test_a_scene_that_could_not_be_read_again_is_not_written(tmp_path):
    scene = Scene(dim=2)
    scene.add_wall((0, 1), 0.0)
    with pytest.raises(SceneError, match=r"^balls: holds no ball; a scene file needs at least one$"):
        scene.save(tmp_path / "a.toml")
    assert not list(tmp_path.iterdir())


# (what to replace in GOOD, by what, line, the rest of the message)
BAD = [
    ("format = 1\n", "", None, "format: is missing"),
    ("format = 1", "format = 2", 1, "format: 2 is not allowed; it must be 1"),
    ("dim = 2", "dim = 4", 2, "dim: 4 is not allowed; it must be 2 or 3"),
    ("[0.0, -10.0]", "[0.0, -1e300]", 3, "gravity[1]: -1e+300 is not allowed; it must be at most 1e+50 in magnitude"),
    ("[0.0, -10.0]", "[0.0, nan]", 3, "gravity[1]: nan is not allowed; it must be a finite number"),
    ("[0.0, -10.0]", "[0.0, 1.0, 2.0]", 3, "gravity: shape"),
    ("dt = 0.001", "dt = 0", 5, "simulation.dt: 0 is not allowed; it must be greater than 0 or 'auto'"),
    ("dt = 0.001", "dt = -0.1", 5, "simulation.dt: -0.1"),
    ("dt = 0.001", "dt = nan", 5, "simulation.dt: nan is not allowed; it must be a finite number"),
    ("dt = 0.001", "dt = 'fast'", 5, "simulation.dt: 'fast' is not allowed; it must be a number or 'auto'"),
    ("dt = 0.001", "step = 1", 5, "simulation.step: is not a known key"),
    ("dt = 0.001", "contact_passes = 4", 5, "simulation.contact_passes: is now called 'contact_iterations'"),
    ("dt = 0.001", "threads = 0", 5, "simulation.threads: 0"),
    ("dt = 0.001", "arch = 'gpu'", 5, "simulation.arch: 'gpu' is not allowed; it must be 'auto', 'cpu', 'cuda'"),
    ("dt = 0.001", "precision = 'f16'", 5, "simulation.precision: 'f16' is not allowed; it must be 'f32' or 'f64'"),
    (
        '"verlet"',
        '"verlot"',
        6,
        "simulation.integrator: 'verlot' is not allowed; it must be 'auto', 'explicit_euler', ",
    ),
    ("restitution = 0.5", "restitution = 2", 9, "materials[0].restitution: 2.0 is not allowed; it must be from 0 to 1"),
    ("restitution = 0.5", "restitution = '1'", 9, "materials[0].restitution: '1' is not allowed; it must be a number"),
    ("restitution = 0.5", "bounce = 1", 9, "materials[0].bounce: is not a known key"),
    ("[1.0, 1.0]", "[1.0, inf]", 14, "balls[0].position[1][1]: inf is not allowed"),
    ("[1.0, 1.0]", "[1.0]", 12, "balls[0].position: its lists differ in length"),
    ("[1.0, 1.0]", "[1.0, 'x']", 12, "balls[0].position: "),
    ("mass = 1.0", "mas = 1.0", 16, "balls[0].mas: is not a known key; did you mean 'mass'?"),
    ("mass = 1.0", "mass = -1.0", 16, "balls[0].mass: -1.0 is not allowed; it must be greater than 0"),
    ("mass = 1.0", "mass = [1.0, 0.0]", 16, "balls[0].mass[1]: 0.0 is not allowed; it must be greater than 0"),
    ("mass = 1.0", "mass = '1'", 16, "balls[0].mass: '1' is not a number"),
    ("mass = 1.0", "mass = true", 16, "balls[0].mass: True is not a number"),
    ("radius = 0.05", "radius = 0.0", 17, "balls[0].radius: 0.0 is not allowed; it must be greater than 0"),
    ("mass = 1.0", "collides_with = 1", 16, "balls[0].collides_with: 1 is not allowed; it must be a text or a list"),
    ("mass = 1.0", "collides_with = [1]", 16, "[1] is not allowed; it must be a text or a list, each a text"),
    ("radius = 0.05\n", "", 10, "balls[0].radius: is missing"),
    ("pinned = [0]", "pinned = [2]", 18, "balls[0].pinned[0]: 2 is not allowed; it must name a ball, from 0 to 1"),
    ('material = "rubber"', 'material = "stell"', 19, "balls[0].material: 'stell' is not a material"),
    (
        "[[springs]]",
        "[[balls]]\nname = 'pair'\nposition = [[0, 0]]\nradius = 1\n[[springs]]",
        21,
        "name: 'pair' is the name of balls[0] already",
    ),
    (
        'balls = "pair"',
        'balls = "pear"',
        21,
        "springs[0].balls: 'pear' is not a name in this file; did you mean 'pair'?",
    ),
    ("[[0, 1]]", "[\n[0, 1],\n[0, 7],\n]", 24, "springs[0].pairs[1]: [0, 7] is not allowed; it must name a ball"),
    ("[[0, 1]]", "[[0, 1], [1, 1]]", 22, "springs[0].pairs[1]: [1, 1] joins a ball to itself"),
    ("[[0, 1]]", "[[0, 0.5]]", 22, "springs[0].pairs: "),
    ("stiffness = 100.0", "stiffness = -1", 23, "springs[0].stiffness: -1"),
    ("stiffness = 100.0", "file = 'none.npz'", 23, "springs[0].file: "),
    ("normal = [0.0, 1.0]", "normal = [0.0, 0.0]", 25, "walls[0].normal: [0.0, 0.0] is not allowed"),
    ("normal = [0.0, 1.0]", "normal = [nan, 0.0]", 25, "walls[0].normal[0]: nan is not allowed"),
    ("normal = [0.0, 1.0]", "", 24, "walls[0].normal: is missing"),
    ("[[walls]]", "[[wals]]", 24, "wals: is not a known key; did you mean 'walls'?"),
    ("[[walls]]", "[[skins]]", 24, "skins: is now called 'embedded_surfaces'"),
    ("[[walls]]", "[[colliders]]", 25, "colliders[0].normal: is not a known key"),
    ("[[walls]]", "[walls]", 24, "walls: is written as one table; there may be several of them: write [[walls]]"),
    ("fps = 30", "fps = -30", 27, "output.fps: -30 is not allowed; it must be greater than 0"),
    ("[640, 360]", "[640, 7.5]", 28, "output.size[1]: 7.5 is not allowed; it must be a whole number"),
    ("[640, 360]", "[640, 0]", 28, "output.size[1]: 0 is not allowed"),
    ("[output]", "[[cloth]]\n[output]", 26, "cloth[0]: a cloth needs a scene with dim = 3"),
    (
        "[output]",
        "[[rope]]\nstart = [0, 0]\nend = [1, 1]\nstifness = 1\n[output]",
        29,
        "rope[0].stifness: is not a known",
    ),
    ("[output]", "[[rope]]\nstart = [0, nan]\nend = [1, 1]\n[output]", 27, "rope[0].start[1]: nan is not allowed"),
    ("[output]", "[[rope]]\nstart = [0, 0]\nend = [1, 1]\npinned = [40]\n[output]", 29, "rope[0].pinned[0]: 40"),
    ("dim = 2", "dim = = 2", None, "is not valid TOML: "),
]


@pytest.mark.parametrize(("old", "new", "line", "message"), BAD, ids=[f"{b[1]!r}" for b in BAD])
def test_bad(tmp_path, old, new, line, message):
    assert old in GOOD
    with pytest.raises(SceneError) as caught:
        load(tmp_path, GOOD.replace(old, new, 1))
    text = str(caught.value)
    start = f"{tmp_path / 'scene.toml'}" + (f", line {line}" if line else "") + ": "
    assert text.startswith(start)
    assert message in text
    assert "\n" not in text or "TOML" in text


EMPTY = ["format = 1", "format = 1\ndim = 3\n[output]\nfps = 1\n", "format = 1\n[[walls]]\nnormal = [0, 1]\n"]


def test_a_name_given_twice_is_refused_with_both_tables(tmp_path):
    """Tables are read in a fixed order, whatever that of the file, so that the first in the file may be the second read."""
    rope = '[[rope]]\nname = "pair"\nstart = [0, 0]\nend = [1, 0]\n'
    head, rest = GOOD.split("[[materials]]")
    for text, line in ((GOOD + rope, 30), (f"{head}{rope}[[materials]]{rest}", 8)):
        (tmp_path / "twice.toml").write_text(text)
        says = rf"twice\.toml, line {line}: rope\[0\]\.name: 'pair' is the name of balls\[0\] already"
        with pytest.raises(SceneError, match=says):
            load_scene(tmp_path / "twice.toml")


@pytest.mark.parametrize("text", EMPTY)
def test_a_file_without_balls_is_refused(tmp_path, text):
    with pytest.raises(SceneError, match="holds no ball"):
        load(tmp_path, text)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no such scene file"):
        load_scene(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match="is not a text in UTF-8"):
        load_scene(tmp_path / "bytes.toml")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('file = "no.npz"\nradius = 1', "is not there"),
        ('file = "words.npz"\nradius = 1', "cannot be read as .npz"),
        ('file = "a.npz"\nprefix = "x_"\nradius = 1', "holds no array whose name begins with 'x_'"),
        ('file = "a.npz"', "stands in the table and in|is missing"),
        ('file = "a.npz"\nposition = [[0, 0]]\nradius = 1', "position: stands in the table and in 'a.npz'"),
        ('file = "b.npz"\nradius = 1', "holds the array 'positon'; did you mean 'position'"),
        ('file = "nan.npz"\nradius = 1', r"balls\[0\]\.position\[0\]\[1\]: nan"),
    ],
)
def test_bad_array_files(tmp_path, table, message):
    np.savez(tmp_path / "a.npz", position=[[0.0, 0.0]])
    np.savez(tmp_path / "b.npz", positon=[[0.0, 0.0]])
    np.savez(tmp_path / "nan.npz", position=[[0.0, np.nan]])
    (tmp_path / "words.npz").write_text("not an archive")
    with pytest.raises(SceneError, match=message):
        load(tmp_path, f"format = 1\n[[balls]]\n{table}\n")


def test_bad_meshes(tmp_path):
    (tmp_path / "points.obj").write_text("v 0 0 0\n")
    for mesh, message in (("points.obj", "has no faces"), ("none.obj", "is not there"), ("a.stp", "must be a file")):
        with pytest.raises(SceneError, match=rf"line 4: cloth\[0\]\.mesh: .*{message}"):
            load(tmp_path, f'format = 1\ndim = 3\n[[cloth]]\nmesh = "{mesh}"\n')


def test_words_are_those_of_the_simulation():
    from taichi_sim.contacts import CONTACT_RULES
    from taichi_sim.device import backend
    from taichi_sim.files.toml_settings import Simulation
    from taichi_sim.integrators import BUILT_IN
    from taichi_sim.simulation.settings import DEFAULTS, WORDS

    fields = Simulation.model_fields
    assert set(fields) == set(DEFAULTS)
    words = {
        name: set(field.annotation.__args__) for name, field in fields.items() if hasattr(field.annotation, "__args__")
    }
    assert words["arch"] == set(backend.ARCHES)
    assert words["precision"] == set(backend.PRECISIONS)
    assert words["integrator"] == {"auto", *(kind.method.name for kind in BUILT_IN)}
    assert words["contacts"] == {"auto", *CONTACT_RULES}
    for name, allowed in WORDS.items():
        assert words[name] == set(allowed)


def test_lines():
    text = 'a = 1\n[t]\n"b" = [1,\n  2, # two\n  [3, 4]]\n[[u]]\nx = 1\n[[u]]\nx = 2\n'
    found = [("a",), ("t", "b"), ("t", "b", 1), ("t", "b", 2, 0), ("u", 1, "x"), ("u", 0), ("u", 1, "none"), ("none",)]
    assert [line_of(text, path) for path in found] == [1, 3, 4, 5, 9, 6, 8, None]
    assert key_name(("springs", 3, "pairs", 12)) == "springs[3].pairs[12]"


def test_a_saved_scene_moves_with_its_texture(tmp_path):
    from PIL import Image

    (home := tmp_path / "home" / "art").mkdir(parents=True)
    Image.new("RGB", (4, 4)).save(home / "face.png")
    cloth = '[[cloth]]\nname = "flag"\nresolution = [3, 3]\n[[output.looks]]\nof = "flag"\ntexture = "art/face.png"\n'
    (tmp_path / "home" / "scene.toml").write_text(f"format = 1\ndim = 3\n{cloth}")
    scene = load_scene(tmp_path / "home" / "scene.toml")
    scene.save(tmp_path / "home" / "again.toml")
    assert 'texture = "art/face.png"' in (tmp_path / "home" / "again.toml").read_text()
    (tmp_path / "home").rename(tmp_path / "moved")
    look = load_scene(tmp_path / "moved" / "again.toml").output["looks"][0]
    assert Path(look["texture"]) == (tmp_path / "moved" / "art" / "face.png").resolve()
    (tmp_path / "other").mkdir()
    scene.save(tmp_path / "other" / "scene.toml")
    assert str(home.resolve()) in (tmp_path / "other" / "scene.toml").read_text()
