"""A second process compiles nothing that a first one has compiled, whatever either did before the engine was started."""

import os
import subprocess
import sys

import kept_scenes
import pytest
from physics_support import PRECISION
from trajectories import BY_NAME

from taichi_sim.device.engine import IS_KNOWN

pytestmark = [pytest.mark.once, pytest.mark.skipif(not IS_KNOWN, reason="Taichi's cache")]
FEW = ("crowd_gauss_seidel", "cloth_on_sphere", "motors_verlet")


def kept_by(folder, *names):
    """Kernels in a cache after a process that has run these scenes one after another, each on an engine started anew."""
    environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(folder), "TAICHI_SIM_PRECISION": PRECISION}
    subprocess.run([sys.executable, kept_scenes.__file__, *names], check=True, env=environment)
    return {file.name for file in folder.glob("*.tic")}


def found_again(folder, names):
    first = kept_by(folder, *names)
    assert len(first) > 3 * len(names)
    assert kept_by(folder, *reversed(names)) == first
    assert kept_by(folder, names[1]) == first  # the first of its process


@pytest.mark.slow
def test_a_second_process_compiles_nothing(tmp_path):
    found_again(tmp_path, FEW)


@pytest.mark.long
def test_a_second_process_compiles_nothing_of_scenes_of_all_kinds(tmp_path):
    found_again(tmp_path, tuple(BY_NAME))
