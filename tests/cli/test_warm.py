"""`taichi-sim warm`: what one process has compiled, no later one compiles again."""

import os
import re
import subprocess
import sys

import pytest

SCENES = {
    "balls": """
format = 1
dim = 2
gravity = [0, -10]
[[materials]]
name = "rubber"
restitution = 0.5
friction = 0.3
[[balls]]
position = [[0.0, 0.2], [0.05, 0.5]]
radius = 0.1
material = "rubber"
[[walls]]
normal = [0, 1]
material = "rubber"
""",
    "stiff": """
format = 1
dim = 3
gravity = [0, -10, 0]
[simulation]
integrator = "implicit_euler"
dt = 0.004
[[cloth]]
size = [0.5, 0.5]
resolution = [4, 4]
pinned = "left"
""",
    "chain": """
format = 1
dim = 2
gravity = [0, -10]
[[balls]]
position = [[0, 0], [0.1, 0], [0.2, 0]]
radius = 0.01
pinned = [0]
[[springs]]
pairs = [[0, 1], [1, 2]]
stiffness = 1000.0
damping = 20.0
""",
}


@pytest.fixture
def warm(tmp_path):
    """Runs the command on files, by name, with a cache that begins empty; returns what it prints."""
    for name, text in SCENES.items():
        (tmp_path / f"{name}.toml").write_text(text + "\n[output]\nsize = [64, 48]\n")

    def command(*names):
        files = [str(tmp_path / f"{name}.toml") for name in names]
        environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / "kernels")}
        arguments = [sys.executable, "-m", "taichi_sim", "warm", *files, "--arch", "cpu"]
        return subprocess.run(arguments, capture_output=True, text=True, env=environment, check=False)

    return command


@pytest.mark.once
@pytest.mark.long
def test_a_second_process_compiles_nothing_for_scenes_of_other_kinds(warm):
    first = warm(*SCENES).stdout
    assert len(re.findall(r"\.toml: compiled \d+ kernels, took", first)) == len(SCENES), first
    kept = re.search(r"; (\d+) kernels, \d+ MiB, are kept in", first)
    again = warm(*reversed(SCENES)).stdout
    assert again.count("compiled nothing") == len(SCENES), again
    assert f"; {kept[1]} kernels" in again


@pytest.mark.once
def test_a_scene_that_fails_is_said_with_status_2(warm, tmp_path):
    ended = warm("nowhere")
    assert ended.returncode == 2
    assert "nowhere.toml: there is no such file" in ended.stdout
    assert "1 of the scenes failed" in ended.stderr
