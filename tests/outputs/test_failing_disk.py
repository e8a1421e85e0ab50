"""A disk that is full, a folder that has gone, a file that somebody removed: one error that names the file, nothing half-written
under the final name, and a run that can be resumed."""

import errno
import resource
import shutil
import subprocess
import sys
from contextlib import contextmanager

import pytest
from test_resume import Steady, _as_often_as_asked, cut_off, files, run

from taichi_sim import Scene, SceneError
from taichi_sim.common.atomic_file import PartFile, replacing
from taichi_sim.outputs import export, open_output

pytestmark = pytest.mark.once
__all__ = ["_as_often_as_asked"]

FIRST = {
    "x.mp4": "x.mp4",
    "x.webm": "x.webm",
    "x.gif": "x.gif",
    "frames": "frames/frame_",
    "x.npz": "x.npz",
    "x.ply": "x_0",
    "x.obj": "x_0",
}


@contextmanager
def no_room():
    """As if the disk became full, by `fill`."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def fill(size):
    """Files may be no larger from now on."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


@pytest.mark.parametrize(
    ("name", "size"),
    [("x.mp4", 600), ("x.mp4", 2200), ("x.webm", 900), ("x.gif", 600), ("x.gif", 3000), ("frames", 100), ("x.npz", 90),
     ("x.npz", 2000), ("x.ply", 100), ("x.obj", 20)],
)  # fmt: skip
def test_a_full_disk_is_said_and_the_run_resumed_once_there_is_space(tmp_path, name, size):
    class Filling(Steady):
        def contacts(self):
            if self.at == 40:
                fill(size)
            return super().contacts()

    (folder := tmp_path / "full").mkdir()
    with no_room(), pytest.raises(OSError, match="File too large") as said:
        run(folder, name, kind=Filling, checkpoint=None)
    assert said.value.errno == errno.EFBIG
    assert str(said.value.filename).startswith(str(folder / FIRST[name]))
    assert not [file for file in files(folder) if file == name or file.endswith(".part")]
    run(folder, name, resume=True)
    (whole := tmp_path / "whole").mkdir()
    run(whole, name)
    assert files(folder) == files(whole)


@pytest.mark.parametrize("name", ["x.npz", "x.mp4"])
def test_a_checkpoint_for_which_there_is_no_room_ends_the_run(tmp_path, name):
    class Large(Steady):
        def save(self, path):
            with replacing(path) as file:
                file.write(bytes(100_000 if self.at == 40 else 10))
                fill(20_000)

    (tmp_path / name).write_text("old")
    with no_room(), pytest.raises(OSError, match="File too large") as said:
        run(tmp_path, name, kind=Large)
    assert "state_000011.npz" in said.value.filename
    assert (tmp_path / name).read_text() == "old"
    (tmp_path / name).unlink()
    run(tmp_path, name)
    assert list(files(tmp_path)) == [name]


@pytest.mark.parametrize("name", FIRST)
def test_a_folder_that_goes_away_is_said(tmp_path, name):
    (folder := tmp_path / "gone").mkdir()

    class Removed(Steady):
        def contacts(self):
            if self.at == 40:
                folder.rename(tmp_path / "elsewhere")
            return super().contacts()

    with pytest.raises(OSError, match=f"{name.split('.')[0]}|gone'$") as said:  # the file or, missed first, its folder
        run(folder, name, kind=Removed, checkpoint=None)
    assert str(folder) in str(said.value)
    assert not folder.exists()


@pytest.mark.parametrize("name", ["frames", "x.ply", "x.obj"])
def test_frames_that_were_removed_meanwhile_are_missed(tmp_path, name):
    class Removed(Steady):
        def contacts(self):
            if self.at == 80:
                for index in (3, 5):
                    next(tmp_path.rglob(f"*_0000{index}.*")).unlink()
            return super().contacts()

    with pytest.raises(FileNotFoundError, match=r"was removed before the run ended, as were 1 more") as said:
        run(tmp_path, name, kind=Removed, checkpoint=None)
    assert "_00003." in said.value.filename
    run(tmp_path, name, resume=True)
    assert len([file for file in files(tmp_path) if "resume" not in file and "_frames.mtl" not in file]) == 30


