"""`report` and `tune` by a quantity that a probe names, and the error of the mesh."""

import re
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from physics_support import PRECISION
from speed_support import RATE, STIFFNESS, MadeUp, length, pair, plan

import taichi_sim as ts
from taichi_sim.common.errors import SceneError
from taichi_sim.reports.speed_error import budget, command, report, resolution, tune
from taichi_sim.reports.speed_error.compared import Compared
from taichi_sim.reports.speed_error.plan import FRAME, PARTS, fitting, limit
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.trial_process import Outcome, Track, Trial

pytestmark = pytest.mark.once

NONE = {"progress": False, "say": lambda line: None}


def loaded():
    scene = pair()
    scene.add_probe("load", "tension", spring=0)
    scene.add_probe("end", "position", balls=[1])
    scene.add_probe("heat", "energy")
    return scene


# What errors are relative to ---------------------------------------------------------------------------------------


def test_what_has_a_zero_counts_from_there_and_a_place_from_where_it_starts():
    scene = loaded()
    values = [np.array([k]) for k in (3.0, 5.0, -7.0)]
    outcome = Outcome("", [], [], [], quantity=values, begin=np.array([4.0]))
    for name, moved in (("load", [3.0, 5.0, 7.0]), ("end.x", [1.0, 1.0, 11.0]), ("heat.total", [2.0, 2.0, 2.0])):
        compared = Compared(scene, plan(quantity=name))
        assert compared.motion(outcome, 2.0).tolist() == moved
        assert compared.unit == {"load": "N", "end.x": "m", "heat.total": "J"}[name]
    vector = Compared(scene, plan(quantity="end"))
    one, other = (Outcome("", [], [], [], quantity=[np.array(x)]) for x in ([0.0, 0.0], [3.0, 4.0]))
    assert vector.errors(one, other)[0].tolist() == [5.0]
    moved = Outcome("", [scene.position + np.array([0.3, 0.4])], [], [])
    assert Compared(scene, plan()).motion(moved, 2.0).tolist() == [0.5]  # of positions: how far balls went


def test_a_report_is_of_the_quantity(tmp_path, monkeypatch):
    """Of which MadeUp knows the error: k (h w)^2, relative to k 0.1 max |sin|."""
    scene = loaded()
    monkeypatch.setattr(report, "TrialProcesses", lambda *_: MadeUp(scene))
    findings = report.main(scene, plan(quantity="load"), tmp_path / "r", **NONE)
    row = next(row for row in findings.rows if row.method == "verlet")
    largest = STIFFNESS * 0.1 * np.abs(np.sin(np.arange(1, PARTS + 1))).max()
    assert row.relative_error == pytest.approx(STIFFNESS * (row.step * RATE) ** 2 / largest, rel=1e-2)
    page = (tmp_path / "r" / "report.md").read_text()
    assert (
        "Errors are of load.tension, relative to the largest load.tension at 8 sample times up to 0.4 s, 9.89 N."
        in page
    )
    assert "rms error [N]" in page
    assert re.search(
        r"Largest load.tension at 8 sample times up to 0.4 s, with verlet at .* s, the scene's own settings in double precision:"
        r" [\d.]+ \+- [\d.]+ N \(step\)",
        page,
    )


@pytest.mark.parametrize(
    ("quantity", "tolerance", "message"),
    [
        ("lod", "1%", "--quantity: 'lod' is not a probe of this scene; did you mean 'load'?"),
        ("load", "100%", "--tolerance: 100% is not allowed; it is a part of the motion, below 1, or like 1%"),
        ("load", "1 percent", "--tolerance: '1 percent' is not allowed; it must be a number greater than 0"),
    ],
)
def test_wrong_options(tmp_path, quantity, tolerance, message):
    loaded().save(tmp_path / "s.toml")
    with pytest.raises(ValueError, match=re.escape(message)):
        command.read(str(tmp_path / "s.toml"), quantity=quantity, tolerance=tolerance)


