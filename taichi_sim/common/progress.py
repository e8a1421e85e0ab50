"""Progress of long work: a bar on a terminal; in a log a line every few seconds, from the first seconds on."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any, TextIO

__all__ = ["EVERY", "Work", "log_to", "showing"]

# s, between two lines of a log: no more than ten even where compiling holds up all threads for some seconds
EVERY = 5.0

_log: TextIO | None = None  # where lines go instead of standard error


class Work:
    """Work in progress. total: steps of it, None where that is not known; done: steps that are finished; what: the steps in
    words, like "frames"; words: further text, made whenever it is shown."""

    def __init__(self, total: int | None = None, what: str = "", done: int = 0) -> None:
        self.total, self.what, self.done = total, what, done
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
    def remaining(self) -> str:
        """Time left at the pace of this phase, like `0:01:30 left`; empty while there is no pace."""
        if self.total is None or self.done <= self._first:
            return ""
        each = self.elapsed / (self.done - self._first)
        return f"{timedelta(seconds=round(each * (self.total - self.done)))} left"

    def line(self) -> str:
        """Text of one line: `12 of 240 frames, 0:01:30 left`."""
        count = f"{self.done}" if self.total is None else f"{self.done} of {self.total}"
        counted = f"{count} {self.what}" if self.what else ""
        return ", ".join(part for part in (counted, self.words()) if part)


@contextmanager
def log_to(stream: TextIO) -> Iterator[None]:
    """Write the lines to this stream meanwhile, unless it is a terminal."""
    global _log
    before, _log = _log, None if stream.isatty() else stream
    try:
        yield
    finally:
        _log = before


@contextmanager
def showing(work: Work, shown: bool) -> Iterator[None]:
    """Show work meanwhile, on standard error or, see `log_to`, in a log; nothing where `shown` is False."""
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


def _bar(work: Work, console: Any) -> Any:
    """A bar of the terminal, redrawn by a thread of its own."""
    from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TimeElapsedColumn
    from rich.text import Text

    class Line(ProgressColumn):
        """The work's own line."""

        def render(self, task: Task) -> Text:
            if work.total is not None:
                task.total, task.completed = work.total, work.done
            return Text(work.line())

    first = SpinnerColumn() if work.total is None else BarColumn()
    progress = Progress(first, TimeElapsedColumn(), Line(), console=console, transient=True)
    progress.add_task("", total=work.total)
    return progress


@contextmanager
def _lines(work: Work) -> Iterator[None]:
    """A line every EVERY seconds, by a thread, since a step of the work may take longer than that."""
    ended, start = threading.Event(), time.monotonic()

    def say() -> None:
        while not ended.wait(EVERY):
            stream = _log or sys.stderr
            try:
                print(f"{timedelta(seconds=round(time.monotonic() - start))}  {work.line()}", file=stream, flush=True)
            except (OSError, ValueError):  # whoever read it has gone
                return

    thread = threading.Thread(target=say, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(1.0)
