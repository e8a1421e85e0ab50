"""Outputs: what they hold, that they appear complete or not at all, and the loop that feeds them."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest
from physics_support import PRECISION
from PIL import Image

import taichi_sim as ts
from taichi_sim import Frame, Scene, UnstableError
from taichi_sim.analysis.frame import Contacts, frame_count
from taichi_sim.analysis.outcome import Scales
from taichi_sim.device.backend import Backend
from taichi_sim.device.engine import ENGINE, VERSION
from taichi_sim.outputs import Output, export, open_output
from taichi_sim.outputs.companion import StepError
from taichi_sim.outputs.summary import Summary
from taichi_sim.simulation.settings import Settings

pytestmark = pytest.mark.once

SIZE = (64, 48)
NAMES = ["x.mp4", "x.gif", "x.npz", "frames/"]


class FakeSimulation:
    """Two balls in 2D that fall, as far as outputs can tell; frame `fails_at` raises `error`."""

    scene = Scene(dim=2)
    settings = Settings.resolve(scene, {})
    backend = Backend("cpu", "f32", 2)
    parts = SimpleNamespace(arguments=[()], fields=SimpleNamespace(layout=()), kernels="key")
    setup = SimpleNamespace(at_touch=False)
    time, dt, substeps = 0.0, 1e-3, 1
    torn = None

    def __init__(self, fails_at: int | None = None, error: BaseException | None = None) -> None:
        self.fails_at, self.failure = fails_at, error

    def kernels(self) -> list[str]:
        return []

    def exported(self, is_exported: bool = True) -> AbstractContextManager:
        return nullcontext()

    def frames(self, fps: float, duration: float) -> Iterator[Frame]:
        for k in range(frame_count(fps, duration)):
            if k == self.fails_at and self.failure is not None:
                raise self.failure
            yield self.frame(k / fps, k)

    def frame(self, t: float = 0.0, k: int = 0) -> Frame:
        return Frame(
            time=t,
            position=np.array([[0.0, -5 * t**2], [1.0, k]]),
            velocity=np.array([[0.0, -10 * t], [0.0, 0.0]]),
            radius=np.full(2, 0.1),
            energy=(1.0, 2.0, 3.0, 6.0 - t),
        )

    def probes(self) -> dict[str, float]:
        return {}

    def error(self) -> None:
        """Nothing controls it."""

    def decisions(self) -> list[str]:
        return []

    def solver(self) -> None:
        """Nothing to solve."""

    def scales(self) -> Scales:
        return Scales(slow=0.02, drivers=(), takers=("friction",), motion=2.0, swing=0.0, squeezes=False)

    def momentum(self) -> np.ndarray:
        return np.array([1.0, 2.0])

    def contacts(self) -> Contacts:
        self.asked = getattr(self, "asked", 0) + 1
        deep = 0.25 if self.asked == 3 else 0.01
        speeds = {"residual": 0.5 / self.asked, "rms_residual": 0.1, "largest_speed": 4.0, "unsolved": 0.1 * deep}
        counts = {"iterations": 2, "substeps": 3, "searches": self.asked - getattr(self, "restored_at", 0)}
        return Contacts(7 - self.asked % 3, deep, 0.004, 10 * deep, 0.04, **counts, **speeds)


class FakeRenderer:
    """A picture whose left part is red, right part blue; the border moves with the frame."""

    def __init__(self, frame: Frame, size: tuple[int, int], **style: object) -> None:
        self.size, self.style = size, style
        self.first, self.drawn, self.skipped = frame.time, [], []
        FakeRenderer.last = self

    def skip(self, frame: Frame) -> None:
        self.skipped.append(round(60 * frame.time))

    def render(self, frame: Frame) -> np.ndarray:
        self.drawn.append(round(60 * frame.time))
        image = np.zeros((self.size[1], self.size[0], 3), dtype=np.uint8)
        border = 2 + round(60 * frame.time) % (self.size[0] - 2)
        image[:, :border, 0] = 255
        image[:, border:, 2] = 255
        return image

    def __enter__(self) -> "FakeRenderer":
        return self

    def __exit__(self, *_: object) -> None:
        pass


def draw_with(monkeypatch, renderer):
    """Exports draw with this class."""
    made = lambda frame, size, style: renderer(frame, size, **style)  # noqa: E731
    monkeypatch.setitem(export.__globals__, "_renderer", made)


@pytest.fixture(autouse=True)
def _renderer(monkeypatch):
    draw_with(monkeypatch, FakeRenderer)


def unstable() -> UnstableError:
    return UnstableError("ball 1 is not finite", 0.1, 1, None, None)


def make(folder: Path, name: str, *, fps: float = 60.0, duration: float = 0.5, size=SIZE, **options) -> Output:
    out = open_output(f"{folder}/{name}", fps=fps, **options)
    export(FakeSimulation(), out, fps=fps, duration=duration - 1 / fps, size=size)  # without a frame at its end
    return out


def pictures(path: Path) -> list[tuple[float, np.ndarray]]:
    with av.open(str(path)) as container:
        return [(f.time, f.to_ndarray(format="rgb24")) for f in container.decode(video=0)]


@pytest.mark.parametrize(
    ("name", "codec", "found", "tag", "late", "off"),
    [
        ("x.mp4", None, "h264", "avc1", 1e-4, 12),
        ("x.mp4", "h265", "hevc", "hvc1", 2e-3, 16),
        ("x.webm", None, "vp9", "", 2e-3, 16),
        ("y.webm", "vp9", "vp9", "", 2e-3, 16),
    ],
)
def test_video(tmp_path, name, codec, found, tag, late, off):
    """late [s], off [1/255]: the largest errors of a frame's time and of its colours."""
    fps = 60 if found == "h264" else 30
    make(tmp_path, name, fps=fps, codec=codec)
    with av.open(str(tmp_path / name)) as container:
        stream = container.streams.video[0]
        assert found in stream.codec_context.name
        assert not tag or stream.codec_context.codec_tag == tag
        assert (stream.width, stream.height) == SIZE
        assert stream.codec_context.pix_fmt == "yuv420p"
        if stream.duration:  # WebM has that of the file alone
            assert stream.average_rate == fps
            assert stream.duration * stream.time_base == pytest.approx(0.5)
    frames = pictures(tmp_path / name)
    assert [t for t, _ in frames] == pytest.approx([k / fps for k in range(fps // 2)], abs=late)
    assert frames[10][1][24, 2] == pytest.approx([255, 0, 0], abs=off)
    assert frames[10][1][24, 60] == pytest.approx([0, 0, 255], abs=off)


def test_a_codec_that_does_not_fit_is_refused(tmp_path):
    for name, codec in (
        ("x.mp4", "vp9"),
        ("x.webm", "h264"),
        ("x.gif", "h264"),
        ("frames", "h265"),
        ("x.mp4", "mpeg1"),
    ):
        with pytest.raises(
            ValueError, match=f"codec: '{codec}' is not allowed for .*; there are h264, h265 for x.mp4, vp9 for x.webm"
        ):
            open_output(f"{tmp_path}/{name}", codec=codec)
    assert not list(tmp_path.iterdir())


def test_small_videos_have_the_same_bytes_in_every_run(tmp_path):
    """x264's mbtree read memory that nobody wrote."""
    found, random = set(), np.random.default_rng(0)
    pictures = np.zeros((24, 64, 112, 3), dtype=np.uint8)
    for k, image in enumerate(pictures):
        image[:, : 2 + 3 * k, 0], image[:, 2 + 3 * k :, 2], image[:k, :, 1] = 255, 255, 255
    for k in range(6):
        _ = [random.integers(0, 255, size, dtype=np.uint8) for size in random.integers(100, 20_000, 500)]  # used memory
        with open_output(tmp_path / f"{k}.mp4") as out:
            for index, image in enumerate(pictures):
                out.write(index, FakeSimulation().frame(), image)
        found.add((tmp_path / f"{k}.mp4").read_bytes())
    assert len(found) == 1


class Slow(Output):
    """Takes its time in a thread of its own, and fails at one frame."""

    apart = True
    fails = -1

    def __init__(self) -> None:
        self.seen: list[int] = []
        self.threads: set[str] = set()
        self.ended = ""

    def write(self, index, frame, image) -> None:
        time.sleep(0.002)
        if index == self.fails:
            raise OSError("the disk is full")
        self.seen.append(index)
        self.threads.add(threading.current_thread().name)

    def finish(self) -> None:
        self.ended = f"finished after {len(self.seen)}"

    def discard(self) -> None:
        self.ended = "discarded"


def test_frames_are_written_in_order_by_a_thread_of_their_own():
    out = Slow()
    export(FakeSimulation(), out, fps=60, duration=29 / 60, size=SIZE)
    assert out.seen == list(range(30))
    assert out.frames == 30
    assert out.threads == {"writing frames"}
    assert out.ended == "finished after 30"
    assert "writing frames" not in {thread.name for thread in threading.enumerate()}


@pytest.mark.parametrize("frame", [3, 29])
def test_what_the_writer_raises_ends_the_run(frame):
    out = Slow()
    out.fails = frame
    with pytest.raises(OSError, match="the disk is full"):
        export(FakeSimulation(), out, fps=60, duration=29 / 60, size=SIZE)
    assert out.seen == list(range(frame))
    assert out.ended == "discarded"


def test_all_frames_are_written_before_an_unstable_run_ends():
    out = Slow()
    with pytest.raises(UnstableError):
        export(FakeSimulation(7, unstable()), out, fps=20, duration=1.0, size=SIZE)
    assert out.seen == list(range(7))
    assert out.ended == "finished after 7"


def test_video_of_odd_size_and_fractional_rate(tmp_path):
    with pytest.warns(UserWarning, match=r"x\.mp4: a video has even sides, so that of 33 x 31 px is 34 x 32 px"):
        make(tmp_path, "x.mp4", fps=29.97, duration=6 / 29.97, size=(33, 31))
    frames = pictures(tmp_path / "x.mp4")
    assert frames[0][1].shape == (32, 34, 3)
    assert frames[5][0] == pytest.approx(5 / 29.97, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "fps", "shown", "shortest"),
    [
        ("x.gif", 25, 25, 20),
        ("x.gif", 60, 40, 20),
        ("x.gif", 7, 7, 20),
        ("x.webp", 60, 60, 10),
        ("x.webp", 200, 60, 10),  # as many as differ: WebP shows like ones as one
    ],
)
def test_animations_keep_the_duration(tmp_path, name, fps, shown, shortest):
    make(tmp_path, name, fps=fps, duration=1.0)
    with Image.open(tmp_path / name) as image:
        assert image.size == SIZE
        assert image.info["loop"] == 0
        times = []
        for k in range(image.n_frames):
            image.seek(k)
            image.load()
            times.append(image.info["duration"])
    assert len(times) == shown
    assert sum(times) == 1000
    assert min(times[:-1]) >= shortest
    if fps == shown < 25:  # each begins in the hundredth of a second that is the nearest
        assert np.cumsum(times[:-1]).tolist() == [10 * round(100 * k / fps) for k in range(1, shown)]


def test_png_folder(tmp_path):
    make(tmp_path, "frames", duration=0.1)
    files = sorted(p.name for p in (tmp_path / "frames").iterdir())
    assert files == [f"frame_{k:05d}.png" for k in range(6)]
    with Image.open(tmp_path / "frames" / files[3]) as image:
        assert np.asarray(image)[24, [2, 60]].tolist() == [[255, 0, 0], [0, 0, 255]]


def test_arrays(tmp_path):
    make(tmp_path, "x.npz", fps=10, duration=1.0)
    with np.load(tmp_path / "x.npz") as data:
        shapes = {name: data[name].shape for name in data.files}
        nothing = {"pinned": (0,), "springs": (0, 2), "sticks": (0,), "triangles": (0, 3)}
        state = {"time": (10,), "position": (10, 2, 2), "velocity": (10, 2, 2), "energy": (10, 4)}
        state |= {"contacts": (10,), "penetration": (10, 2), "residual": (10,), "largest_speed": (10,)}
        assert shapes == state | {
            "fps": (1,),
            "radius": (2,),
            "colour": (2, 3),
            "object": (2,),
            "names": (1,),
            "colliders": (0,),
            **nothing,
        }
        assert data["time"] == pytest.approx(np.arange(10) / 10)
        assert data["position"][:, 1, 1].tolist() == list(range(10))
        assert data["velocity"][:, 0, 1] == pytest.approx(-np.arange(10.0))
        assert data["energy"][0].tolist() == [1, 2, 3, 6]
        assert data["contacts"][:4].tolist() == [6, 5, 7, 6]
        assert data["penetration"][1:4].tolist() == [[0.01, 0.004], [0.25, 0.004], [0.01, 0.004]]
        assert data["residual"] == pytest.approx(0.5 / np.arange(1, 11))
        assert data["largest_speed"].tolist() == [4.0] * 10


@pytest.mark.parametrize(
    ("fps", "duration", "said"),
    [
        (4, 0.7, "3, 0.5 s simulated: 0.7 s is no whole number of frames"),
        (24, 0.4, "10, 0.375 s simulated: 0.4 s is no whole number of frames"),
        (3, 5.0, "16, 5 s simulated"),
        (30, 0.333333, "11, 0.3333 s simulated"),
    ],
)
def test_the_summary_tells_the_time_that_was_simulated(fps, duration, said):
    summary = export(FakeSimulation(), None, fps=fps, duration=duration)
    assert summary.lines()[0] == f"frames       {said}"
    assert summary.duration == pytest.approx((summary.frames - 1) / fps)


def test_summary():
    summary = export(FakeSimulation(), None, fps=10, duration=1.0)
    assert summary.frames == 11  # the start and the end among them
    assert summary.energy_start == (1, 2, 3, 6)
    assert summary.energy_end[3] == pytest.approx(5.0)
    assert summary.momentum == (1, 2)
    assert summary.penetration == 0.25
    assert summary.contacts == FakeSimulation.contacts(SimpleNamespace(asked=10))
    assert summary.most_contacts == 7
    assert summary.wall >= summary.simulating > 0
    text = "\n".join(summary.lines())
    for word in (
        "11, 1 s simulated",
        "6 J at the start, 5 J at the end",
        "contacts     5 at the end, 7 at most; 2 iterations in each of 3 substeps, 11 searches",
        "; largest speed 4 m/s at a frame, ball 0 at 0 s",
        "1 J of it went into friction, as expected",
        "penetration  largest 0.25 m (2.5 of a radius), mean at the end 0.004 m: wrong; take shorter steps",
        "residual     approach speed left by the contact solver: 0.001 m/s typical, good; 0.025 m/s worst, which a new impact",
        f"device       cpu, 2 threads, f32, {ENGINE} {VERSION}",
        "per simulated second",
    ):
        assert word in text


@pytest.mark.parametrize(
    ("off", "said"), [(1e-17, "0.2 J (exact to rounding)"), (0.004, "0.200 +- 0.004 J (step and rounding)")]
)
def test_the_energies_of_the_summary_have_one_unit(off, said):
    energies = {"energy_start": (0.0, 0.0, 0.3, 0.3), "energy_end": (0.0, 0.0, 0.2, 0.2)}
    lines = Summary(**energies, step_error=StepError(5e-4, energy=off)).lines()
    assert f"energy       0.3 J at the start, {said} at the end (kinetic 0, spring 0, gravity 0.2)" in lines


def test_the_summary_has_the_last_least_and_largest_reading_of_probes():
    """Of a mean, which has none at first, too."""

    class Probed(FakeSimulation):
        def probes(self):
            read = (1.0, 5.0, -2.0, 3.0)[self.asked - 1]
            return {"a": read, "mean": read if self.asked > 1 else np.nan}

    assert export(Probed(), None, fps=10, duration=0.3).probes == {"a": (3, -2, 5), "mean": (3, -2, 5)}


def test_the_summary_lines_up_probes_and_says_once_what_is_exact():
    known = {"load.magnitude": (1e-17, 1e-17, 1e-17), "b.x": (0.0, 0.0, 0.0), "c.x": (0.01, 0.01, 0.01)}
    known["d.x"] = (0.01, 0.0, 0.01)
    off = StepError(5e-4, probes=known)
    read = {"load.magnitude": (9.0, 8.0, 9.5), "b.x": (2.0, 2.0, 2.0), "c.x": (1.0, 0.5, 2.0), "d.x": (1.0, 0.5, 2.0)}
    lines = Summary(
        probes=read, units={"load.magnitude": "N", "b.x": "m", "c.x": "m", "d.x": "m"}, step_error=off
    ).lines()
    for line in (
        "load.magnitude 9.00 N in the last frame; least 8.00 N, peak 9.50 N of all frames (exact to rounding)",
        "b.x            2.00 m in all frames (exact to rounding)",
        "c.x            1.000 +- 0.010 m in the last frame; least 500 +- 10 mm, peak 2.000 +- 0.010 m at and between frames"
        " (step and rounding)",
        "d.x            1.000 +- 0.010 m in the last frame; least 500 mm (exact to rounding), peak 2.000 +- 0.010 m at and"
        " between frames (step and rounding)",
    ):
        assert line in lines


def test_the_summary_counts_edges_that_go_through_triangles():
    """Not of surfaces that collide, which let nothing through, and not of so many that it takes long."""

    class Crossed(FakeSimulation):
        scene = Scene(dim=3)
        scene.add_balls(np.zeros((9, 3)), radius=0.1)
        scene.add_triangles([[0, 1, 2], [3, 4, 5]])

        def contacts(self):
            return super().contacts()._replace(number=0)

        def crossings(self):
            return 2

    class Apart(Crossed):
        scene = Scene(dim=3)
        scene.add_balls(np.zeros((9, 3)), radius=0.1)
        scene.add_triangles([[0, 1, 2], [3, 4, 5]], collides=True)

    class Large(Crossed):
        scene = Scene(dim=3)
        scene.add_balls(np.zeros((9, 3)), radius=0.1)
        scene.add_triangles([[0, 1, 2]] * 10_001)

    says = {Crossed: "2 edges of surfaces go through triangles at the end: look at it; ", Large: "too many triangles; "}
    for kind in (Crossed, Apart, Large):
        lines = [line for line in export(kind(), None, fps=60.0, duration=0.05).lines() if line.startswith("crossings")]
        assert len(lines) == (kind in says)
        assert all(says[kind] + "surface_collision = true keeps" in line for line in lines)


def test_the_summary_says_how_much_has_torn():
    class Tearing(FakeSimulation):
        scene = Scene(dim=2)
        scene.add_balls([[0, 0], [1, 0], [2, 0]], radius=0.1)
        scene.add_springs([[0, 1], [1, 2]], stiffness=1.0, break_strain=[0.5, np.inf])
        torn = np.array([True, False])

    summary = export(Tearing(), None, fps=60.0, duration=0.05)
    assert "torn         1 of the 1 springs that may tear" in summary.lines()
    assert summary.torn == (1, 1)
    assert not any(line.startswith("torn") for line in export(FakeSimulation(), None, fps=60.0, duration=0.05).lines())


def test_a_short_run_says_how_fast_a_long_one_is(monkeypatch):
    """What is there only once, 8 s before the first frame and 5 s for its picture, is no part of the 3 s a frame."""
    clock = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])

    class Slow(FakeSimulation):
        def frames(self, fps, duration):
            for k, frame in enumerate(super().frames(fps, duration)):
                clock[0] += 2.0 if k else 8.0
                yield frame

    class SlowAtFirst(FakeRenderer):
        def render(self, frame):
            clock[0] += 1.0 if frame.time else 5.0
            return super().render(frame)

    class Pictures(Output):
        def write(self, index, frame, image):
            assert image is not None

    draw_with(monkeypatch, SlowAtFirst)
    for count in (2, 5):
        begin = clock[0]
        summary = export(Slow(), Pictures(), fps=10, duration=(count - 1) / 10, size=SIZE)
        assert summary.wall == clock[0] - begin == 13.0 + 3.0 * (count - 1)
        assert summary.lines()[-1].endswith(": 30 s per simulated second without compiling and starting")
    assert "per simulated" not in export(Slow(), None, fps=10, duration=0.0).lines()[-1]


