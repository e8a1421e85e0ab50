"""Videos and folders that were cut off are gone on with: nothing finished is lost, and nobody sees that it happened."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_outputs import SIZE, FakeRenderer, FakeSimulation, draw_with, make, pictures, unstable

from taichi_sim import UnstableError
from taichi_sim.outputs import Output, export, open_output

pytestmark = pytest.mark.once


@pytest.fixture(autouse=True)
def _renderer(monkeypatch):
    draw_with(monkeypatch, FakeRenderer)


def cut_off(folder, name="x.mp4", at=13, error=None, **options):
    """A run that ends at frame `at` of 30."""
    with pytest.raises(type(error or KeyboardInterrupt())):
        export(
            FakeSimulation(at, error or KeyboardInterrupt()),
            open_output(folder / name, **options),
            duration=29 / 60,
            size=SIZE,
        )


@pytest.mark.parametrize(("name", "codec"), [("x.mp4", None), ("x.mp4", "h265"), ("x.webm", None)])
def test_a_resumed_video_has_the_same_bytes(tmp_path, name, codec):
    (tmp_path / "whole").mkdir()
    make(tmp_path / "whole", name, codec=codec)
    cut_off(tmp_path, name, codec=codec)
    assert {p.name for p in tmp_path.iterdir()} == {"whole", f".{name}.resume"}
    cut_off(tmp_path, name, at=21, codec=codec, resume=True)
    out = make(tmp_path, name, codec=codec, resume=True)
    assert out.frames == 30
    assert FakeRenderer.last.first == 0.0  # the camera is placed by the first frame
    assert FakeRenderer.last.skipped == list(range(21))
    assert FakeRenderer.last.drawn == list(range(21, 30))
    assert {p.name for p in tmp_path.iterdir()} == {"whole", name}
    assert (tmp_path / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_killed_run_is_resumed(tmp_path):
    code = f"""if True:
        import os, signal, sys
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        import test_outputs as t
        from taichi_sim.outputs import export, open_output
        export.__globals__["_renderer"] = lambda frame, size, style: t.FakeRenderer(frame, size, **style)
        class Killed(t.FakeSimulation):
            def contacts(self):
                if getattr(self, "asked", 0) == 20:
                    os.kill(os.getpid(), signal.SIGKILL)
                return super().contacts()
        export(Killed(), open_output({str(tmp_path / "x.mp4")!r}), duration=29 / 60, size=t.SIZE)
    """
    ended = subprocess.run([sys.executable, "-c", code], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert any(p.suffix == ".part" for p in tmp_path.iterdir())
    out = make(tmp_path, "x.mp4", resume=True)
    assert out._kept >= 20 - 5  # at most those that waited for the writer are lost
    assert [p.name for p in tmp_path.iterdir()] == ["x.mp4"]
    assert len(pictures(tmp_path / "x.mp4")) == 30


@pytest.mark.parametrize("cut", ["truncated", "damaged", "garbage"])
def test_what_is_not_whole_is_drawn_again(tmp_path, cut):
    cut_off(tmp_path)
    journal = tmp_path / ".x.mp4.resume" / "pictures"
    data = journal.read_bytes()
    damaged = {"truncated": data[:-3], "damaged": data[:-3] + b"abc", "garbage": data + b"12345678901"}
    journal.write_bytes(damaged[cut])
    make(tmp_path, "x.mp4", resume=True)
    assert FakeRenderer.last.skipped == list(range(13 if cut == "garbage" else 12))
    assert len(pictures(tmp_path / "x.mp4")) == 30


def test_a_journal_that_is_none_is_not_gone_on_with(tmp_path):
    cut_off(tmp_path)
    (tmp_path / ".x.mp4.resume" / "pictures").write_bytes(b"something else")
    make(tmp_path, "x.mp4", resume=True)
    assert FakeRenderer.last.skipped == []
    assert [p.name for p in tmp_path.iterdir()] == ["x.mp4"]


def test_resuming_when_all_frames_are_there(tmp_path):
    class Full(FakeSimulation):
        def solver(self):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(Full(), open_output(tmp_path / "x.mp4"), duration=29 / 60, size=SIZE)
    make(tmp_path, "x.mp4", resume=True)
    assert FakeRenderer.last.drawn == []
    assert len(pictures(tmp_path / "x.mp4")) == 30


@pytest.mark.parametrize("frames", [6, 42])
def test_resuming_with_another_duration_gives_what_is_asked_for(tmp_path, frames):
    cut_off(tmp_path)
    make(tmp_path, "x.mp4", duration=frames / 60, resume=True)
    assert len(pictures(tmp_path / "x.mp4")) == frames


def test_a_run_that_is_cut_off_again_keeps_all_frames(tmp_path):
    cut_off(tmp_path)
    out = open_output(tmp_path / "x.mp4", resume=True)
    with pytest.raises(KeyboardInterrupt):
        export(FakeSimulation(5, KeyboardInterrupt()), out, duration=29 / 60, size=SIZE)
    assert out.frames == 13
    assert open_output(tmp_path / "x.mp4", resume=True)._kept == 13


def test_without_resume_a_video_starts_anew(tmp_path):
    cut_off(tmp_path)
    open_output(tmp_path / "x.mp4").discard()
    assert (
        open_output(tmp_path / "x.mp4", resume=True)._kept == 13
    )  # nothing is dropped before the first new frame is there
    make(tmp_path, "x.mp4", duration=0.2)
    assert FakeRenderer.last.skipped == []
    assert len(pictures(tmp_path / "x.mp4")) == 12


def test_other_options_are_refused(tmp_path):
    cut_off(tmp_path)
    for differs, options in (
        (r"fps \(60.0 then, 30.0 now\)", {"fps": 30.0}),
        (r"size \(\[64, 48\] then, \[32, 24\] now\)", {"size": (32, 24)}),
        (r"codec \('libx264' then, 'libx265' now\)", {"codec": "h265"}),
    ):
        says = rf"x\.mp4: what is kept of it is of another run, which differs in {differs}.*; resume it as it was begun, or"
        with pytest.raises(ValueError, match=says):
            make(tmp_path, "x.mp4", resume=True, **options)
    assert [p.name for p in tmp_path.iterdir()] == [".x.mp4.resume"]
    assert open_output(tmp_path / "x.mp4", resume=True)._kept == 13


def test_a_resumed_run_that_becomes_unstable_keeps_all_frames(tmp_path):
    cut_off(tmp_path, at=9)
    out: Output = open_output(tmp_path / "x.mp4", resume=True)
    with pytest.raises(UnstableError):
        export(FakeSimulation(9, unstable()), out, duration=29 / 60, size=SIZE)
    assert len(pictures(tmp_path / "x.mp4")) == 9


def test_a_resumed_folder_begins_with_the_first_frame(tmp_path):
    cut_off(tmp_path, "frames", at=3)
    make(tmp_path, "frames", resume=True)
    assert FakeRenderer.last.first == 0.0
    assert FakeRenderer.last.skipped == [0, 1, 2]


def test_pictures_with_alpha(tmp_path, monkeypatch):
    class Clear(FakeRenderer):
        def render(self, frame):
            image = super().render(frame)
            return np.concatenate([image, image[:, :, :1]], axis=2)

    draw_with(monkeypatch, Clear)
    style = {"transparent": True}
    export(FakeSimulation(), open_output(tmp_path / "frames"), duration=5 / 60, size=SIZE, style=style)
    with Image.open(tmp_path / "frames" / "frame_00003.png") as image:
        assert image.mode == "RGBA"
        assert np.asarray(image)[24, [2, 60]].tolist() == [[255, 0, 0, 255], [0, 0, 255, 0]]
    for name in ("x.mp4", "x.gif"):
        with pytest.raises(ValueError, match=rf"transparent: .*{name} holds no transparency; write PNG frames"):
            export(FakeSimulation(), open_output(tmp_path / name), duration=5 / 60, size=SIZE, style=style)
    assert [p.name for p in tmp_path.iterdir()] == ["frames"]


@pytest.mark.parametrize("name", ["x.mp4", "x.webm", "x.gif", "x.npz", "x.csv", "x.pvd", "x.ply", "frames/"])
def test_what_is_complete_is_left_as_it_is(tmp_path, name):
    make(tmp_path, name)
    before = {p: (p.read_bytes(), p.stat().st_ino) for p in tmp_path.rglob("*") if p.is_file()}
    out = open_output(f"{tmp_path}/{name}", resume=True)
    assert out.is_finished(30)
    other = open_output(tmp_path / "other.csv", resume=True)  # was not begun
    assert not other.is_finished(30)
    summary = export(FakeSimulation(), [out, other], duration=29 / 60, size=SIZE)
    assert summary.frames == 30
    (tmp_path / "other.csv").unlink()
    assert {p: (p.read_bytes(), p.stat().st_ino) for p in tmp_path.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("name", ["x.mp4", "x.npz", "x.csv", "x.pvd", "x.ply"])
def test_what_has_other_frames_is_made_anew(tmp_path, name):
    make(tmp_path, name)
    assert not open_output(tmp_path / name, resume=True).is_finished(42)
    assert make(tmp_path, name, duration=0.7, resume=True).frames == 42


@pytest.mark.parametrize("content", [b"", b"mine", b"PK\x05\x06" + bytes(18)])
@pytest.mark.parametrize("name", ["x.mp4", "x.npz", "x.csv"])
def test_what_is_something_else_is_made_anew(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    assert not open_output(tmp_path / name, resume=True).is_finished(30)
