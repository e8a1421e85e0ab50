"""Nothing is deleted, emptied or followed that this program did not make: links, pipes, folders of others, a run beside it."""

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from test_outputs import SIZE, FakeRenderer, FakeSimulation, draw_with, make
from test_resume import run

from taichi_sim import SceneError
from taichi_sim.common import atomic_file
from taichi_sim.common.atomic_file import PartFile, locked, replacing, sweep
from taichi_sim.outputs import export, open_output
from taichi_sim.outputs.kept_files import read_kept, write_kept
from taichi_sim.reports.speed_error.report_folder import ReportFolder
from taichi_sim.sweeps.folder import SweepFolder

pytestmark = [pytest.mark.once, pytest.mark.skipif(os.name != "posix", reason="links and pipes")]

NAMES = ["x.csv", "x.npz", "x.gif", "x.mp4", "x.pvd", "x.ply", "frames/"]


@pytest.fixture(autouse=True)
def _renderer(monkeypatch):
    draw_with(monkeypatch, FakeRenderer)


@pytest.fixture
def precious(tmp_path):
    """A folder of somebody else, in which some names are such as ours."""
    folder = tmp_path / "precious"
    (folder / "state_000001.npz.d").mkdir(parents=True)
    for name in ("thesis.txt", "lock", "state_000001.npz", "frames", "a.jsonl", "state_000001.npz.d/deep.txt"):
        (folder / name).write_text(name)
    yield folder
    assert (folder / "state_000001.npz.d/deep.txt").read_text() == "state_000001.npz.d/deep.txt"
    for name in ("thesis.txt", "lock", "state_000001.npz", "frames", "a.jsonl"):
        assert (folder / name).read_text() == name


def log_of(folder, name):
    """Where an unfinished output of that name keeps what it needs."""
    if name.endswith("/"):
        (folder / name).mkdir()
        return folder / name / ".resume"
    return folder / f".{name}.resume"


# Folders -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_a_link_in_place_of_what_is_kept(tmp_path, precious, name, resume):
    log_of(tmp_path, name).symlink_to(precious, target_is_directory=True)
    with pytest.raises(OSError, match=r"\.resume: is a link; .* remove it"):
        make(tmp_path, name, resume=resume)


@pytest.mark.parametrize("name", ["x.csv", "x.npz", "frames/"])
def test_a_folder_of_somebody_else_in_place_of_what_is_kept(tmp_path, precious, name):
    precious.rename(log_of(tmp_path, name))
    try:
        with pytest.raises(OSError, match=r"\.resume: is a folder that this program did not make, .* remove it"):
            make(tmp_path, name)
    finally:
        (tmp_path / name / ".resume" if name.endswith("/") else tmp_path / f".{name}.resume").rename(precious)


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("record", ["{}", '{"name": "run"}', '{"crc32": 5, "kept": {"name": "run"}}', "[1]", ""])
def test_a_folder_of_somebody_else_that_has_a_record_of_theirs(tmp_path, record, resume):
    inside = tmp_path / ".x.gif.resume"
    inside.mkdir()
    theirs = {"run.json": record, "pictures": "theirs", "state_000001.npz": "theirs"}
    for name, text in theirs.items():
        (inside / name).write_text(text)
    with pytest.raises(OSError, match=r"\.resume: is a folder that this program did not make, .* remove it"):
        make(tmp_path, "x.gif", resume=resume)
    assert {file.name: file.read_text() for file in inside.iterdir()} == theirs


def test_frames_behind_a_link_are_not_overwritten(tmp_path):
    """As a file takes the place of a link, and not of what it points to."""
    make(tmp_path, "theirs/")
    before = {file.name: file.stat().st_mtime_ns for file in (tmp_path / "theirs").iterdir()}
    (tmp_path / "frames").symlink_to("theirs")
    with pytest.raises(OSError, match=r"frames: is a link; --overwrite deletes nothing behind one; give '.*theirs'"):
        make(tmp_path, "frames/", overwrite=True)
    assert {file.name: file.stat().st_mtime_ns for file in (tmp_path / "theirs").iterdir()} == before


@pytest.mark.parametrize("name", ["lock", "pictures", "checkpoint.json"])
def test_a_folder_in_place_of_a_file_that_is_kept(tmp_path, name):
    cut_off(tmp_path, "y.gif")
    inside = tmp_path / ".y.gif.resume" / name
    inside.unlink(missing_ok=True)
    inside.mkdir()
    with pytest.raises(OSError, match=rf"\.resume: holds {name!r}, which is a folder; .* remove it"):
        open_output(tmp_path / "y.gif")


