"""What goes to a terminal, or to none: no control sequences of others, any encoding, streams that are closed or full."""

import os
import subprocess
import sys

import pytest
from typer.testing import CliRunner

import taichi_sim as ts
from taichi_sim.cli.main import main
from taichi_sim.common.printable import printable

pytestmark = [pytest.mark.once, pytest.mark.skipif(os.name != "posix", reason="descriptors and /dev/full")]

EVIL = "\x1b]0;owned\x07\x1b[2J"  # sets a title and clears the screen
BALL = "[[balls]]\nposition = [[0, 1, 0]]\nradius = 0.1\n"
TURNED = "\u202etoml\u202c"  # is shown from right to left


def command(*words, shell="", **environment):
    """Python with these arguments, its streams as the shell's words make them."""
    line = " ".join([sys.executable, *words, shell])
    return subprocess.run(["bash", "-c", line], capture_output=True, env={**os.environ, **environment}, timeout=120)


def test_what_a_terminal_would_obey_is_shown_by_its_code():
    assert printable(EVIL) == r"\x1b]0;owned\x07\x1b[2J"
    assert printable("\x9b31m" + TURNED + "\ud800\r") == r"\x9b31m\u202etoml\u202c\ud800\r"
    for text in ("Würfel ☃\n\tm²", "10\u202fmm", "10\xa0mm"):
        assert printable(text) == text


@pytest.mark.parametrize(
    "text",
    [
        f'format = 1\n"{EVIL}" = 1\n',
        f'format = 1\n[[balls]]\n"a{EVIL}" = 1\n',
        f'format = 1\n"a\\nb{EVIL}" = 1\n',
        f'format = 1\n{BALL}material = "{EVIL}"\n[[materials]]\nname = "{EVIL}2"\n',
        f'format = 1\n{BALL}name = "{EVIL}"\n[[springs]]\nballs = "{EVIL}x"\npairs = [0, 1]\n',
        f'format = 1\n[[{EVIL}]]\n',
    ],
)  # fmt: skip
def test_names_in_a_scene_file_command_no_terminal(tmp_path, text):
    escaped = text.replace("\x1b", "\\u001b").replace("\x07", "\\u0007")
    for written in (escaped, text):
        (tmp_path / "a.toml").write_text(written)
        with pytest.raises(ts.SceneError) as raised:
            ts.load_scene(tmp_path / "a.toml")
        assert printable(str(raised.value)) == str(raised.value)
        assert "\n" not in str(raised.value)


def test_an_error_is_one_line_whatever_is_named(tmp_path):
    done = CliRunner().invoke(main, ["check", f"{tmp_path}/a\nb.toml"])
    assert (done.exit_code, done.output.count("\n")) == (2, 1)
    assert r"/a\nb.toml: " in done.output


def test_names_of_files_command_no_terminal(tmp_path):
    done = CliRunner().invoke(main, ["check", f"{tmp_path}/{EVIL}.toml"])
    assert done.exit_code == 2
    assert "\x1b" not in done.output
    assert r"\x1b]0;owned" in done.output


def test_any_encoding(tmp_path):
    done = command("-m", "taichi_sim", "check", f"{tmp_path}/Bälle☃.toml", PYTHONIOENCODING="latin-1")
    assert done.returncode == 2
    assert "Bälle".encode("latin-1") + rb"\u2603" in done.stderr
    for encoding in ("ascii", "cp1252"):
        done = command(
            "-c",
            "'import taichi_sim.common.printable as m; m.settle_streams(); print(chr(0x2603))'",
            PYTHONIOENCODING=encoding,
        )
        assert (done.returncode, done.stdout) == (0, rb"\u2603" + b"\n")


CLOSED = """
import os, sys
from taichi_sim.common.printable import settle_streams
settle_streams()
if open(os.devnull).fileno() < 3:
    os._exit(7)
print(1)
print(2, file=sys.stderr)
os.write(1, b"3")
"""


def test_python_without_docstrings_and_with_warnings_as_errors():
    done = command("-W", "error", "-OO", "-m", "taichi_sim", "schema")
    assert done.returncode == 0, done.stderr
    code = "'from taichi_sim.device.engine import ti; print(ti.__name__)'"
    assert command("-W", "error", "-c", code).stdout.split()[-1:] in ([b"taichi"], [b"quadrants"])


def test_streams_that_are_closed(tmp_path):
    """A file that is opened later does not take their numbers, in which libraries write."""
    (tmp_path / "closed.py").write_text(CLOSED)
    for shell in (">&-", "2>&-", "<&- >&- 2>&-"):
        assert command(str(tmp_path / "closed.py"), shell=shell).returncode == 0


def test_streams_that_are_full():
    done = command("-m", "taichi_sim", "--version", shell="> /dev/full")
    assert done.returncode == 2
    assert done.stderr.decode().splitlines() == ["taichi-sim: standard output: No space left on device"]
    assert command("-m", "taichi_sim", "check", "nowhere.toml", shell="> /dev/full 2> /dev/full").returncode == 2


SPAWNS = """
import multiprocessing, os, sys
from taichi_sim.__main__ import main
sys.argv = ["taichi-sim", "--version"]
if __name__ == "__main__":
    try:
        main()
    except SystemExit:
        pass
    os.chdir(sys.path[0])
    os.chdir("scene")
    process = multiprocessing.get_context("spawn").Process(target=print, args=("begun",))
    process.start()
    process.join()
"""


def test_the_package_as_a_command_takes_no_modules_from_the_working_folder(tmp_path):
    for name in ("typer", "random", "numpy", "tempfile"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'taken')!r}, 'w').close()\n")
    command = [sys.executable, "-m", "taichi_sim", "--version"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.returncode, (tmp_path / "taken").exists()) == (0, False), done.stderr


def test_processes_that_are_started_take_no_modules_from_the_working_folder(tmp_path):
    """It may be that of a scene from elsewhere."""
    (tmp_path / "scene").mkdir()
    for name in ("pickle", "socket", "runpy"):
        (tmp_path / "scene" / f"{name}.py").write_text(f"open({str(tmp_path / 'sprung')!r}, 'w')")
    (tmp_path / "spawns.py").write_text(SPAWNS)
    done = command(str(tmp_path / "spawns.py"))
    assert done.stdout.split()[-1:] == [b"begun"], done.stderr
    assert not (tmp_path / "sprung").exists()
