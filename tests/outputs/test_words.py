"""Arguments of `ts.video` that other programs call otherwise."""

import time

import pytest

import taichi_sim as ts
from taichi_sim.common import progress
from taichi_sim.common.errors import SceneError
from taichi_sim.outputs import quick

pytestmark = pytest.mark.once


@pytest.mark.parametrize(
    ("word", "meant"), [("framerate", "fps"), ("seconds", "duration"), ("timestep", "dt"), ("sise", "size")]
)
def test_a_word_that_is_no_argument_is_refused_with_what_was_meant(tmp_path, word, meant):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0]], radius=0.1)
    with pytest.raises(SceneError, match=f"^{word}: is not an argument of video; did you mean '{meant}'"):
        ts.video(scene, tmp_path / "x.mp4", **{word: 30})
    assert not list(tmp_path.iterdir())


def test_a_video_says_that_the_simulation_is_prepared(tmp_path, monkeypatch, capsys):
    """As it settles, say, before the first frame."""
    said = []

    def prepared():
        while not said and time.monotonic() < until:
            time.sleep(0.01)
            said.extend(line for line in capsys.readouterr().err.splitlines() if "preparing the simulation" in line)
        raise SceneError("enough", says="is enough")

    monkeypatch.setattr(progress, "EVERY", 0.02)
    monkeypatch.setattr(quick, "_simulation", lambda what, _: (what, prepared))
    until = time.monotonic() + 10.0
    with pytest.raises(SceneError, match="enough"):
        ts.video(ts.Scene(dim=2), tmp_path / "x.mp4")
    assert said


@pytest.mark.parametrize("of_scene", [True, False])
def test_a_video_takes_what_a_picture_takes(tmp_path, monkeypatch, of_scene):
    seen = []
    monkeypatch.setattr(quick, "export", lambda *_, style, **__: seen.append(style) or quick.Summary())
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0]], radius=0.1)
    scene.output = {"stage": "studio"}
    view = {"centre": (0.5, 0.0), "height": 3.0}
    with ts.Simulation(scene, contacts="off") as sim:
        ts.video(scene if of_scene else sim, tmp_path / "x.npz", style={"shadow": False}, camera=view, subdivide=1)
    assert seen == [{"stage": "studio", "shadow": False, "camera": view, "subdivide": 1}]


@pytest.mark.parametrize(("given", "shown"), [({}, True), ({"progress": False}, False)])
def test_a_video_shows_its_progress_unless_told_not_to(tmp_path, monkeypatch, given, shown):
    seen = []
    monkeypatch.setattr(quick, "export", lambda *_, progress, **__: seen.append(progress) or quick.Summary())
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0]], radius=0.1)
    with ts.Simulation(scene, contacts="off") as sim:
        ts.video(sim, tmp_path / "x.npz", duration=0.1, **given)
    assert seen == [shown]