def test_a_file_in_place_of_what_is_kept(tmp_path):
    (tmp_path / ".x.csv.resume").write_text("mine")
    with pytest.raises(OSError, match=r"\.resume: is a file; .* remove it"):
        make(tmp_path, "x.csv")
    assert (tmp_path / ".x.csv.resume").read_text() == "mine"


def cut_off(folder, name, **options):
    with pytest.raises(KeyboardInterrupt):
        export(
            FakeSimulation(20, KeyboardInterrupt()), open_output(f"{folder}/{name}", **options), duration=0.5, size=SIZE
        )


WITHIN = [("x.gif", "pictures"), ("x.mp4", "run.json"), ("x.gif", "lock")]


@pytest.mark.parametrize(
    ("name", "file", "put", "what"),
    [(*one, Path.symlink_to, "a link") for one in WITHIN]
    + [(*one, Path.hardlink_to, "also the file of another name") for one in WITHIN]
    + [("x.gif", "pictures", lambda inside, _: os.mkfifo(inside), "a pipe")],
)
def test_what_stands_in_place_of_a_file_that_is_kept(tmp_path, precious, name, file, put, what):
    """As in an archive that somebody sends: it is not ours, whatever its record says, and is not written into."""
    cut_off(tmp_path, name)
    inside = tmp_path / f".{name}.resume" / file
    inside.unlink()
    put(inside, precious / "thesis.txt")
    with pytest.raises(OSError, match=rf"\.resume: holds {file!r}, which is {what}; .* remove it"):
        make(tmp_path, name, resume=True)


def test_what_others_put_into_what_is_kept_stays(tmp_path):
    cut_off(tmp_path, "x.gif")
    inside = tmp_path / ".x.gif.resume"
    (inside / "mine").mkdir()
    (inside / "mine" / "a.txt").write_text("a")
    (inside / "b.txt").write_text("b")
    make(tmp_path, "x.gif")
    assert {str(p.relative_to(inside)) for p in inside.rglob("*")} == {"mine", "mine/a.txt", "b.txt"}


@pytest.mark.parametrize("left", [(), ("lock",), ("lock", ".run.json.0123456789abcdef.part")])
def test_what_a_run_left_that_was_killed_at_its_start(tmp_path, left):
    inside = tmp_path / ".x.csv.resume"
    inside.mkdir()
    for name in left:
        (inside / name).touch()
    make(tmp_path, "x.csv")
    assert not inside.exists()


def test_a_checkpoint_names_files_of_its_own_folder_alone(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, "x.npz", 13)
    place = tmp_path / ".x.npz.resume" / "checkpoint.json"
    kept = read_kept(place)
    state = kept["checkpoints"][0]["state"]
    state[0] = f"../elsewhere/{state[0]}"
    write_kept(place, kept)
    with pytest.raises(SceneError, match="its state is not that of a checkpoint"):
        run(tmp_path, "x.npz", resume=True)


def begun(kind, folder):
    """The folder of a study that was begun."""
    one = kind(folder, {"a": 1})
    if not one.begun:
        one.begin()
    one.close()
    return folder


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_link_in_place_of_the_batches_of_a_sweep(tmp_path, precious, overwrite):
    batches = begun(SweepFolder, tmp_path / "swept") / "batches"
    batches.rmdir()
    batches.symlink_to(precious, target_is_directory=True)
    with pytest.raises(OSError, match=r"batches: is a link; .* remove it"):
        SweepFolder(tmp_path / "swept", {"a": 1}, overwrite)


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_others_put_into_the_batches_of_a_sweep_stays(tmp_path, overwrite):
    batches = begun(SweepFolder, tmp_path / "swept") / "batches"
    (batches / "mine.jsonl").write_text("mine")
    (batches / "folder").mkdir()
    again = SweepFolder(tmp_path / "swept", {"a": 1}, overwrite)
    again.begin()
    again.close()
    assert (batches / "mine.jsonl").read_text() == "mine"


