"""Scene files with a mistake in them."""

import pytest

import taichi_sim as ts


def assert_refused(folder, text, old, new, words):
    """Loading the scene file, in which something that occurs is replaced, raises a SceneError with these words."""
    assert old in text
    file = folder / "scene.toml"
    file.write_text(text.replace(old, new))
    with pytest.raises(ts.SceneError, match=words):
        ts.load_scene(file)
