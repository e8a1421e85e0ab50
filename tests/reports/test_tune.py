"""`taichi-sim tune SCENE`: the cheapest settings, and what becomes of the scene file."""

import os
from types import SimpleNamespace

import numpy as np
import pytest
from speed_support import MadeUp, pair, plan

import taichi_sim as ts
from taichi_sim.analysis.element_rates import Declared
from taichi_sim.analysis.methods import VERLET
from taichi_sim.analysis.outcome import left_out
from taichi_sim.analysis.stability import stability
from taichi_sim.common.errors import SceneError
from taichi_sim.reports import check
from taichi_sim.reports.speed_error import command, report, tune
from taichi_sim.reports.speed_error.plan import METHODS
from taichi_sim.simulation.settings import Settings

pytestmark = pytest.mark.once

FILE = """# Two balls on a spring
format = 1   # the only one
dim = 2
[simulation]  # as it was
dt = 0.5      # s, far too long
contacts = "off"

[[balls]]
position = [[0.0, 0.0], [1.1, 0.0]]
radius = 0.05
[[springs]]
pairs = [[0, 1]]
stiffness = 100.0   # N/m
rest_length = 1.0
"""


def tuned(monkeypatch, tolerance, said, cost=None, grows=1.0, methods=("verlet", "symplectic_euler", "rk4"), **other):
    """What tune finds with made-up runs."""
    scene = pair()
    monkeypatch.setattr(tune, "TrialProcesses", lambda *_: MadeUp(scene, cost=cost, grows=grows))
    chosen = plan(methods=methods, tolerance=tolerance, **other)
    return tune.main(scene, chosen, progress=False, say=said.append)


def test_the_cheapest_that_meets_the_tolerance(monkeypatch):
    said = []
    dear = {("f64", "rk4"): 6e-3}  # for 4 passes
    assert tuned(monkeypatch, 0.05, said, cost=dear)["integrator"] == "verlet"
    assert tuned(monkeypatch, 1e-6, said)["integrator"] == "rk4"
    cheap = {("f32", "verlet"): 4e-4}
    assert tuned(monkeypatch, 0.05, said, cost=dear | cheap, precisions=("f64", "f32")) == {
        "integrator": "verlet",
        "dt": pytest.approx(0.00416, abs=1e-9),
        "precision": "f32",
    }
    assert 'integrator = "verlet"' in said[1]
    value, allowed = said[2].splitlines()[:2]
    assert value.startswith("value")
    assert allowed.startswith("allowed")  # two balls on a spring are no mesh


@pytest.mark.slow_where(damping=0.0)
@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_a_report_names_the_settings_that_tune_names(tmp_path, monkeypatch, damping):
    """From the same runs: the longest step that each method may take in the long run is among them, and none above it counts."""
    scene = pair()
    scene.set_springs(stiffness=3.0 * scene.stiffness, damping=damping)
    methods = ("verlet", "symplectic_euler", "rk4", "explicit_euler", "tr_bdf2")
    workers = MadeUp(scene, cost={("f64", "explicit_euler"): 1e-4, ("f64", "tr_bdf2"): 2e-2})
    for module in (tune, report):
        monkeypatch.setattr(module, "TrialProcesses", lambda *_: workers)
    for tolerance in (0.5, 0.1, 0.02, 2e-4):
        asked, said = plan(methods=methods, tolerance=tolerance, duration=0.55), []
        found = tune.main(scene, asked, progress=False, say=said.append)
        findings = report.main(scene, asked, tmp_path / "r", progress=False, say=lambda _: None)
        ((best, *_),) = (rows for one, rows in findings.fastest((0.5,)) if one == tolerance)
        assert tune.settings_of(scene, best) == found
        (cost,) = (line for line in said[2].splitlines() if line.startswith("cost"))
        assert f"{best.seconds:.3g} s of {best.clock}" in cost


def test_of_all_methods_the_cheapest_is_named_and_what_cannot_win_is_said(monkeypatch):
    said = []
    dear = {
        (precision, method): 5e-2 for precision in ("f64", "f32") for method in ("xpbd", "implicit_euler", "tr_bdf2")
    }
    cost = dear | {("f64", "symplectic_euler"): 2e-4}
    assert tuned(monkeypatch, 0.5, said, cost=cost, methods=METHODS)["integrator"] == "symplectic_euler"
    assert "not tried    explicit_euler: has no step that is safe in the long run" in said


