"""`taichi-sim verify`: right where all is right, and exit status 1 where one scene is off."""

import json
from importlib import resources

import numpy as np
import pytest
from typer.testing import CliRunner

from taichi_sim.cli.main import main
from taichi_sim.common.errors import UnstableError
from taichi_sim.device.engine import ENGINE, VERSION
from taichi_sim.reports import verify

pytestmark = pytest.mark.once

STORED = json.loads(resources.files("taichi_sim.reports").joinpath(verify.STORED).read_text(encoding="utf-8"))


def stored(case):
    wanted = STORED[case.name]
    return np.array(wanted["position"]), wanted["energy"], wanted["exchanged"]


def test_each_case_has_a_stored_result():
    assert list(STORED) == [case.name for case in verify.CASES]
    for case in verify.CASES:
        x = stored(case)[0]
        assert x.shape == case.scene().position.shape
        assert np.abs(x - case.scene().position).max() > 0.01  # it moves


@pytest.mark.slow_where(case=list(verify.CASES[1:]))
@pytest.mark.parametrize("case", verify.CASES, ids=lambda case: case.name)
@pytest.mark.long_where(case=list(verify.CASES[3:]))
def test_this_installation_computes_what_is_stored(case, monkeypatch):
    monkeypatch.setattr(verify, "CASES", (case,))
    (result,) = verify.results("cpu")
    assert result.passed
    assert result.deviation < 0.1 * verify.TOLERANCE


def test_the_last_line_says_that_all_passed(monkeypatch):
    monkeypatch.setattr(verify, "computed", lambda case, **_: stored(case))
    ended = CliRunner().invoke(main, ["verify", "--arch", "cpu"])
    assert ended.exit_code == 0
    assert ended.output.splitlines()[-1] == "all 7 passed"


@pytest.mark.parametrize("what", ["position", "energy", "nan", "unstable"])
def test_one_scene_that_is_off_is_named_and_ends_with_status_1(what, monkeypatch):
    def computed(case, **_):
        x, energy, exchanged = stored(case)
        if case.name.startswith("cloth"):
            if what == "unstable":
                raise UnstableError("ball 3 has left the world", 0.1, 3, None, None)
            x = x + {"position": 2e-5, "nan": np.nan}.get(what, 0.0)
            energy += exchanged * 2e-5 * (what == "energy")
        return x, energy, exchanged

    monkeypatch.setattr(verify, "computed", computed)
    ended = CliRunner().invoke(main, ["verify", "--arch", "cpu"])
    assert ended.exit_code == 1
    lines = ended.output.splitlines()
    assert next(line for line in lines if line.startswith("WRONG")).startswith("WRONG   cloth, implicit_euler: ")
    assert sum(line.startswith("passed") for line in lines) == len(verify.CASES) - 1
    assert ended.output.splitlines()[-1] == "taichi-sim: 1 of 7 failed: cloth, implicit_euler"
    assert ("off by 2.0e-05 of its size or energy, allowed 1e-05" in ended.output) == (what in ("position", "energy"))
    for part in ("taichi-sim 0", "f32", f"{ENGINE} {VERSION}", "NumPy", "Python", "allowed 1e-05"):
        assert part in ended.output


def test_what_only_a_cpu_runs_is_passed_over_on_a_device(monkeypatch):
    class Device:
        arch = "vulkan"

    monkeypatch.setattr(verify.backend, "start", lambda *_: Device)
    monkeypatch.setattr(verify, "computed", lambda case, **_: stored(case))
    passed_over = [result.name for result in verify.results("vulkan") if result.deviation is None and result.passed]
    assert passed_over == ["collisions, gauss_seidel", "jelly, xpbd, one spring at a time"]