def test_a_summary_without_contacts_does_not_speak_of_them():
    class Free(FakeSimulation):
        def contacts(self) -> Contacts:
            return Contacts(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 1, 4.0, 0)

        def scales(self) -> Scales:
            return super().scales()._replace(takers=("damping",))

    text = "\n".join(export(Free(), None, fps=10, duration=1.0).lines())
    assert "momentum" in text
    assert "contacts" not in text
    assert "penetration" not in text


@pytest.mark.parametrize("name", NAMES[:3])
def test_nothing_under_the_final_name_before_the_end(tmp_path, name):
    class EnergyMonitor(FakeSimulation):
        def contacts(self) -> Contacts:
            assert not (tmp_path / name).exists()
            return super().contacts()

    export(EnergyMonitor(), open_output(tmp_path / name), fps=20, duration=0.5, size=SIZE)
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_unstable_keeps_the_frames_so_far(tmp_path):
    for name in NAMES:
        out = open_output(f"{tmp_path}/{name}", fps=20)
        with pytest.raises(UnstableError):
            export(FakeSimulation(7, unstable()), out, fps=20, duration=1.0, size=SIZE)
        assert out.frames == 7
    assert len(pictures(tmp_path / "x.mp4")) == 7
    assert np.load(tmp_path / "x.npz")["time"].shape == (7,)
    assert Image.open(tmp_path / "x.gif").n_frames == 7
    assert len(list((tmp_path / "frames").iterdir())) == 7
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frames", "x.gif", "x.mp4", "x.npz"]


