"""Runs that are cut off and resumed: what comes out is what an undisturbed run writes, in every format and in a user's own."""

import json
import os
import signal
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
from test_outputs import SIZE, FakeRenderer, FakeSimulation, draw_with, make, pictures, unstable

from taichi_sim import Scene, UnstableError
from taichi_sim.analysis.frame import frame_count
from taichi_sim.analysis.probe_readings import Readings
from taichi_sim.common.signals import insistent_signals
from taichi_sim.outputs import Output, checkpoints, export, frame_log, open_output

pytestmark = pytest.mark.once

COUNT = 30


class Steady(FakeSimulation):
    """Steps, and can be written to a file. It is interrupted at the frame `ends`; `made` counts the steps of all of them."""

    dt = 1 / 240
    ends, made = -1, 0

    def __init__(self, step: int = 0) -> None:
        super().__init__()
        self.at, self.asked, self.readings = step, (step + 4) // 4 if step else 0, Readings(())
        self.restored_at = self.asked  # searches count from there

    @property
    def time(self):
        return self.at * self.dt

    def step(self, n: int) -> None:
        self.at += n
        Steady.made += n

    def frame(self):
        return super().frame(self.at / 240, self.at // 4)

    def frames(self, fps, duration):
        for k in range(frame_count(fps, duration)):
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


class Whole(Steady):
    """Its camera shows all of the run, so that pictures are drawn at the end."""

    scene = Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [1.0, 0.0]], radius=0.1)


class Remembers(FakeRenderer):
    """Its pictures depend on the frames that were before, or that it was fitted to. It is interrupted at the picture `ends`."""

    seen, ends = 0, -1

    def fit(self, frames):
        self.seen = len(list(frames)) - len(frames[-1].position)

    def skip(self, frame):
        super().skip(frame)
        self.seen += 1

    def render(self, frame):
        if 0 <= Remembers.ends <= round(60 * frame.time):
            raise KeyboardInterrupt
        image = super().render(frame)
        self.seen += 1
        image[: self.seen, :, 1] = 255
        return image

    def memory(self):
        return {"seen": self.seen}

    def recall(self, memory):
        self.seen = memory["seen"]


class Own(Output):
    """A user's: it knows nothing of resuming."""

    def __init__(self, path, resume) -> None:
        self.path, self.resume = path, resume

    def write(self, index, frame, image):
        with open(self.path, "ab" if index else "wb") as file:
            contacts = frame.contacts._replace(searches=0)  # which a simulation that is restored counts anew
            said = (index, frame.time, frame.energy, contacts, *frame.position.ravel())
            file.write(repr(said).encode() + image.tobytes())


@pytest.fixture(autouse=True)
def _as_often_as_asked(monkeypatch):
    monkeypatch.setattr(checkpoints, "SHARE", 1e9)
    monkeypatch.setattr(Steady, "made", 0)
    monkeypatch.setattr(Steady, "ends", -1)
    monkeypatch.setattr(Remembers, "ends", -1)
    draw_with(monkeypatch, Remembers)


def run(folder, names, ends=-1, *, kind=Steady, fps=60, **options):
    """An export of 30 frames into a name, or several, with a checkpoint after each."""
    Steady.ends = ends
    given = {key: options.pop(key) for key in ("duration", "size", "style", "checkpoint") if key in options}
    names = [names] if isinstance(names, str) else names
    made = [
        Own(folder / name, options.get("resume", False)) if name == "own" else open_output(f"{folder}/{name}", fps=fps, **options)
        for name in names
    ]  # fmt: skip
    duration = given.pop("duration", COUNT / 60) - 1 / fps  # without a frame at its end
    return export(kind(), made, duration=duration, **({"size": SIZE, "checkpoint": 1e-9, "fps": fps} | given))


def cut_off(folder, names, ends, **options):
    with pytest.raises(KeyboardInterrupt):
        run(folder, names, ends, **options)


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


