"""The JSON Schema of scene files: an independent validator takes every demo and refuses what the reader refuses; docs/scenes.md
has a row for every key."""

import copy
import json
import random
import re
import subprocess
import sys
import warnings

import pytest
from jsonschema import Draft202012Validator
from scene_keys import PAGE, page
from typer.testing import CliRunner

import taichi_sim as ts
from taichi_sim.analysis.methods import BUILT_IN_RULES
from taichi_sim.cli.main import main
from taichi_sim.contacts import CONTACT_RULES
from taichi_sim.files.json_schema import scene_schema
from taichi_sim.files.source import checked_output, demos, open_scene
from taichi_sim.files.toml_document import tomllib
from taichi_sim.files.toml_schema import ALIASES
from taichi_sim.files.toml_settings import Simulation

pytestmark = pytest.mark.once

SCHEMA = scene_schema()
VALIDATOR = Draft202012Validator(SCHEMA)


def problems(document):
    return [f"{error.json_path}: {error.message}" for error in VALIDATOR.iter_errors(document)]


def test_it_is_a_schema_and_the_command_prints_it():
    Draft202012Validator.check_schema(SCHEMA)
    shown = CliRunner().invoke(main, ["schema"])
    assert shown.exit_code == 0
    assert json.loads(shown.stdout) == json.loads(json.dumps(SCHEMA))


NAMED_TYPES = """
import json, typing
import numpy as np, numpy.typing
from typing_extensions import Buffer, TypeAliasType
T = typing.TypeVar("T", bound=np.generic)
numpy.typing.ArrayLike = TypeAliasType("ArrayLike", Buffer | typing.Sequence[float])
numpy.typing.NDArray = TypeAliasType("NDArray", np.ndarray[typing.Any, np.dtype[T]], type_params=(T,))
from taichi_sim.files.json_schema import scene_schema
print(json.dumps(scene_schema()))
"""