@pytest.mark.parametrize("name", NAMES)
def test_unstable_at_once_leaves_nothing(tmp_path, name):
    with pytest.raises(UnstableError):
        export(FakeSimulation(0, unstable()), open_output(f"{tmp_path}/{name}"), size=SIZE)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", NAMES[:3])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError()], ids=["interrupted", "error"])
def test_any_other_end_leaves_what_was_there(tmp_path, name, error):
    (tmp_path / name).write_text("old")
    with pytest.raises(type(error)):
        export(FakeSimulation(5, error), open_output(tmp_path / name), size=SIZE)
    kept = [] if name == "x.npz" else [f".{name}.resume"]
    assert sorted(p.name for p in tmp_path.iterdir()) == [*kept, name]
    assert (tmp_path / name).read_text() == "old"


def test_overwrite_replaces_frames_and_nothing_else(tmp_path):
    make(tmp_path, "frames", duration=0.2)
    (tmp_path / "frames" / "notes.txt").write_text("mine")
    open_output(tmp_path / "frames", overwrite=True).discard()
    assert len(list((tmp_path / "frames").iterdir())) == 13  # nothing is deleted before the first frame is there
    make(tmp_path, "frames", duration=0.05, overwrite=True)
    assert sorted(p.name for p in (tmp_path / "frames").iterdir()) == [
        "frame_00000.png",
        "frame_00001.png",
        "frame_00002.png",
        "notes.txt",
    ]