def test_what_single_precision_makes_the_cheapest_is_found(monkeypatch):
    """It was 1.6 times as dear in double precision."""
    cost = {("f64", "symplectic_euler"): 1.6e-3, ("f32", "symplectic_euler"): 0.7e-3}
    both = {"methods": ("verlet", "symplectic_euler"), "precisions": ("f64", "f32"), "steps": (0.0025,)}
    found = tuned(monkeypatch, 0.5, [], cost=cost, **both)
    assert (found["integrator"], found["precision"]) == ("symplectic_euler", "f32")
    cost = {("f64", "tr_bdf2"): 2e-2, ("f32", "tr_bdf2"): 0.7e-3}  # it solves its equations to what rounding allows
    monkeypatch.setattr(tune, "_cannot_win", lambda *_: "")
    found = tuned(monkeypatch, 0.5, [], cost=cost, **both | {"methods": ("verlet", "tr_bdf2")})
    assert (found["integrator"], found["precision"]) == ("tr_bdf2", "f32")


def test_tune_names_the_mesh_that_its_error_leaves_out(monkeypatch):
    scene, rope, said = pair(), ts.Scene(dim=2), []
    ts.shapes.rope(rope, (0, 0), (1, 0), 5)
    monkeypatch.setattr(tune, "left_out", lambda _: left_out(rope))
    monkeypatch.setattr(tune, "TrialProcesses", lambda *_: MadeUp(scene))
    tune.main(scene, plan(methods=("verlet",), tolerance=0.05), progress=False, say=said.append)
    left = said[2].splitlines()[1]
    assert left == "             not included: the mesh"


def test_check_knows_what_an_undamped_spring_allows():
    """Its advice is about the step that dt = "auto" would take."""
    scene = pair()
    safe = 2 / np.sqrt(200.0)  # s, of small motion
    for part, words in (
        (0.9, f"an undamped spring: large motion can resonate above {0.4 * safe:.4g} s"),
        (0.35, f"verlet at {0.35 * safe:.4g} s is safe, however the scene deforms"),
        (1.5, f"above the bound of {safe:.4g} s may blow up; take {0.4 * safe:.4g} s"),
    ):
        settings = SimpleNamespace(integrator=SimpleNamespace(method=VERLET))
        setup = SimpleNamespace(rule="off")
        sim = SimpleNamespace(
            scene=scene, dt=part * safe, substeps=1, settings=settings, setup=setup, force_rates=Declared()
        )
        assert words in check._advice(sim, stability(scene, VERLET), 0.0)


def test_the_longest_safe_step_is_tried_first_and_an_unstable_one_is_not_the_last(monkeypatch):
    scene = pair()
    scene.set_springs(stiffness=scene.stiffness * 100.0)
    safe = 0.4 * 2 / np.sqrt(2e4)  # s, of an undamped spring
    workers = MadeUp(scene)
    run = workers.run

    def shakes(precision, trial):
        outcome = run(precision, trial)
        return outcome._replace(position=[], unstable="left") if trial.step.seconds > 0.8 * safe else outcome

    workers.run = shakes
    monkeypatch.setattr(tune, "TrialProcesses", lambda *_: workers)
    chosen = plan(methods=("verlet",), tolerance=0.05)
    settings = tune.main(scene, chosen, progress=False, say=lambda line: None)
    steps = [trial.step.seconds for _, trial in workers.trials if trial.timed]
    assert 0.9 * safe < steps[0] <= safe
    assert len(steps) == 2
    assert settings["dt"] == pytest.approx(steps[1], rel=0.01)


def test_nothing_meets_it(monkeypatch):
    said = []
    assert tuned(monkeypatch, 1e-2, said, most=1e-3) is None
    assert said[-1].startswith("no method and step within --limit 0.001 s keeps the error of positions below")


def test_what_cannot_be_tuned_says_why(monkeypatch):
    said = []
    with pytest.raises(SceneError, match="small differences grow too fast"):
        tuned(monkeypatch, 1e-2, said, grows=1e6)
    with pytest.raises(ValueError, match="f32 cannot meet --tolerance 1e-09"):
        tuned(monkeypatch, 1e-9, said, precisions=("f32",))
    assert tuned(monkeypatch, 1e-8, said, precisions=("f64", "f32"), most=100.0)["precision"] == "f64"


