"""Errors are data: what was wrong can be asked, and the message is made of it."""

import pickle

import pytest

import taichi_sim as ts
from taichi_sim.cli.command import echo
from taichi_sim.common.errors import about, path_of, unknown_key
from taichi_sim.files.parameters import put

pytestmark = pytest.mark.once


def test_the_message_is_made_of_the_data():
    error = ts.SceneError("springs[3].pairs[12]", [0, 7], "two balls")
    assert error.path == ("springs", 3, "pairs", 12) == path_of(error.path)
    assert (error.value, error.allowed, error.file, error.line) == ([0, 7], "two balls", None, None)
    assert str(error) == "springs[3].pairs[12]: [0, 7] is not allowed; it must be two balls"
    error.file, error.line = "a.toml", 4
    assert str(error) == "a.toml, line 4: springs[3].pairs[12]: [0, 7] is not allowed; it must be two balls"
    error.value = ((0, 7), (1, 2))  # a file has lists alone
    assert "springs[3].pairs[12]: [[0, 7], [1, 2]] is not" in str(error)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert str(ts.SceneError("balls.mass", "x", says="is not a number")) == "balls.mass: 'x' is not a number"
    assert str(ts.SceneError("wind", says="there is one already")) == "wind: there is one already"
    assert str(ts.SceneError("nothing moves")) == "nothing moves"


def test_an_error_speaks_of_the_arguments_of_a_shape():
    with pytest.raises(ts.SceneError) as caught, about("cloth"):
        ts.Scene().add_balls([0.0, 0.0], radius=-1.0)
    assert (caught.value.path, caught.value.value) == (("cloth", "radius"), -1.0)


def test_a_scene_file_adds_where(tmp_path):
    (tmp_path / "a.toml").write_text("format = 1\n[[balls]]\nposition = [[0, 0]]\nradius = [-1.0]\n")
    with pytest.raises(ts.SceneError) as caught:
        ts.load_scene(tmp_path / "a.toml")
    error = caught.value
    assert (error.path, error.line, error.value) == (("balls", 0, "radius", 0), 4, -1.0)
    assert error.file == tmp_path / "a.toml"
    assert error.allowed == "greater than 0"


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("skins", "is now called 'embedded_surfaces'"),
        ("embeded_surfaces", "is not a known key; did you mean 'embedded_surfaces'?"),
        ("x", "is not a known key; there are embedded_surfaces, walls"),
    ],
)
def test_unknown_keys(key, says):
    assert str(unknown_key(key, ["embedded_surfaces", "walls"])) == f"{key}: {says}"


@pytest.mark.parametrize(("known", "meant"), [(("size", "meshes"), "meshes"), (("size", "radius"), "size")])
def test_words_of_other_programs_mean_what_there_is(known, meant):
    assert str(unknown_key("resolution", known)).endswith(f"did you mean '{meant}'?")


@pytest.mark.parametrize(
    "error",
    [
        ts.SceneError("walls[2]" + ".ab" * 20_000, says="is not in this scene"),
        ts.SceneError("walls[2]", says=f"is given twice; give {'ab.' * 20_000} once"),
        unknown_key("walls[2].qq", [f"name{k}" for k in range(5000)]),
        "walls[2]: 'ab cd " + "ef gh " * 10_000 + "' is not allowed",
        "walls[2]: " + "ab" * 20_000 + ": is not allowed",
    ],
)
def test_no_message_is_longer_than_anybody_reads(error, capsys):
    """Whatever was given: it is cut off, and what the sentence says of it is kept."""
    echo(f"taichi-sim: {error}", err=True)
    said = capsys.readouterr().err
    assert said.startswith("taichi-sim: walls[2]")
    assert len(said) < 1200
    end = said.strip().rpartition("...")[2] if "..." in said else said.strip()
    assert end in (": is not in this scene", " once", " is not allowed", ": is not allowed") or end.endswith(
        "and 4950 more"
    )


def test_the_name_of_a_file_is_whole_in_a_message(capsys):
    path = "/".join(["folder" * 10] * 15)
    echo(f"{path}: there is no such file", err=True)
    assert path in capsys.readouterr().err


HUGE = "0x7" + "b" * 4000  # Python writes no such number in decimal digits


@pytest.mark.parametrize("line", ["[[balls]]\nradius = {}\nposition = [[0, 0]]", "[[balls]]\nradius = 1\nposition = [[0, {}]]",
    "dim = {}", "gravity = {}", "[[walls]]\nnormal = [0, {}]", "[simulation]\ndt = {}", "[simulation]\nsubsteps = {}",
    "[output]\nfps = {}", "[output]\nstyle = {{ depth = {} }}", "wind = {{ x = {} }}", "format = {}", "[output]\noverlay = {}",
    "[[rope]]\nstart = {}", "balls = {}", "[materials]\nrubber = {}", "[output.camera]\nfollow = {}"])  # fmt: skip
def test_a_number_of_too_many_digits_is_cut_off(tmp_path, line):
    text = line.format(HUGE)
    file = tmp_path / "a.toml"
    file.write_text(text if text.startswith("format") else f"format = 1\n{text}\n")
    with pytest.raises(ts.SceneError) as caught:
        ts.load_scene(file)
    assert len(str(caught.value).replace(str(file), "")) < 400
    assert "digits" not in str(caught.value)


def test_values_that_hold_such_a_number_are_cut_off_too():
    for value in (int(HUGE, 16), -int(HUGE, 16), [1, [int(HUGE, 16)]], {"a": int(HUGE, 16)}):
        assert len(str(ts.SceneError("mass", value, "less"))) < 120
    with pytest.raises(ts.SceneError, match=r"gravity is 0x7bb.*, which has no parts"):
        put({"gravity": int(HUGE, 16)}, "gravity[0]", 1.0)
