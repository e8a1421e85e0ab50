"""`taichi-sim report SCENE`: errors against a closed solution, orders, what is cheapest, pages, resuming, and what is refused."""

import csv
import json
import re
import shutil
from dataclasses import fields, replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from speed_support import MadeUp, length, pair, plan

import taichi_sim as ts
from taichi_sim.analysis.methods import named
from taichi_sim.common.errors import SceneError
from taichi_sim.files.source import open_scene, resolve
from taichi_sim.reports.speed_error import budget, measure, report, rows, statistics
from taichi_sim.reports.speed_error.findings import Findings, choice, equal
from taichi_sim.reports.speed_error.plan import (
    FRAME,
    METHODS,
    PARTS,
    Plan,
    Step,
    about,
    duration_of,
    fitting,
    longest_step,
    steps_of,
)
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.report_folder import ReportFolder
from taichi_sim.reports.speed_error.trial_process import Outcome
from taichi_sim.reports.speed_error.trials import Trials
from taichi_sim.studies import records

pytestmark = pytest.mark.once


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A report in both precisions, by processes of its own: folder, findings, lines."""
    folder, said = tmp_path_factory.mktemp("report") / "pair", []
    findings = report.main(pair(), plan(precisions=("f64", "f32")), folder, progress=False, say=said.append)
    return folder, findings, "\n".join(said)


@pytest.fixture
def made_up(monkeypatch):
    """Replace the processes; gives a function that does, for what MadeUp takes."""

    def install(scene, **options):
        workers = MadeUp(scene, **options)
        monkeypatch.setattr(report, "TrialProcesses", lambda *_: workers)
        return workers

    return install


# What was measured -------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_reference_is_the_closed_solution(made):
    _, findings, _ = made
    reference = findings.reference
    x = reference.position
    times = 0.4 * np.arange(1, PARTS + 1) / PARTS
    off = np.abs(x[:, 1, 0] - x[:, 0, 0] - length(times))
    assert off.max() < 4 * reference.known
    assert 0 < reference.known < 1e-6
    assert not reference.chaotic


@pytest.mark.slow
@pytest.mark.parametrize(("method", "order"), [("verlet", 2.0), ("symplectic_euler", 1.0)])
def test_orders(made, method, order):
    found = [row.order for row in made[1].rows if (row.method, row.precision) == (method, "f64") and row.order]
    assert len(found) >= 2
    assert found[-1] == pytest.approx(order, abs=0.15)


@pytest.mark.slow
def test_errors_are_those_of_the_closed_solution(made):
    """Each end is off by half of what the length is."""
    _, findings, _ = made
    row = next(row for row in findings.rows if (row.method, row.precision) == ("verlet", "f64"))
    with ts.Simulation(pair(), integrator="verlet", dt=row.step, substeps=1) as sim:
        off = []
        for k in range(1, PARTS + 1):
            sim.step(round(0.4 / PARTS / row.step))
            x = sim.position[:, 0]
            off.append((x[1] - x[0] - length(0.4 * k / PARTS)) / 2)
    assert row.rms_error == pytest.approx(np.abs(off).max(), rel=0.02)  # at the worst moment
    assert row.max_error == pytest.approx(np.abs(off).max(), rel=0.02)
    moved = np.abs(length(0.4 * np.arange(1, PARTS + 1) / PARTS) - length(0.0)).max() / 2
    assert row.relative_error == pytest.approx(np.abs(off).max() / moved, rel=0.02)  # no part of the scene's diagonal


@pytest.mark.slow
def test_both_precisions_have_all_rows_with_costs(made):
    _, findings, _ = made
    for precision in ("f64", "f32"):
        for method in ("verlet", "symplectic_euler"):
            own = [row for row in findings.rows if (row.precision, row.method) == (precision, method)]
            assert len(own) == 5
            assert all(row.seconds > 0 and row.ns_per_ball_step > 0 and row.passes > 0 for row in own)
            assert own[0].passes == pytest.approx(1 / own[0].step)


@pytest.mark.slow
def test_pages(made):
    folder, findings, said = made
    names = {p.name for p in folder.iterdir()}
    made_of = "report.md report.html rows.csv rows.jsonl error.svg error.png reference.npz budget.npz report.json"
    assert names == set(made_of.split())
    page, text = (folder / "report.html").read_text(), (folder / "report.md").read_text()
    value = r"[\d.]+ \+- [\d.]+ mm \(step\), .*single precision"
    assert re.search(rf"Largest rms displacement at 8 sample times up to 0.4 s, with verlet .*: {value}", text)
    assert "mesh" not in text  # two balls on a spring are none
    assert "<svg" in page
    assert not re.search(r"(src|href)=\"(http|/|\w+\.)", page)  # nothing is loaded from elsewhere
    assert "#010203" not in page
    for row in findings.rows:
        assert f"{row.step:.3g}" in text
    assert "fastest with an error below 1 %: " in said
    assert "fastest with an error below 0.01 %: " in said
    kept = rows_of(folder)
    assert kept == sorted_as(folder, findings.rows)
    assert any(row.order for row in kept)


def rows_of(folder):
    """The rows that are kept; the table for other programs has the same."""
    kept = records.rows_of((folder / "rows.jsonl").read_bytes(), rows.Row)
    table = list(csv.DictReader((folder / "rows.csv").read_text().splitlines()))
    assert table == [{name: "" if value is None else str(value) for name, value in vars(row).items()} for row in kept]
    return kept


def sorted_as(folder, found):
    """The rows in the order of the file."""
    keys = [row.key for row in rows_of(folder)]
    return sorted(found, key=lambda row: keys.index(row.key))


# What follows from rows --------------------------------------------------------------------------------------------


def row(seconds, error, verdict="stable", step=1e-3, noise=None):
    none = dict.fromkeys([field.name for field in fields(rows.Row) if field.type == float | None])
    given = {"scene": "s", "balls": 1, "springs": 1, "precision": "f64", "device": "d", "method": "rk4", "reason": ""}
    values = {**none, **given, "step": step, "seconds": seconds, "rms_error": error, "relative_error": error}
    return rows.Row(**{**values, "noise": noise}, verdict=verdict)


def test_an_order_is_that_of_errors_over_steps():
    """Of a third order, also between steps of which one is no half of the other; none where the reference is as far off."""
    found = [
        row(1.0, error, step=step) for step, error in ((8e-3, 8.0), (4e-3, 1.0), (3e-3, 1.0 * 0.75**3), (1e-3, 1e-9))
    ]
    orders = [one.order for one in rows.with_orders(found, known=1e-9)]
    assert orders == [None, pytest.approx(3.0), pytest.approx(3.0), None]


def test_pareto_front_and_the_cheapest():
    fast, good, worse, best, wild, near = found = [
        row(1.0, 1e-2),
        row(2.0, 1e-3),
        row(3.0, 1e-2),
        row(4.0, 1e-4),
        row(0.1, 1e-6, "unstable"),
        row(5.0, 1e-9),
    ]
    assert rows.pareto(found, known=1e-9) == [fast, good, best]  # what is near to the reference tells nothing
    assert rows.pareto(found, known=1e-12) == [fast, good, best, near]
    assert rows.cheapest(found, 1e-3, motion=1.0, known=0.0) == [good]
    assert rows.cheapest(found, 1e-3, motion=10.0, known=0.0) == [fast]
    assert rows.cheapest(found, 1e-3, motion=1.0, known=1e-5) == [best]  # what the reference may be off counts as well
    assert rows.cheapest(found, 1e-10, motion=1.0, known=0.0) == []
    assert worse not in rows.pareto(found, 0.0)
    exact = row(1.5, 1e-15)
    assert rows.pareto([*found, exact], known=1e-9) == [fast]  # what is exact beats all that is slower
    assert wild not in rows.pareto(found, 0.0)


def test_what_is_said_of_the_front_is_true(monkeypatch):
    """As printed: errors and times are rounded, unstable runs may be faster, and times within 20 % are equal."""
    rng = np.random.default_rng(8)
    for _ in range(200):
        found = [
            row(rng.uniform(1.0, 2.0), 10.0 ** rng.uniform(-3.0, -2.0), rng.choice(["stable", "stable", "unstable"]))
            for _ in range(8)
        ]
        stable = [one for one in found if one.verdict == "stable"]
        for one in rows.pareto(found, known=1e-9):
            assert all(other.seconds > 1.2 * one.seconds for other in stable if other.rms_error < one.rms_error)
    found = [row(1.0, 1.24e-3, step=1e-3), row(1.21, 1.23e-3, step=5e-4)]  # printed, the second is as accurate
    monkeypatch.setattr(Findings, "lasting", [])
    said = " ".join(Findings(plan(), pair(), known_to(1e-9), found, []).lines())
    assert "Every stable run that is more accurate than one of these takes over 20 % longer than it" in said
    assert "times and errors are rounded here" in said


def test_what_noise_hides_is_no_rank():
    """Equally fast, the smaller error is better; what is clearly slower is not, however large the noise was."""
    quick, near, slow = found = [row(1.0, 1e-2, noise=0.1), row(1.1, 1e-3, noise=0.1), row(1.5, 1e-4, noise=9.0)]
    assert rows.pareto(found, known=1e-9) == [near, slow]
    assert rows.cheapest(found, 0.1, motion=1.0, known=0.0) == [near, quick]
    said = choice([near, quick])
    assert "rk4 at 0.001 s in f64, 1.1 s of wall time" in said
    assert "equally fast: rk4 at 0.001 s in f64 (times within 20 % are taken as equal)" in said


def test_a_busy_machine_recommends_what_an_idle_one_does():
    """Times beside other programs are up to a tenth longer than alone; of what is as fast the count of passes decides."""
    rng = np.random.default_rng(3)
    idle = [row(1.0, 1e-3), row(1.05, 1e-4), row(1.5, 1e-5), row(10.4, 1e-6)]
    idle = [replace(one, passes=passes) for one, passes in zip(idle, (900.0, 1000.0, 800.0, 50_000.0))]
    best = rows.cheapest(idle, 0.1, 1.0, 0.0)
    assert best == idle[:2]
    for _ in range(50):
        busy = [replace(one, seconds=one.seconds * rng.uniform(1.0, 1.1), noise=one.seconds) for one in idle]
        found = rows.cheapest(busy, 0.1, 1.0, 0.0)
        assert [one.passes for one in found] == [900.0, 1000.0]


def known_to(error):
    """A reference whose error is that at every end."""
    ends, x, none, energy = np.full(PARTS, error), np.ones((PARTS, 2, 2)), np.ones((PARTS, 0)), np.ones((PARTS, 4))
    return Reference("rk4", 1e-3, 1.0, x, none, energy, ends, 0 * ends + 1.0, ends, 0, False, "")


def test_runs_that_are_exact_are_said_to_be_so():
    """The reference is known to rounding, as are two runs; one is off by more."""
    reference = known_to(2e-15)
    found = Findings(plan(), pair(), reference, [row(1.0, 1e-15), row(2.0, 0.0), row(2.0, 1e-3)], [])
    said = " ".join(found.about())
    assert "2 runs agree with the reference to rounding" in said
    assert "can be told" not in said


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ((1.1, 2.2), "2 of 3 runs became unstable, at steps above the safe one;"),
        ((0.9, 2.2), "2 of 3 runs became unstable, 1 of them at a step above the safe one;"),
        ((1.1, 2.2, 1.0), "3 of 4 runs became unstable, 2 of them at steps above the safe one;"),
        ((0.9,), "1 of 2 runs became unstable;"),
        ((1.7,), "1 of 2 runs became unstable, at a step above the safe one;"),
        ((None, 0.7), "2 of 3 runs became unstable, 1 of them by methods that have no safe step here;"),
    ],
)
def test_runs_that_became_unstable_are_told_by_the_safe_step(parts, said):
    reference = known_to(1e-6)
    wild = [replace(row(1.0, 1e-3, "unstable"), part_of_safe_step=part) for part in parts]
    lines = list(Findings(plan(), pair(), reference, [row(2.0, 1e-3), *wild], []).lines())
    assert any(line.startswith(said) for line in lines)


def test_steps_fit_and_halve():
    for method in METHODS:
        steps = steps_of(pair(), method, Plan("pair", 0.37))
        for step in steps:
            assert step.number * PARTS * step.seconds == pytest.approx(0.37)
        longest = fitting(0.37, min(FRAME, longest_step(pair(), method))) if longest_step(pair(), method) else steps[0]
        assert longest in steps
        halves = [step for step in steps if step != longest or step == steps[0]]
        assert all(b.seconds == pytest.approx(a.seconds / 2) for a, b in pairwise(halves))
    assert [s.number for s in steps_of(pair(), "verlet", plan(steps=(0.4, 0.01)))] == [1, 5]


def test_duration_is_short_where_a_scene_is_expensive():
    assert duration_of(open_scene(resolve("cloth"))) == pytest.approx(0.25)
    assert duration_of(pair()) == 5.0


def test_key_knows_the_scene():
    other = pair()
    other.add_wall((0, 1), -1.0)
    keys = {json.dumps(about(scene, p)) for scene in (pair(), other) for p in (plan(), plan(duration=0.5))}
    assert len(keys) == 4
    assert about(pair(), plan()) == about(pair(), plan(methods=("rk4",), precisions=("f32",)))


@pytest.mark.parametrize("verdict", ["stable", "unstable", "left out"])
def test_the_reference_is_blamed_only_where_a_run_was_stable(verdict):
    reference = known_to(1e-6)
    said = " ".join(Findings(plan(), pair(), reference, [row(1.0, 1e-7, verdict)], []).about())
    assert ("No method's error can be told" in said) == (verdict == "stable")
    assert ("No run was stable" in said) == (verdict != "stable")


# Interrupted, refused ----------------------------------------------------------------------------------------------


def test_an_interrupted_report_goes_on(tmp_path, made_up):
    scene, say = pair(), lambda line: None
    first = made_up(scene, fail=14)
    with pytest.raises(KeyboardInterrupt):
        report.main(scene, plan(), tmp_path / "r", progress=False, say=say)
    kept = rows_of(tmp_path / "r")
    of_reference = sum(not trial.timed for _, trial in first.trials)
    budget = 1  # a run with the scene's own settings
    assert 1 <= len(kept) == 14 - of_reference <= 9
    assert not (tmp_path / "r" / "report.md").exists()
    second = made_up(scene)
    findings = report.main(scene, plan(), tmp_path / "r", progress=False, say=say)
    assert len(findings.rows) == 10
    assert len(first.trials) + len(second.trials) == of_reference + 10 + budget
    third = made_up(scene)
    report.main(scene, plan(methods=("verlet", "symplectic_euler", "rk4")), tmp_path / "r", progress=False, say=say)
    assert {trial.method for _, trial in third.trials} == {"rk4"}  # a method more is added to what is there


@pytest.mark.parametrize("fail", [1, 4])
def test_a_report_that_ends_within_its_reference_goes_on_there(tmp_path, made_up, fail):
    """Every run that is finished is kept, with all that it came to, and nothing of them is left once the report is there."""
    scene, folder, say = pair(), tmp_path / "r", lambda line: None
    first = made_up(scene, fail=fail)
    with pytest.raises(KeyboardInterrupt):
        report.main(scene, plan(), folder, progress=False, say=say)
    assert len(list(folder.glob("run_*.npz"))) == fail
    second = made_up(scene)
    found = report.main(scene, plan(), folder, progress=False, say=say)
    whole = made_up(scene)
    fresh = report.main(scene, plan(), tmp_path / "whole", progress=False, say=say)
    assert len(first.trials) + len(second.trials) == len(whole.trials)
    assert [row.rms_error for row in found.rows] == [row.rms_error for row in fresh.rows]
    np.testing.assert_array_equal(found.reference.position, fresh.reference.position)
    assert not list(folder.glob("run_*"))


def test_folders_of_others_are_refused(tmp_path, made_up):
    scene, say = pair(), lambda line: None
    made_up(scene)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    for path, words in (("full", "is not empty and holds no report"), ("no/r", "there is no folder")):
        with pytest.raises(OSError, match=words):
            report.main(scene, plan(), tmp_path / path, progress=False, say=say)
    report.main(scene, plan(), tmp_path / "r", progress=False, say=say)
    with pytest.raises(
        FileExistsError, match=r"holds another report, which differs in plan\.duration \(0\.4 then, 0\.5 now\)"
    ):
        report.main(scene, plan(duration=0.5), tmp_path / "r", progress=False, say=say)
    findings = report.main(scene, plan(duration=0.5), tmp_path / "r", overwrite=True, progress=False, say=say)
    assert len(rows_of(tmp_path / "r")) == len(findings.rows)
    assert [p.name for p in (tmp_path / "full").iterdir()] == ["notes.txt"]


DAMAGE = [  # file, bytes of it that are kept, and what follows them
    ("rows.jsonl", 0, b""),
    ("rows.jsonl", 500, b""),
    ("rows.jsonl", 500, b"\n"),
    ("seeds.jsonl", 100, b"\n"),
    ("budget.npz", 100, b""),
    ("reference.npz", 0, b""),
    ("reference.npz", 0, b"rubbish"),
    ("reference.npz", 1000, b""),
]


def test_a_damaged_folder_is_refused_by_name(tmp_path, made_up):
    scene, whole, folder, say = pair(), tmp_path / "whole", tmp_path / "r", lambda line: None
    made_up(scene, grows=15.0)
    report.main(scene, plan(), whole, progress=False, say=say)
    for name, keep, data in DAMAGE:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(whole, folder)
        (folder / name).write_bytes((folder / name).read_bytes()[:keep] + data)
        with pytest.raises(SceneError, match=rf"r/{name}: is damaged; use --overwrite or another --out"):
            report.main(scene, plan(), folder, progress=False, say=say)
    report.main(scene, plan(), folder, overwrite=True, progress=False, say=say)
    for record in ("rubbish", "[]"):  # nothing says that the folder is ours
        (folder / "report.json").write_text(record)
        for overwrite in (False, True):
            with pytest.raises(OSError, match=r"r/report\.json: is not as this program writes it; remove the folder"):
                report.main(scene, plan(), folder, overwrite=overwrite, progress=False, say=say)


def test_a_run_that_takes_too_long_is_listed_with_its_reason(tmp_path, made_up):
    scene = pair()
    made_up(scene)
    findings = report.main(scene, plan(most=0.07), tmp_path / "r", progress=False, say=lambda line: None)
    verdicts = [row.verdict for row in findings.rows if row.method == "verlet"]
    assert verdicts[0] == "stable"
    assert verdicts[-2:] == ["left out", "left out"]
    assert "takes too long already" in findings.rows[4].reason
    assert "takes too long already" in (tmp_path / "r" / "report.html").read_text()


def test_single_precision_that_cannot_meet_the_tolerance_is_said_before_the_run(tmp_path, made_up):
    scene, said = pair(), []
    workers = made_up(scene)
    run = workers.run

    def only_double(precision, trial):
        if precision == "f32":
            raise KeyboardInterrupt
        return run(precision, trial)

    workers.run = only_double
    with pytest.raises(KeyboardInterrupt):
        report.main(
            scene, plan(precisions=("f64", "f32"), tolerance=1e-9), tmp_path / "r", progress=False, say=said.append
        )
    assert "single precision resolves about 7e-07 of the motion" in said[0]


def test_a_scene_at_rest_is_told_to_name_a_quantity():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 3.0]], radius=0.1)
    only = plan(precisions=("f32",), tolerance=1e-3)
    at_rest, moves = (list(report.coarse(scene, only, SimpleNamespace(motion=by, growth=1.0))) for by in (4e-8, 1e-5))
    assert at_rest[1].startswith("note: balls move by 40.0 nm only")
    assert at_rest[1].endswith("name what you want by --quantity")
    assert len(moves) == 1


# Chaos, and nothing at all -----------------------------------------------------------------------------------------


def chaotic(tmp_path, made_up, grows):
    scene = pair()
    made_up(scene, grows=grows)
    findings = report.main(scene, plan(), tmp_path / "r", progress=False, say=lambda line: None)
    return findings, (tmp_path / "r" / "report.md").read_text()


def test_no_errors_beyond_the_horizon(tmp_path, made_up):
    findings, page = chaotic(tmp_path, made_up, 15.0)  # 15^4 < 1e5 < 15^5
    assert findings.reference.parts == 4
    assert "the horizon, where it is 0.001, comes after 0.2 s" in page
    assert all(row.rms_error is not None for row in findings.rows)
    assert "## Statistics" in page


def test_statistics_alone_where_there_is_no_horizon(tmp_path, made_up):
    findings, page = chaotic(tmp_path, made_up, 1e6)
    assert all(row.rms_error is None for row in findings.rows)
    assert "no error means anything" in page
    assert len(findings.intervals) == 3
    assert findings.intervals[0].mean["total"] == 1.0
    assert findings.intervals[0].half["height"] > 0.0
    assert "![" not in page


@pytest.mark.parametrize("touch", [False, True])
def test_contacts_between_the_samples_are_known_by_errors_that_do_not_fall(tmp_path, made_up, touch):
    workers = made_up(pair())
    run = workers.run

    def misses(precision, trial):
        outcome = run(precision, trial)._replace(touch=touch)
        off = 0.01 * (trial.method == "verlet")
        return outcome._replace(position=[x + off for x in outcome.position])

    workers.run = misses
    findings = report.main(pair(), plan(), tmp_path / "r", progress=False, say=lambda line: None)
    assert findings.reference.contacts == 0
    assert bool(findings.intervals) == touch
    about = " ".join(findings.about())
    assert "Errors do not fall with the step of verlet" in about
    assert ("begin and end with a step, and shorter steps may do so at the same moments" in about) == touch


@pytest.mark.parametrize("in_double", [0.0, 0.004, 0.01])
def test_a_floor_is_that_of_single_precision_only_where_double_is_lower(tmp_path, made_up, in_double):
    workers = made_up(pair())
    run = workers.run

    def off(precision, trial):
        outcome = run(precision, trial)
        by = 0.01 if precision == "f32" else in_double * (trial.method == "verlet")
        return outcome._replace(position=[x + by for x in outcome.position])

    workers.run = off
    chosen = plan(precisions=("f64", "f32"), methods=("verlet",))
    findings = report.main(pair(), chosen, tmp_path / "r", progress=False, say=lambda line: None)
    about = " ".join(findings.about())
    assert ("In single precision smaller steps do not go below" in about) == (in_double < 0.01)


def test_errors_that_fall_over_two_halvings_do_fall():
    """The last pair alone falls little: .81 and .66 of the errors at twice and four times its step."""
    steps = (8.0, 4.0, 2.0, 1.0)
    falling = [replace(row(step, error), step=step) for step, error in zip(steps, (5.5, 4.7, 3.8, 3.1))]
    assert rows.stuck(falling, 1e-9) == []
    flat = [replace(one, rms_error=3.1 + 0.1 * one.step) for one in falling]
    assert rows.stuck(flat, 1e-9) == ["rk4"]


def test_errors_of_two_passes_are_laid_to_their_softness_and_contacts_are_claimed_only_where_seen():
    flat = [replace(row(1.0, 3.0), step=step, method=name) for name in ("xpbd", "verlet") for step in (4.0, 2.0, 1.0)]
    for seen, words in ((0, "contacts between the moments compared, if there were any, begin"), (3, "contacts begin")):
        reference = replace(known_to(1e-9), touch=True, contacts=seen)
        about = list(Findings(plan(), pair(), reference, flat, []).about())
        assert "Errors do not fall with the step of xpbd: its passes leave springs too soft at these steps." in about
        (other,) = [line for line in about if line.startswith("Errors do not fall with the step of verlet")]
        assert words in other


@pytest.mark.parametrize(("method", "verdict"), [("xpbd", "unstable"), ("implicit_euler", "stable")])
def test_energy_that_two_passes_leave_in_springs_is_no_stable_run(method, verdict):
    """Springs hold 60 times the largest energy of the reference, and nothing moves faster."""
    outcome = Outcome("cpu", [], [(0.0, 60.0, 0.0, 60.0)] * PARTS, [])
    found = measure._verdict(known_to(1e-9), outcome, named(method))
    assert found[0] == verdict


@pytest.mark.parametrize(
    ("method", "verdict"),
    [("explicit_euler", "unstable"), ("rk4", "unstable"), ("verlet", "stable"), ("tr_bdf2", "stable")],
)
def test_energy_out_of_nothing_is_no_stable_run(method, verdict):
    """1.3 times the largest energy of the reference, of which half moves; symplectic methods swing by that near their bound."""
    outcome = Outcome("cpu", [], [(1.15, 1.15, -40.0, 2.3 - 40.0)] * PARTS, [])
    reference = replace(known_to(1e-9), energy=np.tile([0.5, 0.5, -40.0, -39.0], (PARTS, 1)))
    assert measure._verdict(reference, outcome, named(method))[0] == verdict


def test_intervals_hold_the_mean():
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(400):
        seeds = [
            statistics.Seed("f64", "rk4", 1e-3, k, rng.normal(3.0, 2.0), 0.0, 0.0, 0.0) for k in range(statistics.SEEDS)
        ]
        (found,) = statistics.intervals(seeds)
        hits += abs(found.mean["kinetic"] - 3.0) < found.half["kinetic"]
    assert 0.92 < hits / 400 < 0.98


@pytest.mark.parametrize(("gravity", "up"), [((0.0, 0.0), (0, 1)), ((0.0, 5.0), (0, -1)), ((-4.0, 0.0), (1, 0))])
def test_heights_grow_against_gravity(gravity, up):
    """Along the last axis where there is none; of balls that are not pinned."""
    scene = pair()
    scene.gravity = np.array(gravity)
    scene.set_balls([0, 1], position=[(7.0, 7.0), (1.0, 3.0)], pinned=[True, False])
    seed = statistics.one_seed(Trials(scene, plan(), MadeUp(scene)), "f64", "rk4", Step(50, 1e-3), 1)
    assert seed.height == pytest.approx(np.dot(scene.position[1], up), abs=0.1)


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    """Reports of a scene in which nothing moves, and of one without springs."""
    pinned = ts.Scene(dim=2, gravity=(0, -10))
    pinned.add_balls([[0, 0], [1, 0]], radius=0.1, pinned=True)
    falling = ts.Scene(dim=2, gravity=(0, -10))
    falling.add_balls([[0, 0]], radius=0.1, velocity=(1, 0))
    folder = tmp_path_factory.mktemp("odd")
    found: dict[str, Findings] = {}
    for name, scene in (("pinned", pinned), ("falling", falling)):
        chosen = plan(name=name, methods=("symplectic_euler",))
        found[name] = report.main(scene, chosen, folder / name, progress=False, say=lambda line: None)
    return folder, found


@pytest.mark.slow
def test_nothing_moves(odd):
    folder, found = odd
    assert found["pinned"].rows == []
    assert "Nothing moves in this scene" in (folder / "pinned" / "report.html").read_text()


@pytest.mark.slow
def test_no_springs(odd):
    folder, found = odd
    assert "has no springs" in (folder / "falling" / "report.md").read_text()
    first = found["falling"].rows[0]
    assert first.part_of_safe_step is None
    assert first.rms_error == pytest.approx(  # g t h / 2 below the parabola
        10 * first.step / 2 * 0.4, rel=1e-6
    )


def test_a_scene_that_the_reference_cannot_follow_says_so(tmp_path, made_up, monkeypatch):
    workers = made_up(pair())
    run = workers.run

    def fails(precision, trial):
        outcome = run(precision, trial)
        return outcome._replace(unstable="ball 0 left the world") if trial.contacts else outcome

    workers.run = fails
    findings = report.main(pair(), plan(), tmp_path / "r", progress=False, say=lambda line: None)
    assert "There is no reference" in (tmp_path / "r" / "report.md").read_text()
    assert findings.rows
    assert all(row.rms_error is None for row in findings.rows)


def test_another_folder_key_does_not_touch_the_disk(tmp_path):
    ReportFolder(tmp_path / "r", {"a": 1})
    assert list(tmp_path.iterdir()) == []


def test_few_of_many_equal_runs_are_named():
    """The best of each other method, and how many more there are; one, where all are of one method."""
    many = [
        replace(row(1.0, 0.1, step=step), method=method)
        for method in ("verlet", "rk4", "xpbd", "tr_bdf2", "implicit_euler")
        for step in (1e-3, 5e-4)
    ]
    words = equal(many)
    assert words.startswith(
        "rk4 at 0.001 s in f64, xpbd at 0.001 s in f64, tr_bdf2 at 0.001 s in f64 and 6 more runs ("
    )
    assert equal(many[:2]).startswith("verlet at 0.0005 s in f64 (")
    assert " and 1 more run (" in equal([*many[:2], many[2]])


def test_what_is_below_rounding_is_said_in_words_and_a_mesh_where_there_is_one():
    about = {"name": "motion", "unit": "m", "value": 0.8, "method": "verlet", "step_length": 1e-3}
    line = next(budget.Budget(**about, step=3e-16, single=2e-6, meshed=False).lines())
    assert "800.000 +- 0.002 mm (single precision), step exact to rounding." in line
    assert "with verlet at 0.001 s, the scene's own settings: " in line
    line = next(budget.Budget(**about | {"step_length": 9.92e-4}, given=1e-3).lines())
    assert (
        "verlet at 0.000992 s, the scene's own settings (its 0.001 s, shortened so that steps end at these times):"
        in line
    )
    line = next(budget.Budget(**about | {"value": 34.0, "unit": "N"}, mesh=2.0, step=0.0295, single=3e-6).lines())
    assert "34 +- 2 N (mesh), +- 29.5 mN (step), +- 3.00 µN (single precision)." in line
    line = next(
        budget.Budget(**about | {"value": 0.0231}, missed=4.2e-4, step=7.1e-9, single=8.3e-10, meshed=False).lines()
    )
    assert "23.100000 +- 0.000007 mm (step), +- 0.830 nm (single precision), +- 420 µm (between these times)." in line
    line, more, *_ = budget.Budget(**about, step=1e-4, single=2e-3, meshed=False, precision="f64").lines()
    assert "the scene's own settings in double precision:" in line
    assert line.endswith("800.00 +- 0.10 mm (step).")
    assert more == "Single precision, which the scene does not use, would add +- 2.00 mm."
    assert "single" not in next(budget.Budget(**about, meshed=False, precision="f64").lines())
    lines = list(budget.Budget(**about, step=1e-4, meshed=True).lines())
    assert "800.00 +- 0.10 mm (step), mesh not known, single precision not known." in lines[0]
    assert "--resolutions does that" in lines[1]
    for given, said in (
        ({"step": 1e-3}, "The error of the mesh is 40 times that of the step: only"),
        ({"step": 1e-3, "settling": 2e-3}, "The error of the mesh is 20 times that of the settling: only"),
        ({"step": 0.0}, "The error of the mesh is the only one beside rounding: only"),
    ):
        assert any(line.startswith(said) for line in budget.Budget(**about, **given, mesh=0.04).lines())


def test_a_peak_of_positions_may_lie_between_the_times_too(tmp_path, made_up):
    """As that of a quantity: the largest of the samples is no peak of the motion."""
    workers = made_up(pair())
    run = workers.run

    def swings(precision, trial):
        outcome = run(precision, trial)
        return outcome._replace(position=[x + 0.3 * (k == 4) for k, x in enumerate(outcome.position)])

    workers.run = swings
    report.main(pair(), plan(), tmp_path / "r", progress=False, say=lambda line: None)
    text = (tmp_path / "r" / "report.md").read_text()
    assert re.search(r"Largest rms displacement at 8 sample times .*, \+- [\d.]+ mm \(between these times\)", text)
