"""Sweeps from end to end, in this process but for the last."""

import csv
import gc
import json
import pickle
from collections import Counter, deque
from contextlib import closing
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
from physics_support import PRECISION
from sweep_scenes import both, heap, heap_file, hostile, mortal, slow, springs, square, top

import taichi_sim as ts
from taichi_sim.common.atomic_file import locked
from taichi_sim.device.engine import IS_KNOWN
from taichi_sim.files.parameters import put
from taichi_sim.studies.workers import Workers, _answers
from taichi_sim.sweeps import study
from taichi_sim.sweeps.folder import SweepFolder
from taichi_sim.sweeps.measures import measures_of
from taichi_sim.sweeps.points import Job, Point, Row, Runner, keep_batch
from taichi_sim.sweeps.study import Study
from taichi_sim.sweeps.subject import FileSubject, subject_of

pytestmark = pytest.mark.once
HERE = {"workers": 0, "precision": PRECISION}


class Done(list):
    """Dask's `as_completed`: futures in the order in which they were given."""

    add = list.append

    def __next__(self):
        return self.pop(0)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "heap.toml"
    path.write_text(heap_file(3, 0.1))
    return path


def table(folder):
    with open(folder / "table.csv", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_sweep_is_what_single_runs_are(tmp_path):
    vary = {"restitution": "0.2:0.8:2", "friction": [0.1, 0.3]}
    done = ts.sweep(
        heap, vary, seeds=2, measure=["probes.floor.y", "energy.total.max", top], folder=tmp_path / "s", **HERE
    )
    assert len(done) == 8
    assert [row.parameters for row in done.rows[:3]] == [{"restitution": 0.2, "friction": 0.1}] * 2 + [
        {"restitution": 0.2, "friction": 0.3}
    ]
    assert sum(row.compiled for row in done.rows) == (1 if IS_KNOWN else 8)  # whose kernels are used again
    for k in (0, 7):
        row = done.rows[k]
        with done.open(k) as sim, ts.Simulation(heap(**row.parameters, seed=row.seed), precision=PRECISION) as single:
            force = [(s.run(0.1), s.probes(), s.energy().total)[1:] for s in (sim, single)]
            assert row.measures["top"] == top(sim) == top(single)
            assert force[0][1] == force[1][1] <= row.measures["energy.total.max"]
    found = table(tmp_path / "s")
    assert [float(line["top"]) for line in found] == [row.measures["top"] for row in done.rows]
    assert list(found[0]) == [
        "restitution", "friction", "seed", "probes.floor.y", "energy.total.max", "top", "error", "warning", "version", "wall",
    ]  # fmt: skip
    assert done.table()["restitution"].tolist() == [0.2] * 4 + [0.8] * 4
    page = (tmp_path / "s" / "report.html").read_text()
    assert "top" in page
    assert "<svg" in page
    assert "restitution" in page


@pytest.mark.slow
def test_what_a_killed_worker_was_writing_does_not_outlast_the_sweep(tmp_path, monkeypatch):
    batches, run, busy = tmp_path / "s" / "batches", Runner.run, []
    left, held = (f".0123456789ab_{'7' * 16}_4.jsonl.{16 * one}.part" for one in "ab")

    def after_a_kill(self, point):
        (batches / left).write_text("half a r")
        busy.append(open(batches / held, "x+b"))  # noqa: SIM115  # another worker is at it
        assert locked(busy[0])
        return run(self, point)

    monkeypatch.setattr(Runner, "run", after_a_kill)
    ts.sweep(heap, {"restitution": [0.3]}, measure=top, folder=tmp_path / "s", duration=0.02, **HERE)
    assert [file.name for file in batches.iterdir()] == [held]
    busy[0].close()


def test_the_same_call_does_what_is_missing(tmp_path, monkeypatch):
    ran = []
    run = Runner.run
    monkeypatch.setattr(
        Runner, "run", lambda self, point: (ran.append(point.parameters["restitution"]), run(self, point))[1]
    )
    given = {"measure": top, "folder": tmp_path / "s", "duration": 0.02, **HERE}
    first = ts.sweep(heap, {"restitution": [0.2, 0.4]}, **given)
    (tmp_path / "s" / "batches" / ".x.jsonl.0123456789abcdef.part").write_text("what a killed worker left")
    more = ts.sweep(heap, {"restitution": [0.4, 0.6, 0.2]}, **given)
    assert ran == [0.2, 0.4, 0.6]
    assert [row.parameters["restitution"] for row in more.rows] == [0.4, 0.6, 0.2]
    assert more.rows[2] == first.rows[0]
    assert not list((tmp_path / "s" / "batches").iterdir())
    for changed in ({"measure": both}, {"duration": 0.03}, {"dt": 5e-4}):
        with pytest.raises(
            FileExistsError, match=f"holds another sweep, which differs in {next(iter(changed))[:8]}|settings"
        ):
            ts.sweep(heap, {"restitution": [0.4]}, **given | changed)
    other = ts.sweep(heap, {"restitution": [0.4]}, **given | {"measure": both, "overwrite": True})
    assert set(other.rows[0].measures) == {"x", "time"}
    assert len(table(tmp_path / "s")) == 1


def test_another_scene_is_noticed_in_what_its_file_reads(tmp_path, monkeypatch):
    def heights(file, **more):
        given = {"measure": "probes.p.y", "folder": tmp_path / file.partition(".")[0], "duration": 0.01, **HERE, **more}
        return ts.sweep(str(tmp_path / file), {"gravity[1]" if file.endswith("toml") else "g": [-10.0, -5.0]}, **given)

    ball = {"mass": np.array([1.0]), "velocity": np.zeros((1, 2))}
    np.savez(tmp_path / "b.npz", position=np.array([[0.0, 1.0]]), **ball)
    text = (
        'format = 1\ndim = 2\ngravity = [0.0, -10.0]\n[[balls]]\nfile = "b.npz"\nradius = 0.1\n'
        '[[probes]]\nname = "p"\nkind = "position"\nballs = [0]\n'
    )
    (tmp_path / "n.toml").write_text(text)
    heights("n.toml")
    (tmp_path / "n.toml").write_text(text + "# a comment changes nothing\n")
    heights("n.toml")
    np.savez(tmp_path / "b.npz", position=np.array([[0.0, 2.0]]), **ball)
    with pytest.raises(FileExistsError, match="holds another sweep, which differs in contents"):
        heights("n.toml")

    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "height_of_balls.py").write_text("H = 1.0\n")
    (tmp_path / "py.py").write_text(
        "import taichi_sim as ts\nfrom height_of_balls import H\n\n\ndef scene(g=-10.0):\n"
        "    scene = ts.Scene(dim=2, gravity=(0, g))\n    scene.add_balls([[0, H]], radius=0.1)\n"
        '    scene.add_probe("p", "position", balls=[0])\n    return scene\n'
    )
    heights("py.py")
    heights("py.py")
    (tmp_path / "height_of_balls.py").write_text("H = 7.0\n")
    with pytest.raises(FileExistsError, match="holds another sweep, which differs in contents"):
        heights("py.py")


