"""Workers of one machine that need the same kernels: one compiles them, whatever becomes of another one."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from physics_support import PRECISION

from taichi_sim.device.engine import IS_KNOWN

pytestmark = [pytest.mark.once, pytest.mark.slow, pytest.mark.skipif(not IS_KNOWN, reason="Taichi's cache")]
ROOT = Path(__file__).parents[2]
COMPILED = "Cache kernel"  # in the engine's log


def worker(folder, *restitutions, **more):
    path = f"{ROOT / 'tests' / 'support'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    given = {"TI_OFFLINE_CACHE_FILE_PATH": str(folder), "TAICHI_SIM_PRECISION": PRECISION, "PYTHONPATH": path, **more}
    command = [sys.executable, "-m", "tests.support.sweep_worker", "job", str(folder), *map(str, restitutions)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(command, env={**os.environ, **given}, cwd=ROOT, **pipes)


def test_one_worker_compiles_and_where_it_is_killed_another_one(tmp_path):
    first = worker(tmp_path, 0.2, DIES="1")
    until = time.monotonic() + 60.0
    while not list(tmp_path.glob("once_*.lock")) and time.monotonic() < until:
        time.sleep(0.05)
    others = [worker(tmp_path, 0.3, 0.6), worker(tmp_path, 0.4)]
    said = [one.communicate(timeout=300)[0] for one in (first, *others)]
    assert first.returncode == -signal.SIGKILL
    assert all("energy.total" in text for text in said[1:])
    one, another = sorted(text.count(COMPILED) for text in said[1:])
    assert one == 0 < another