@pytest.mark.slow
def test_tune_finds_the_tension_to_one_percent(tmp_path):
    """From the file to settings whose error against the closed solution is below 1 % of the largest tension."""
    loaded().save(tmp_path / "s.toml")
    file = str(tmp_path / "s.toml")
    _, scene, chosen = command.read(
        file, methods="verlet", precision="f64", quantity="load.tension", tolerance="1%", duration=0.4
    )
    said = []
    settings = tune.main(scene, chosen, progress=False, say=said.append)
    assert said[0].startswith("cheapest settings with an error of load.tension below 1.0 % in the first 0.4 s:")
    lines = "\n".join(said).splitlines()
    value = next(line for line in lines if line.startswith("value"))  # no peak, which lies between the times: 10.0 N
    assert re.match(r"value +largest load.tension at 8 sample times up to 0.4 s: 9\.5\d* \+- 0\.0\d+ N \(step\)", value)
    assert any(line.startswith("allowed      95.1 mN, 1.0 % of the value") for line in lines)
    assert "             not seen: errors between these times" in lines
    peak = next(line for line in lines if line.startswith("peak"))
    assert lines.index(peak) < lines.index(value)
    low, off = map(
        float,
        re.match(r"peak +([\d.]+) \+- ([\d.]+) N \(step\), at and between sample times", peak).groups(),
    )
    assert abs(low - 10.0) <= off < 0.1
    assert any(
        re.match(r"found +[\d.]+ mN, 0?[\d.]+ % of the value, the largest of 8 sample times", line) for line in lines
    )
    with ts.Simulation(scene, **{**settings, "precision": None}) as sim:
        off = []
        for _ in range(round(0.4 / sim.dt)):
            sim.step()
            off.append(sim.probe("load") - STIFFNESS * (length(sim.time) - 1.0))
    assert (
        1e-4 < np.abs(off).max() < 0.01 * STIFFNESS * 0.1 * 1.2
    )  # moments between those compared may be a little worse
    assert settings["integrator"] == "verlet"


@pytest.mark.parametrize(("passes", "tried"), [(0.2, {"verlet"}), (0.4, {"rk4", "verlet", "implicit_euler"})])
def test_methods_that_cannot_win_are_not_compiled(monkeypatch, passes, tried):
    """RK4 goes through the forces four times in a step 1.4 times as long; of two balls a pass costs less than a step. So it is
    left out where it makes more than three times the passes. passes: of each step, over the duration of 0.4 s."""
    scene = loaded()
    workers = MadeUp(scene)
    run = workers.run
    workers.run = lambda precision, trial: run(precision, trial)._replace(passes=passes / trial.step.seconds)
    monkeypatch.setattr(tune, "TrialProcesses", lambda *_: workers)
    chosen = plan(quantity="load", tolerance=0.2, methods=("rk4", "verlet", "implicit_euler"))
    assert tune.main(scene, chosen, **NONE)["integrator"] == "verlet"
    assert {trial.method for _, trial in workers.trials if trial.timed} == tried


# The error of the mesh ---------------------------------------------------------------------------------------------


def test_richardson():
    """Values a + b h^p at h, h/2, h/4: the error at h is b h^p."""
    for order in (1.0, 2.0):
        values = [5.0 + 0.3 * h**order for h in (1.0, 0.5, 0.25)]
        error, found, why = budget.mesh_error(np.abs(np.diff(values)).tolist(), "N")
        assert (error, found, why) == (pytest.approx(0.3), pytest.approx(order), "")
    error, order, why = budget.mesh_error([0.1, 0.2], "N")
    assert error is None
    assert order == pytest.approx(-1.0)
    assert "not known, at least 100 mN" in why
    assert why.endswith("100 mN and 200 mN")
    error, order, why = budget.mesh_error([1.3, 0.004], "m")  # by chance
    assert error is None
    assert order > 8.0
    assert "no mesh converges so fast" in why
    assert budget.mesh_error([0.1], "m")[0] == pytest.approx(0.2)  # of first order, with two meshes alone


