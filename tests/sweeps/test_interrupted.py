"""Ctrl-C, as a terminal sends it, to a sweep with two workers: rows are kept, processes end, the same command goes on."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from physics_support import PRECISION
from sweep_kills import rows_so_far, table, workers_of
from sweep_scenes import heap

from taichi_sim.common.signals import HUNG_UP, TERMINATED
from taichi_sim.sweeps.folder import SweepFolder
from taichi_sim.sweeps.points import Runner
from taichi_sim.sweeps.sweep import sweep

pytestmark = [pytest.mark.slow, pytest.mark.once]

SCENE = """format = 1
dim = 2
gravity = [0.0, -10.0]
[[pile]]
name = "heap"
resolution = [6, 6]
radius = 0.05
position = [0.0, 0.1]
[simulation]
contacts = "off"
[output]
duration = 2.0
"""
POINTS = 80
COMMAND = (
    "sweep", "heap.toml", "--vary", f"gravity[1]=-20:-1:{POINTS}", "--measure", "energy.kinetic.max",
    "--measure", "sweep_wait:wait", "-o", "swept",
)  # fmt: skip
WAIT = (
    "import time\n\ndef wait(simulation):\n    time.sleep(0.05)\n    return 0.0\n"  # so that there is time to interrupt
)
LONGEST = 120.0  # s; machines that test are busy


def start(folder, workers):
    """The command, in a group of its own, which is what a terminal sends Ctrl-C to."""
    return subprocess.Popen(
        [sys.executable, "-m", "taichi_sim", *COMMAND, "--workers", str(workers)], cwd=folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, env={**os.environ, "PYTHONPATH": str(folder)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # where these tests run in the background it is ignored
    )  # fmt: skip


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def until(true, process):
    """Wait for it, and say whether it came before the end of the process."""
    limit = time.monotonic() + LONGEST
    while time.monotonic() < limit and process.poll() is None:
        if true():
            return True
        time.sleep(0.02)
    return False


def interrupted(folder, moment):
    """Interrupt the command at a moment; the rows that were there then."""
    process, swept = start(folder, 2), folder / "swept"
    try:
        came = until(lambda: moment(process, swept), process)
        workers, rows = workers_of(process), rows_so_far(swept)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=LONGEST)
    finally:
        process.kill()
    assert came, said
    assert process.returncode == 130
    assert said.splitlines() == [
        "swept: keeps the points that are done; the same command goes on",
        "taichi-sim: interrupted",
    ]
    assert len(table(swept)) >= rows
    assert len(table(swept)) == rows_so_far(swept)
    limit = time.monotonic() + 10.0
    while any(map(is_alive, workers)) and time.monotonic() < limit:
        time.sleep(0.1)
    assert not any(map(is_alive, workers))
    return rows


@pytest.mark.long
def test_ctrl_c_at_any_moment(tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "heap.toml").write_text(SCENE)
    (tmp_path / "sweep_wait.py").write_text(WAIT)
    interrupted(tmp_path, lambda process, swept: (swept / "sweep.json").is_file())  # before workers are started
    interrupted(tmp_path, lambda process, swept: len(workers_of(process)) > 0)  # while they are
    interrupted(tmp_path, lambda process, swept: len(workers_of(process)) == 2)
    before = rows_so_far(tmp_path / "swept")  # of batches that workers finished
    few = interrupted(tmp_path, lambda process, swept: rows_so_far(swept) > before)
    many = interrupted(tmp_path, lambda process, swept: rows_so_far(swept) > few + 30)
    assert 0 < few < many < POINTS
    process = start(tmp_path, 2)
    _, said = process.communicate(timeout=LONGEST)
    assert (process.returncode, said) == (0, "")
    found = table(tmp_path / "swept")
    assert len(found) == POINTS
    (tmp_path / "swept").rename(tmp_path / "by_two")
    process = start(tmp_path, 0)
    _, said = process.communicate(timeout=LONGEST)
    assert (process.returncode, said) == (0, "")
    assert table(tmp_path / "swept") == found


def test_ctrl_c_before_the_first_point(tmp_path, monkeypatch):
    """Once the folder says that it is this sweep's it has a table, too."""
    (tmp_path / "heap.toml").write_text(SCENE)
    compact, given = SweepFolder._compact, {"seeds": 2, "measure": "energy.kinetic.max", "workers": 0}

    def interrupt(folder):
        monkeypatch.setattr(SweepFolder, "_compact", compact)
        raise KeyboardInterrupt

    monkeypatch.setattr(SweepFolder, "_compact", interrupt)
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path / "heap.toml", folder=tmp_path / "swept", **given)
    assert table(tmp_path / "swept") == []
    assert len(sweep(tmp_path / "heap.toml", folder=tmp_path / "swept", **given).rows) == 2
    assert len(table(tmp_path / "swept")) == 2


@pytest.mark.parametrize("status", [TERMINATED, HUNG_UP])
def test_a_signal_is_no_failed_point(tmp_path, monkeypatch, status):
    """SIGTERM and SIGHUP come as SystemExit, within whatever point runs then: it is run again."""
    came = []

    def measured(runner, scene):
        came.append(scene)
        if len(came) == 3:
            raise SystemExit(status)
        return {"m": 1.0}

    monkeypatch.setattr(Runner, "measured", measured)
    given = {
        "seeds": 5,
        "measure": "energy.kinetic.max",
        "workers": 0,
        "precision": PRECISION,
        "folder": tmp_path / "s",
    }
    with pytest.raises(SystemExit) as ended:
        sweep(heap, **given)
    assert ended.value.code == status
    assert [row["error"] for row in table(tmp_path / "s")] == ["", ""]
    assert [row.error for row in sweep(heap, **given).rows] == 5 * [""]
    assert len(came) == 6


def test_ctrl_c_before_another_sweep_is_gone_leaves_it(tmp_path, monkeypatch):
    (tmp_path / "heap.toml").write_text(SCENE)
    given = {"measure": "energy.kinetic.max", "workers": 0, "folder": tmp_path / "swept"}
    sweep(tmp_path / "heap.toml", seeds=2, **given)
    before = (tmp_path / "swept" / "table.csv").read_bytes()

    def interrupt(folder):
        raise KeyboardInterrupt

    monkeypatch.setattr(SweepFolder, "empty", interrupt)
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path / "heap.toml", seeds=3, duration=0.1, overwrite=True, **given)
    assert (tmp_path / "swept" / "table.csv").read_bytes() == before
