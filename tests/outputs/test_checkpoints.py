"""Runs that go on from a checkpoint: the same files as without an interruption, of the same run only, and what they cost."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_outputs import SIZE, FakeRenderer, FakeSimulation, draw_with

from taichi_sim import Scene, SceneError
from taichi_sim.analysis.probe_readings import Readings
from taichi_sim.outputs import checkpoints, export, open_output, run_log
from taichi_sim.outputs.kept_files import read_kept, write_kept

pytestmark = pytest.mark.once

NAMES = ["x.mp4", "x.webm", "x.gif", "x.webp", "frames/", "x.npz", "x.ply", "x.obj"]


class Steady(FakeSimulation):
    """Steps, and can be written to a file. It is interrupted at the frame `ends`; `steps` counts those of all of them."""

    dt = 1 / 240
    ends, made = -1, 0

    def __init__(self, step: int = 0) -> None:
        super().__init__()
        self.at, self.asked, self.readings = step, (step + 4) // 4 if step else 0, Readings(())

    @property
    def time(self):
        return self.at * self.dt

    def step(self, n: int) -> None:
        self.at += n
        Steady.made += n

    def frame(self):
        return super().frame(self.at / 240, self.at // 4)

    def frames(self, fps, duration):
        for k in range(round(fps * duration) + 1):
            self.step(round(k / fps / self.dt) - self.at)
            yield self.frame()

    def contacts(self):
        if self.at == 4 * self.ends:
            raise KeyboardInterrupt
        return super().contacts()

    def save(self, path) -> None:
        Path(path).write_text(json.dumps(self.at))

    @classmethod
    def restore(cls, path, **_):
        return cls(json.loads(Path(path).read_text()))

    def close(self) -> None:
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


class Remembers(FakeRenderer):
    """Its pictures depend on how many frames there were before."""

    seen = 0

    def skip(self, frame):
        super().skip(frame)
        self.seen += 1

    def render(self, frame):
        image = super().render(frame)
        self.seen += 1
        image[: self.seen, :, 1] = 255
        return image

    def memory(self):
        return {"seen": self.seen}

    def recall(self, memory):
        self.seen = memory["seen"]


@pytest.fixture(autouse=True)
def _as_often_as_asked(monkeypatch):
    monkeypatch.setattr(checkpoints, "SHARE", 1e9)
    monkeypatch.setattr(Steady, "made", 0)
    draw_with(monkeypatch, Remembers)


def run(folder, name, ends=-1, *, kind=Steady, fps=60, **options):
    """An export of 30 frames, with a checkpoint after each."""
    Steady.ends = ends
    given = {key: options.pop(key) for key in ("duration", "size", "style", "checkpoint") if key in options}
    output = open_output(f"{folder}/{name}", fps=fps, **options)
    duration = given.pop("duration", 0.5) - 1 / fps  # without a frame at its end
    return export(kind(), output, duration=duration, **({"size": SIZE, "checkpoint": 1e-9, "fps": fps} | given))


def cut_off(folder, name, ends, **options):
    with pytest.raises(KeyboardInterrupt):
        run(folder, name, ends, **options)


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("name", NAMES)
def test_what_comes_out_is_what_an_undisturbed_run_writes(tmp_path, name):
    (whole := tmp_path / "whole").mkdir()
    summary = run(whole, name, checkpoint=None)
    (folder := tmp_path / "cut").mkdir()
    Steady.made = 0
    cut_off(folder, name, 13)
    cut_off(folder, name, 21, resume=True)
    again = run(folder, name, resume=True)
    assert files(folder) == files(whole)
    assert Steady.made == 29 * 4 + 2 * 4  # the frame that an interruption came at is simulated once more, no other
    assert again.resumed == 21
    assert again.checkpoints == 29
    assert again.lines()[:5] == summary.lines()[:5]


def test_arrays_beyond_the_checkpoint_are_written_again(tmp_path):
    cut_off(tmp_path, "x.npz", 13)
    for column in tmp_path.glob(".x.npz.resume/column_*"):
        column.write_bytes(column.read_bytes() + b"rows since then, the last cut off")
    run(tmp_path, "x.npz", resume=True)
    found = (tmp_path / "x.npz").read_bytes()
    run(tmp_path, "x.npz")
    assert (tmp_path / "x.npz").read_bytes() == found


def test_gif_frames_that_are_left_out_are_counted(tmp_path):
    """60 frames a second are more than a GIF shows; the last of them are left out here, and one is cut off at each."""
    (whole := tmp_path / "whole").mkdir()
    run(whole, "x.gif", duration=0.2)
    for ends in (9, 10, 11):
        (folder := tmp_path / str(ends)).mkdir()
        cut_off(folder, "x.gif", ends, duration=0.2)
        run(folder, "x.gif", resume=True, duration=0.2)
        assert files(folder) == files(whole)


def test_the_output_is_finished_where_no_frame_is_left(tmp_path):
    cut_off(tmp_path, "x.npz", 13)
    summary = run(tmp_path, "x.npz", resume=True, duration=13 / 60)
    assert (summary.frames, summary.resumed) == (13, 13)
    assert np.load(tmp_path / "x.npz")["time"].shape == (13,)


def test_a_shorter_run_begins_anew(tmp_path):
    cut_off(tmp_path, "x.npz", 13)
    assert run(tmp_path, "x.npz", resume=True, duration=0.1).resumed == 0
    assert np.load(tmp_path / "x.npz")["time"].shape == (6,)
    assert [p.name for p in tmp_path.iterdir()] == ["x.npz"]


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
    assert list(run_log._differences(then, now)) == [
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


@pytest.mark.parametrize(
    ("name", "lost"), [*((name, "frames") for name in NAMES), ("x.gif", "state"), ("x.ply", "state")]
)
def test_without_what_a_checkpoint_needs_the_run_begins_anew(tmp_path, name, lost):
    cut_off(tmp_path, name, 13)
    log = tmp_path / "frames/.resume" if name == "frames/" else tmp_path / f".{name}.resume"
    for pattern in {
        "state": [".*.resume/state_*"],
        "frames": [".*.resume/pictures", ".*.resume/column_001", "*/frame_00004.png", "x_00004.*"],
    }[lost]:
        for file in tmp_path.glob(pattern):
            file.unlink()
    assert log.is_dir()
    assert run(tmp_path, name, resume=True).resumed == 0
    (whole := tmp_path / "whole").mkdir()
    run(whole, name)
    assert {k: v for k, v in files(tmp_path).items() if not k.startswith("whole")} == files(whole)


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
    "another output": (CHECKPOINT, lambda p: last_edited(p, lambda kept: kept["own"].update(output={"x": 1}))),
    "another summary": (CHECKPOINT, lambda p: last_edited(p, lambda kept: kept["own"].update(summary={"x": 1}))),
    "a file elsewhere": (
        CHECKPOINT,
        lambda p: last_edited(p, lambda kept: kept["files"].update(state=["../run.json", 1])),
    ),
    "no file": (CHECKPOINT, lambda p: last_edited(p, lambda kept: kept.update(files=[1]))),
    "state": ("state_000013.npz", lambda p: p.write_bytes(p.read_bytes()[:-1])),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_log_is_said(tmp_path, damage):
    """In one sentence that names the file, before anything is simulated; and it stays as it is."""
    cut_off(tmp_path, "x.npz", 13)
    name, change = DAMAGES[damage]
    change(tmp_path / ".x.npz.resume" / name)
    before, Steady.made = files(tmp_path), 0
    says = rf"/{name}: is damaged \(.+\); delete .*\.x\.npz\.resume, or use --overwrite in place of --resume, to begin anew$"
    with pytest.raises(SceneError, match=says):
        run(tmp_path, "x.npz", resume=True)
    assert Steady.made == 0
    assert files(tmp_path) == before
    run(tmp_path, "x.npz", overwrite=True)
    assert list(files(tmp_path)) == ["x.npz"]


def test_columns_that_were_changed_are_written_again(tmp_path):
    (whole := tmp_path / "whole").mkdir()
    run(whole, "x.npz")
    (folder := tmp_path / "cut").mkdir()
    cut_off(folder, "x.npz", 13)
    column = folder / ".x.npz.resume" / "column_001"
    data = bytearray(column.read_bytes())
    data[40] ^= 1
    column.write_bytes(data)
    assert run(folder, "x.npz", resume=True).resumed == 0
    assert files(folder) == files(whole)


TOGETHER = ("x.npz", "x.mp4", "x.ply")


def run_together(folder, ends=-1, resume=False, every=1e-9):
    Steady.ends = ends
    outputs = [open_output(folder / name, fps=60, resume=resume) for name in TOGETHER]
    return export(Steady(), outputs, duration=29 / 60, size=SIZE, checkpoint=every, fps=60)


@pytest.mark.parametrize("written", [1, 2, 3, 4, 5])
def test_outputs_that_have_different_checkpoints_go_on_from_the_one_that_all_have(tmp_path, monkeypatch, written):
    """A kill after the first, the second or all of them have made theirs of frame 13, or while the one before is given up."""
    (whole := tmp_path / "whole").mkdir()
    run_together(whole, every=None)
    (folder := tmp_path / "cut").mkdir()
    steps = []

    def killed(way, step):
        def wrapped(log, *given, **more):
            if (log.checkpoint.frame if step == "settle" else given[0]) == 13:
                steps.append(step)
            if len(steps) > written:
                raise KeyboardInterrupt
            way(log, *given, **more)

        return wrapped

    with monkeypatch.context() as patch:
        for step in ("keep", "settle"):
            patch.setattr(run_log.RunLog, step, killed(getattr(run_log.RunLog, step), step))
        with pytest.raises(KeyboardInterrupt):
            run_together(folder)
    assert run_together(folder, resume=True).resumed == (13 if written > 2 else 12)
    assert files(folder) == files(whole)


def test_a_checkpoint_of_the_same_frame_does_not_touch_the_last(tmp_path, monkeypatch):
    """A run that begins anew comes to frames again of which there are checkpoints; a kill between two files loses none."""
    cut_off(tmp_path, "x.npz", 13)
    (tmp_path / ".x.npz.resume" / "column_001").unlink()
    before = (tmp_path / ".x.npz.resume" / CHECKPOINT).read_bytes()

    def killed(path, value):
        raise KeyboardInterrupt

    monkeypatch.setattr(run_log, "write_kept", killed)
    monkeypatch.setattr(checkpoints, "EVERY", 0.0)
    output = open_output(tmp_path / "x.npz", resume=True)
    assert output.begin(json.loads(json.dumps(read_kept(output.log.folder / "run.json"))), 30, False) == []
    with pytest.raises(KeyboardInterrupt):
        output.log.keep(13, {"state": lambda path: path.write_bytes(b"other")}, {})
    assert (tmp_path / ".x.npz.resume" / CHECKPOINT).read_bytes() == before
    assert [one.frame for one in output.log._checkpoints()] == [13]
    output.log.close()


def test_frames_of_an_unknown_run_are_not_resumed(tmp_path):
    run(tmp_path, "frames", duration=0.1)
    with pytest.raises(FileExistsError, match="nothing says which run its frames are of"):
        run(tmp_path, "frames", duration=0.2, resume=True)


@pytest.mark.parametrize("name", ["x.mp4", "frames/", "x.ply"])
def test_two_runs_do_not_write_the_same_output(tmp_path, name):
    class Second(Steady):
        def contacts(self):
            if self.at == 20:
                for resume in (False, True):
                    with pytest.raises((OSError, FileExistsError), match=r"another run is writing it|not empty"):
                        export(Steady(), open_output(f"{tmp_path}/{name}", resume=resume), duration=29 / 60, size=SIZE)
            return super().contacts()

    run(tmp_path, name, kind=Second)
    Steady.ends = -1
    assert not [file for file in files(tmp_path) if "resume" in file or "part" in file]


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