SHEET = """format = 1
dim = 3
[[balls]]
name = "weight"
position = [[0.5, 0.2, 0.5]]
radius = 0.05
[[cloth]]
name = "sheet"
resolution = [3, 4]
mass_per_area = 0.2
pinned = [0, 1, 2, 3, 11]
[[springs]]
pairs = [[0, 5]]
stiffness = 1.0
[[attachments]]
one = "weight"
other = "sheet"
other_members = [7]
one_members = [0]
stiffness = 2.0
[[moving_pins]]
balls = "sheet"
members = [0, 1]
velocity = [1.0, 0.0, 0.0]
[[probes]]
name = "corner"
kind = "position"
at = [1.0, 0.0, 0.0]
[[probes]]
name = "load"
kind = "tension"
at = [0.5, 0.1, 0.75]
"""


def test_a_finer_mesh_has_the_balls_of_the_coarse_one(tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(SHEET)
    coarse, (half, quarter) = ts.load_scene(file), resolution.finer(file)
    for finer, balls in ((half, 5 * 7), (quarter, 9 * 13)):
        fine = finer.scene
        assert fine.n_balls == 1 + balls
        assert fine.position[finer.balls] == pytest.approx(coarse.position)
        assert fine.mass.sum() == pytest.approx(coarse.mass.sum())
        edge = fine.position[fine.pinned]
        assert np.count_nonzero(edge[:, 0] == 0.0) == len(np.unique(fine.position[1:, 2]))  # all of the edge, no gaps
        assert len(edge) == np.count_nonzero(edge[:, 0] == 0.0) + 1  # and the lone corner
        assert sorted(finer.balls[coarse.pairs[-2:].ravel()]) == sorted(fine.pairs[-2:].ravel())
        assert fine.probes[0].given["balls"].tolist() == [finer.balls[coarse.probes[0].given["balls"][0]]]
        assert fine.probes[1].given["spring"] == fine.n_springs - (coarse.n_springs - coarse.probes[1].given["spring"])
    assert len(half.scene.moving_pins[0].balls) == 3  # and the new one between two


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "mass_per_area = 0.2",
            "mass = 0.2",
            "cloth[0]: is another body at another resolution; give it mass_per_area or",
        ),
        ("at = [0.5, 0.1, 0.75]", "spring = 3", "probes[1]: the springs of a shape are others in a finer mesh"),
        ("[[springs]]\npairs = [[0, 5]]", "[[springs]]\nfile = 'x.npz'", "file: '"),
        ("[[springs]]", "[[triangles]]\ntriangles = [[0, 1, 2]]\n[[springs]]", "[[triangles]] names balls by hand"),
    ],
)
def test_what_cannot_be_refined(tmp_path, old, new, message):
    (tmp_path / "s.toml").write_text(SHEET.replace(old, new))
    with pytest.raises(SceneError, match=re.escape(message)):
        resolution.finer(tmp_path / "s.toml")


CABLE = """format = 1
dim = 2
gravity = [0.0, -9.0]
[[rope]]
name = "cable"
start = [0.0, 0.0]
end = [2.0, 0.0]
n = 5
EA = 400.0
mass = 1.2
pinned = [0, 4]
[[probes]]
name = "middle"
kind = "position"
at = [1.0, 0.0]
"""


