"""Scenes and scene files with a mistake in them."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.scene.document import document


def assert_refused(folder, text, old, new, words):
    """Loading the scene file, in which something that occurs is replaced, raises a SceneError with these words."""
    assert old in text
    file = folder / "scene.toml"
    file.write_text(text.replace(old, new))
    with pytest.raises(ts.SceneError, match=words):
        ts.load_scene(file)


def assert_unchanged(scene, change, words):
    """Changing the scene so raises a SceneError with these words and leaves all of it as it was."""
    values, arrays = document(scene)
    before = {name: array.copy() for name, array in arrays.items()}
    with pytest.raises(ts.SceneError, match=words):
        change(scene)
    now, after = document(scene)
    assert now == values
    assert after.keys() == before.keys()
    for name, array in before.items():
        np.testing.assert_array_equal(after[name], array, err_msg=name)
