"""Pictures of a recording: those of the run that wrote it, alone or by workers; other styles; files that are no recording."""

import zipfile

import numpy as np
import pytest
from physics_support import PRECISION
from PIL import Image

import taichi_sim as ts
from taichi_sim.files.checkpoint import FORMAT
from taichi_sim.outputs.recording import Recording
from taichi_sim.sweeps.pictures import draw

pytestmark = pytest.mark.slow
SIZE = (96, 54)
FORMATS = [f'"format": {number}'.encode("utf-32-le") for number in (FORMAT, FORMAT + 1)]  # texts in .npy


def torn_net():
    """A net with a weight, which tears, a moving collider and a camera that follows."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    net = ts.shapes.cloth(scene, size=(1, 1), resolution=(7, 7), pinned="corners", position=(0, 1, 0))
    scene.set_springs(net.springs, break_strain=0.1)
    scene.add_balls([[0.5, 1.2, 0.5]], radius=0.1, mass=2.0, velocity=(0, -3, 0))
    scene.add_collider(ts.Sphere((0.2, 0.3, 0.2), 0.2, velocity=(0.5, 0, 0)))
    scene.output = {"camera": {"follow": [49]}, "fps": 20.0, "duration": 0.5}
    return scene


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder with pictures, and a recording of them."""
    folder = tmp_path_factory.mktemp("run")
    with ts.Simulation(torn_net(), precision=PRECISION) as sim:
        outputs = [ts.open_output(folder / "whole"), ts.open_output(folder / "s.npz", fps=20)]
        ts.export(sim, outputs, fps=20, duration=0.5, size=SIZE, style={"camera": {"follow": [49]}})
        assert sim.torn.any()
    return folder


def pictures(folder):
    return [np.asarray(Image.open(path)) for path in sorted(folder.glob("*.png"))]


def test_a_recording_has_the_frames_of_its_run(run):
    frames = Recording(run / "s.npz")
    assert (len(frames), frames.fps) == (10, 20.0)
    with ts.Simulation(torn_net(), precision=PRECISION) as sim:
        for mine, other in zip(frames, sim.frames(fps=20, duration=0.5), strict=True):
            assert mine.time == other.time
            for name in (
                "position",
                "velocity",
                "springs",
                "triangles",
                "torn_springs",
                "torn_triangles",
                "radius",
                "strain",
            ):
                assert np.array_equal(getattr(mine, name), getattr(other, name)), name
            assert np.array_equal(mine.colliders[0].centre, other.colliders[0].centre)
            assert mine.energy == pytest.approx(tuple(other.energy), rel=1e-12)
    assert [one.time for one in frames[2:4]] == [frames[2].time, frames[3].time]


def test_it_is_drawn_as_the_run_was(run, tmp_path):
    assert draw(run / "s.npz", [tmp_path / "again"], size=SIZE, workers=0) == 10
    whole, again = pictures(run / "whole"), pictures(tmp_path / "again")
    assert len(whole) == 10
    assert all(np.array_equal(a, b) for a, b in zip(whole, again, strict=True))
    style = {"colour": "speed", "camera": {"azimuth": 70.0}}
    draw(run / "s.npz", [tmp_path / "other", tmp_path / "x.csv"], size=(64, 48), style=style, workers=0)
    assert pictures(tmp_path / "other")[0].shape == (48, 64, 3)
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 11


@pytest.mark.once
def test_workers_draw_the_same(run, tmp_path):
    pytest.importorskip("distributed")
    draw(run / "s.npz", [tmp_path / "again"], size=SIZE, workers=2, precision=PRECISION)
    assert all(np.array_equal(a, b) for a, b in zip(pictures(run / "whole"), pictures(tmp_path / "again"), strict=True))


