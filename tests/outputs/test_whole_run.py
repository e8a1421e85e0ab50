"""Exports that are simulated to their end before they are drawn: their cameras show all, and they are resumed as others are."""

from importlib.util import find_spec

import numpy as np
import pytest
from test_outputs import SIZE, FakeRenderer, draw_with

import taichi_sim as ts
from taichi_sim import UnstableError
from taichi_sim.common import progress
from taichi_sim.device import compiling
from taichi_sim.outputs import checkpoints, export, open_output, whole_run
from taichi_sim.outputs.export import _Frames
from taichi_sim.render import Renderer

pytestmark = pytest.mark.once
COUNT = 30
OPTIONAL = [name for name, module in (("x.gsd", "gsd"), ("x.usda", "pxr")) if find_spec(module)]


def scene(pull=9.0):
    """Two balls on a spring that tears, and one far above the ground that they fall to."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_material("rubber", restitution=0.5, friction=0.4)
    balls = scene.add_balls(
        [[0, 0.5], [1, 0.5], [0.4, 3]], velocity=[[-pull, 0], [pull, 0], [0, 0]], radius=0.1, material="rubber"
    )
    scene.add_springs([balls[:2]], stiffness=100, break_strain=0.5)
    scene.add_wall((0, 1), offset=0.0, material="rubber")
    scene.add_probe("all", kind="energy")
    return scene


class Interrupted(ts.Simulation):
    """Ends at a frame, counting from the first of the whole run."""

    ends = -1

    def contacts(self):
        if round(60 * self.time) == Interrupted.ends:
            raise KeyboardInterrupt
        return super().contacts()


class Fitted(FakeRenderer):
    """Its pictures show what it was fitted to."""

    def fit(self, frames):
        self.frames = list(frames)

    def render(self, frame):
        image = super().render(frame)
        reach = int(max(np.abs(one.position).max() for one in self.frames))
        image[: reach + len(frame.springs), :, 1] = 255
        return image


class Told(ts.Output):
    """A user's, which writes down all that a frame says of itself."""

    needs_image = False

    def __init__(self, path, resume) -> None:
        self.path, self.resume = path, resume

    def write(self, index, frame, image):
        arrays = (frame.position, frame.velocity, frame.springs, frame.torn_springs, frame.strain)
        said = [
            frame.time,
            frame.energy,
            frame.energy.kinetic,
            frame.contacts,
            frame.probes,
            *(a.tolist() for a in arrays),
        ]
        with open(self.path, "a" if index else "w") as file:
            print(*said, file=file)


@pytest.fixture(autouse=True)
def _drawn(monkeypatch):
    draw_with(monkeypatch, Fitted)
    monkeypatch.setattr(checkpoints, "SHARE", 1e9)
    monkeypatch.setattr(Interrupted, "ends", -1)


def run(folder, *names, ends=-1, resume=False, integrator="verlet", **given):
    Interrupted.ends = ends
    outputs = [
        Told(folder / name, resume) if name == "own" else open_output(f"{folder}/{name}", resume=resume)
        for name in names
    ]
    with Interrupted(scene(), dt=1 / 240, integrator=integrator) as sim:
        return export(
            sim, outputs, **{"fps": 60, "duration": (COUNT - 1) / 60, "size": SIZE, "checkpoint": None, **given}
        )


@pytest.mark.slow
def test_pictures_are_drawn_when_all_is_simulated(tmp_path):
    run(tmp_path, "x.mp4")
    frames = Fitted.last.frames
    assert len(frames) == COUNT
    assert [len(frame.springs) for frame in frames] == sorted((len(frame.springs) for frame in frames), reverse=True)
    assert len(frames[0].springs) == 1
    assert len(frames[-1].springs) == 0
    assert frames[-1].springs is frames[-2].springs  # what stays the same takes no memory
    assert Fitted.last.drawn == list(range(COUNT))


@pytest.mark.slow
@pytest.mark.parametrize("camera", [{"fit": "start"}, {"centre": (0, 0), "width": 3}, {"follow": [0]}])
def test_other_cameras_are_drawn_on_the_way(tmp_path, monkeypatch, camera):
    monkeypatch.setattr(Fitted, "render", FakeRenderer.render)
    Interrupted.ends = 7
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, "frames/", ends=7, style={"camera": camera})
    assert Fitted.last.drawn == list(range(7))


@pytest.mark.slow
def test_what_is_too_much_to_keep_is_drawn_on_the_way(tmp_path, monkeypatch):
    monkeypatch.setattr(Fitted, "render", FakeRenderer.render)
    monkeypatch.setattr(whole_run, "MOST_KEPT", 3 * COUNT - 1)
    run(tmp_path, "x.mp4")
    assert Fitted.last.drawn == list(range(COUNT))
    assert not hasattr(Fitted.last, "frames")


