"""Looks of a scene in Python: judged wherever it is saved or exported, in the words for scene files."""

import re

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim import shapes
from taichi_sim.files.source import checked_output
from taichi_sim.scene.looks import Look, Subjects

pytestmark = pytest.mark.once


def sheet_and_pole(label: str = "pole") -> ts.Scene:
    """A sheet, two balls that are called `grains`, and a collider."""
    scene = ts.Scene(dim=3)
    scene.set_name(shapes.cloth(scene, size=(1, 1), resolution=(3, 3)).balls, "sail")
    scene.set_name(scene.add_balls([[0.0, 2, 0], [0, 3, 0]], radius=0.1), "grains")
    scene.add_collider(ts.Sphere(center=(0, -2.0, 0), radius=0.5, name=label))
    return scene


def test_a_collider_may_have_a_look_whatever_balls_have_its_name(tmp_path):
    scene = sheet_and_pole("grains")
    scene.output = {"looks": [{"of": "grains", "opacity": 0.5}]}
    scene.save(tmp_path / "a.toml")
    again = ts.load_scene(tmp_path / "a.toml").output["looks"]
    assert Look.listed(again, Subjects.of_scene(scene))[0].opacity == 0.5


WRONG = [
    ([{"of": "sial"}], r"looks\[0\]\.of: 'sial' is not allowed; it must be the name of a shape or of a collider: pole, sail"),
    ([{"of": "pole"}, {"of": "grains"}], r"looks\[1\]\.of: 'grains' has no surface"),
    ([{"of": np.array(["pole", "sail"])}], r"looks\[0\]\.of: \['pole', 'sail'\] is not allowed"),
    ([{"of": "sail", "pattern": np.array(["checks", "weave"])}], r"looks\[0\]\.pattern: \['checks', 'weave'\] is not allowed"),
    ([{"of": None, "gloss": 0.5}], r"looks\[0\]\.of: is missing"),
    ([{"of": "pole", "golss": 1}], r"looks\[0\]\.golss: is not a key of a look; did you mean .gloss."),
    ({"of": "sail"}, "looks: .* is not allowed"),
    ([0.5], r"looks\[0\]: 0\.5 is not allowed; it must be a table"),
    (7, "looks: 7 is not allowed"),
]  # fmt: skip


@pytest.mark.parametrize(("looks", "says"), WRONG)
def test_a_wrong_look_is_refused_wherever_the_scene_goes(tmp_path, looks, says):
    scene = sheet_and_pole()
    with pytest.raises(ts.SceneError, match="^" + says):
        Look.listed(looks, Subjects.of_scene(scene))
    scene.output = {"looks": looks}
    for act in (
        lambda: checked_output(scene),
        lambda: scene.save(tmp_path / "a.toml"),
        lambda: ts.video(scene, tmp_path / "a.csv", progress=False),
        lambda: ts.picture(scene),
    ):
        with pytest.raises(ts.SceneError, match=r"^scene\.output\." + says):
            act()
    assert not list(tmp_path.iterdir())


def test_wrong_looks_in_2d_and_in_a_style_are_refused(tmp_path):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [1.0, 0.3]], radius=0.2)
    refused = pytest.raises(ts.SceneError, match=r"^(scene\.output\.)?looks\[0\]: is for 3D")
    with ts.Simulation(scene, contacts="off", arch="cpu") as sim, refused:
        ts.export(sim, ts.open_output(tmp_path / "a.csv"), duration=0.1, style={"looks": [{"of": "disc"}]})
    scene.output = {"looks": [{"of": "disc"}]}
    with ts.Simulation(scene, contacts="off", arch="cpu") as sim, refused:
        sim.save(tmp_path / "state.npz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("given", [None, [], [{"of": "pole", "opacity": None, "hem": None}]])
def test_keys_that_are_none_are_left_out(given):
    looks = Look.listed(given, Subjects.of_scene(sheet_and_pole()))
    assert [one.opacity for one in looks] == [1.0] * len(given or ())


def test_a_picture_names_looks_that_are_no_list(tmp_path):
    scene = sheet_and_pole()
    with pytest.raises(ts.SceneError, match=re.escape("looks: 7 is not allowed; it must be a list of tables")):
        ts.picture(scene, looks=7)
