"""The benchmark of a device: counts of launches, its file, what it refuses, and the checks before it."""

import json
import os
import subprocess
import sys

import known_launches
import numpy as np
import pytest

from taichi_sim.benchmark import checks, copy_limit, launch_counts, main
from taichi_sim.benchmark.contest import Report, peer
from taichi_sim.benchmark.launches import Row, launch_report
from taichi_sim.common.errors import BackendError
from taichi_sim.device import backend
from taichi_sim.device.devices import find
from taichi_sim.device.engine import ENGINE

EXPECTED = {  # launches, of these on one thread, waits
    "nothing": [0, 0, 0],
    "launched": [3, 1, 0],
    "synced": [3, 1, 1],
    "returned": [4, 2, 1],
    "filled": [1, 0, 1],
    "fetched": [4, 1, 1],
    "element": [4, 2, 1],
}


def counted(arch):
    done = subprocess.run(
        [sys.executable, known_launches.__file__, arch],
        env=os.environ | launch_counts.PROFILED,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.once
def test_launches_and_waits_of_known_kernels():
    assert counted("cpu") == EXPECTED


@pytest.mark.gpu
def test_launches_and_waits_of_known_kernels_on_the_device(request):
    assert counted(request.config.getoption("--arch")) == EXPECTED


@pytest.mark.once
def test_counting_needs_the_profiler():
    with pytest.raises(
        BackendError, match="launches: the profiler is off; start the process with TI_KERNEL_PROFILER=1"
    ):
        launch_counts.count(lambda: None)


@pytest.mark.once
def test_the_counts_are_of_one_substep():
    row = Row.of("a", 4, launch_counts.Counts(launches=10, one_thread=4, waits=1), 100.0)
    assert (row.launches, row.one_thread, row.waits, row.bytes_a_ball) == (2.5, 1.0, 0.25, 100.0)


@pytest.mark.long
@pytest.mark.once
def test_launches_of_all_scenes(capsys):
    report = launch_report(True)
    report.show()
    shown = capsys.readouterr().out
    for row in report.counts:
        assert row.scene in shown
        assert 0 < row.one_thread < row.launches
    pile, cloth, surfaces, implicit, trapezoidal = report.counts
    assert cloth.launches < pile.launches < surfaces.launches
    assert pile.waits < 1 < implicit.waits < trapezoidal.waits  # stages ask the host whether they are solved


@pytest.mark.once
def test_the_file_holds_numbers(tmp_path, monkeypatch, capsys):
    report = Report("a title", "ball-step", least_bytes=8e6, limit=16e9)
    report.rows = [("ours", [2e-3, 1e-3, 4e-3], 1e6), ("theirs", [4e-3], 1e6)]
    report.goals, report.notes = {"ours": "< 4 ms"}, ["a note"]
    monkeypatch.setitem(main.CASES, "small", lambda quick: report)
    monkeypatch.setattr(main, "bandwidth", lambda arch, quick: 5e9)
    file = tmp_path / "out.json"
    assert main.main(["small"], file=str(file))
    found = json.loads(file.read_text())
    assert found["device"]["arch"] == "cpu"
    assert found["versions"][ENGINE]
    assert found["copy_bytes_per_second"] == 5e9
    assert (found["format"], found["quick"], found["checks"]) == (1, False, None)
    (table,) = found["tables"]
    assert (table["case"], table["title"], table["notes"]) == ("small", "a title", ["a note"])
    ours, theirs = table["rows"]
    assert ours == {
        "name": "ours",
        "seconds": [2e-3, 1e-3, 4e-3],
        "units": 1e6,
        "goal": "< 4 ms",
        "units_per_second": pytest.approx(5e8),
        "bytes_per_second": pytest.approx(4e9),
        "part_of_limit": pytest.approx(0.25),
    }
    assert theirs["goal"] is None
    shown = capsys.readouterr().out
    assert "25 %" in shown
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]


@pytest.mark.slow
@pytest.mark.once
def test_a_case_that_fails_loses_no_other(tmp_path, monkeypatch, capsys):
    def broken(quick):
        raise BackendError("no memory")

    monkeypatch.setitem(main.CASES, "pile", broken)
    monkeypatch.setitem(main.CASES, "small", lambda quick: Report("nothing"))
    file = tmp_path / "out.json"
    assert not main.main(["pile", "small"], file=str(file))
    assert "pile: not measured. BackendError: no memory" in capsys.readouterr().out
    tables = json.loads(file.read_text())["tables"]
    assert [table.get("error") for table in tables] == ["BackendError: no memory", None]


