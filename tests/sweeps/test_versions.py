"""A cluster whose worker has another version of this package, in a process of its own: nothing is run there."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sweep_scenes import heap

import taichi_sim as ts
from taichi_sim.common.version import __version__

pytestmark = [pytest.mark.slow, pytest.mark.once]

LONGEST = 120.0  # s; machines that test are busy


def other_version(folder):
    """The package under `folder`, linked file by file but for its version."""
    here = Path(ts.__file__).parent
    package = folder / "taichi_sim"
    (package / "common").mkdir(parents=True)
    for entry in [*here.iterdir(), *(here / "common").iterdir()]:
        if entry.name not in ("common", "version.py", "__pycache__"):
            (package / entry.relative_to(here)).symlink_to(entry)
    for name in ("kernels", "demos"):  # which lie beside the package
        if not (package / name).exists():
            (package / name).symlink_to(here.parent / name)
    (package / "common" / "version.py").write_text('__version__ = "0.0.7"\n')


def test_a_worker_of_another_version_is_refused(tmp_path):
    distributed = pytest.importorskip("distributed")
    other_version(tmp_path / "other")
    with distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster:
        command = [
            sys.executable,
            "-m",
            "dask",
            "worker",
            cluster.scheduler_address,
            "--nthreads",
            "1",
            "--no-dashboard",
        ]
        worker = subprocess.Popen(
            [*command, "--no-nanny"], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(tmp_path / "other")},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            limit = time.monotonic() + LONGEST
            while not cluster.scheduler.workers and time.monotonic() < limit:
                time.sleep(0.1)
            with pytest.raises(ts.SceneError) as refused:
                ts.sweep(heap, folder=tmp_path / "s", scheduler=cluster.scheduler_address)
        finally:
            worker.terminate()
            worker.wait()
    says = str(refused.value)
    assert f"has other versions: taichi_sim 0.0.7 there, {__version__} here" in says
    assert "\n" not in says
    assert not (tmp_path / "s").exists()
