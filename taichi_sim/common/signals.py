"""Ctrl-C and SIGTERM that are not lost: an exception raised inside a library's import or callback may be swallowed there."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, NoReturn

__all__ = ["INTERRUPTED", "TERMINATED", "heard", "insistent_signals", "leave", "without_interrupts"]

INTERRUPTED, TERMINATED = 130, 143  # exit status: 128 + SIGINT, 128 + SIGTERM
AGAIN = 2.0  # s; long enough for a half-written file to be removed
TIMES = 10

_held_back = False
_unheard: type[BaseException] | None = None  # what was asked for, and maybe swallowed


@contextmanager
def insistent_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGINT and SystemExit(143) on SIGTERM, again and again until the block is left."""
    global _unheard
    asked: list[type[BaseException]] = []
    _unheard = None

    def insist(number: int, _: Any) -> None:
        global _unheard
        asked.append(SystemExit if number == signal.SIGTERM else KeyboardInterrupt)
        if len(asked) > TIMES:  # a library that was cut short holds the process
            os._exit(TERMINATED if asked[0] is SystemExit else INTERRUPTED)
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        _unheard = asked[0]
        if not _held_back:
            raise _answer(asked[0])

    numbers = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # a shell's background job ignores it, and so do we
        numbers.append(signal.SIGINT)
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


def _answer(kind: type[BaseException]) -> BaseException:
    return SystemExit(TERMINATED) if kind is SystemExit else KeyboardInterrupt()


def heard() -> None:
    """Ctrl-C was taken as an end like others: it does not come again, so that what is open can be closed in peace."""
    global _unheard
    _unheard = None
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Within `insistent_signals` these come as soon as the block is left, and those that were swallowed before it is entered.
    Processes that are started in it never get SIGINT: a terminal sends it to all processes of a command, and those that work for
    another one are ended by that."""
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
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
