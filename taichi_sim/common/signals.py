"""Ctrl-C, SIGTERM and SIGHUP that are not lost: a library's import or callback may swallow an exception raised inside it."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from typing import Any, NoReturn

__all__ = [
    "ENDED",
    "HUNG_UP",
    "INTERRUPTED",
    "TERMINATED",
    "Patience",
    "heard",
    "insistent_signals",
    "leave",
    "patiently",
    "without_interrupts",
]

HUNG_UP, INTERRUPTED, TERMINATED = 129, 130, 143  # exit status: 128 + the number of the signal
ENDED = (HUNG_UP, TERMINATED)  # those that a SystemExit carries
AGAIN = 2.0  # s; long enough for a half-written file to be removed
TIMES = 10
PATIENCE = 6.0  # s; `docker stop` and many a queue wait ten before they kill

_held_back = False
_unheard: int | None = None  # the exit status of what was asked for, and maybe swallowed
_patience: "Patience | None" = None


@contextmanager
def insistent_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGINT, SystemExit(143) on SIGTERM and SystemExit(129) on SIGHUP, which comes when a terminal or
    an ssh connection is closed, again and again until the block is left. SIGINT and SIGHUP that are ignored, as in a shell's
    background job or after `nohup`, stay so."""
    global _unheard
    asked: list[int] = []
    _unheard = None

    def insist(number: int, _: Any) -> None:
        global _unheard
        asked.append(128 + number)
        if len(asked) > TIMES:  # a library that was cut short holds the process
            os._exit(asked[0])
        if _patience is not None and len(asked) == 1:
            _patience.note(asked[0])
            return
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        _unheard = asked[0]
        if not _held_back:
            raise _answer(asked[0])

    known = [getattr(signal, name) for name in ("SIGINT", "SIGHUP") if hasattr(signal, name)]
    numbers = [signal.SIGTERM, *(number for number in known if signal.getsignal(number) is not signal.SIG_IGN)]
    if hasattr(signal, "SIGALRM"):
        numbers.append(signal.SIGALRM)
    before = {number: signal.signal(number, insist) for number in numbers}
    tell = sys.unraisablehook

    def tell_others(lost: Any) -> None:  # of those swallowed in a callback nothing need be said: they come again
        if not (asked and isinstance(lost.exc_value, (KeyboardInterrupt, SystemExit))):
            tell(lost)

    sys.unraisablehook = tell_others
    try:
        yield
    except BaseException:
        if asked:  # what a half-made object raised while it was cleaned up is of no interest
            raise _answer(asked[0]) from None
        raise
    finally:
        _unheard = None
        sys.unraisablehook = tell
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _answer(status: int) -> BaseException:
    return KeyboardInterrupt() if status == INTERRUPTED else SystemExit(status)


class Patience:
    """The first signal of a block, which waits until the work stands well, but no longer than PATIENCE.

    tell: called as soon as it comes.
    """

    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell = tell
        self._status: int | None = None

    def note(self, status: int) -> None:
        """Take the signal, whose exit status this is."""
        self._status = status
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, PATIENCE)
        self._tell()

    def taken(self) -> bool:
        """True once it came. The work stands well then: what it does before `end` is cut short by a second signal alone."""
        if self._status is None:
            return False
        heard()
        return True

    def end(self) -> None:
        """Raise what was asked for, if it was."""
        if self.taken():
            assert self._status is not None
            raise _answer(self._status)


@contextmanager
def patiently(tell: Callable[[], None]) -> Iterator[Patience]:
    """Note the first signal of a block within `insistent_signals`; it is raised where the block calls `end`, and at its end. A
    second signal, and work that does not stand well for too long, raise it at once."""
    global _patience
    _patience = patience = Patience(tell)
    try:
        yield patience
    finally:
        _patience = None
    patience.end()


def heard() -> None:
    """Ctrl-C was taken as an end like others: it does not come again, so that what is open can be closed in peace."""
    global _unheard
    _unheard = None
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Hold interrupts back during the block. Within `insistent_signals` these come as soon as the block is left, and those
    that were swallowed before it is entered. Processes that are started in it never get SIGINT: a terminal sends it to all
    processes of a command, and those that work for another one are ended by that."""
    global _held_back
    _come()
    # the mask is not enough: threads that were there before take signals, and the main one hears of it
    _held_back = True
    masks = hasattr(signal, "pthread_sigmask")
    if masks:
        resource_tracker.ensure_running()  # its start lets SIGINT through again, in the thread that starts the first process
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        _held_back = False
    _come()


def _come() -> None:
    if _unheard is not None:
        raise _answer(_unheard)


def leave(status: int) -> NoReturn:
    """End the process now. Libraries that were interrupted while they started may wait for ever on the ordinary way out."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # of a terminal that was closed
            stream.flush()
    os._exit(status)