def test_names_that_cannot_be_written(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.txt").write_text("")
    (tmp_path / "file").write_text("")
    for name, error, message in (
        (
            "x.avi",
            ValueError,
            r"'\.avi' is not allowed; use x\.mp4, x\.webm, x\.gif, x\.webp, x\.npz, .* x\.ply, x\.obj or folder/",
        ),
        ("none/x.mp4", FileNotFoundError, "there is no folder"),
        ("none/frames", FileNotFoundError, "there is no folder"),
        ("full", FileExistsError, "not empty; use --overwrite"),
        ("file", NotADirectoryError, "is a file"),
    ):
        with pytest.raises(error, match=message):
            open_output(tmp_path / name)
    with pytest.raises(ValueError, match="exclude each other"):
        open_output(tmp_path / "full", resume=True, overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "full"]


def test_an_output_of_the_users_own():
    """The example of taichi_sim.outputs.base."""
    heights = []

    class Heights(Output):
        needs_image = False

        def write(self, index, frame, image):
            assert image is None
            heights.append(frame.position[:, 1].max())

    export(FakeSimulation(), Heights(), fps=10, duration=0.5)
    assert heights == [0, 1, 2, 3, 4, 5]


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


LOADS = """
import sys
from taichi_sim.outputs import open_output

output, before = open_output("x.usda"), set(sys.modules)
output.finish()
print(*(name for name in set(sys.modules) - before if name.startswith("pxr")))
"""


@pytest.mark.skipif(find_spec("pxr") is None, reason="usd-core")
def test_usd_loads_its_libraries_before_another_output_has_a_thread(tmp_path):
    """They wait for the thread that runs Python, and a film's, which loads its own at the first frame, for theirs: for ever."""
    done = subprocess.run([sys.executable, "-c", LOADS], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr
    assert (tmp_path / "x.usda").is_file()


@pytest.mark.parametrize("end", ["finish", "discard"])
@pytest.mark.parametrize("name", ["x.mp4", "x.gif", "x.npz", "frames/", "x.csv", "x.pvd", "x.ply"])
def test_what_has_ended_takes_no_more_frames(tmp_path, name, end):
    """It said nothing, and left parts of files."""
    output, frame, image = open_output(f"{tmp_path}/{name}"), FakeSimulation().frame(), np.zeros((48, 64, 3), np.uint8)
    getattr(output, end)()
    before = {path for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=r"was finished or discarded, and takes no more frames; open it anew$"):
        output.write(0, frame, image if output.needs_image else None)
    output.discard()
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("name", ["twice.csv", "twice.npz", "twice.ply"])
def test_an_output_takes_the_frames_of_one_export(tmp_path, name):
    """Of the second one it said that a file of its own was missing."""
    scene = ts.Scene(dim=2)
    scene.add_balls([0.0, 1.0], radius=0.1)
    with ts.Simulation(scene, arch="cpu", precision=PRECISION, contacts="off", dt=0.01) as sim:
        output = ts.open_output(tmp_path / name)
        ts.export(sim, output, fps=50, duration=0.04)
        written = {file: file.read_bytes() for file in tmp_path.iterdir()}
        with pytest.raises(
            ValueError, match=rf"{name}: was finished or discarded, and takes no more frames; open it anew$"
        ):
            ts.export(sim, output, fps=50, duration=0.04)
        assert {file: file.read_bytes() for file in tmp_path.iterdir()} == written