OPTIONAL = {"x.gsd": "gsd", "x.usda": "pxr", "x.usdc": "pxr"}
FORMATS = ["x.mp4", "x.webm", "x.gif", "x.webp", "frames/", "x.npz", "x.glb", "x.ply", "x.obj", "x.pvd", "x.csv", "own"]
FORMATS += [name for name, module in OPTIONAL.items() if find_spec(module)]
TOGETHER = ("x.npz", "x.mp4", "own", "x.ply")
MIXED = ("x.csv", "x.mp4", "x.pvd", "x.npz")
GROWING = ["x.mp4", "x.csv", "x.pvd", *(name for name in FORMATS if name == "x.gsd")]
DRAWN = ("x.mp4", "x.gif", "frames/", "own")


@pytest.mark.slow_where(names=["x.webm", "x.gif", "x.webp", "x.glb", "x.ply", "x.obj", "x.pvd", "x.usda", MIXED])
@pytest.mark.parametrize(
    ("names", "kind", "codec"),
    [*((name, Steady, None) for name in FORMATS), (TOGETHER, Steady, None), ("x.mp4", Steady, "h265"),
     *((name, Whole, None) for name in DRAWN), (MIXED, Whole, None)],
    ids=str,
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*is complete, and is left:UserWarning")
def test_what_comes_out_is_what_an_undisturbed_run_writes(tmp_path, names, kind, codec):
    """Cut off twice while it is simulated, and, where pictures come last, while it is drawn."""
    how = {"kind": kind, "codec": codec}
    (whole := tmp_path / "whole").mkdir()
    summary = run(whole, names, checkpoint=None, **how)
    for every in (1e-9, None):
        Steady.made = 0
        (folder := tmp_path / str(every)).mkdir()
        cut_off(folder, names, 13, checkpoint=every, **how)
        cut_off(folder, names, 21, checkpoint=every, resume=True, **how)
        drawn = 21
        if kind is Whole:
            Remembers.ends = drawn = 17
            cut_off(folder, names, -1, checkpoint=every, resume=True, **how)
            Remembers.ends = -1
        again = run(folder, names, checkpoint=every, resume=True, **how)
        assert files(folder) == files(whole)
        assert again.lines()[:5] == summary.lines()[:5]
        if every is not None:  # the frame that an interruption came at is simulated once more, no other
            assert (again.resumed, again.checkpoints) == ((21, 29) if kind is Steady else (30, 30))
            assert Steady.made == 29 * 4 + 2 * 4
        if names in ("x.mp4", "frames/", "own"):  # no picture is drawn twice
            assert Remembers.last.first == 0.0  # the camera is placed by the first frame
            assert Remembers.last.drawn == list(range(drawn, COUNT))


def test_gif_frames_that_are_left_out_are_counted(tmp_path):
    """60 frames a second are more than a GIF shows; the last of them are left out here, and one is cut off at each."""
    (whole := tmp_path / "whole").mkdir()
    run(whole, "x.gif", duration=0.2)
    for ends in (9, 10, 11):
        (folder := tmp_path / str(ends)).mkdir()
        cut_off(folder, "x.gif", ends, duration=0.2)
        run(folder, "x.gif", resume=True, duration=0.2)
        assert files(folder) == files(whole)


@pytest.mark.parametrize("frames", [6, 13, 42])
@pytest.mark.parametrize("name", ["x.npz", "x.mp4", "x.csv"])
def test_another_duration_gives_what_is_asked_for(tmp_path, name, frames):
    (whole := tmp_path / "whole").mkdir()
    run(whole, name, duration=frames / 60)
    (folder := tmp_path / "cut").mkdir()
    cut_off(folder, name, 13)
    assert run(folder, name, resume=True, duration=frames / 60).resumed == (13 if frames >= 13 else 0)
    assert files(folder) == files(whole)


def test_a_duration_of_no_whole_number_of_frames_ends_before_it(tmp_path):
    """As of an undisturbed run; and what ends at the same frame is complete."""
    (whole := tmp_path / "whole").mkdir()
    given = {"duration": 22.7 / 60}
    summary = run(whole, "x.npz", **given)
    assert summary.lines()[0] == "frames       22, 0.35 s simulated: 0.3617 s is no whole number of frames"
    (folder := tmp_path / "cut").mkdir()
    cut_off(folder, "x.npz", 13, **given)
    again = run(folder, "x.npz", resume=True, **given)
    assert (again.resumed, again.lines()[0]) == (13, summary.lines()[0])
    assert files(folder) == files(whole)
    with pytest.warns(UserWarning, match="is complete, and is left"):
        assert run(folder, "x.npz", resume=True, duration=22 / 60).complete


LOST = {
    "state": lambda folder: [p.unlink() for p in folder.glob(".*/state_*")],
    "frames": lambda folder: [p.unlink() for p in folder.glob(".*/frames")],
    "pictures": lambda folder: [p.unlink() for p in folder.glob(".*/pictures")],
    "a picture": lambda folder: (folder / "frames/frame_00004.png").unlink(),
    "a mesh": lambda folder: (folder / "x_00004.ply").unlink(),
    "the end": lambda folder: changed(folder, lambda data: data[:-3]),
    "a byte": lambda folder: changed(folder, lambda data: data[:700] + bytes([data[700] ^ 1]) + data[701:]),
    "all": lambda folder: changed(folder, lambda data: b"something else"),
}


def changed(folder, change):
    for path in [*folder.glob(".*/frames"), *folder.glob(".*/pictures")]:
        path.write_bytes(change(path.read_bytes()))


@pytest.mark.parametrize(
    ("name", "lost"),
    [*(("x.npz", lost) for lost in ("state", "frames", "the end", "a byte", "all")), ("x.mp4", "pictures"), ("x.csv", "frames"),
     ("frames/", "a picture"), ("x.ply", "a mesh"), ("x.gif", "all")],
)  # fmt: skip
def test_without_what_a_checkpoint_needs_the_run_begins_anew(tmp_path, name, lost):
    (whole := tmp_path / "whole").mkdir()
    run(whole, name)
    (folder := tmp_path / "cut").mkdir()
    cut_off(folder, name, 13)
    LOST[lost](folder)
    assert run(folder, name, resume=True).resumed == 0
    assert files(folder) == files(whole)


def test_what_the_log_has_beyond_the_checkpoint_is_made_again_or_cut_off(tmp_path):
    (whole := tmp_path / "whole").mkdir()
    run(whole, "x.npz")
    (folder := tmp_path / "cut").mkdir()
    cut_off(folder, "x.npz", 13)
    changed(folder, lambda data: data + b"rows since then, the last cut off")
    assert run(folder, "x.npz", resume=True).resumed == 13
    assert files(folder) == files(whole)


@pytest.mark.parametrize("cut", ["truncated", "damaged", "garbage"])
def test_pictures_that_are_not_whole_are_drawn_again(tmp_path, cut):
    cut_off(tmp_path, "x.mp4", 13, checkpoint=None)
    log = tmp_path / ".x.mp4.resume" / "pictures"
    data = log.read_bytes()
    log.write_bytes({"truncated": data[:-3], "damaged": data[:-3] + b"abc", "garbage": data + b"12345678901"}[cut])
    run(tmp_path, "x.mp4", resume=True)
    assert FakeRenderer.last.skipped == list(range(13 if cut == "garbage" else 12))
    assert len(pictures(tmp_path / "x.mp4")) == COUNT


def test_pictures_are_kept_until_all_is_done(tmp_path):
    """A run is cut off again before it comes to new frames, or before the first one is made anew."""
    cut_off(tmp_path, "x.mp4", 13, checkpoint=None)
    cut_off(tmp_path, "x.mp4", 5, checkpoint=None, resume=True)
    open_output(tmp_path / "x.mp4").discard()
    out = open_output(tmp_path / "x.mp4", resume=True)
    assert out.log.pictures.number == 13
    out.discard()
    assert out.frames == 13

    class Full(Steady):
        def solver(self):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, "x.mp4", kind=Full, resume=True)
    run(tmp_path, "x.mp4", resume=True)
    assert FakeRenderer.last.drawn == []
    assert len(pictures(tmp_path / "x.mp4")) == COUNT
    assert list(files(tmp_path)) == ["x.mp4"]