def test_a_part_that_was_removed_is_said(tmp_path):
    part = PartFile(tmp_path / "x.bin")
    part.part.unlink()
    with pytest.raises(FileNotFoundError, match="what was written of it was removed before it was complete") as said:
        part.finish()
    assert said.value.filename == str(tmp_path / "x.bin")


def test_frames_are_kept_only_where_they_are(tmp_path):
    class Removed(Steady):
        def contacts(self):
            if self.at == 80:
                shutil.rmtree(tmp_path / ".x.gif.resume")
                raise KeyboardInterrupt
            return super().contacts()

    output = open_output(tmp_path / "x.gif")
    with pytest.raises(KeyboardInterrupt):
        export(Removed(), output, duration=29 / 60, checkpoint=None)
    assert output.frames == 0
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["x.npz", "x.mp4", "x.gif", "x.ply", "x.obj", "x.webm"])
def test_a_folder_is_no_file(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(IsADirectoryError, match=rf"{name}: is a folder; give the name of a file"):
        open_output(tmp_path / name)
    assert list(tmp_path.iterdir()) == [tmp_path / name]


def test_a_folder_may_have_a_dot(tmp_path):
    (tmp_path / "frames.v2").mkdir()
    run(tmp_path, "frames.v2", duration=0.05)
    assert len(files(tmp_path)) == 3


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc takes no files, whoever asks")
@pytest.mark.parametrize("name", FIRST)
def test_a_folder_that_takes_no_files(name):
    with pytest.raises(OSError, match=rf"/proc/{name}: cannot be written"):
        open_output(f"/proc/{name}")


def test_no_room_for_the_first_file_leaves_nothing(tmp_path):
    class Filling(Steady):
        def contacts(self):
            fill(20)
            return super().contacts()

    with no_room(), pytest.raises(OSError, match="File too large"):
        run(tmp_path, "x.npz", kind=Filling, checkpoint=None)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", [".", "/", ""])
def test_what_has_no_name_is_a_folder(path):
    for write in (PartFile, Scene(dim=2).save):
        with pytest.raises(IsADirectoryError, match="is a folder; give the name of a file"):
            write(path)


def test_one_output_twice_is_refused_first(tmp_path):
    output = open_output(tmp_path / "x.npz")
    with pytest.raises(SceneError, match=r"^output\[1\]: is given twice; give each output once"):
        export(Steady(), [output, output], duration=0.1)
    output.discard()
    assert not list(tmp_path.iterdir())


# What killed runs leave --------------------------------------------------------------------------------------------


def test_what_a_killed_run_left_is_swept_and_what_another_writes_is_not(tmp_path):
    code = f"""if True:
        import os, signal
        from taichi_sim.common.atomic_file import PartFile
        PartFile({str(tmp_path / "x.json")!r}).file.write(b"half")
        os.kill(os.getpid(), signal.SIGKILL)
    """
    subprocess.run([sys.executable, "-c", code], check=False)
    other = PartFile(tmp_path / "y.json")
    assert len(list(tmp_path.iterdir())) == 2
    with replacing(tmp_path / "x.json") as file:
        file.write(b"whole")
        again = PartFile(tmp_path / "x.json")
        again.file.write(b"other")
    assert (tmp_path / "x.json").read_bytes() == b"whole"
    again.finish()
    other.finish()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["x.json", "y.json"]


@pytest.mark.parametrize(
    ("name", "part"),
    [("frames", "frames/.frame_00007.png.0123456789abcdef.part"), ("x.ply", ".x_00007.ply.0123456789abcdef.part")],
)
def test_half_frames_of_a_killed_run_are_swept(tmp_path, name, part):
    cut_off(tmp_path, name, 13)
    (tmp_path / part).write_bytes(b"half")
    run(tmp_path, name, resume=True)
    assert len(files(tmp_path)) == 30
