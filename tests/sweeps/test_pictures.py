"""Pictures of a recording: those of the run that wrote it, alone or by workers; other styles; files that are no recording."""

import io
import json
import time
import zipfile
from concurrent.futures import CancelledError
from importlib.util import find_spec

import numpy as np
import pytest
import taichi as ti
from commands import status
from physics_support import PRECISION
from PIL import Image

import taichi_sim as ts
from taichi_sim import outputs
from taichi_sim.common.atomic_file import lock
from taichi_sim.files.checkpoint import FORMAT
from taichi_sim.outputs.recording import Recording, require_drawable
from taichi_sim.studies import workers as cluster
from taichi_sim.sweeps import pictures
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
    scene.output = {"camera": {"follow": [49]}, "fps": 20.0, "duration": 0.45}
    return scene


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder with pictures, and a recording of them."""
    folder = tmp_path_factory.mktemp("run")
    with ts.Simulation(torn_net(), precision=PRECISION) as sim:
        outputs = [ts.open_output(folder / "whole"), ts.open_output(folder / "s.npz", fps=20)]
        ts.export(sim, outputs, fps=20, duration=0.45, size=SIZE, style={"camera": {"follow": [49]}})
        assert sim.torn.any()
    return folder


def images(folder):
    return [np.asarray(Image.open(path)) for path in sorted(folder.glob("*.png"))]


@pytest.mark.once
@pytest.mark.long
def test_a_recording_has_the_frames_of_its_run(run):
    frames = Recording(run / "s.npz")
    assert (len(frames), frames.fps) == (10, 20.0)
    with ts.Simulation(torn_net(), precision=PRECISION) as sim:
        for mine, other in zip(frames, sim.frames(fps=20, duration=0.45), strict=True):
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
    whole, again = images(run / "whole"), images(tmp_path / "again")
    assert len(whole) == 10
    assert all(np.array_equal(a, b) for a, b in zip(whole, again, strict=True))
    style = {"colour": "speed", "camera": {"azimuth": 70.0}}
    draw(run / "s.npz", [tmp_path / "other", tmp_path / "x.csv"], size=(64, 48), style=style, workers=0)
    assert images(tmp_path / "other")[0].shape == (48, 64, 3)
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 11


@pytest.mark.once
def test_workers_draw_the_same(run, tmp_path):
    pytest.importorskip("distributed")
    draw(run / "s.npz", [tmp_path / "again"], size=SIZE, workers=2, precision=PRECISION)
    assert all(np.array_equal(a, b) for a, b in zip(images(run / "whole"), images(tmp_path / "again"), strict=True))


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
    def ended(*words):
        code = status("render", run / "s.npz", "-o", tmp_path / "x.csv", "--workers", "0", *words)
        return code, capfd.readouterr()

    code, said = ended("--style", "camera.azimuth=80", "--style", "colour=speed", "--fps", "10")
    assert code == 0
    assert "x.csv: 10 frames" in said.out
    for words, why in (
        (("--style", "camera"), "KEY=VALUE"),
        (("--style", "colour=sped"), "colour"),
        (("--fps", "0"), "--fps"),
        (("-o", str(tmp_path / "x.csv")), "is given twice"),
    ):
        code, said = ended(*words)
        assert code == 2, words
        assert why in said.err
        assert "Traceback" not in said.err


@pytest.mark.long
@pytest.mark.once
def test_a_run_drawn_by_workers_is_the_run(tmp_path, monkeypatch, capfd):
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    common = ("--duration", "0.2", "--fps", "20", "--size", "96x54", "--arch", "cpu", "--precision", PRECISION, "-q")
    for name, words in (("a.gif", ()), ("b.gif", ("--workers", "2"))):
        assert status("run", "box", "-o", name, *common, *words) == 0, capfd.readouterr().err
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "b.gif"]


@pytest.mark.once
def test_what_cannot_be_drawn_is_not_simulated_and_what_was_simulated_is_kept(tmp_path, monkeypatch, capfd):
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cluster, "PATIENCE", 0.5)
    common = ["run", "box", "-o", "a.gif", "--duration", "0.1", "--fps", "20", "--size", "64x48", "-q"]
    assert status(*common, "--scheduler", "tcp://127.0.0.1:9") == 2
    assert "no scheduler answers there" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())

    def broken(*_):
        raise OSError("disk is gone")

    monkeypatch.setattr(pictures, "_images", broken)
    assert status(*common, "--workers", "0") == 2
    said = capfd.readouterr().err
    assert "disk is gone" in said
    assert "holds the run" in said
    monkeypatch.undo()
    assert draw(tmp_path / ".a.gif.states.npz", [tmp_path / "a.gif"], size=(64, 48), workers=0) == 3


DATA = ["x.csv", "x.npz", "x.pvd", "x.ply", "x.obj"]
DATA += [name for name, module in (("x.gsd", "gsd"), ("x.usda", "pxr")) if find_spec(module)]


@pytest.mark.once
@pytest.mark.long
def test_files_of_a_recording_are_those_of_its_run(tmp_path):
    """With its contacts and probes, byte by byte."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.add_balls([[0, 0.1, 0], [0, 0.3, 0.01]], radius=0.1)
    rope = ts.shapes.rope(scene, start=(1, 1, 0), end=(2, 1, 0), n=3, pinned=[0])
    scene.add_wall((0, 1, 0), 0.0)
    scene.add_collider(ts.Sphere((0.2, 0.3, 0.2), 0.2, velocity=(-0.5, 0, 0)))
    scene.add_probe("floor", "force", wall=0)
    scene.add_probe("rope", "length", spring=int(rope.springs[0]))
    for name in ("run", "again"):
        (tmp_path / name).mkdir()
    with ts.Simulation(scene, precision=PRECISION) as sim:
        ts.export(sim, [ts.open_output(tmp_path / "run" / name, fps=20) for name in DATA], fps=20, duration=0.25)
    assert draw(tmp_path / "run" / "x.npz", [tmp_path / "again" / name for name in DATA], workers=0) == 6
    found = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    assert {path.name: path.read_bytes() for path in (tmp_path / "again").iterdir()} == found
    assert "floor.y" in (tmp_path / "again" / "x.csv").read_text()
    assert np.load(tmp_path / "again" / "x.npz")["contacts"].max() >= 1