def test_what_fails_is_a_row(tmp_path):
    def broken(simulation):
        raise AssertionError

    done = ts.sweep(heap, {"speed": [1.0, 1e13], "restitution": [0.5]}, measure=top, duration=0.02, **HERE)
    assert [bool(row.error) for row in done.rows] == [False, True]
    assert "must be below 1e12 m" in done.rows[1].error
    assert np.isnan(done.table()["top"][1])
    assert done.failed == [done.rows[1]]
    with pytest.raises(ts.SceneError, match="no name in a module"):
        ts.sweep(heap, {}, measure=broken, **HERE)
    with pytest.raises(ts.SceneError, match="measure: a lambda has no name in a module"):
        ts.sweep(heap, {}, measure=lambda sim: 1.0, **HERE)
    with pytest.raises(ValueError, match="no folder"):
        done.report()


def test_whatever_a_measure_raises_or_returns_is_in_the_table_and_on_the_page(tmp_path):
    speeds = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    done = ts.sweep(heap, {"speed": speeds}, measure=hostile, duration=0.02, folder=tmp_path / "s", **HERE)
    assert [row.error for row in done.rows] == [
        "UnspeakableError: (its message raises KeyError)",
        "SystemExit: 3",
        "ValueError: a lone \\udc80 surrogate",
        *[""] * 3,
    ]
    assert [row["hostile"] for row in table(tmp_path / "s")] == ["", "", "", "1.7e+308", "-1.7e+308", "1.7e+308"]
    assert "surrogate" in done.report().read_text()