def test_a_run_that_is_ended_leaves_no_file(tmp_path, monkeypatch):
    def ended(quick):
        raise KeyboardInterrupt

    monkeypatch.setitem(main.CASES, "small", ended)
    with pytest.raises(KeyboardInterrupt):
        main.main(["small"], file=str(tmp_path / "out.json"))
    assert not list(tmp_path.iterdir())


@pytest.mark.once
def test_a_mistyped_device_is_one_line(tmp_path):
    command = [sys.executable, "-m", "taichi_sim", "bench", "--arch", "abacus", "--json", "out.json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    says = "--arch: 'abacus' is not allowed; it must be one of auto, cpu, cuda, vulkan, metal"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"taichi-sim: {says}\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.once
def test_what_cannot_work_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setitem(main.CASES, "small", lambda quick: pytest.fail("it ran"))
    with pytest.raises(FileNotFoundError, match=r"nowhere/out.json: there is no folder '.*nowhere'; make it first"):
        main.main(["small"], file=str(tmp_path / "nowhere" / "out.json"))
    with pytest.raises(ValueError, match="--checks: tests a device; give --arch cuda, metal or vulkan"):
        main.main(["small"], checks=True)


@pytest.mark.once
def test_a_case_of_the_cpu_is_refused_on_a_device():
    with pytest.raises(ValueError, match="'pile' runs on the CPU only; on cuda there are copy, springs"):
        main._chosen(["pile"], "cuda")
    assert set(main.ON_DEVICE) <= set(main.CASES)


@pytest.mark.once
def test_the_cuda_kernel_says_what_is_lacking(monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", None)  # as if it were not installed
    monkeypatch.delitem(sys.modules, "taichi_sim.benchmark.peers.cloth_cuda", raising=False)
    report = Report("springs")
    report.enter("CUDA written by hand", peer("cloth_cuda.ClothCuda", None, None), 1, 1)
    assert not report.entries
    assert report.notes == ["CUDA written by hand: not measured. CuPy is not installed (pip install cupy-cuda12x)"]


@pytest.mark.once
def test_results_of_the_tests_are_counted(tmp_path, monkeypatch):
    (tmp_path / "conftest.py").write_text(
        "def pytest_addoption(parser): parser.addoption('--arch')\n"
        "def pytest_configure(config): config.addinivalue_line('markers', 'gpu: x')\n"
    )
    (tmp_path / "test_it.py").write_text(
        "import os, pytest\npytestmark = pytest.mark.gpu\n"
        "def test_good(): assert os.environ['TAICHI_SIM_PRECISION'] == 'f32'\n"
        "def test_bad(): assert False\n"
        "def test_left_out(): pytest.skip()\n"
    )
    monkeypatch.setattr(checks, "ROOT", tmp_path)
    found = checks.run_tests("vulkan")
    assert (found.tests, found.failed, found.skipped, found.exit_status) == (3, 1, 1, 1)
    assert found.failures == ["test_it::test_bad"]
    monkeypatch.setattr(checks, "examine", lambda arch: "sums are wrong")
    whole = checks.check_device("vulkan", True)
    assert whole.tests is None  # the folder has no tests of devices
    assert not whole.passed
    assert whole.lines() == ["self-test: sums are wrong", "tests of devices: none here; they come with the source"]


@pytest.mark.once
def test_a_copy_copies_all_and_its_best_time_is_the_limit(monkeypatch):
    backend.start("cpu", "f32")
    copy = copy_limit.Copy(4 * 1000)
    copy.source.from_numpy(np.arange(1000, dtype=np.float32))
    copy.step(1)
    np.testing.assert_array_equal(copy.target.to_numpy(), np.arange(1000))
    copy.close()
    monkeypatch.setattr(copy_limit, "copy_seconds", lambda arch, quick: (0.5, 0.25, 1.0))
    assert copy_limit.bandwidth("cpu", True) == 2 * copy_limit.SMALL / 0.25  # read and written


@pytest.mark.gpu
def test_a_table_with_the_limit_of_the_device(request, tmp_path):
    arch = request.config.getoption("--arch")
    file = tmp_path / "out.json"
    assert main.main(["springs"], quick=True, arch=arch, file=str(file))
    found = json.loads(file.read_text())
    assert found["device"]["name"] == find(arch).name
    row = found["tables"][0]["rows"][0]
    assert row["part_of_limit"] == pytest.approx(row["bytes_per_second"] / found["copy_bytes_per_second"])
