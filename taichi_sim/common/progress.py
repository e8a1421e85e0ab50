"""Progress of long work: a bar on a terminal; in a log a line every few seconds, from the first seconds on."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from datetime import timedelta
from typing import Any, TextIO

__all__ = ["EVERY", "Counted", "Work", "current", "log_to", "showing", "waiting"]

EVERY = 5.0  # s, between two lines of a log

FEED = 1.0  # s, between two lines that the printing process is told

PRINTER = """
import datetime, os, signal, sys, threading, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
every, begin, said = float(sys.argv[1]), time.monotonic(), [b""]
def read():
    for line in sys.stdin.buffer:
        said[0] = line
    os._exit(0)
threading.Thread(target=read, daemon=True).start()
while True:
    time.sleep(every)
    passed = datetime.timedelta(seconds=round(time.monotonic() - begin))
    try:
        if said[0].strip():
            os.write(1, f"{passed}  ".encode() + said[0])
    except OSError:
        os._exit(0)
"""

_log: TextIO | None = None  # where lines go instead of standard error
_current: ContextVar["Work | None"] = ContextVar("current", default=None)


class Work:
    """Work in progress. total: steps of it, None where that is not known; done: steps that are finished; what: the steps in
    words, like "frames"; words: further text, made whenever it is shown; about: whether the total may turn out otherwise."""

    def __init__(self, total: int | None = None, what: str = "", done: int = 0, about: bool = False) -> None:
        self.total, self.what, self.done, self.about = total, what, done, about
        self.words: Callable[[], str] = str
        self.begin(what)

    def begin(self, what: str) -> None:
        """Count the steps of a new phase; `remaining` is judged by these alone."""
        self.what, self._first = what, self.done
        self._since = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds since the phase began."""
        return time.monotonic() - self._since

    @property
    def pace(self) -> float:
        """Steps a second in this phase."""
        return (self.done - self._first) / max(1e-9, self.elapsed)

    @property
    def remaining(self) -> str:
        """Time left at the pace of this phase, like `0:01:30 left`; empty while there is no pace."""
        if self.total is None or self.done <= self._first:
            return ""
        return f"{timedelta(seconds=round((self.total - self.done) / self.pace))} left"

    def line(self) -> str:
        """Text of one line: `12 of 240 frames, 0:01:30 left`."""
        count = f"{self.done}" if self.total is None else f"{self.done} of {'about ' * self.about}{self.total}"
        counted = f"{count} {self.what}" if self.what else ""
        return ", ".join(part for part in (counted, self.words()) if part)


class Counted(Work):
    """Work whose steps take about as long as each other: its line says how many failed, and the time left."""

    def __init__(self, total: int, what: str, done: int = 0) -> None:
        super().__init__(total, what, done)
        self.failed = 0
        self.words = lambda: ", ".join(filter(None, (f"{self.failed} failed" if self.failed else "", self.remaining)))


@contextmanager
def log_to(stream: TextIO) -> Iterator[None]:
    """Write the lines to this stream meanwhile, unless it is a terminal."""
    global _log
    before, _log = _log, None if stream.isatty() else stream
    try:
        yield
    finally:
        _log = before


def current() -> Work | None:
    """The work that this thread shows, or would show if that was wanted; None: it does none."""
    return _current.get()


@contextmanager
def showing(work: Work, shown: bool) -> Iterator[None]:
    """Show work meanwhile, on standard error or, see `log_to`, in a log; nothing where `shown` is False."""
    before = _current.set(work)
    try:
        with _shown(work, shown):
            yield
    finally:
        _current.reset(before)


@contextmanager
def _shown(work: Work, shown: bool) -> Iterator[None]:
    if not shown:
        yield
        return
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        with _bar(work, console):
            if _log is None:
                yield
                return
            with _lines(work):
                yield
        return
    with _lines(work):
        yield


@contextmanager
def waiting(what: str, shown: bool) -> Iterator[None]:
    """Say meanwhile what is waited for."""
    work = Work()
    work.words = lambda: what
    with showing(work, shown):
        yield


def _bar(work: Work, console: Any) -> Any:
    """A bar of the terminal, redrawn by a thread of its own."""
    from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TimeElapsedColumn
    from rich.table import Column
    from rich.text import Text

    class Line(ProgressColumn):
        """The work's own line."""

        def render(self, task: Task) -> Text:
            if work.total is not None:
                task.total, task.completed = work.total, work.done
            return Text(work.line())

    first = SpinnerColumn() if work.total is None else BarColumn(bar_width=16)
    line = Line(Column(no_wrap=True, overflow="ellipsis"))
    progress = Progress(first, TimeElapsedColumn(), line, console=console, transient=True)
    progress.add_task("", total=work.total)
    return progress


@contextmanager
def _lines(work: Work) -> Iterator[None]:
    """Print a line every EVERY seconds. A thread asks the work for its line, and a process of its own prints what it got last:
    compiling a kernel holds up all threads of this one, for half a minute on a busy machine."""
    ended, start = threading.Event(), time.monotonic()
    stream: TextIO = _log or sys.stderr
    printer = _printer(stream) if stream in (sys.__stdout__, sys.__stderr__) else None

    def say() -> None:
        while not ended.wait(EVERY if printer is None else min(EVERY, FEED)):
            try:
                if printer is not None:
                    tell()
                elif line := work.line():
                    print(f"{timedelta(seconds=round(time.monotonic() - start))}  {line}", file=stream, flush=True)
            except (OSError, ValueError):  # whoever read it has gone
                return

    def tell() -> None:
        assert printer is not None
        assert printer.stdin is not None
        printer.stdin.write(work.line().replace("\n", " ").encode("utf-8", "backslashreplace") + b"\n")
        printer.stdin.flush()

    thread = threading.Thread(target=say, name="progress", daemon=True)
    try:
        if printer is not None:
            with suppress(OSError):
                tell()
        thread.start()
        yield
    finally:
        ended.set()
        thread.join(1.0)
        if printer is not None:
            _end(printer)


def _printer(stream: TextIO) -> "subprocess.Popen[bytes] | None":
    """A process that prints the last line of its standard input every EVERY seconds; None where none can be started."""
    try:
        stream.flush()
        command = [sys.executable, "-I", "-S", "-c", PRINTER, str(EVERY)]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stream.fileno(), stderr=subprocess.DEVNULL)
    except (OSError, ValueError):
        return None


def _end(printer: "subprocess.Popen[bytes]") -> None:
    """End the printer: it ends where its input does, and prints nothing more."""
    assert printer.stdin is not None
    with suppress(OSError):
        printer.stdin.close()
    try:
        printer.wait(5.0)
    except subprocess.TimeoutExpired:
        printer.kill()
        printer.wait()