def test_an_unstable_point_is_a_row():
    row = ts.sweep(
        springs, {"stiffness": [100.0, 1e5]}, measure="probes.sag", dt=0.02, integrator="explicit_euler", **HERE
    )
    assert row.rows[1].error.startswith("unstable: ")
    assert "above the safe bound" in row.rows[1].warning


def test_scene_files_are_varied_in_their_own_words(file):
    subject = FileSubject(file)
    scene = subject.scene(
        {"materials.rubber.restitution": 0.9, "pile.heap.radius": 0.04, "gravity[1]": -5.0, "simulation.dt": 1e-4}
    )
    assert scene.materials[1].restitution == 0.9
    assert scene.radius[0] == 0.04
    assert scene.gravity[1] == -5.0
    assert scene.settings["dt"] == 1e-4
    assert not np.array_equal(subject.scene({}, 1).position, subject.scene({}, 2).position)
    assert np.array_equal(subject.scene({}, 0).position, subject.scene({}).position)
    for path, why in (
        ("material.rubber.restitution", "is not in this scene; did you mean 'materials'"),
        ("materials.steel.restitution", r"there is materials\[0\]; or, by name, rubber"),
        ("materials.rubber.restitutoin", "did you mean 'restitution'"),
        ("pile[3].radius", r"there is pile\[0\]"),
        ("gravity[2]", "is not in this scene"),
        ("gravty", "did you mean 'gravity'"),
        ("gravity[1][2]", "which has no parts"),
        ("pile.heap.radius", "radius"),
    ):
        with pytest.raises(ts.SceneError, match=why) as error:
            subject.scene({path: -1.0})
        assert error.value.file == file


def test_a_table_that_a_file_may_have_once_is_made():
    document = {}
    put(document, "output.duration", 3.0)
    assert document == {"output": {"duration": 3.0}}
    with pytest.raises(ts.SceneError, match="cloth"):
        put(document, "cloth[0].mass", 3.0)


def test_loose_balls_take_a_seed_where_nothing_else_does(tmp_path):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0], [2, 0]], radius=0.1, pinned=[0])
    subject = subject_of(scene, tmp_path / "s")
    a, b = (subject.scene({}, seed).position for seed in (0, 1))
    assert np.array_equal(a, scene.position)
    assert np.array_equal(a[0], b[0])
    assert 0 < np.abs(a - b)[1:].max() <= 1e-4
    scene.set_balls(pinned=True)
    with pytest.raises(ts.SceneError, match="seeds: would all give one result"):
        subject_of(scene, tmp_path / "s").scene({}, 1)


def test_measures_by_name():
    scene = heap()
    scene.add_probe("tip", "position", balls=[0])
    scene.add_probe("strain", "energy")
    default = measures_of(None, scene)
    assert default.names[:2] == ["probes.floor.x", "probes.floor.y"]
    assert default.every_frame
    found = measures_of(["probes.tip.y.max", "energy.total", "contacts.max", "sweep_scenes:top"], scene)
    assert [number.statistic for number in found.numbers] == ["max", "last", "max"]
    assert found.identity()[-1].split()[0] == "top"
    assert not measures_of("energy.total", scene).every_frame
    for name, why in (
        ("probes.tpi", "did you mean 'tip'"),
        ("probes.tip", "is a vector"),
        ("probes.tip.w", "has no number 'w'"),
        ("energy.totl", "did you mean 'energy.total'"),
        ("sweep_scenes:topp", "cannot be imported"),
        ("nowhere:top", "cannot be imported"),
        (3, "a name or a function"),
    ):
        with pytest.raises(ts.SceneError, match=why):
            measures_of(name, scene)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"vary": {"restitutoin": [1]}}, "is no argument of heap.*did you mean 'restitution'"),
        ({"vary": {"restitution": [0.5, 2.0]}}, "materials.restitution: 2.0 is not allowed"),
        ({"vary": {"restitution": "0:1:1000", "friction": "0:1:10000"}}, "points: are 10000000"),
        ({"seeds": 0}, "seeds: 0 is not allowed"),
        ({"duration": -1.0}, "duration: -1.0 is not allowed"),
        ({"workers": -1}, "workers: -1 is not allowed"),
        ({"workers": 1, "scheduler": "tcp://127.0.0.1:1"}, "give one of the two"),
        ({"integrator": "verlt"}, "integrator: 'verlt' is not allowed"),
        ({"vary": {"restitution": "0:1"}, "design": "latin", "points": 2, "luck": -1}, "luck: -1 is not allowed"),
        ({"scene": 7}, "scene: 7 is not allowed"),
        ({"scene": slow}, "scene.output.duration: 'long' is not allowed"),
        ({"scene": lambda: None}, "scene: a lambda has no name"),
        ({"scene": square, "vary": {"side": [2, 0]}}, r"scene: cannot be made with side = 0; ZeroDivisionError"),
    ],
)
def test_what_is_refused_before_anything_runs(given, why, tmp_path):
    folder = tmp_path / "s"
    with pytest.raises(ts.SceneError, match=why):
        ts.sweep(given.pop("scene", heap), **{"folder": folder, "workers": 0, **given})
    assert not folder.exists()