def test_the_file_keeps_all_else(tmp_path):
    file = tmp_path / "pair.toml"
    file.write_text(FILE)
    file.chmod(0o640)
    link = tmp_path / "link.toml"
    link.symlink_to(file)
    tune.write_settings(link, {"integrator": "rk4", "dt": 0.00125, "precision": "f64"})
    text = file.read_text()
    assert text.replace('integrator = "rk4"\n', "").replace('precision = "f64"\n', "") == FILE.replace(
        "dt = 0.5 ", "dt = 0.00125 "
    )
    assert link.is_symlink()
    assert os.stat(file).st_mode & 0o777 == 0o640
    assert ts.load_scene(file).settings == {"dt": 0.00125, "contacts": "off", "integrator": "rk4", "precision": "f64"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link.toml", "pair.toml"]


def test_a_file_without_settings_gets_them(tmp_path):
    file = tmp_path / "pair.toml"
    file.write_bytes(
        FILE.replace('[simulation]  # as it was\ndt = 0.5      # s, far too long\ncontacts = "off"\n', "").encode()
    )
    before = file.read_text()
    tune.write_settings(file, {"integrator": "rk4", "dt": 0.001})
    assert file.read_text().startswith(before.rstrip("\n"))
    assert ts.load_scene(file).settings == {"integrator": "rk4", "dt": 0.001}


def test_a_byte_order_mark_stays(tmp_path):
    """Some editors begin a file with one; the settings that were found after minutes were lost."""
    file = tmp_path / "marked.toml"
    file.write_bytes(b"\xef\xbb\xbf" + FILE.encode())
    tune.write_settings(file, {"integrator": "tr_bdf2", "dt": 0.0025})
    assert file.read_bytes().startswith(b"\xef\xbb\xbf")
    assert file.read_bytes().count(b"\xef\xbb\xbf") == 1
    assert ts.load_scene(file).settings == {"dt": 0.0025, "contacts": "off", "integrator": "tr_bdf2"}


def test_dt_takes_the_place_of_a_tolerance(tmp_path):
    file = tmp_path / "pair.toml"
    file.write_text(FILE.replace("dt = 0.5      # s, far too long", "tolerance = 1e-3  # was asked for"))
    tune.write_settings(file, {"integrator": "rk4", "dt": 0.001})
    scene = ts.load_scene(file)
    assert scene.settings == {"integrator": "rk4", "dt": 0.001, "contacts": "off"}
    assert Settings.resolve(scene, {}).dt == 0.001


def test_settings_that_do_not_go_together_leave_the_file(tmp_path):
    file = tmp_path / "pair.toml"
    file.write_text(FILE.replace("dt = 0.5 ", "tolerance = 1e-3 "))
    before = file.read_text()
    with pytest.raises(ValueError, match="tolerance: chooses the step, but substeps = 2"):
        tune.write_settings(file, {"substeps": 2})
    assert file.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["pair.toml"]


def test_dt_is_rounded_down_to_what_was_measured():
    from test_report import row

    for step in (0.0015625, 0.05, 1 / 3000):
        dt = tune.settings_of(pair(), row(1.0, 1e-3, step=step))["dt"]
        assert 0.99 * step < dt <= step


def test_demos_and_python_are_not_written(tmp_path):
    with pytest.raises(SceneError, match="box is a demo; copy"):
        command.require_own_file("box", command.resolve("box"))
    with pytest.raises(
        SceneError, match=r"cloth is a demo; copy .*cloth.py and set scene\.settings there to the lines"
    ):
        command.require_own_file("cloth", command.resolve("cloth"))
    (tmp_path / "s.py").write_text("")
    with pytest.raises(SceneError, match=r"is Python and stays as it is; set scene\.settings there to the lines"):
        command.require_own_file(str(tmp_path / "s.py"), tmp_path / "s.py")


@pytest.mark.slow
def test_the_settings_that_were_written_meet_the_tolerance(tmp_path, monkeypatch):
    """From the file to the file, with processes; the scene then runs as it is told."""
    file = tmp_path / "pair.toml"
    file.write_text(FILE)
    _, scene, chosen = command.read(
        str(file), methods="symplectic_euler", precision="f64", tolerance=2e-3, duration=0.4
    )
    found = tune.main(scene, chosen, progress=False, say=lambda line: None)
    tune.write_settings(file, found)
    from speed_support import length

    settings = {**ts.load_scene(file).settings, "precision": None}
    with ts.Simulation(ts.load_scene(file), **settings) as sim:
        sim.run(0.4)
        off = abs(sim.position[1, 0] - sim.position[0, 0] - length(sim.time)) / 2
    assert 1e-5 < off < 2 * 2e-3 * 1.2