@pytest.mark.once
@pytest.mark.parametrize("name", ["contacts", "residual"])
def test_a_recording_without_contacts_is_refused(run, tmp_path, name):
    file = changed(run / "s.npz", tmp_path / "x.npz", lambda other, data: None if other == f"{name}.npy" else data)
    with pytest.raises(ts.SceneError, match=rf"x\.npz: is damaged \(it has no {name}\.npy\)"):
        Recording(file)


@pytest.mark.once
def test_probes_that_are_not_in_a_recording_are_missed(tmp_path):
    """Frames that are not an export's have none."""
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0]], radius=0.1)
    scene.add_probe("all", "energy")
    with ts.Simulation(scene, contacts="off", precision=PRECISION) as sim, ts.open_output(tmp_path / "s.npz") as output:
        output.write(0, sim.frame(), None)
    with pytest.raises(ts.SceneError, match=r"s\.npz: holds no all\.kinetic, .*, which .*x\.csv would lack"):
        draw(tmp_path / "s.npz", [tmp_path / "x.ply", tmp_path / "x.csv"], workers=0)
    assert draw(tmp_path / "s.npz", [tmp_path / "x.ply"], workers=0) == 1


@pytest.mark.once
def test_a_recording_is_not_replaced_by_itself(run):
    before = (run / "s.npz").read_bytes()
    with pytest.raises(ValueError, match=r"s\.npz: is the recording itself; give another name"):
        draw(run / "s.npz", [run / "x.csv", run / "." / "s.npz"], workers=0)
    assert (run / "s.npz").read_bytes() == before
    assert not (run / "x.csv").exists()