def test_folders_that_cannot_be_used(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    with pytest.raises(FileExistsError, match="is not empty and holds no sweep"):
        ts.sweep(heap, folder=tmp_path / "full", **HERE)
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        ts.sweep(heap, folder=tmp_path / "none" / "s", **HERE)


def test_batches_become_one_file_and_damage_is_told(tmp_path):
    about = {"scene": "x"}
    folder = SweepFolder(tmp_path / "s", about)
    folder.begin()
    points = [Point({"a": k}) for k in range(4)]
    for k in (0, 2):
        keep_batch(
            folder.batches, [Row.of(point, measures={"m": float("nan")}) for point in points[k : k + 2]], folder.mark
        )
    folder.close()
    again = SweepFolder(tmp_path / "s", about)
    assert len(again.rows) == 4
    again.begin()
    assert not list(again.batches.iterdir())
    again.finish(points)
    assert len(table(tmp_path / "s")) == 4
    assert json.loads((tmp_path / "s" / "sweep.json").read_text()) == {"program": "taichi_sim sweep", **about}
    again.close()
    text = (tmp_path / "s" / "rows.jsonl").read_text()
    for damage in (
        '{"key"',
        "[1]",
        "[" * 50_000,
        text.replace('{"m": NaN}', "null"),
        text.replace('{"m": NaN}', '{"m": "abc"}'),
        text.replace('{"a": 0}', '{"a": 7}'),
        text.replace('"wall": 0.0', '"wall": "long"'),
        text.replace('"wall": 0.0', '"wall": 1.0'),
        text.replace('{"m": NaN}', '{"m": 17.5}'),
    ):
        assert damage != text
        (tmp_path / "s" / "rows.jsonl").write_text(damage)
        with pytest.raises(ts.SceneError, match=r"rows\.jsonl: is damaged; delete it"):
            SweepFolder(tmp_path / "s", about)
    (tmp_path / "s" / "rows.jsonl").write_text(text)
    for damage in ("[1]", "[" * 50_000, "{", "null"):
        (tmp_path / "s" / "sweep.json").write_text(damage)
        with pytest.raises(OSError, match=r"sweep\.json: is not as this program writes it; remove the folder"):
            SweepFolder(tmp_path / "s", about)


@pytest.mark.parametrize("number", [9, 300])
def test_points_of_a_scene_are_opened_without_a_folder(number):
    """Whose longer arrays are read again with each."""
    scene = ts.Scene(dim=2)
    scene.add_balls(np.stack([np.arange(number), np.zeros(number)], axis=1), radius=0.1)
    scene.settings["contacts"] = "off"
    done = ts.sweep(scene, {"gravity[1]": [-1.0, -2.0]}, duration=0.02, **HERE)
    place = done._subject.file.parent
    for k in range(2):
        with done.open(k) as sim:
            assert sim.scene.n_balls == number
            assert sim.scene.gravity[1] == -1.0 - k
    assert pickle.loads(pickle.dumps(done._subject)).scene({}).n_balls == number
    del done
    gc.collect()
    assert not place.exists()


def test_rows_that_workers_wrote_are_kept_before_they_come_in(tmp_path):
    folder = SweepFolder(tmp_path / "s", {"scene": "x"})
    folder.begin()
    points = [Point({"a": k}) for k in range(3)]
    keep_batch(folder.batches, [Row.of(point) for point in points[:2]], folder.mark)
    folder.add([Row.of(points[2])])
    folder.finish(points)
    folder.close()
    assert len(table(tmp_path / "s")) == 3
    assert len(SweepFolder(tmp_path / "s", {"scene": "x"}).rows) == 3


@pytest.mark.once
def test_batches_of_another_sweep_and_rows_without_a_file(tmp_path):
    """What a worker of an overwritten sweep writes late is not this one's; a row that says its worker was killed is kept."""
    before = SweepFolder(tmp_path / "s", {"duration": 1})
    before.begin()
    before.close()
    now = SweepFolder(tmp_path / "s", {"duration": 2}, overwrite=True)
    now.begin()
    keep_batch(now.batches, [Row.of(Point({"a": 1}), measures={"m": 1.0})], before.mark)
    now.add([Row.of(Point({"a": 2}), error="its worker ended 4 times")])
    now.finish([Point({"a": 1}), Point({"a": 2})])
    now.close()
    again = SweepFolder(tmp_path / "s", {"duration": 2})
    assert [row.parameters["a"] for row in again.rows.values()] == [2]
    again.begin()
    assert not list(again.batches.iterdir())
    again.close()


@pytest.mark.once
def test_names_of_columns_measures_of_files_and_lists_as_values(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = {"duration": 0.002, **HERE}
    for name in ("wall", "error"):
        with pytest.raises(ts.SceneError, match=f"{name}: is a column of every table of a sweep; name the argument"):
            ts.sweep(heap, {name: [1, 2]}, **given)
    with pytest.raises(ts.SceneError, match="seed: is a column of every table of a sweep; give seeds"):
        ts.sweep(heap, {"seed": [1, 2]}, **given)
    (tmp_path / "sub").mkdir()
    (tmp_path / "m2.py").write_text("def h(sim):\n    return 5.0\n")
    (tmp_path / "sub" / "m2.py").write_text("def h(sim):\n    return 99.0\n")
    (tmp_path / "wrong.py").write_text("def h(sim)\n")
    for measure, why in (
        ("wrong.py:h", "cannot be imported: SyntaxError"),
        ("nofile/json.py:dumps", "there is no file"),
        (["m2.py:h", "sub/m2.py:h"], "two functions are named 'h'"),
    ):
        with pytest.raises(ts.SceneError, match=f"measure: .*{why}"):
            ts.sweep(heap, {"restitution": [0.2]}, measure=measure, **given)
    values = [
        ts.sweep(heap, {"restitution": [0.2]}, measure=m, **given).rows[0].measures["h"]
        for m in ("m2.py:h", "sub/m2.py:h")
    ]
    assert values == [5.0, 99.0]
    (tmp_path / "two.toml").write_text(
        "format = 1\ndim = 2\ngravity = [0.0, -9.0]\n[[pile]]\nresolution = [2, 2]\nradius = 0.1\nposition = [0.0, 1.0]\n"
    )
    varied = {"gravity": [[0.0, -9.0], [0.0, -5.0]], "pile[0].mass": [1.0, 2.0]}
    found = ts.sweep("two.toml", varied, measure="energy.total", folder=tmp_path / "s", **given)
    assert (tmp_path / "s" / "report.html").is_file()
    assert len(found) == 4
    for path, value in (("pile[0].seed", "abc"), ("pile[0]", 3), ("pile", 3)):
        with pytest.raises(ts.SceneError, match="pile"):
            ts.sweep("two.toml", {path: [value]}, seeds=2, **given)
    with pytest.raises(ValueError, match="seeds"):
        ts.sweep("two.toml", {"pile[0].mass": [1.0]}, seeds=[0.5, 1.7], **given)


def test_the_table_of_an_interrupted_sweep_has_what_workers_do_before_they_end(tmp_path, monkeypatch):
    class Slow:
        """Leaves a batch while it closes, as workers do that end in peace."""

        said, number, apart = "slow", 1, True

        def run(self, work, waiting, what, parts):
            self.batches, self.folder, self.mark = list(waiting), tmp_path / "s" / "batches", work.args[0].mark
            keep_batch(self.folder, rows := [Row.of(point) for point in self.batches[0]], self.mark)
            yield self.batches[0], rows
            raise KeyboardInterrupt

        def close(self):
            keep_batch(self.folder, [Row.of(point) for point in self.batches[1]], self.mark)

    monkeypatch.setattr("taichi_sim.sweeps.study.connected", lambda *_: closing(Slow()))
    with pytest.raises(KeyboardInterrupt):
        ts.sweep(heap, {"speed": [0.1, 0.2, 0.3]}, folder=tmp_path / "s", workers=0)
    assert len(table(tmp_path / "s")) == 2
    assert len((tmp_path / "s" / "rows.jsonl").read_text().splitlines()) == 2


def test_a_dashboard_is_told_where_there_is_one(monkeypatch):
    class Client:
        dashboard_link = "http://127.0.0.1:1/status"

    assert Workers(Client(), 2, True).said == "2 workers, http://127.0.0.1:1/status"
    assert Workers(Client(), 1, False).said == "1 worker"


def test_a_dashboard_is_there_where_its_page_is(monkeypatch):
    class Page(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200 if self.path == "/status" else 404)
            self.end_headers()

        def log_message(self, *_):
            pass

    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # of no use for what is near
    with HTTPServer(("127.0.0.1", 0), Page) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        here = f"http://127.0.0.1:{server.server_port}"
        assert _answers(f"{here}/status")
        assert not _answers(f"{here}/other")
        server.shutdown()
    assert not _answers(f"{here}/status")
    assert not _answers("")


@pytest.mark.parametrize("status", ["finished", "cancelled"])
def test_a_scheduler_that_is_lost_ends_a_sweep_in_a_sentence(monkeypatch, status):
    """Its futures are cancelled, or what they came to cannot be had; a worker that ended leaves others to try."""
    distributed = pytest.importorskip("distributed")
    comm = pytest.importorskip("distributed.comm")

    class Future:
        def __init__(self):
            self.status = status

        def result(self):
            raise comm.CommClosedError("in <TCP>")

    class Client:
        status = "closed"

        def submit(self, *_, **__):
            return Future()

        def cancel(self, futures):
            raise OSError("no scheduler")

    monkeypatch.setattr(distributed, "as_completed", Done)
    with pytest.raises(ts.BackendError, match="sweep: the scheduler was lost; give the same command again"):
        list(Workers(Client(), 1, False).run(len, deque(["task"]), "sweep"))


def test_a_worker_that_ends_before_its_rows_are_fetched_has_its_points_repeated(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    comm = pytest.importorskip("distributed.comm")
    batches = []

    class Future:
        status = "finished"

        def __init__(self, points):
            self.points = points

        def result(self):
            if len(self.points) > 1:
                self.status = "error"
                raise self.exception()
            return [Row.of(point) for point in self.points]

        def exception(self):
            return distributed.KilledWorker("run_batch", None, 0)

    class Client:
        status = "running"

        def submit(self, work, points, **_):
            batches.append(len(points))
            return Future(points)

        def cancel(self, futures):
            raise comm.CommClosedError

    monkeypatch.setattr(distributed, "as_completed", Done)
    points = [Point({"a": k}) for k in range(3)]
    folder = SweepFolder(tmp_path / "s", {})
    folder.begin()
    study = Study(
        None,
        None,
        SimpleNamespace(job=Job(None, None, {})),
        folder,
        {"a": {}},
        lambda: Workers(Client(), 1, False),
        print,
    )
    monkeypatch.setattr("taichi_sim.sweeps.study.FEW_TASKS", 1)
    rows = [row for some in study.run(points) for row in some]
    assert batches == [3, 1, 1, 1]
    assert [row.parameters["a"] for row in rows] == [0, 1, 2]
    assert len(list(folder.batches.glob("*.jsonl"))) == 3  # which a worker elsewhere could not write


def test_no_folder_is_made_where_no_scheduler_answers(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("taichi_sim.studies.workers.PATIENCE", 0.5)
    with pytest.raises(ts.SceneError, match="no scheduler answers there"):
        ts.sweep(heap, folder=tmp_path / "s", scheduler="tcp://127.0.0.1:9")
    assert not (tmp_path / "s").exists()


@pytest.mark.slow
def test_workers_find_the_same_and_one_that_dies_is_a_row(tmp_path):
    pytest.importorskip("distributed")
    said = []
    vary = {"restitution": [0.2, 0.4, 0.5, 0.6, 0.8]}
    given = {"measure": top, "precision": PRECISION}
    alone = ts.sweep(heap, vary, workers=0, **given)
    done = ts.sweep(mortal, vary, folder=tmp_path / "s", workers=2, say=said.append, **given)
    assert "5 points to run, 0 done before; 2 workers" in said[0]
    assert [row.measures for row in done.rows if not row.error] == [
        row.measures for row in alone.rows if row.parameters["restitution"] != 0.5
    ]
    assert [row.error for row in done.failed] == ["its worker ended 4 times: killed, or out of memory"]
    assert len({row.key for row in done.rows}) == len(done.rows) == len(table(tmp_path / "s")) == 5


class OneWorker:
    """Dask's client and its `as_completed`: a point of restitution 0.5 ends the one worker, and all that wait for it are lost."""

    status = "running"

    def __init__(self):
        self.sent, self.submitted = [], Counter()

    def submit(self, work, task, **given):
        self.submitted.update(point.parameters["restitution"] for point in task)
        self.sent.append(Future(work, task))
        return self.sent[-1]

    def add(self, future):
        pass

    def __next__(self):
        if any(point.parameters["restitution"] == 0.5 for future in self.sent for point in future.task):
            for future in self.sent:
                future.status = "error"
        return self.sent.pop(0)

    def cancel(self, futures):
        pass


class Future:
    status = "finished"

    def __init__(self, work, task):
        self.work, self.task = work, task

    def result(self):
        return self.work(self.task)

    def exception(self):
        return pytest.importorskip("distributed").KilledWorker("", None, 0)


def test_a_point_that_waits_behind_one_that_ends_its_worker_is_not_blamed(tmp_path, monkeypatch):
    """Three points are lost with another one each time; the last time each runs alone."""
    client = OneWorker()
    monkeypatch.setattr(pytest.importorskip("distributed"), "as_completed", lambda: client)
    monkeypatch.setattr(study, "run_batch", lambda job, points: [Row.of(point) for point in points])
    kept = SimpleNamespace(rows={}, batches=tmp_path, mark="", add=lambda rows: None)
    run = Study(
        None,
        None,
        SimpleNamespace(job=Job(None, None, {})),
        kept,
        {"restitution": {}},
        lambda: Workers(client, 1, False),
        print,
    ).run
    points = [Point({"restitution": value}) for value in (0.5, 0.2, 0.4, 0.6)]
    rows = [row for some in run(points) for row in some]
    assert [row.parameters["restitution"] for row in rows if row.error] == [0.5]
    assert [row.error for row in rows if row.error] == ["its worker ended 4 times: killed, or out of memory"]
    assert client.submitted == {0.5: 4, 0.2: 4, 0.4: 4, 0.6: 4}
    assert sorted(row.parameters["restitution"] for row in rows if not row.error) == [0.2, 0.4, 0.6]


def test_a_refused_sweep_changes_nothing_and_a_folder_is_written_by_one(tmp_path):
    folder, scene = tmp_path / "s", heap()
    ts.sweep(scene, {"gravity[1]": [-9.0]}, duration=0.02, folder=folder, **HERE)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    with pytest.raises(FileExistsError, match="holds another sweep"):
        ts.sweep(heap(restitution=0.9), {"gravity[1]": [-9.0]}, duration=0.02, folder=folder, **HERE)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    about = json.loads((folder / "sweep.json").read_text())
    writing = SweepFolder(folder, about)
    writing.begin()
    with pytest.raises(OSError, match="another sweep is writing it"):
        ts.sweep(scene, {"gravity[1]": [-8.0]}, duration=0.02, folder=folder, **HERE)
    keep_batch(writing.batches, [Row.of(Point({"gravity[1]": -7.0}))], writing.mark)
    with pytest.raises(OSError, match="another sweep is writing it"):
        ts.sweep(scene, {"gravity[1]": [-8.0]}, duration=0.02, folder=folder, overwrite=True, **HERE)
    assert list(writing.batches.glob("*.jsonl"))
    writing.close()
    assert len(ts.sweep(scene, {"gravity[1]": [-8.0]}, duration=0.02, folder=folder, **HERE)) == 1


@pytest.mark.once
def test_a_value_that_is_refused_is_not_looked_for_in_the_file(tmp_path):
    """The error of a value that is varied names no line of the file: another value stands there."""
    text = 'format = 1\ndim = 2\ngravity = [0.0, -9.0]\n[[materials]]\nname = "slate"\nfriction = 0.4\n'
    (tmp_path / "slate.toml").write_text(text + "[[balls]]\nposition = [[0.0, 1.0]]\nradius = 0.1\n")
    with pytest.raises(ts.SceneError, match=r"friction: -3\.0 is not allowed") as refused:
        ts.sweep(str(tmp_path / "slate.toml"), {"materials.slate.friction": [0.2, -3.0]}, **HERE)
    assert refused.value.file == tmp_path / "slate.toml"
    assert refused.value.line is None
