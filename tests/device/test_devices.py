"""Which devices are taken without being asked for: those that are no software and have passed the self-test once."""

import json
import subprocess
import sys

import pytest

import taichi_sim as ts
from taichi_sim.common import remembered
from taichi_sim.device import backend, devices
from taichi_sim.device.engine import ENGINE

pytestmark = pytest.mark.once

GPU = devices.Device("vulkan", "Some GPU", "Vulkan 1.3, driver 0x1", 8 << 30)


@pytest.fixture
def examined(monkeypatch, tmp_path):
    """The self-test is not run but counted, and its result is what the test says."""
    seen, result = [], {"says": ""}
    monkeypatch.setattr(remembered, "user_cache_path", lambda name: tmp_path / name)
    monkeypatch.setattr(devices, "examine", lambda arch: seen.append(arch) or result["says"])
    return seen, result, tmp_path / "taichi_sim" / "devices.json"


def test_the_self_test_runs_once_for_each_driver_and_version(examined):
    seen, _, record = examined
    assert [devices.verdict(GPU, "taichi 1.7.4") for _ in range(3)] == ["", "", ""]
    assert seen == ["vulkan"]
    devices.verdict(GPU._replace(driver="Vulkan 1.3, driver 0x2"), "taichi 1.7.4")
    devices.verdict(GPU, "taichi 1.7.5")
    devices.verdict(GPU, "taichi 1.7.5", again=True)
    assert len(seen) == 4
    assert len(json.loads(record.read_text())) == 3
    record.write_text("{")  # cut off
    assert devices.verdict(GPU, "taichi 1.7.4") == ""
    assert len(seen) == 5


def test_only_what_has_passed_is_taken(examined, monkeypatch):
    _, result, _ = examined
    monkeypatch.setattr(backend, "find", lambda arch: {"vulkan": GPU}.get(arch))
    assert backend._is_trusted("vulkan")
    assert not backend._is_trusted("cuda")
    result["says"] = "sums are wrong"
    monkeypatch.setattr(backend, "find", lambda arch: GPU._replace(name="Other GPU"))
    with pytest.warns(UserWarning, match=r"Other GPU \(vulkan\) is not used: sums are wrong"):
        assert not backend._is_trusted("vulkan")


def test_software_is_never_taken_unasked(examined, monkeypatch):
    seen, _, _ = examined
    monkeypatch.setattr(backend, "find", lambda arch: GPU._replace(software=True))
    assert not backend._is_trusted("vulkan")
    assert not seen


def test_a_self_test_that_ends_badly_is_told(monkeypatch):
    monkeypatch.setattr(devices, "SELF_TEST", "taichi_sim.no_such_module")
    assert devices.examine("cpu").startswith("the self-test ended with status 1: ")
    monkeypatch.setattr(devices, "SELF_TEST", "taichi_sim.reports.self_test")
    assert devices.examine("cpu") == ""


def test_the_self_test_takes_no_modules_from_the_working_folder(tmp_path, monkeypatch):
    """It may be that of a scene from elsewhere."""
    for name in ("runpy", "taichi_sim", "numpy", "taichi", "json"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'sprung')!r}, 'w')")
    monkeypatch.chdir(tmp_path)
    assert devices.examine("cpu") == ""
    assert not (tmp_path / "sprung").exists()


def test_every_machine_has_a_cpu():
    found = devices.find("cpu")
    assert (found.arch, found.software) == ("cpu", False)
    assert found.memory > 1 << 20


@pytest.mark.parametrize("arch", ["vulkan", "metal"])
def test_double_precision_is_refused_where_there_may_be_none(arch):
    with pytest.raises(
        ts.BackendError, match=f"precision: 'f64' was asked for, which {arch} devices may lack; use 'f32'"
    ):
        ts.Simulation(ts.Scene(), arch=arch, precision="f64")


@pytest.mark.parametrize("known", [True, False])
def test_what_runs_is_named_as_the_list_of_devices_names_it(monkeypatch, known):
    monkeypatch.setattr(backend, "find", lambda arch: GPU if known else None)
    monkeypatch.setattr(backend, "_works", lambda arch: True)
    monkeypatch.setattr(backend.ti, "init", lambda **_: None)
    name = "vulkan Some GPU (Vulkan 1.3, driver 0x1), f32, " if known else "vulkan, f32, "
    assert str(backend._init("vulkan", "f32", 2)).startswith(name)
    assert str(backend._init("cpu", "f32", 2)).startswith("cpu, 2 threads, f32, ")


NOTEBOOK = """
import io, sys, types
sys.modules["ipykernel"] = types.ModuleType("ipykernel")
sys.stdout = io.StringIO()  # as a notebook's
from taichi_sim.device.engine import ti
sys.__stdout__.write(sys.stdout.getvalue())
"""


@pytest.mark.once
@pytest.mark.skipif(ENGINE != "taichi", reason="only Taichi says so")
def test_nothing_is_said_in_a_notebook_of_what_shell_it_is():
    said = subprocess.run([sys.executable, "-c", NOTEBOOK], capture_output=True, text=True, check=True)
    assert "Graphical" not in said.stdout + said.stderr
