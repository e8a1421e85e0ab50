"""Completion by the shell: the script that the command prints is one of bash, and completes commands, options and scenes."""

import os
import shutil
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.once, pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")]

ASKED = """
script=$(taichi-sim --show-completion bash) || exit 1
bash -n <<< "$script" || exit 1
eval "$script"
ask() { COMP_WORDS=("$@"); COMP_CWORD=$(( $# - 1 )); _taichi_sim_completion taichi-sim; echo "${COMPREPLY[*]}"; }
ask taichi-sim re
ask taichi-sim run --dur
ask taichi-sim view je
ask taichi-sim run sub/
"""


@pytest.mark.slow
def test_bash_completes_commands_options_and_scenes(tmp_path):
    (tmp_path / "sub").mkdir()
    for name in ("a.toml", "b.npz", "c.py"):
        (tmp_path / "sub" / name).touch()
    command = tmp_path / "taichi-sim"
    command.write_text(f"#!{sys.executable}\nfrom taichi_sim.__main__ import main\nmain()\n")
    command.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    environment["_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION"] = "1"  # the shell is named
    done = subprocess.run(
        ["bash", "-c", ASKED], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = [line.split() for line in done.stdout.splitlines()]
    assert found == [["render", "report"], ["--duration"], ["jelly"], ["sub/a.toml", "sub/c.py"]]