STUDIES = [
    (SweepFolder, "rows.jsonl"),
    (SweepFolder, "sweep.json"),
    (SweepFolder, "table.csv"),
    (ReportFolder, "rows.jsonl"),
    (ReportFolder, "reference.npz"),
    (ReportFolder, "budget.npz"),
    (ReportFolder, "run_00ab.npz"),
]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(("kind", "name"), STUDIES)
def test_links_in_the_folder_of_a_study(tmp_path, precious, kind, name, overwrite):
    file = begun(kind, tmp_path / "out") / name
    file.unlink(missing_ok=True)
    file.symlink_to(precious / "thesis.txt")
    with pytest.raises(OSError, match=rf"{name}: is a link; .* remove it"):
        kind(tmp_path / "out", {"a": 1}, overwrite)
    assert file.is_symlink()


@pytest.mark.parametrize(("kind", "name"), STUDIES)
def test_what_is_no_file_in_the_folder_of_a_study(tmp_path, kind, name):
    file = begun(kind, tmp_path / "out") / name
    file.unlink(missing_ok=True)
    for make_it, word in ((os.mkfifo, "pipe"), (os.mkdir, "folder")):
        make_it(file)
        with pytest.raises(OSError, match=rf"{name}: is a {word}; .* remove it"):
            kind(tmp_path / "out", {"a": 1}, overwrite=True)
        file.rename(tmp_path / word)


@pytest.mark.parametrize("kind", [SweepFolder, ReportFolder])
def test_a_study_leaves_what_others_put_beside_it(tmp_path, precious, kind):
    """The folder is the user's own choice, a link to it, too; but nothing behind one is overwritten."""
    begun(kind, tmp_path / "disk")
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    (tmp_path / "disk" / "notes").symlink_to(precious)
    begun(kind, tmp_path / "out")
    kind(tmp_path / "disk", {"a": 1}, overwrite=True).close()
    assert (tmp_path / "disk" / "notes").is_symlink()
    with pytest.raises(OSError, match=r"out: is a link; --overwrite deletes nothing behind one; give '.*disk'"):
        kind(tmp_path / "out", {"a": 1}, overwrite=True)


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("record", ["{}", '{"a": 1}', '{"program": "another"}', "[1]", ""])
@pytest.mark.parametrize("kind", [SweepFolder, ReportFolder])
def test_a_folder_of_somebody_else_that_has_such_a_record(tmp_path, kind, record, overwrite):
    theirs = {kind.record: record, "rows.jsonl": "theirs", "report.html": "theirs"}
    for name, text in theirs.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(OSError, match=rf"{kind.record}: is not as this program writes it; remove the folder"):
        kind(tmp_path, {"a": 1}, overwrite)
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == theirs