def test_it_is_the_same_where_types_of_arrays_have_names():
    """As NumPy's have from 2.5 on, which only Python 3.12 and later take: no function of pydantic's knows these types."""
    run = subprocess.run([sys.executable, "-c", NAMED_TYPES], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr[-1000:]
    assert json.loads(run.stdout.splitlines()[-1]) == json.loads(json.dumps(SCHEMA))


@pytest.mark.parametrize("name", demos())
def test_it_takes_every_demo(name, tmp_path):
    """Those in Python as TOML."""
    file = demos()[name]
    if file.suffix == ".toml":
        assert problems(tomllib.loads(file.read_text())) == []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the cow of the stairs is no clean mesh
        scene = open_scene(file)
    if scene is None:
        pytest.skip("makes a simulation of its own")
    scene.save(tmp_path / "scene.toml")
    assert problems(tomllib.loads((tmp_path / "scene.toml").read_text())) == []


# Mutations ----------------------------------------------------------------------------------------------------------

FULL = """
format = 1
dim = 3
gravity = [0.0, -10.0, 0.0]
[simulation]
dt = 0.001
integrator = "verlet"
substeps = 2
[output]
fps = 30
size = [320, 180]
colour = "strain"
[output.camera]
azimuth = 30.0
[[materials]]
name = "rubber"
friction = 0.5
[[balls]]
name = "loose"
position = [[0.0, 5.0, 0.0], [1.0, 5.0, 0.0]]
radius = 0.1
material = "rubber"
[[cloth]]
name = "flag"
size = [1.0, 1.0]
resolution = [5, 5]
stiffness = 100.0
pinned = [0, 4]
position = [0.0, 2.0, 0.0]
[[rope]]
start = [3.0, 2.0, 0.0]
end = [4.0, 2.0, 0.0]
n = 8
[[pile]]
resolution = [2, 2, 2]
radius = 0.05
position = [0.0, 8.0, 0.0]
[[springs]]
balls = "loose"
pairs = [[0, 1]]
stiffness = 10.0
[wind]
velocity = [1.0, 0.0, 0.0]
[[walls]]
normal = [0.0, 1.0, 0.0]
[[colliders]]
shape = "sphere"
center = [9.0, 0.0, 0.0]
radius = 0.5
[[colliders]]
shape = "box"
center = [20.0, 0.0, 0.0]
size = [1.0, 1.0, 1.0]
path = [{ time = 0.0 }, { time = 1.0, rotation = [0.0, 90.0, 0.0] }]
[[probes]]
name = "tip"
kind = "position"
balls = "flag"
members = [24]
"""
WRONG = {float: "much", int: "much", str: 7, bool: "yes", list: "many", dict: 7}


def places(value, path=()):
    """Where something stands in a document: keys of tables, and items of lists of tables."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield (*path, key)
            yield from places(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from places(item, (*path, index)) if isinstance(item, dict) else ()


def at(document, path):
    for part in path:
        document = document[part]
    return document


def mutations():
    """Documents that are wrong, each with what was done to it: wrong types, unknown, missing and misspelled keys, wrong words."""
    document = tomllib.loads(FULL)
    for path in places(document):
        table, key, changed = path[:-1], path[-1], copy.deepcopy(document)
        at(changed, table)[key] = WRONG[type(at(document, path))]
        yield f"{path} of another type", changed
        changed = copy.deepcopy(document)
        at(changed, table)[f"{key}_"] = at(changed, table).pop(key)
        yield f"{path} misspelled", changed
    for path in (
        *(("format",), ("materials", 0, "name"), ("balls", 0, "radius"), ("rope", 0, "end"), ("pile", 0, "radius")),
        *(("springs", 0, "pairs"), ("wind", "velocity"), ("walls", 0, "normal"), ("probes", 0, "kind")),
        *(("colliders", 0, "shape"), ("colliders", 1, "size"), ("colliders", 1, "path", 0, "time")),
    ):
        changed = copy.deepcopy(document)
        del at(changed, path[:-1])[path[-1]]
        yield f"{path} missing", changed
    for path, value in (
        *((("format",), 2), (("dim",), 4), (("simulation", "integrator"), "euler"), (("simulation", "dt"), 0.0)),
        *((("simulation", "substeps"), 0), (("output", "fps"), -1.0), (("output", "size"), [320, 180, 3])),
        *((("output", "size"), [320, 9]), (("output", "colour"), "red"), (("colliders", 0, "shape"), "cone")),
        *((("colliders", 0, "center"), [1.0, 2.0, 3.0, 4.0]), (("colliders", 0, "size"), [1.0, 1.0, 1.0])),
        *((("cloth", 0, "position"), [0.0]), (("colliders", 1, "path", 1, "when"), 1.0)),
    ):
        changed = copy.deepcopy(document)
        at(changed, path[:-1])[path[-1]] = value
        yield f"{path} = {value}", changed


def test_it_refuses_what_the_reader_refuses(tmp_path):
    import tomlkit

    assert problems(tomllib.loads(FULL)) == []
    (tmp_path / "full.toml").write_text(FULL)
    ts.load_scene(tmp_path / "full.toml")
    wrong = list(mutations())
    taken = [what for what, document in wrong if not problems(document)]
    assert taken == []
    assert len(wrong) > 100
    for what, document in random.Random(1).sample(wrong, 50):
        (tmp_path / "wrong.toml").write_text(tomlkit.dumps(document))
        try:
            ts.load_scene(tmp_path / "wrong.toml")
        except ts.SceneError:
            continue
        pytest.fail(f"the reader takes {what}")


# Words --------------------------------------------------------------------------------------------------------------


def keys(schema=SCHEMA, path=""):
    """Every key of every table: where it is, its name and its schema."""
    for key, one in schema.get("properties", {}).items():
        yield path, key, one
        yield from keys(one, f"{path}.{key}")
    for name, table in schema.get("$defs", {}).items():
        yield from keys(table, name)
    for kind in (*schema.get("anyOf", ()), schema.get("items", {})):
        if kind:
            yield from keys(kind, path)


def holds(one, kind):
    parts = [*one.get("anyOf", ()), *([one["items"]] if "items" in one else [])]
    return one.get("type") == kind or any(holds(part, kind) for part in parts)


COUNTED = {  # lists of whole numbers that may come as arrays, whose type says no more than "numbers"
    *("pairs", "corners", "triangles", "covers", "balls", "springs", "members", "together", "body", "wall", "collider"),
    *("spring", "pinned", "collides", "one", "other"),
}  # fmt: skip


def test_every_key_is_described_and_quantities_have_units():
    found = list(keys())
    assert len(found) > 250
    assert [f"{where}.{key}" for where, key, one in found if not one.get("description")] == []
    assert [name for name, table in SCHEMA["properties"].items() if "\n" in table["description"]] == []
    quantities = [(where, key, one) for where, key, one in found if holds(one, "number") and key not in COUNTED]
    assert [f"{where}.{key}" for where, key, one in quantities if "x-unit" not in one] == []


def test_the_page_has_a_row_for_every_key():
    text = PAGE.read_text()
    assert page(text) == text, "run `make docs`"
    rows = set(re.findall(r"^\| `(\w+)` \| ([^|]*?) \|", text, re.MULTILINE))
    tables = set(SCHEMA["properties"]) - {"format", "dim", "gravity"}  # these have headings
    found = [(where, key, one.get("x-unit", "")) for where, key, one in keys() if key not in ALIASES]
    assert [one for one in found if one[1:] not in rows and not (one[0] == "" and one[1] in tables)] == []
    assert all(re.search(rf"^### \[+{name}\]", text, re.MULTILINE) for name in tables)


@pytest.mark.parametrize(("dim", "output", "says"), [
    (3, "fps = 50\nshutter = 0.03", r"line 7: output\.shutter: 0\.03 is not allowed; it must be at most 1 / fps, 0\.02 s"),
    (3, "aperture = 2e3", r"line 6: output\.aperture: 2000\.0 is not allowed; it must be less than or equal to 1000"),
    (2, "aperture = 0.1", r"line 6: output\.aperture: 0\.1 is for scenes in 3D; in 2D all is as far away"),
    (3, "looks = [{object = 'flag', texture = 'a.png'}]", r"line 6: output\.looks\[0\]\.object: is not a key of a look; there"),
    (3, "looks = [{texture = 'a.png'}]", r"line 6: output\.looks\[0\]\.of: is missing; give the name of a shape or of a"),
    (3, "looks = [{of = 'b', gloss = 1}]", r"line 6: output\.looks\[0\]\.of: 'b' has no surface; a look is for cloth, jelly"),
    (2, "looks = [{of = 'b', gloss = 1}]", r"line 6: output\.looks\[0\]: is for 3D; in 2D give `colour`"),
])  # fmt: skip
def test_what_pictures_cannot_have_is_refused_where_it_stands(tmp_path, dim, output, says):
    place = [[0.0] * dim]
    file = tmp_path / "a.toml"
    file.write_text(
        f"format = 1\ndim = {dim}\nballs = [{{name = 'b', position = {place}, radius = 0.1}}]\n\n[output]\n{output}\n"
    )
    with pytest.raises(ts.SceneError, match=says):
        ts.load_scene(file)


def test_color_is_colour(tmp_path):
    file = tmp_path / "a.toml"
    text = "format = 1\n[[balls]]\nposition = [0, 0]\nradius = 0.1\n"
    file.write_text(f"{text}color = [1.0, 0.0, 0.0]\n[output]\ncolor = 'strain'\ncolor_range = [0.0, 0.5]\n")
    scene = ts.load_scene(file)
    assert scene.colour.tolist() == [[1, 0, 0]]
    assert scene.output == {"colour": "strain", "colour_range": (0.0, 0.5)}
    assert problems(tomllib.loads(file.read_text())) == []
    file.write_text(f"{text}color = [1.0, 0.0, 7.0]\n")
    with pytest.raises(ts.SceneError, match=r"line 5: balls\[0\]\.color\[2\]: 7\.0 is not allowed"):
        ts.load_scene(file)
    file.write_text(f"{text}color = [1.0, 0.0, 0.0]\ncolour = [1.0, 0.0, 0.0]\n")
    with pytest.raises(
        ts.SceneError, match=r"line 5: balls\[0\]\.color: is another spelling of 'colour', which is given"
    ):
        ts.load_scene(file)
    scene = ts.Scene()
    scene.output = {"color": "red"}
    with pytest.raises(ts.SceneError, match="did you mean 'colour'"):
        checked_output(scene)


@pytest.mark.parametrize(
    ("output", "message"),
    [
        ({"background": [1, 1]}, r"background: \[1, 1\] is not allowed; it must be a list of 3$"),
        ({"background": [1]}, r"background: \[1\] is not allowed; it must be a list of 3$"),
        ({"background": [1, 1, 1, 1]}, r"background: .* it must be a list of 3 at most$"),
        ({"size": [640]}, r"size: \[640\] is not allowed; it must be a list of 2$"),
    ],
)
def test_lists_of_an_output_have_their_length(output, message):
    scene = ts.Scene()
    scene.output = output
    with pytest.raises(ts.SceneError, match=rf"^scene\.output\.{message}"):
        checked_output(scene)


def test_an_output_that_lies_deep_is_refused():
    scene, inner = ts.Scene(), []
    for _ in range(5000):
        inner = [inner]
    scene.output = {"camera": {"eye": inner}}
    with pytest.raises(ts.SceneError, match=r"^scene\.output: has lists or tables within each other, too deep"):
        checked_output(scene)


def test_contact_rules_have_one_list_of_names():
    assert sorted(BUILT_IN_RULES) == sorted(CONTACT_RULES)
    assert Simulation.model_json_schema()["properties"]["contacts"]["enum"] == ["auto", *BUILT_IN_RULES]
