"""Words of the command line, as they are read: each that is not allowed is named."""

import pytest

from taichi_sim.cli.options import keys_and_values
from taichi_sim.common.errors import SceneError

pytestmark = pytest.mark.once


def test_keys_and_values_are_as_in_a_scene_file():
    texts = ["camera.azimuth=2", "colour=speed", "camera.orbit=1.5", "background=[1, 0, 0]", "shadow=false"]
    wanted = {"camera": {"azimuth": 2, "orbit": 1.5}, "colour": "speed", "background": [1, 0, 0], "shadow": False}
    assert keys_and_values("--style", texts) == wanted


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        (
            ["camera=1", "camera.azimuth=2"],
            r"'camera\.azimuth=2' is within camera, which another --style gives a value",
        ),
        (["camera.azimuth=2", "camera=1"], "'camera=1' is given twice; give camera once"),
        (["colour=speed", "colour=strain"], "'colour=strain' is given twice"),
        ([f"colour={'[' * 5000}"], "more than 16 deep"),
        ([f"colour={'[' * 300}{']' * 300}"], "more than 16 deep"),
        ([f"a{'.b' * 300}=1"], "more than 16 deep"),
        (["camera"], "KEY=VALUE"),
        (["camera.=1"], "KEY=VALUE"),
    ],
)
def test_what_is_refused(texts, why):
    with pytest.raises(SceneError, match=rf"^--style: .*{why}"):
        keys_and_values("--style", texts)
