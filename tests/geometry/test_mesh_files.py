"""Mesh files from other programs: each is read as the body that it describes, or refused in one sentence."""

import os
import warnings
from pathlib import Path

import mesh_zoo
import numpy as np
import pytest

from taichi_sim import SceneError
from taichi_sim.geometry.mesh import holes, read_surface, surface_area, volume

pytestmark = pytest.mark.once

CASES = mesh_zoo.cases()


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_it_is_read_rightly_or_refused(tmp_path, case):
    for name, data in case.beside:
        (tmp_path / name).write_bytes(data)
    file = tmp_path / case.name
    file.write_bytes(case.data)
    if case.body is None:
        with pytest.raises(SceneError, match=case.says) as caught:
            read_surface(file)
        assert "\n" not in str(caught.value)
        assert case.name in str(caught.value)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        surface = read_surface(file)
    assert surface_area(surface) == pytest.approx(case.body.area, rel=1e-4)
    assert volume(surface) == pytest.approx(case.body.volume, rel=1e-4)
    assert not len(holes(surface.triangles))
    assert np.array([surface.vertices.min(axis=0), surface.vertices.max(axis=0)]) == pytest.approx(
        np.array(case.body.bounds), abs=1e-4
    )


def test_there_are_many():
    assert len(CASES) >= 150
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices")
@pytest.mark.parametrize("kind", ["pipe", "folder", "device"])
def test_what_is_no_file(tmp_path, kind):
    file = tmp_path / "a.obj"
    {"pipe": os.mkfifo, "folder": Path.mkdir, "device": lambda file: file.symlink_to("/dev/zero")}[kind](file)
    with pytest.raises(SceneError, match=f"is a {kind}, and no file"):
        read_surface(file)
