"""Checkpoints: of the same run only, whole or refused, and what they cost."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_resume import Remembers, Steady, _as_often_as_asked, cut_off, files, run

from taichi_sim import Scene, SceneError
from taichi_sim.analysis.probe_readings import Readings
from taichi_sim.outputs import checkpoints, frame_log, open_output
from taichi_sim.outputs.kept_files import read_kept, write_kept

pytestmark = pytest.mark.once
__all__ = ["_as_often_as_asked"]


def other_scene():
    scene = Scene(dim=2, gravity=(0, -3))
    scene.add_material("ice", friction=0.1)
    scene.add_balls([[0, 1]], radius=0.1)
    return scene


class Elsewhere(Steady):
    """The same settings, another scene."""

    scene = other_scene()


class Longer(Steady):
    settings = replace(Steady.settings, contact_iterations=7)


class Later(Steady):
    def __init__(self, step: int = 8) -> None:
        super().__init__(step)


@pytest.mark.parametrize("name", ["frames/", "x.npz"])
def test_another_run_is_refused_and_what_differs_is_named(tmp_path, name):
    cut_off(tmp_path, name, 13)
    before = files(tmp_path)
    says = rf"{name.strip('/')}: what is kept of it is of another run, which differs in "
    for kind, differs in (
        (Elsewhere, r"gravity \(\[0.0, 0.0\] then, \[0.0, -3.0\] now\), materials .*, balls.position and \d+ more;"),
        (Longer, r"contact_iterations \('auto' then, 7 now\);"),
        (Later, r"start.time \(0.0 then, 0.03+ now\), start.position, start.velocity;"),
    ):
        with pytest.raises(ValueError, match=says + differs):
            run(tmp_path, name, kind=kind, resume=True)
    with pytest.raises(ValueError, match=r"differs in fps \(60.0 then, 30.0 now\)"):
        run(tmp_path, name, fps=30.0, resume=True)
    assert files(tmp_path) == before
    assert run(tmp_path, name, resume=True).resumed == 13


def test_the_key_that_differs_is_named_with_both_values():
    then = {"scene": {"materials.grippy": {"friction": 0.5, "restitution": 0.1}, "colliders[0]": {"size": [1.0, 2.0]}}}
    now = {
        "scene": {
            "materials.grippy": {"friction": 0.6, "restitution": 0.1},
            "colliders[0]": {"size": [1.0, 3.0], "ramp": 1},
        }
    }
    assert list(frame_log._differences(then, now)) == [
        "materials.grippy.friction (0.5 then, 0.6 now)",
        "colliders[0].size ([1.0, 2.0] then, [1.0, 3.0] now)",
        "colliders[0].ramp (none then, 1 now)",
    ]


def test_another_version_is_refused(tmp_path, monkeypatch):
    cut_off(tmp_path, "x.npz", 13)
    monkeypatch.setattr("taichi_sim.__version__", "0.7")
    says = (
        r"differs in taichi_sim \('0.1.0' then, '0.7' now\); resume it as it was begun, or delete .*\.x\.npz\.resume to"
    )
    with pytest.raises(ValueError, match=says):
        run(tmp_path, "x.npz", resume=True)


def test_options_of_pictures_matter_only_where_there_are_some(tmp_path):
    for name in ("x.npz", "x.ply"):
        cut_off(tmp_path, name, 13)
        assert run(tmp_path, name, resume=True, size=(32, 24), style={"colour": "speed"}).resumed == 13
    cut_off(tmp_path, "x.gif", 13)
    with pytest.raises(ValueError, match=r"size \(.*\), colour \(none then, 'speed' now\)"):
        run(tmp_path, "x.gif", resume=True, size=(32, 24), style={"colour": "speed"})
    cut_off(tmp_path, "x.mp4", 13)
    with pytest.raises(ValueError, match=r"differs in codec \('libx264' then, 'libx265' now\)"):
        run(tmp_path, "x.mp4", resume=True, codec="h265")


def edited(path, change):
    """Change the plain values of a file that an unfinished output keeps, as if they had been written so."""
    kept = read_kept(path)
    write_kept(path, change(kept) or kept)


def last_edited(path, change):
    """The same of the last checkpoint."""
    edited(path, lambda kept: change(kept["checkpoints"][0]))


CHECKPOINT = "checkpoint.json"
DAMAGES = {
    "cut off": ("run.json", lambda p: p.write_text("{")),
    "a list": ("run.json", lambda p: p.write_text("[1]")),
    "deep": ("run.json", lambda p: p.write_text("[" * 50_000)),
    "another group": ("run.json", lambda p: edited(p, lambda kept: kept.update(version=[1]))),
    "by hand": ("run.json", lambda p: p.write_text(p.read_text().replace("0.1.0", "0.1.1"))),
    "numbers": (CHECKPOINT, lambda p: p.write_text("[1]")),
    "binary": (CHECKPOINT, lambda p: p.write_bytes(bytes(range(256)))),
    "none": (CHECKPOINT, lambda p: edited(p, lambda kept: kept.update(checkpoints=[]))),
    "frame as a text": (CHECKPOINT, lambda p: last_edited(p, lambda kept: kept.update(frame="5"))),
    "frame below 0": (CHECKPOINT, lambda p: last_edited(p, lambda kept: kept.update(frame=-5))),
    "frame by hand": (CHECKPOINT, lambda p: p.write_text(p.read_text().replace('"frame": 13', '"frame": 11'))),
    "nothing of its own": (CHECKPOINT, lambda p: last_edited(p, lambda kept: kept.update(own={}))),
    "another summary": (CHECKPOINT, lambda p: last_edited(p, lambda kept: kept["own"].update(summary={"x": 1}))),
    "a file elsewhere": (
        CHECKPOINT,
        lambda p: last_edited(p, lambda kept: kept.update(state=["../run.json", 1])),
    ),
    "no file": (CHECKPOINT, lambda p: last_edited(p, lambda kept: kept.update(state=[1]))),
    "state": ("state_000013.npz", lambda p: p.write_bytes(p.read_bytes()[:-1])),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_log_is_said(tmp_path, damage):
    """In one sentence that names the file, before anything is simulated; and it stays as it is."""
    cut_off(tmp_path, "x.npz", 13)
    name, change = DAMAGES[damage]
    change(tmp_path / ".x.npz.resume" / name)
    before, Steady.made = files(tmp_path), 0
    says = rf"/{name}: is damaged \(.+\); delete .*\.x\.npz\.resume, or leave --resume out, to begin anew$"
    with pytest.raises(SceneError, match=says) as caught:
        run(tmp_path, "x.npz", resume=True)
    assert not re.search("Expecting|Unterminated|subscript|indices|recursion|codec|__", str(caught.value))
    assert Steady.made == 0
    assert files(tmp_path) == before
    run(tmp_path, "x.npz", overwrite=True)
    assert list(files(tmp_path)) == ["x.npz"]


def test_a_checkpoint_of_the_same_frame_does_not_touch_the_last(tmp_path, monkeypatch):
    """A run that begins anew comes to frames again of which there are checkpoints; a kill between two files loses none."""
    cut_off(tmp_path, "x.npz", 13)
    (tmp_path / ".x.npz.resume" / "frames").unlink()
    before = (tmp_path / ".x.npz.resume" / CHECKPOINT).read_bytes()

    def killed(path, value):
        raise KeyboardInterrupt

    monkeypatch.setattr(frame_log, "write_kept", killed)
    monkeypatch.setattr(checkpoints, "EVERY", 0.0)
    output = open_output(tmp_path / "x.npz", resume=True)
    assert [one.frame for one in output.log.begin(read_kept(output.log.folder / "run.json"))] == [13]
    assert not output.log.holds(13)
    output.log.go_on(None)
    with pytest.raises(KeyboardInterrupt):
        output.log.keep(13, lambda path: path.write_bytes(b"other"), {})
    assert (tmp_path / ".x.npz.resume" / CHECKPOINT).read_bytes() == before
    assert [one.frame for one in output.log._checkpoints()] == [13]
    output.log.close()


def test_means_of_probes_go_on():
    """They count since the reading before, which may be one of another process."""

    class Impulse:
        name = "push"
        total = staticmethod(lambda sample: np.array([sample.total]))
        mean = staticmethod(lambda growth, interval: {"force": float(growth[0])})
        read = staticmethod(lambda sample: {})
        numbers = staticmethod(lambda dim: ("force",))

    def sample(total):
        return SimpleNamespace(total=total, scene=SimpleNamespace(dim=2))

    readings, again = Readings([Impulse()]), Readings([Impulse()])
    readings.begin(0.0, sample(1.0))
    assert np.isnan(readings.read(0.0, sample(1.0))["push.force"])
    assert readings.read(0.5, sample(4.0)) == {"push.force": 6.0}
    again.begin(0.5, sample(4.0))
    again.recall(json.loads(json.dumps(readings.memory())))
    for one in (readings, again):
        assert one.read(0.5, sample(4.0)) == {"push.force": 6.0}
        assert one.read(1.5, sample(5.0)) == {"push.force": 1.0}


# What they cost ----------------------------------------------------------------------------------------------------


class Clock:
    """Wall time that passes when something says so."""

    def __init__(self, monkeypatch) -> None:
        self.now = 0.0
        monkeypatch.setattr(checkpoints.time, "perf_counter", lambda: self.now)


def moments(monkeypatch, tmp_path, interval, cost, until, first=None, stretched=None):
    """When checkpoints are made that cost so much [s], the first one perhaps more, in a run of frames of 0.5 s."""
    clock, found = Clock(monkeypatch), []
    log = checkpoints.Checkpoints([open_output(tmp_path / "x.npz")], interval)

    class Costly(Steady):
        def save(self, path) -> None:
            super().save(path)
            clock.now += cost if len(found) > 1 or first is None else first

    while clock.now < until:
        clock.now += 0.5
        if log.due:
            found.append(clock.now)
            log.make(1, Costly(), {})
    assert log.number == len(found)
    assert log.seconds == pytest.approx(cost * len(found) + (0.0 if first is None else first - cost))
    assert log.stretched == (stretched and pytest.approx(stretched))
    return np.array(found)


def test_when_they_are_made(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "SHARE", 0.02)
    assert moments(monkeypatch, tmp_path, "auto", 0.0, 400).tolist() == [120, 180, 240, 300, 360]
    assert moments(monkeypatch, tmp_path, 20.0, 0.0, 90).tolist() == [20, 40, 60, 80]
    assert moments(monkeypatch, tmp_path, None, 0.0, 1000).tolist() == []


@pytest.mark.parametrize("cost", [0.5, 4.0, 30.0])
def test_they_take_no_more_than_a_fiftieth(tmp_path, monkeypatch, cost):
    monkeypatch.setattr(checkpoints, "SHARE", 0.02)
    found = moments(monkeypatch, tmp_path, "auto", cost, 4000)
    assert len(found) >= min(4000 / 61, 0.02 * 4000 / cost) - 2
    made = np.arange(1, len(found) + 1)
    assert (
        (made[2:] - 1) * cost <= 0.02 * (found[2:] + cost)
    ).all()  # the first one is dear, the second shows what they cost


def test_the_first_one_is_dearer_than_the_next(tmp_path, monkeypatch):
    """It imports and compiles; what was asked for is kept all the same, and where it is not, that is known."""
    monkeypatch.setattr(checkpoints, "SHARE", 0.02)
    assert moments(monkeypatch, tmp_path, 10.0, 0.0, 50, first=5.0).tolist() == [10, 25, 35, 45]
    cost, until = 0.5, 61.0
    assert moments(monkeypatch, tmp_path, 10.0, cost, until, stretched=(10.0, 24.5, 0.5)).tolist() == [10, 20.5, 50]


def test_the_summary_says_where_they_are_made_less_often_than_asked(tmp_path, monkeypatch):
    clock = Clock(monkeypatch)
    monkeypatch.setattr(checkpoints, "SHARE", 0.02)

    class Costly(Steady):
        def save(self, path) -> None:
            super().save(path)
            clock.now += 1.0

        def step(self, n):
            super().step(n)
            clock.now += 10.0

    lines = "\n".join(run(tmp_path, "x.npz", kind=Costly, checkpoint=15.0).lines())
    assert "\n             one in 15 s asked, one in 44 s taken: a checkpoint takes 1 s\n" in lines
    for often in ("auto", 3600.0):
        assert "asked" not in "\n".join(run(tmp_path, "x.npz", kind=Costly, checkpoint=often).lines())


def test_what_cannot_be_saved_is_said_once(tmp_path):
    class Own(Steady):
        def save(self, path) -> None:
            raise ValueError("save: forces of your own cannot be written to a file")

    with pytest.warns(UserWarning, match="no checkpoints") as said:
        run(tmp_path, "x.npz", kind=Own)
    assert [str(one.message) for one in said] == [
        "no checkpoints: forces of your own cannot be written to a file; a resumed run begins anew"
    ]
    cut_off(tmp_path, "x.gif", 13, kind=Own, checkpoint=None)
    assert run(tmp_path, "x.gif", kind=Own, checkpoint=None, resume=True).resumed == 0
    assert Remembers.last.skipped[:3] == [0, 1, 2]  # kept pictures are not drawn again
