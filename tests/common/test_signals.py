"""Ctrl-C is not lost where a library swallows it, or while something is started that cannot be closed."""

import signal
import time
from contextlib import suppress

import pytest

from taichi_sim.common import signals
from taichi_sim.common.signals import HUNG_UP, TERMINATED, heard, insistent_signals, patiently, without_interrupts

pytestmark = pytest.mark.once


@pytest.fixture(autouse=True)
def _not_ignored():
    """A shell's background job ignores Ctrl-C, and one behind nohup a hangup."""
    before = [signal.signal(signal.SIGINT, signal.default_int_handler), signal.signal(signal.SIGHUP, signal.SIG_DFL)]
    yield
    for number, handler in zip((signal.SIGINT, signal.SIGHUP), before):
        signal.signal(number, handler)


def interrupt(number=signal.SIGINT):
    """In this thread: another thread of the process might take what is sent to the process, and later."""
    signal.raise_signal(number)


def test_what_comes_while_it_is_held_back_comes_at_the_end():
    done = []

    def work():
        with insistent_signals():
            with without_interrupts():
                interrupt()
                done.append(1)
            done.append(2)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == [1]


@pytest.mark.parametrize(
    ("number", "comes", "status"),
    [
        (signal.SIGINT, KeyboardInterrupt, None),
        (signal.SIGTERM, SystemExit, TERMINATED),
        (signal.SIGHUP, SystemExit, HUNG_UP),
    ],
)
def test_what_was_swallowed_comes_before_something_is_started(number, comes, status):
    started = []

    def work():
        with insistent_signals():
            with suppress(BaseException):  # as in a callback of a library
                interrupt(number)
            with without_interrupts():
                started.append(1)

    with pytest.raises(comes) as end:
        work()
    assert not started
    assert getattr(end.value, "code", None) == status


def test_a_hangup_that_is_ignored_stays_so():
    """As after `nohup`."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with insistent_signals():
            interrupt(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_what_was_heard_does_not_come_again():
    with insistent_signals():
        with pytest.raises(KeyboardInterrupt):
            interrupt()
        heard()
        with without_interrupts():
            pass


def test_nothing_is_left_for_the_next_block():
    with pytest.raises(KeyboardInterrupt), insistent_signals():
        interrupt()
    with insistent_signals(), without_interrupts():
        pass


def test_the_first_signal_waits_until_the_work_stands_well_and_the_second_does_not():
    told, done = [], []

    def work(signals_in_a_row):
        with insistent_signals(), patiently(lambda: told.append(1)) as patience:
            patience.end()
            for _ in range(signals_in_a_row):
                interrupt(signal.SIGTERM)
            done.append(patience.taken())
            patience.end()
            done.append("not reached")

    with pytest.raises(SystemExit) as end:
        work(1)
    assert (told, done, end.value.code) == ([1], [True], TERMINATED)
    with pytest.raises(SystemExit):
        work(2)
    assert done == [True]


@pytest.mark.parametrize("calls_end", [False, True])
def test_work_that_does_not_stand_well_in_time_is_cut_short(monkeypatch, calls_end):
    monkeypatch.setattr(signals, "PATIENCE", 0.05)

    def work():
        with insistent_signals(), patiently(lambda: None) as patience:
            interrupt()
            if calls_end:
                assert patience.taken()
                time.sleep(0.2)  # not hurried any more
                patience.end()
            time.sleep(30.0)
            pytest.fail("the signal was lost")

    with pytest.raises(KeyboardInterrupt):
        work()