def test_a_killed_run_leaves_files_that_open_and_is_resumed(tmp_path, monkeypatch):
    """Those that grow are whole, and of the pictures at most those are lost that waited for the writer."""
    draw_with(monkeypatch, FakeRenderer)
    code = f"""if True:
        import os, signal, sys
        sys.path[:0] = {[str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]!r}
        import test_outputs as t
        from taichi_sim.outputs import export, open_output
        export.__globals__["_renderer"] = lambda frame, size, style: t.FakeRenderer(frame, size, **style)
        class Killed(t.FakeSimulation):
            def contacts(self):
                if getattr(self, "asked", 0) == 20:
                    os.kill(os.getpid(), signal.SIGKILL)
                return super().contacts()
        outputs = [open_output({str(tmp_path)!r} + "/" + name) for name in {GROWING}]
        export(Killed(), outputs, duration=29 / 60, size=t.SIZE)
    """
    ended = subprocess.run([sys.executable, "-c", code], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert any(p.suffix == ".part" for p in tmp_path.iterdir())
    if "x.gsd" in GROWING:
        with import_module("gsd.hoomd").open(str(tmp_path / "x.gsd")) as file:
            assert [one.particles.position[1, 1] for one in file] == list(range(20))
    rows = (tmp_path / "x.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["frame", *map(str, range(20))]
    pvd = (tmp_path / "x.pvd").read_text()
    assert pvd.endswith("</VTKFile>\n")
    assert pvd.count("<DataSet") >= 20 - 5
    resumed = [open_output(tmp_path / name, resume=True) for name in GROWING]
    export(FakeSimulation(), resumed, duration=29 / 60, size=SIZE)
    assert len(FakeRenderer.last.drawn) <= COUNT - 20 + 5
    (whole := tmp_path / "whole").mkdir()
    export(FakeSimulation(), [open_output(whole / name) for name in GROWING], duration=29 / 60, size=SIZE)
    assert {name: data for name, data in files(tmp_path).items() if "whole" not in name} == files(whole)


def test_a_resumed_run_that_becomes_unstable_keeps_all_frames(tmp_path):
    cut_off(tmp_path, "x.mp4", 9, checkpoint=None)
    with pytest.raises(UnstableError):
        export(FakeSimulation(9, unstable()), open_output(tmp_path / "x.mp4", resume=True), duration=29 / 60, size=SIZE)
    assert len(pictures(tmp_path / "x.mp4")) == 9


@pytest.mark.parametrize("written", [1, 2, 3, 4, 5])
def test_outputs_that_have_different_checkpoints_go_on_from_the_one_that_all_have(tmp_path, monkeypatch, written):
    """A kill after the first, the second or all of them have made theirs of frame 13, or while the one before is given up."""
    names = ("x.npz", "x.mp4", "x.ply")
    (whole := tmp_path / "whole").mkdir()
    run(whole, names, checkpoint=None)
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
            patch.setattr(frame_log.FrameLog, step, killed(getattr(frame_log.FrameLog, step), step))
        cut_off(folder, names, -1)
    assert run(folder, names, resume=True).resumed == (13 if written > 2 else 12)
    assert files(folder) == files(whole)


def test_of_several_outputs_one_alone_goes_on(tmp_path):
    (whole := tmp_path / "whole").mkdir()
    run(whole, ("x.gif", "x.npz"))
    (folder := tmp_path / "cut").mkdir()
    cut_off(folder, ("x.gif", "x.npz"), 13)
    assert run(folder, "x.npz", resume=True).resumed == 13
    assert (folder / "x.npz").read_bytes() == (whole / "x.npz").read_bytes()
    with pytest.warns(UserWarning, match="x.npz: is complete"):
        assert run(folder, ("x.gif", "x.npz"), resume=True).resumed == 13
    assert files(folder) == files(whole)


def interrupted(folder, names, kind, **options):
    """An export that is asked to end while it makes frame 17."""

    class Interrupted(kind):
        def contacts(self):
            if self.at == 4 * 17:
                os.kill(os.getpid(), signal.SIGTERM)
            return super().contacts()

    with pytest.raises(SystemExit), insistent_signals():
        run(folder, names, kind=Interrupted, **options)


@pytest.mark.parametrize("names", ["x.npz", ("x.csv", "x.mp4")])
@pytest.mark.parametrize("kind", [Steady, Whole])
def test_an_interrupt_makes_a_checkpoint_where_none_was_due(tmp_path, names, kind):
    """Of the frame that it came in, whether pictures are drawn meanwhile or at the end."""
    (whole := tmp_path / "whole").mkdir()
    run(whole, names, kind=kind)
    (folder := tmp_path / "cut").mkdir()
    interrupted(folder, names, kind, checkpoint="auto")
    assert run(folder, names, kind=kind, checkpoint="auto", resume=True).resumed == 18
    assert files(folder) == files(whole)


def test_no_checkpoint_is_made_at_an_interrupt_where_none_are_wanted(tmp_path):
    interrupted(tmp_path, "x.mp4", Steady, checkpoint=None)
    assert not list(tmp_path.glob(".x.mp4.resume/state*"))


def test_what_is_said_to_be_kept_is(tmp_path):
    outputs = [open_output(tmp_path / name) for name in ("x.mp4", "x.csv", "x.npz")]
    Steady.ends = 13
    with pytest.raises(KeyboardInterrupt):
        export(Whole(), outputs, fps=60, duration=29 / 60, size=SIZE, checkpoint=1e-9)
    assert [one.frames for one in outputs] == [0, 13, 13]
    assert [one.simulated for one in outputs] == [13, 0, 0]
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 1 + 13


def test_beside_one_without_a_path_there_is_no_checkpoint_but_pictures_are_kept(tmp_path):
    """Of the same run only."""

    class Nameless(Output):
        needs_image = False

        def write(self, index, frame, image):
            pass

    def exported(name, ends, resume=False, fps=60):
        Steady.ends = ends
        outputs = [open_output(tmp_path / name, resume=resume), Nameless()]
        return export(Steady(), outputs, fps=fps, duration=0.5, size=SIZE, checkpoint=1e-9)

    for name in ("x.npz", "x.mp4"):
        with pytest.raises(KeyboardInterrupt):
            exported(name, 13)
    assert [path.name for path in tmp_path.iterdir()] == [".x.mp4.resume"]
    with pytest.raises(ValueError, match=r"of another run, which differs in fps \(60.0 then, 30.0 now\)"):
        exported("x.mp4", -1, resume=True, fps=30)
    assert exported("x.mp4", -1, resume=True).resumed == 0
    assert Remembers.last.drawn == list(range(13, 31))


# What is complete --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x.mp4", "x.webm", "x.gif", "x.npz", "x.csv", "x.pvd", "x.ply", "frames/"])
def test_what_is_complete_is_left_as_it_is(tmp_path, name):
    make(tmp_path, name)
    before = {p: (p.read_bytes(), p.stat().st_ino) for p in tmp_path.rglob("*") if p.is_file()}
    out = open_output(f"{tmp_path}/{name}", resume=True)
    assert out.is_finished(COUNT)
    other = open_output(tmp_path / "other.csv", resume=True)  # was not begun
    assert not other.is_finished(COUNT)
    with pytest.warns(UserWarning, match="is complete, and is left as it is"):
        summary = export(FakeSimulation(), [out, other], duration=29 / 60, size=SIZE)
    assert summary.frames == COUNT
    (tmp_path / "other.csv").unlink()
    assert {p: (p.read_bytes(), p.stat().st_ino) for p in tmp_path.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("name", ["x.npz", "x.csv", "frames/"])
def test_what_a_run_leaves_that_is_killed_as_it_removes_its_folder_goes(tmp_path, name):
    run(tmp_path, name)
    whole = files(tmp_path)
    kept = tmp_path / name / ".resume" if name == "frames/" else tmp_path / f".{name}.resume"
    kept.mkdir()
    (kept / "lock").touch()  # the last file that is deleted
    with pytest.warns(UserWarning, match="is complete, and is left as it is"):
        run(tmp_path, name, resume=True)
    assert (files(tmp_path), kept.exists()) == (whole, False)


@pytest.mark.parametrize("duration", [0.5, 0.9])
def test_a_users_own_output_that_is_complete_is_neither_discarded_nor_simulated(tmp_path, duration):
    class Tidy(Own):
        """Deletes what is not whole."""

        def discard(self):
            self.path.unlink()

    def exported(resume):
        return export(Steady(), Tidy(tmp_path / "own", resume), fps=20, duration=duration if resume else 0.5, size=SIZE)

    exported(resume=False)
    before, Steady.made = (tmp_path / "own").read_bytes(), 0
    with pytest.warns(UserWarning, match="own: is complete, and is left as it is"):
        summary = exported(resume=True)
    assert (tmp_path / "own").read_bytes() == before
    assert Steady.made == 0
    assert summary.lines() == [f"complete     {tmp_path / 'own'}, which is left as it is"]


@pytest.mark.parametrize("name", ["x.mp4", "x.npz", "frames/"])
def test_nothing_is_simulated_where_all_outputs_are_complete(tmp_path, name):
    run(tmp_path, name)
    before, Steady.made = files(tmp_path), 0
    with pytest.warns(UserWarning, match="is complete, and is left as it is"):
        summary = run(tmp_path, name, resume=True)
    assert (Steady.made, summary.frames) == (0, 0)
    assert files(tmp_path) == before


@pytest.mark.parametrize("name", ["x.mp4", "x.npz", "x.csv", "x.pvd", "x.ply"])
def test_what_has_other_frames_or_is_something_else_is_made_anew(tmp_path, name):
    make(tmp_path, name)
    assert not open_output(tmp_path / name, resume=True).is_finished(42)
    assert make(tmp_path, name, duration=0.7, resume=True).frames == 42
    for content in (b"", b"mine", b"PK\x05\x06" + bytes(18)) if name in ("x.mp4", "x.npz", "x.csv") else ():
        (tmp_path / name).write_bytes(content)
        assert not open_output(tmp_path / name, resume=True).is_finished(COUNT)


def test_frames_of_an_unknown_run_are_not_resumed(tmp_path):
    run(tmp_path, "frames", duration=0.1)
    with pytest.raises(FileExistsError, match="nothing says which run its frames are of"):
        run(tmp_path, "frames", duration=0.2, resume=True)


@pytest.mark.parametrize("name", ["x.mp4", "frames/", "x.ply", "x.csv", "own"])
def test_two_runs_do_not_write_the_same_output(tmp_path, name):
    class Second(Steady):
        def contacts(self):
            if self.at == 20:
                before = files(tmp_path).get("x.csv")
                for resume in (False, True):
                    with pytest.raises((OSError, FileExistsError), match=r"another run is writing it|not empty"):
                        run(tmp_path, name, resume=resume)
                assert files(tmp_path).get("x.csv") == before
            return super().contacts()

    run(tmp_path, name, kind=Second)
    assert not [file for file in files(tmp_path) if "resume" in file or "part" in file]