@pytest.mark.parametrize("kind", [SweepFolder, ReportFolder])
def test_a_lock_is_no_link(tmp_path, kind):
    folder = tmp_path / "out"
    begun(kind, folder)
    (folder / "lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="lock: is a link"):
        kind(folder, {}, True).begin()
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize("kind", [SweepFolder, ReportFolder])
def test_a_folder_of_a_study_that_was_killed_at_its_start_is_used_again(tmp_path, kind):
    (tmp_path / "lock").touch()
    kind(tmp_path, {"a": 1}).close()


def test_two_reports_do_not_write_into_one_folder(tmp_path):
    first = ReportFolder(tmp_path / "r", {"a": 1})
    first.write("budget.npz", b"{}")
    with pytest.raises(OSError, match="another report is writing it"):
        ReportFolder(tmp_path / "r", {"a": 1}, overwrite=True)
    assert (tmp_path / "r" / "budget.npz").read_bytes() == b"{}"
    first.close()
    ReportFolder(tmp_path / "r", {"a": 1}, overwrite=True).close()
    assert [file.name for file in (tmp_path / "r").iterdir()] == ["report.json"]


# Two at once -------------------------------------------------------------------------------------------------------


def test_a_run_that_is_refused_destroys_nothing_of_the_one_that_goes_on(tmp_path):
    begun, go_on = threading.Event(), threading.Event()

    class Waiting(FakeSimulation):
        def contacts(self):
            found = super().contacts()
            if self.asked == 8:
                begun.set()
                go_on.wait(60)
            return found

    first = open_output(f"{tmp_path}/frames/")
    running = threading.Thread(target=export, args=(Waiting(), first), kwargs={"duration": 29 / 60, "size": SIZE})
    running.start()
    begun.wait(60)
    there = {p.name for p in (tmp_path / "frames").glob("*.png")}
    with pytest.raises(OSError, match="another run is writing it"):
        make(tmp_path, "frames/", overwrite=True)
    assert there <= {p.name for p in (tmp_path / "frames").glob("*.png")}
    go_on.set()
    running.join()
    assert len(list((tmp_path / "frames").glob("*.png"))) == 30


def test_the_names_of_files_under_construction_are_nobodys_to_guess(tmp_path, monkeypatch):
    """Processes in two containers may have one number."""
    monkeypatch.setattr(os, "getpid", lambda: 7)
    parts = [PartFile(tmp_path / "x.npz") for _ in range(3)]
    assert len({part.part for part in parts}) == 3
    for part in parts:
        assert re.fullmatch(r"\.x\.npz\.[0-9a-f]{16}\.part", part.part.name)
        assert part.part.exists()
        part.discard()


def test_a_file_under_construction_is_made_and_never_opened(tmp_path, monkeypatch):
    (tmp_path / "precious").write_text("precious")
    monkeypatch.setattr(atomic_file, "token_hex", lambda n: n * "ab")
    (tmp_path / f".x.npz.{8 * 'ab'}.part").symlink_to(tmp_path / "precious")
    with pytest.raises(OSError, match="cannot be written"):
        PartFile(tmp_path / "x.npz")
    assert (tmp_path / "precious").read_text() == "precious"


def test_only_parts_of_ours_that_nobody_writes_are_swept(tmp_path):
    names = [".x.npz.mine.part", ".x.npz.1.2.part", f".x.npz.{8 * 'ab'}.part", f".x.npz.{8 * 'cd'}.part"]
    for name in names:
        (tmp_path / name).touch()
    os.mkfifo(tmp_path / f".x.npz.{8 * 'ef'}.part")
    with open(tmp_path / names[2], "rb") as held:
        assert locked(held)
        sweep(tmp_path, "x.npz")
    assert {p.name for p in tmp_path.iterdir()} == {*names[:3], f".x.npz.{8 * 'ef'}.part"}


def test_nothing_is_swept_where_locks_say_nothing(tmp_path, monkeypatch):
    """As on some network file systems: another machine may be writing it."""
    (tmp_path / f".x.npz.{8 * 'ab'}.part").touch()

    def no_locks(*_):
        raise OSError(38, "no locks here")

    monkeypatch.setattr(atomic_file.fcntl, "flock", no_locks)
    with replacing(tmp_path / "x.npz") as file:
        file.write(b"whole")
    assert {p.name for p in tmp_path.iterdir()} == {"x.npz", f".x.npz.{8 * 'ab'}.part"}


# Pipes -------------------------------------------------------------------------------------------------------------


def test_a_table_goes_into_a_pipe(tmp_path):
    make(tmp_path, "whole.csv")
    os.mkfifo(tmp_path / "x.csv")
    reader = subprocess.Popen(["cat", tmp_path / "x.csv"], stdout=subprocess.PIPE)
    make(tmp_path, "x.csv")
    assert reader.communicate(timeout=60)[0] == (tmp_path / "whole.csv").read_bytes()
    assert {p.name for p in tmp_path.iterdir()} == {"whole.csv", "x.csv"}
    assert (tmp_path / "x.csv").is_fifo()


def test_a_reader_that_goes_ends_the_run_with_a_sentence(tmp_path):
    os.mkfifo(tmp_path / "x.csv")
    reads = f"open({str(tmp_path / 'x.csv')!r}).readline()"
    reader = subprocess.Popen([sys.executable, "-c", reads])

    class Slow(FakeSimulation):
        def contacts(self):
            if getattr(self, "asked", 0) == 5:
                reader.wait(60)
            return super().contacts()

    with pytest.raises(OSError, match=r"x\.csv: whoever read it has gone"):
        export(Slow(), open_output(tmp_path / "x.csv"), duration=0.5)


@pytest.mark.parametrize("name", ["x.npz", "x.gif", "x.mp4", "x.ply", "x.pvd", "x.gsd", "x.usdc", "x.glb"])
def test_a_pipe_is_no_place_for_other_formats(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(OSError, match=r"is a pipe; only x\.csv can be written into one"):
        open_output(tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).is_fifo()


def test_a_pipe_is_not_resumed(tmp_path):
    os.mkfifo(tmp_path / "x.csv")
    with pytest.raises(ValueError, match="is a pipe, which cannot be resumed"):
        open_output(tmp_path / "x.csv", resume=True)


def test_devices_are_no_place(tmp_path):
    (tmp_path / "x.csv").symlink_to("/dev/null")
    with pytest.raises(OSError, match="is a device; give the name of a file"):
        open_output(tmp_path / "x.csv")
    assert (tmp_path / "x.csv").is_symlink()