@pytest.mark.once
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_what_is_cut_off_while_it_is_drawn_leaves_nothing_behind(run, tmp_path, monkeypatch, error):
    """No run could go on with it; whole pictures and rows stay."""

    def some(engine, task, count):
        yield from np.zeros((3, 54, 96, 3), dtype=np.uint8)
        raise error("cut off")

    monkeypatch.setattr(pictures, "_images", some)
    with pytest.raises(error):
        draw(run / "s.npz", [tmp_path / "x.mp4", tmp_path / "x.csv", tmp_path / "frames"], size=SIZE, workers=0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frames", "x.csv"]
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 1 + 3
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == [f"frame_0000{k}.png" for k in range(3)]


def test_what_a_recording_cannot_show_is_refused_before_it_is_simulated(tmp_path, monkeypatch, capfd):
    def simulated(*_, **__):
        raise AssertionError("it was simulated")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(outputs, "export", simulated)
    shown = ["--duration", "0.1", "--fps", "20", "--size", "64x48", "-q"]
    common = ["run", "box", *shown, "--workers", "0", "--arch", "cpu", "--precision", PRECISION]

    def refused(*words):
        assert status(*common, *words) == 2
        assert not list(tmp_path.glob("[!.]*"))
        return capfd.readouterr().err

    assert "holds no transparency" in refused("-o", "a.gif", "--transparent")
    held = lock(tmp_path / ".a.gif.lock", "")
    assert "a.gif: another run is writing it" in refused("-o", "a.gif")
    held.close()


@ti.data_oriented
class Half(ts.ColliderShape):
    """Its right half is not there in a file."""

    @ti.func
    def distance(self, p):
        return p.norm() - 1.0

    def surface(self):
        return [[-1, 0], [1, 0], [0, 1]], [[0, 1, 2]]

    def saved_as(self):
        return ts.Box(self.center, (1, 1))


@pytest.mark.once
def test_colliders_that_a_recording_does_not_hold():
    scene = ts.Scene(dim=2)
    scene.add_collider(ts.Sphere((0, 0), 0.1))
    require_drawable(scene)
    scene.add_collider(Half((3, 3)))
    with pytest.raises(ts.SceneError, match=r"colliders\[1\]: a recording holds no Half, a shape of your own"):
        require_drawable(scene)


@pytest.mark.once
def test_the_wall_time_counts_what_was_drawn(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pictures, "draw", lambda *_, **__: time.sleep(1.5))
    words = ["--duration", "0.1", "--fps", "20", "--workers", "0", "--arch", "cpu", "--precision", PRECISION]
    assert status("run", "box", "-o", "a.csv", *words) == 0
    assert float(capfd.readouterr().out.partition("pictures ")[2].partition(",")[0]) >= 1.5
    assert not list(tmp_path.iterdir())


# Schedulers --------------------------------------------------------------------------------------------------------


class Late:
    """Workers that give the second chunk after the third, and nothing of the frame `lost`, which ended each of them."""

    apart, number = True, 1

    def __init__(self, lost=-1):
        self.lost = lost

    def run(self, work, waiting, what):
        first, second, third = (waiting.popleft() for _ in range(3))
        waiting.extendleft([second, third, first])
        while waiting:
            begin, end = waiting.popleft()
            yield (begin, end), None if begin <= self.lost < end else list(np.arange(begin, end))


@pytest.mark.once
def test_a_chunk_that_comes_late_is_in_its_place_and_one_that_never_comes_is_said(monkeypatch):
    monkeypatch.setattr(pictures, "MOST_IN_CHUNK", 3)
    assert list(pictures._images(Late(), (), 32)) == list(range(32))
    with pytest.raises(ts.BackendError, match="pictures 3 to 5: their workers ended 4 times"):
        list(pictures._images(Late(lost=4), (), 32))


class Client:
    """What is asked of Dask's."""

    def __init__(self, threads=1, error=None):
        self.threads, self.error = threads, error

    def scheduler_info(self, n_workers):
        return {"workers": {"tcp://a": {"nthreads": 1}, "tcp://b": {"nthreads": self.threads}}}

    def run(self, function):
        if self.error is not None:
            raise self.error
        return {"tcp://a": function(), "tcp://b": function()}


@pytest.mark.once
@pytest.mark.parametrize(
    ("client", "why"),
    [
        (Client(2), r"worker tcp://b has 2 threads; start it with --nthreads 1"),
        (Client(error=OSError("in <TCP>")), "was lost while its workers were asked"),
        (Client(error=TimeoutError()), "was lost while its workers were asked"),
        (Client(error=CancelledError()), "was lost while its workers were asked"),
        (Client(error=ModuleNotFoundError("No module named 'taichi_sim'")), "its workers cannot import taichi_sim"),
    ],
)
def test_workers_that_will_not_do_are_refused_at_once(client, why):
    assert cluster._checked(Client(), "tcp://s") == 2
    with pytest.raises(ts.SceneError, match=rf"scheduler: 'tcp://s' {why}"):
        cluster._checked(client, "tcp://s")


# Recordings that something happened to -----------------------------------------------------------------------------


def array(data, change):
    """The bytes of an .npy whose values were changed."""
    values, file = np.load(io.BytesIO(data)), io.BytesIO()
    np.save(file, change(values))
    return file.getvalue()


def deep(values):
    return np.array("[" * 50_000 + "]" * 50_000)


def within(values):
    about = json.loads(str(values))
    return np.array(json.dumps(about)[:-1] + ', "output": ' + "[" * 50_000 + "]" * 50_000 + "}")


@pytest.mark.once
@pytest.mark.parametrize(
    ("name", "change", "why"),
    [
        ("scene/about.npy", lambda data: array(data, deep), "damaged"),
        ("scene/about.npy", lambda data: array(data, within), "damaged"),
        ("scene/about.npy", lambda data: array(data, lambda values: np.array("[1]")), "damaged"),
        ("time.npy", lambda data: data.replace(b"{'descr'", b"{{{{((("), "damaged"),
        ("position.npy", lambda data: data.replace(b"'shape': (", b"'shape': ('"), "damaged"),
        ("time.npy", lambda data: array(data, lambda values: values[::-1]), r"time\[1\] is .*, before"),
        ("time.npy", lambda data: array(data, lambda values: values * np.nan), "damaged"),
        ("fps.npy", lambda data: array(data, lambda values: values * np.inf), "damaged"),
        ("fps.npy", lambda data: array(data, lambda values: values * 1e299), r"x\.npz: fps: 2e\+300 is not allowed"),
        ("fps.npy", lambda data: array(data, lambda values: values * 1e-299), r"x\.npz: fps: 2e-298 is not allowed"),
        (
            "position.npy",
            lambda data: array(data, lambda values: values * np.nan),
            r"position\[0\]: has values that are no",
        ),
        (
            "position.npy",
            lambda data: array(data, lambda values: values + 1e300),
            r"position\[0\]: has values that are no",
        ),
        (
            "velocity.npy",
            lambda data: array(data, lambda values: values - np.inf),
            r"velocity\[0\]: has values that are no",
        ),
    ],
)
def test_hostile_recordings_are_refused(run, tmp_path, name, change, why):
    file = changed(run / "s.npz", tmp_path / "x.npz", lambda other, data: change(data) if other == name else data)
    with pytest.raises(ts.SceneError, match=why) as error:
        draw(file, [tmp_path / "x.mp4"], size=SIZE, workers=0)
    assert str(file) in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["x.npz"]
