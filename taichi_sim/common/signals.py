"""Ctrl-C and SIGTERM that are not lost: an exception raised inside a library's import or callback may be swallowed there."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

__all__ = ["INTERRUPTED", "TERMINATED", "heard", "insistent_signals", "leave"]

INTERRUPTED, TERMINATED = 130, 143  # exit status: 128 + SIGINT, 128 + SIGTERM
AGAIN = 2.0  # s; long enough for a half-written file to be removed
TIMES = 10


@contextmanager
def insistent_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGINT and SystemExit(143) on SIGTERM, again and again until the block is left."""
    asked: list[type[BaseException]] = []

    def insist(number: int, _: Any) -> None:
        asked.append(SystemExit if number == signal.SIGTERM else KeyboardInterrupt)
        if len(asked) > TIMES:  # a library that was cut short holds the process
            os._exit(TERMINATED if asked[0] is SystemExit else INTERRUPTED)
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        raise answer()

    def answer() -> BaseException:
        return SystemExit(TERMINATED) if asked[0] is SystemExit else KeyboardInterrupt()

    numbers = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # a shell's background job ignores it, and so do we
        numbers.append(signal.SIGINT)
    if hasattr(signal, "SIGALRM"):
        numbers.append(signal.SIGALRM)
    before = {number: signal.signal(number, insist) for number in numbers}
    try:
        yield
    except BaseException:
        if asked:  # what a half-made object raised while it was cleaned up is of no interest
            raise answer() from None
        raise
    finally:
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def heard() -> None:
    """Ctrl-C was taken as an end like others: it does not come again, so that what is open can be closed in peace."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def leave(status: int) -> NoReturn:
    """End the process now. Libraries that were interrupted while they started may wait for ever on the ordinary way out."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
