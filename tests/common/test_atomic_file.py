"""Files appear complete or not at all."""

import sys

import pytest

from taichi_sim.common.atomic_file import PartFile, replacing

pytestmark = pytest.mark.once


def test_a_file_appears_when_complete(tmp_path):
    with replacing(tmp_path / "a.bin") as file:
        file.write(b"new")
        assert not (tmp_path / "a.bin").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"new"


def test_an_error_leaves_what_was_there(tmp_path):
    (tmp_path / "a.bin").write_bytes(b"old")

    def half():
        with replacing(tmp_path / "a.bin") as file:
            file.write(b"half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        half()
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"old"


def test_where_nothing_can_be_written(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*none"):
        PartFile(tmp_path / "none" / "a.bin")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        PartFile(tmp_path)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc takes no files, whoever asks")
def test_without_the_right_to_write():
    with pytest.raises(OSError, match="cannot be written"):
        PartFile("/proc/a.bin")
