"""Lines about long work where there is no terminal."""

import io
import subprocess
import sys
import time

import pytest

from taichi_sim.common import progress

pytestmark = pytest.mark.once


def waited(condition):
    until = time.monotonic() + 10.0
    while not condition() and time.monotonic() < until:
        time.sleep(0.005)
    return condition()


def test_a_log_gets_lines_while_one_step_lasts(monkeypatch, capsys):
    """The work itself says nothing meanwhile, as while a kernel is compiled."""
    monkeypatch.setattr(progress, "EVERY", 0.01)
    work = progress.Work(40, "frames")
    work.words = lambda: "t = 0.5 s"
    seen = []
    with progress.showing(work, True):
        assert waited(lambda: seen.append(capsys.readouterr().err) or "".join(seen).count("\n") > 2)
        work.done = 7
        assert waited(lambda: seen.append(capsys.readouterr().err) or "7 of 40" in "".join(seen))
    lines = "".join(seen).splitlines()
    assert lines[0] == "0:00:00  0 of 40 frames, t = 0.5 s"
    capsys.readouterr()
    time.sleep(0.05)
    assert capsys.readouterr().err == ""  # it ends with the work


def test_lines_go_where_the_command_writes(monkeypatch, capsys):
    monkeypatch.setattr(progress, "EVERY", 0.01)
    stream = io.StringIO()
    with progress.log_to(stream), progress.showing(progress.Work(what="runs done"), True):
        assert waited(lambda: "0 runs done" in stream.getvalue())
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("printed_apart", [False, True])
def test_a_log_has_no_line_of_work_that_says_nothing(monkeypatch, capfd, printed_apart):
    monkeypatch.setattr(progress, "EVERY", 0.02)
    if printed_apart:
        monkeypatch.setattr(sys, "__stderr__", sys.stderr)
    work, words = progress.Work(), iter([""] * 9)
    work.words = lambda: next(words, "loading")
    seen = []
    with progress.showing(work, True):
        assert waited(lambda: seen.append(capfd.readouterr().err) or "loading" in "".join(seen))
    seen.append(capfd.readouterr().err)
    assert all(line.endswith("  loading") for line in "".join(seen).splitlines())


def test_nothing_is_said_of_quiet_or_short_work(capsys):
    with progress.showing(progress.Work(3), False):
        pass
    with progress.showing(progress.Work(3), True):
        pass
    assert capsys.readouterr().err == ""


def test_a_reader_that_has_gone_ends_the_lines_and_nothing_else(monkeypatch):
    monkeypatch.setattr(progress, "EVERY", 0.01)
    stream = io.StringIO()
    with progress.log_to(stream), progress.showing(progress.Work(3), True):
        stream.close()
        time.sleep(0.05)


def test_time_left_is_judged_by_the_phase(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    work = progress.Work(10, "points", done=6)  # six were there before
    assert work.remaining == ""
    now[0] += 30.0
    work.done = 8
    assert work.remaining == "0:00:30 left"


HELD = """
import ctypes, sys, time
from taichi_sim.common import progress
progress.EVERY = 0.2
work = progress.Work(9, "frames")
with progress.log_to(sys.stdout), progress.showing(work, True):
    ctypes.PyDLL(None).usleep(900_000)  # holds the interpreter's lock, as the compiler does
    time.sleep(0.0)
print("end")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="usleep")
def test_lines_go_on_while_the_compiler_holds_all_threads_up():
    said = subprocess.run([sys.executable, "-c", HELD], capture_output=True, text=True, timeout=60, check=True)
    lines = said.stdout.splitlines()
    assert len(lines) >= 3
    assert all(line.endswith("  0 of 9 frames") for line in lines[:-1])
    assert lines[-1] == "end"
    assert said.stderr == ""


def test_a_total_that_is_about_and_a_pace(monkeypatch):
    now = [50.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    work = progress.Work(12, "runs", about=True)
    now[0] += 8.0
    work.done = 4
    assert work.line() == "4 of about 12 runs"
    assert work.pace == 0.5
    assert work.remaining == "0:00:16 left"
