"""Arguments of `ts.video` that other programs call otherwise."""

import pytest

import taichi_sim as ts
from taichi_sim.common.errors import SceneError

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