def changed(source, target, change):
    """A copy of an archive, its members changed: None leaves one out."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for member in old.infolist():
            data = change(member.filename, old.read(member))
            if data is not None:
                new.writestr(member.filename, data)
    return target


@pytest.mark.once
@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda name, data: None if name.startswith("scene/") else data, "holds no scene that could be drawn"),
        (lambda name, data: None if name == "time.npy" else data, "is damaged"),
        (lambda name, data: data[:-8] if name == "position.npy" else data, "is damaged"),
        (lambda name, data: b"x" + data if name == "velocity.npy" else data, "is damaged"),
        (lambda name, data: data.replace(*FORMATS) if "about" in name else data, "another version"),
    ],
)
def test_other_files_are_refused(run, tmp_path, change, why):
    with pytest.raises(ts.SceneError, match=why) as error:
        Recording(changed(run / "s.npz", tmp_path / "x.npz", change))
    assert error.value.file == tmp_path / "x.npz"


@pytest.mark.once
def test_what_is_refused_before_anything_is_drawn(run, tmp_path):
    for given, why in (
        ({"style": {"colour": "sped"}}, "colour"),
        ({"style": {"azimuth": 3.0}}, "azimuth"),
        ({"workers": 1, "scheduler": "tcp://127.0.0.1:1"}, "give one of the two"),
    ):
        with pytest.raises(ts.SceneError, match=why):
            draw(run / "s.npz", [tmp_path / "x.mp4"], **{"workers": 0, **given})
    with pytest.raises(ValueError, match="holds no transparency"):
        draw(run / "s.npz", [tmp_path / "x.mp4"], style={"transparent": True}, workers=0)
    with pytest.raises(FileNotFoundError, match="no such file"):
        draw(tmp_path / "none.npz", [tmp_path / "x.mp4"], workers=0)
    assert not list(tmp_path.iterdir())


@pytest.mark.once
def test_the_command(run, tmp_path, capfd):
    from taichi_sim.cli.main import main

    def ended(*words):
        with pytest.raises(SystemExit) as end:
            main(["render", str(run / "s.npz"), "-o", str(tmp_path / "x.csv"), "--workers", "0", *words])
        return end.value.code, capfd.readouterr()

    status, said = ended("--style", "camera.azimuth=80", "--style", "colour=speed", "--fps", "10")
    assert status == 0
    assert "x.csv: 10 frames" in said.out
    for words, why in (
        (("--style", "camera"), "KEY=VALUE"),
        (("--style", "colour=sped"), "colour"),
        (("--fps", "0"), "--fps"),
        (("-o", str(tmp_path / "x.csv")), "is given twice"),
    ):
        status, said = ended(*words)
        assert status == 2, words
        assert why in said.err
        assert "Traceback" not in said.err


@pytest.mark.once
def test_a_run_drawn_by_workers_is_the_run(tmp_path, monkeypatch, capfd):
    pytest.importorskip("distributed")
    from taichi_sim.cli.main import main

    monkeypatch.chdir(tmp_path)
    common = ("--duration", "0.2", "--fps", "20", "--size", "96x54", "--arch", "cpu", "--precision", PRECISION, "-q")
    for name, words in (("a.gif", ()), ("b.gif", ("--workers", "2"))):
        with pytest.raises(SystemExit) as end:
            main(["run", "box", "-o", name, *common, *words])
        assert end.value.code == 0, capfd.readouterr().err
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "b.gif"]


@pytest.mark.once
def test_what_cannot_be_drawn_is_not_simulated_and_what_was_simulated_is_kept(tmp_path, monkeypatch, capfd):
    pytest.importorskip("distributed")
    from taichi_sim.cli.main import main
    from taichi_sim.sweeps import cluster, pictures

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cluster, "PATIENCE", 0.5)
    common = ["run", "box", "-o", "a.gif", "--duration", "0.1", "--fps", "20", "--size", "64x48", "-q"]
    with pytest.raises(SystemExit) as end:
        main([*common, "--scheduler", "tcp://127.0.0.1:9"])
    assert end.value.code == 2
    assert "no scheduler answers there" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())

    def broken(*_):
        raise OSError("disk is gone")

    monkeypatch.setattr(pictures, "_images", broken)
    with pytest.raises(SystemExit) as end:
        main([*common, "--workers", "0"])
    assert end.value.code == 2
    said = capfd.readouterr().err
    assert "disk is gone" in said
    assert "holds the run" in said
    monkeypatch.undo()
    assert draw(tmp_path / ".a.gif.states.npz", [tmp_path / "a.gif"], size=(64, 48), workers=0) == 2