def test_a_finer_rope_is_the_same_rope(tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(CABLE)
    coarse, (half, quarter) = ts.load_scene(file), resolution.finer(file)
    for finer, balls in ((half, 9), (quarter, 17)):
        fine = finer.scene
        assert fine.n_balls == balls
        assert fine.position[finer.balls] == pytest.approx(coarse.position)
        assert fine.mass.sum() == pytest.approx(1.2)
        assert np.flatnonzero(fine.pinned).tolist() == [0, balls - 1]
        assert 1.0 / (1.0 / fine.stiffness).sum() == pytest.approx(400.0 / 2.0)
        assert fine.radius == pytest.approx(coarse.radius[0] * 4 / (balls - 1))  # balls do not overlap
        assert fine.probes[0].given["balls"].tolist() == [balls // 2]
    file.write_text(CABLE.replace("EA = 400.0", "stiffness = 300.0"))
    with pytest.raises(SceneError, match=r"rope\[0\]\.stiffness: is of each piece"):
        resolution.finer(file)


LOADED = """[[balls]]
name = "load"
position = [[2.2, 0.0]]
radius = 0.15
[[attachments]]
one = "cable"
one_members = [4]
other = "load"
stiffness = 900.0
"""


@pytest.mark.parametrize(
    ("radius", "told"),
    [
        ("", ["", ""]),  # which shrinks with the spacing
        ("radius = 0.2", ["", "ball 0 (number 0 of load) and ball 16 (number 15 of cable) overlap at the start"]),
    ],
)
def test_finer_scenes_say_what_touches_that_did_not(tmp_path, radius, told):
    """Contacts would push the load from the balls of the cable beside the one that it hangs on."""
    file = tmp_path / "s.toml"
    file.write_text(CABLE.replace("n = 5", f"n = 5\n{radius}") + LOADED)
    assert [finer.overlap for finer in resolution.finer(file)] == told
    file.write_text(file.read_text() + "[simulation]\ncontacts = 'off'\n")
    assert [finer.overlap for finer in resolution.finer(file)] == ["", ""]


def test_the_tension_of_a_rope_goes_with_its_mesh(tmp_path):
    """At its ends that of the outer piece, within the first half of a piece; strains of all pieces that one becomes."""
    probes = "".join(f"[[probes]]\nname = 'p{k}'\nkind = 'tension'\nspring = {k}\n" for k in (0, 1, 3))
    file = tmp_path / "s.toml"
    file.write_text(CABLE + probes + "[[probes]]\nname = 's'\nkind = 'strain'\nsprings = [1, 2]\n")
    half, quarter = resolution.finer(file)
    for finer, outer, inner, last, strains in (
        (half, (0, 1), (2, 3), (7, 8), 4),
        (quarter, (0, 1), (4, 5), (15, 16), 8),
    ):
        fine = finer.scene
        found = [tuple(fine.pairs[probe.given["spring"]].tolist()) for probe in fine.probes[1:4]]
        assert found == [outer, inner, last]
        assert len(fine.probes[4].given["springs"]) == strains
    file.write_text(CABLE + "[[probes]]\nname = 'p'\nkind = 'length'\nspring = 1\n")
    with pytest.raises(SceneError, match="the springs of a shape are others in a finer mesh"):
        resolution.finer(file)


@pytest.mark.parametrize("material", ["warp = 30.0\nmass = 0.3", "young_modulus = 1e4\nthickness = 1e-3\nmass = 0.3"])
def test_a_sheet_of_triangles_is_refined(tmp_path, material):
    file = tmp_path / "s.toml"
    file.write_text(SHEET.replace("mass_per_area = 0.2", material).replace("at = [0.5, 0.1, 0.75]", "spring = 1"))
    coarse, half = ts.load_scene(file), resolution.finer(file, 1)[0].scene
    assert len(half.membranes) == 4 * len(coarse.membranes)
    assert half.membrane_warp[0] == pytest.approx(coarse.membrane_warp[0])
    assert half.mass.sum() == pytest.approx(coarse.mass.sum())


@pytest.mark.parametrize("material", ["density = 700.0", "poisson_ratio = 0.3", "young_modulus = 2e4"])
def test_a_jelly_of_bricks_is_refined(tmp_path, material):
    file = tmp_path / "s.toml"
    file.write_text(f"format = 1\ndim = 3\n[[jelly]]\nsize = [0.4, 0.2, 0.2]\nresolution = [3, 2, 2]\n{material}\n")
    coarse, half = ts.load_scene(file), resolution.finer(file, 1)[0].scene
    assert len(half.bricks) == 8 * len(coarse.bricks)
    assert half.mass.sum() == pytest.approx(coarse.mass.sum())
    assert half.brick_modulus[0] == pytest.approx(coarse.brick_modulus[0])


def test_a_preset_is_a_material(tmp_path):
    (tmp_path / "s.toml").write_text(SHEET.replace("mass_per_area = 0.2", "material = 'silk'"))
    half = resolution.finer(tmp_path / "s.toml", 1)[0]
    assert half.scene.mass.sum() == pytest.approx(ts.load_scene(tmp_path / "s.toml").mass.sum())


def test_a_finer_rope_without_a_radius_is_no_rod_of_its_preset(tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(CABLE.replace("EA = 400.0\nmass = 1.2", "material = 'rubber'"))
    coarse, half = ts.load_scene(file), resolution.finer(file, 1)[0].scene
    assert half.mass.sum() == pytest.approx(coarse.mass.sum())
    assert (half.stiffness * half.rest_length).mean() == pytest.approx((coarse.stiffness * coarse.rest_length).mean())
    assert len(half.bends) == 0


@pytest.mark.slow
def test_finer_meshes_come_to_rest_by_themselves(tmp_path):
    """Each is settled, not the coarse one's shape taken for all."""
    file = tmp_path / "s.toml"
    file.write_text(CABLE + "[simulation]\nsettle = 0.05\ncontacts = 'off'\n")
    _, coarse, _ = command.read(str(file), resolutions=True, duration=0.1)
    meshes = resolution.finer(file)
    sags = [coarse.position[2, 1], *(fine.scene.position[fine.balls[2], 1] for fine in meshes)]
    assert max(sags) < -0.05
    assert sags == pytest.approx([sags[-1]] * 3, rel=0.1)
    assert all("settle" not in fine.scene.settings for fine in meshes)


@pytest.mark.slow
def test_a_report_settles_in_double_precision(tmp_path):
    """In a process of its own, which runs nothing before; all runs start from there, the reference in double among them."""
    file = tmp_path / "s.toml"
    file.write_text(CABLE + "[simulation]\nsettle = 0.05\ncontacts = 'off'\nprecision = 'f64'\n")
    says = (
        "from taichi_sim.reports.speed_error.command import read; from taichi_sim.device import backend;"
        f"read({str(file)!r}, duration=0.1); print(backend.running().precision)"
    )
    done = subprocess.run([sys.executable, "-c", says], capture_output=True, text=True, check=False)
    assert done.stdout.split()[-1:] == ["f64"], done.stderr


def test_the_error_at_the_scenes_own_settings_is_that_of_its_own_precision(tmp_path, monkeypatch):
    scene = pair()
    scene.settings = {"precision": "f64"}
    monkeypatch.setattr(report, "TrialProcesses", lambda *_: MadeUp(scene))
    findings = report.main(scene, plan(precisions=("f64", "f32")), tmp_path / "r", **NONE)
    assert findings.budget.single is not None
    line = next(line for line in findings.about() if "own settings" in line)
    assert "in double precision" in line
    assert "single" not in line


def test_what_settling_left_is_a_part_of_the_error(tmp_path, monkeypatch):
    """Runs from where `settle` leaves the balls are off by twice that in MadeUp, at any step."""
    scene, said = loaded(), []
    monkeypatch.setattr(report, "TrialProcesses", lambda *_: MadeUp(scene))
    monkeypatch.setattr(tune, "TrialProcesses", lambda *_: MadeUp(scene))
    rest = scene.position + np.array([0.0, 0.0035])
    found = report.main(scene, plan(rest=rest), tmp_path / "r", **NONE).budget
    assert found.settling == pytest.approx(0.007)
    assert "+- 7 mm (settling)" in next(found.lines())
    assert not found.meshed
    again = report.main(scene, plan(rest=rest), tmp_path / "r", **NONE).budget
    assert again == found
    tune.main(scene, plan(rest=rest, tolerance=0.05), progress=False, say=said.append)
    off = re.search(r"\+- (\d+) mm \(step and settling\)", said[2])
    assert int(off.group(1)) >= 7
    assert "settling     7.00 mm, more than allowed; a smaller `settle` reduces it" in said[2]


@pytest.mark.parametrize(
    ("missed", "first"), [(3e-7, "value        x: 70.000 +- 0.003 N"), (0.01, "peak         70.000 +- 0.013 N")]
)
def test_no_line_of_tune_states_less_than_settling_left(monkeypatch, missed, first):
    monkeypatch.setattr(tune, "left_out", lambda _: [])
    reference = SimpleNamespace(missed=missed, reads_peak=False, settling=3e-3, motion=70.0, parts=8)
    compared = SimpleNamespace(unit="N", size_in_words=lambda _: "x")
    row = SimpleNamespace(rms_error=1e-9, relative_error=1e-11, seconds=1.0, clock="processor time", passes=1.0)
    assert next(tune._outcome(None, compared, reference, row, 0.01)).startswith(first)


def test_settling_that_cannot_be_told_is_named(tmp_path, monkeypatch):
    scene, said = loaded(), []
    monkeypatch.setattr(report, "TrialProcesses", lambda *_: MadeUp(scene))
    monkeypatch.setattr(tune, "TrialProcesses", lambda *_: MadeUp(scene))
    unknown = plan(rest=scene.position[:0], tolerance=0.05)
    assert "settling not known" in next(report.main(scene, unknown, tmp_path / "r", **NONE).budget.lines())
    tune.main(scene, unknown, progress=False, say=said.append)
    assert "not included: the net force that `settle` left at the start" in said[2]


def test_a_short_run_is_not_left_out_for_what_its_first_call_costs():
    """Its whole time is far below what a call takes, or compiling once more."""
    track = Track(pair(), plan(), PRECISION)
    outcome = track.run(Trial("rk4", fitting(0.4, 0.01), most=1e-4, timed=True))
    track.sim.close()
    assert not outcome.left_out
    assert len(outcome.position) == PARTS


def test_a_peak_between_the_moments_is_read_at_the_steps():
    """Of a weight that swings twice and more from one moment to the next; of positions as well, and not of energies."""
    mass, stiffness = 1.3, 700.0
    scene = ts.Scene(dim=2, gravity=(0, -9.79))
    balls = scene.add_balls([[0, 0], [0, -0.6]], radius=0.01, mass=mass, pinned=[0])
    scene.add_springs([balls], stiffness=stiffness, rest_length=0.6)
    scene.add_probe("load", "tension", spring=0)
    scene.add_probe("all", "energy")
    duration = 8.0 * 1.46 * 2.0 * np.pi * np.sqrt(mass / stiffness)
    for quantity, peak in (
        ("load.tension", 2.0 * mass * 9.79),
        (None, 2.0 * mass * 9.79 / stiffness),
        ("all.total", 0),
    ):
        asked = plan(quantity=quantity, duration=duration)
        track = Track(scene, asked, PRECISION)
        step = fitting(duration, 1e-3)
        outcome = track.run(Trial("rk4", step, contacts=True))
        assert not track.run(Trial("rk4", step)).peak
        track.sim.close()
        if not peak:
            assert not outcome.peak
            continue
        seen = Compared(scene, asked).motion(outcome, 1.0)
        reference = Reference("rk4", 1e-3, 1.0, displacement=seen, parting=np.zeros(PARTS), peak=np.array(outcome.peak))
        assert seen.max() < 0.99 * peak
        assert reference.motion + reference.missed == pytest.approx(peak, rel=3e-3)


def test_what_is_held_at_both_ends_is_refused_before_anything_runs(tmp_path):
    """Unless a motor or a driven pin moves it."""
    for moves in (None, "pin", "motor"):
        scene = ts.Scene(dim=2, gravity=(0, -9.0))
        balls = scene.add_balls([[0, 0], [1.2, 0], [2, 0]], radius=0.1, pinned=[0, 1])
        scene.add_springs([balls[:2], balls[1:]], stiffness=300.0, rest_length=1.0)
        scene.add_probe("load", "tension", spring=0)
        scene.add_probe("free", "length", spring=1)
        scene.add_probe("hook", "position", balls=[0, 1])
        if moves == "pin":
            scene.add_moving_pins([1], velocity=(0.1, 0))
        elif moves == "motor":
            scene.add_motor([0], amplitude=0.1, frequency=1.0)
        scene.save(tmp_path / "s.toml")
        for quantity, held in (
            ("load", "load.tension never changes, for both ends of spring 0 are pinned"),
            ("hook.x", "hook.x never changes, for all its balls are pinned"),
            ("free", ""),
        ):
            expected = (
                pytest.raises(SceneError, match=held)
                if held and (moves is None or (moves == "motor" and quantity == "hook.x"))
                else nullcontext()
            )
            with expected:
                command.read(str(tmp_path / "s.toml"), quantity=quantity)


def test_nothing_to_refine(tmp_path):
    loaded().save(tmp_path / "s.toml")
    with pytest.raises(SceneError, match="has nothing to refine: a rope, or"):
        resolution.finer(tmp_path / "s.toml")
    with pytest.raises(SceneError, match="is Python, whose shapes have one resolution"):
        resolution.finer(tmp_path / "s.py")


@pytest.mark.slow
def test_a_report_has_the_error_of_the_mesh(tmp_path, monkeypatch):
    """Runs that are off by 0.04 h^2, with h = 1, 1/2, 1/4: compared at the coarse mesh's balls, that is what is found."""
    scene, said = pair(), []
    finer = []
    for k in (1, 2):
        fine = pair()
        fine.add_balls(np.zeros((k, 2)), radius=0.05)  # balls that the coarse mesh does not have
        finer.append(resolution.Finer(fine, np.array([0, 1])))

    def made_up(given, *_):
        workers = MadeUp(given)
        off = 0.04 * (1.0 - 0.25 ** (given.n_balls - 2))
        run = workers.run

        def finer_run(precision, trial):
            outcome = run(precision, trial._replace(step=trial.step._replace(seconds=1e-9)))
            return outcome._replace(position=[x - [off, 0.0] for x in outcome.position])

        workers.run = run if given.n_balls == 2 else finer_run
        return workers

    monkeypatch.setattr(report, "TrialProcesses", made_up)
    findings = report.main(scene, plan(resolutions=True), tmp_path / "r", meshes=finer, progress=False, say=said.append)
    assert findings.budget.mesh == pytest.approx(0.04, rel=1e-3)
    assert findings.budget.order == pytest.approx(2.0, abs=1e-2)
    assert "+- 40 mm (mesh), +- " in said[0]
    assert "single precision" not in said[0]  # nothing runs in it
    assert "falls with the order 2.00 of the spacing" in (tmp_path / "r" / "report.html").read_text()
    again = report.main(scene, plan(resolutions=True), tmp_path / "r", meshes=finer, **NONE)
    assert again.budget == findings.budget
    touching = [replace(mesh, overlap="both overlap at the start") for mesh in finer]
    for k, (meshes, mesh, why) in enumerate(
        [
            (touching, None, "not known: with half of the spacing both overlap at the start"),
            (
                [finer[0], touching[1]],
                0.06,
                "order taken to be 1; with a quarter of the spacing both overlap at the start",
            ),
        ]
    ):
        found = report.main(scene, plan(resolutions=True), tmp_path / f"r{k}", meshes=meshes, **NONE).budget
        assert found.mesh == (None if mesh is None else pytest.approx(mesh, rel=1e-3))
        assert found.why.endswith(why)


def placed():
    """The pair, and the place of one of its balls."""
    scene = pair()
    scene.add_probe("tip", "position", balls=[1])
    return scene


def with_meshes(monkeypatch, off, **options):
    """Finer meshes of `placed`, and processes that move their balls by (1 - 4^-k) off, (PARTS,) or a number [m], with k = 1, 2:
    the mesh's error is off, of order 2."""
    meshes = []
    for k in (1, 2):
        fine = placed()
        fine.add_balls(np.zeros((k, 2)), radius=0.05)  # balls that the coarse mesh does not have
        meshes.append(resolution.Finer(fine, np.array([0, 1])))

    def made_up(given, *_):
        workers = MadeUp(given, **options)
        run, by = workers.run, (1.0 - 0.25 ** (given.n_balls - 2)) * np.broadcast_to(off, PARTS)

        def finer_run(precision, trial):
            outcome = run(precision, trial._replace(step=trial.step._replace(seconds=1e-9)))
            places = [x + np.array([d, 0.0]) for x, d in zip(outcome.position, by)]
            return outcome._replace(position=places, quantity=[x + d for x, d in zip(outcome.quantity, by)])

        workers.run = run if given.n_balls == 2 else finer_run
        return workers

    monkeypatch.setattr(report, "TrialProcesses", made_up)
    return meshes


@pytest.mark.parametrize("quantity", ["tip.x", None])
def test_what_has_settled_does_not_part_and_its_place_has_the_error_of_the_mesh(tmp_path, monkeypatch, quantity):
    """Its motion is far below what the runs start apart, and no measure of how they part."""
    scene = placed()
    meshes = with_meshes(monkeypatch, 0.03, moves=3e-10)
    asked = plan(quantity=quantity, resolutions=True, rest=scene.position + 2e-8)
    findings = report.main(scene, asked, tmp_path / "r", meshes=meshes, **NONE)
    assert not findings.reference.chaotic
    assert findings.reference.step == fitting(0.4, min(FRAME, limit(scene, "rk4")) / 4.0).seconds / 2.0  # no finer one
    assert findings.budget.mesh == pytest.approx(0.03, rel=1e-3)
    said = list(findings.about())
    line = next(line for line in said if "own settings" in line)
    value = r"Value of tip.x at its largest motion .*: 1.10 \+- 0.03 m" if quantity else r"Places at .*: \+- 30.0 mm"
    assert re.search(value + r" \(mesh\), ", line)
    assert any("moves by no more than what `settle` left" in line for line in said)
    assert not any("statistics alone" in line for line in said)


def test_what_has_settled_parts_where_the_runs_do(tmp_path, monkeypatch):
    scene = placed()
    with_meshes(monkeypatch, 0.0, moves=3e-10, grows=9.0)
    findings = report.main(scene, plan(quantity="tip.x", rest=scene.position + 2e-8), tmp_path / "r", **NONE)
    assert findings.reference.chaotic


@pytest.mark.parametrize("quantity", ["tip.x", None])
def test_the_error_of_the_largest_motion_is_no_error_of_another_moment(tmp_path, monkeypatch, quantity):
    """Meshes that come to the same rest in other times."""
    path = 1.0 - np.exp(-0.9 * np.arange(1, PARTS + 1))
    off = 0.07 * np.exp(-0.9 * np.arange(PARTS)) + 0.002
    meshes = with_meshes(monkeypatch, off, path=path, moves=0.4)
    found = report.main(placed(), plan(quantity=quantity, resolutions=True), tmp_path / "r", meshes=meshes, **NONE)
    assert found.budget.value == pytest.approx(0.4, rel=1e-2)
    assert found.budget.mesh == pytest.approx(off[-1], rel=1e-2)
    assert found.budget.order == pytest.approx(2.0, abs=1e-2)


def test_extremes_that_agree_by_luck_are_off_by_what_the_runs_are():
    """At the moments where either is the largest, as `run --error` tells it."""
    compared = Compared(placed(), plan(quantity="tip.x"))
    one, other = (
        Outcome("", [], [], [], quantity=[np.array([1.1 + x]) for x in values], begin=np.array([1.1]))
        for values in ([0.1, 0.5, 0.2, 0.9], [0.4, 0.1, 0.5, 0.0])
    )
    assert compared.error_of_largest(one, other, 3) == pytest.approx(0.4)
    assert compared.error_of_largest(one, other, 1) == pytest.approx(0.3)