@pytest.mark.slow
def test_frames_up_to_where_it_became_unstable_are_drawn(tmp_path, monkeypatch):
    def fails(self):
        if round(60 * self.time) == 9:
            raise UnstableError("ball 1 is not finite", 0.1, 1, None, None)
        return contacts(self)

    contacts = Interrupted.contacts
    monkeypatch.setattr(Interrupted, "contacts", fails)
    with pytest.raises(UnstableError):
        run(tmp_path, "frames/")
    assert len(list(tmp_path.glob("frames/*.png"))) == 9


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.slow
def test_what_comes_out_is_what_an_undisturbed_run_writes(tmp_path, monkeypatch):
    """Of a simulation whose springs tear, in all formats at once; test_resume has each alone."""
    names = ["x.mp4", "x.npz", "x.csv", "x.pvd", "x.ply", "own", *OPTIONAL]
    (whole := tmp_path / "whole").mkdir()
    run(whole, *names)
    (folder := tmp_path / "cut").mkdir()
    for ends in (7, 21):  # while it is simulated
        with pytest.raises(KeyboardInterrupt):
            run(folder, *names, ends=ends, resume=ends > 7, checkpoint=1e-9)
    rendered = Fitted.render

    def cut(self, frame):
        if round(60 * frame.time) >= 17:
            raise KeyboardInterrupt
        return rendered(self, frame)

    monkeypatch.setattr(Fitted, "render", cut)  # while it is drawn
    with pytest.raises(KeyboardInterrupt):
        run(folder, *names, resume=True, checkpoint=1e-9)
    monkeypatch.setattr(Fitted, "render", rendered)
    assert run(folder, *names, resume=True, checkpoint=1e-9).resumed == COUNT
    assert files(folder) == files(whole)
    assert Fitted.last.drawn == list(range(17, COUNT))


@pytest.mark.slow
def test_what_a_resumed_run_says_is_of_the_whole_run(tmp_path, monkeypatch):
    said = {}

    def note(frames, done, now, plain=_Frames.advance):
        plain(frames, done, now)
        said[frames.what, done] = frames.line()

    monkeypatch.setattr(_Frames, "advance", note)
    (cut := tmp_path / "cut").mkdir()
    whole = run(tmp_path, "x.mp4", integrator="auto")
    with pytest.raises(KeyboardInterrupt):
        run(cut, "x.mp4", ends=21, integrator="auto", checkpoint=1e-9)
    said.clear()
    resumed = run(cut, "x.mp4", integrator="auto", checkpoint=1e-9, resume=True)
    assert resumed.resumed == 21
    assert min(done for what, done in said if what == "frames simulated") == 22
    for (_, done), line in said.items():
        assert "t = " not in line or f"t = {(done - 1) / 60:.4g} s" in line
    assert any("t = " in line for line in said.values())
    assert resumed.decisions == whole.decisions
    assert whole.decisions[0].startswith("verlet by auto")
    assert resumed.contacts.searches >= whole.contacts.searches  # one more after each checkpoint


def test_the_time_left_does_not_count_compiling(monkeypatch):
    now, compiled = [50.0], [3.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(compiling, "seconds", lambda: compiled[0])
    frames = _Frames(12)
    frames.phase(lambda _: "compiling", "frames")
    frames.advance(1, 0.0)
    now[0], compiled[0] = now[0] + 94.0, compiled[0] + 90.0  # of a kernel that the second frame needs first
    frames.advance(2, 0.1)
    assert frames.line() == "2 of 12 frames, 0:00:40 left, 0.025 x real time, t = 0.1 s, 0.25 frames/s"


def test_what_is_simulated_is_kept_while_it_is_drawn(tmp_path, monkeypatch):
    """Not only up to the last checkpoint that was due."""
    monkeypatch.setattr(Fitted, "render", lambda self, frame: (_ for _ in ()).throw(KeyboardInterrupt))
    every = iter([True])
    monkeypatch.setattr(checkpoints.Checkpoints, "due", property(lambda _: next(every, False)))
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, "x.mp4", checkpoint=1e-9)
    monkeypatch.undo()
    draw_with(monkeypatch, Fitted)
    assert run(tmp_path, "x.mp4", resume=True).resumed == COUNT


def test_what_needs_no_pictures_is_written_while_they_wait(tmp_path):
    """So that it is there when the run is killed."""
    seen = []

    class Looks(ts.Output):
        needs_image = False

        def write(self, index, frame, image):
            seen.append((index, len((tmp_path / "x.csv").read_text().splitlines()) - 1))

    outputs = [open_output(tmp_path / name) for name in ("x.mp4", "x.csv", "x.pvd")]
    with Interrupted(scene(), dt=1 / 240) as sim:
        Interrupted.ends = 13
        with pytest.raises(KeyboardInterrupt):
            export(sim, [*outputs, Looks()], fps=60, duration=(COUNT - 1) / 60, size=SIZE)
    assert seen == [(k, k + 1) for k in range(13)]
    assert (tmp_path / "x.pvd").read_text().count("<DataSet") == 13
    assert Fitted.last.drawn == []


def test_another_duration_is_another_camera(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, "x.mp4", ends=13, checkpoint=1e-9)
    with pytest.raises(
        ValueError, match=r"differs in duration \(0\.48\d* then, 0\.4 now: the camera is fitted to the whole run\)"
    ):
        run(tmp_path, "x.mp4", resume=True, duration=0.4)


def test_the_last_frame_is_in_the_picture(tmp_path, monkeypatch):
    """A ball that was beyond the first picture's edge."""
    draw_with(monkeypatch, Renderer)
    looks = []
    monkeypatch.setattr(Renderer, "render", lambda self, frame: looks.append((self.camera, frame)) or _blank())
    run(tmp_path, "x.mp4")
    camera, frame = looks[-1]
    place = (frame.position - camera.low) * camera.scale
    assert np.all((place > 0) & (place < SIZE))
    with ts.Simulation(scene(), dt=1 / 240) as sim, Renderer(sim.frame(), SIZE) as renderer:
        place = (frame.position - renderer.camera.low) * renderer.camera.scale
        assert not np.all((place > 0) & (place < SIZE))


def _blank():
    return np.zeros((SIZE[1], SIZE[0], 3), dtype=np.uint8)
