"""Player: commands on a simulation that is watched, which the window and browser pages share. Nothing is compiled."""

import numpy as np
import pytest

from taichi_sim.analysis.frame import Frame
from taichi_sim.viewer import window
from taichi_sim.viewer.pace import Share
from taichi_sim.viewer.player import COMMANDS, Player
from taichi_sim.viewer.web_panel import MOST_POINTS, History

pytestmark = pytest.mark.once

STEP = 0.004


class Counted:
    """A simulation that counts its steps: two balls that move along x by a metre each second, the second one pinned."""

    dt, substeps = STEP, 1

    def __init__(self):
        self.steps = 0

    @property
    def time(self):
        return self.steps * STEP

    def step(self, steps):
        self.steps += steps

    def frame(self):
        x = np.array([[self.time, 1.0], [3.0, 1.0]])
        return Frame(self.time, x, 0 * x, np.full(2, 0.1), pinned=np.array([False, True]))

    def snapshot(self):
        return self.steps

    def resume(self, steps):
        self.steps = steps


class Hand:
    """A pointer that notes what it is told."""

    ready, ball, target = True, None, None

    def grab(self, ball, target):
        self.ball, self.target = ball, target

    def move(self, target):
        self.target = target

    def release(self):
        self.ball = None


def player(until=None):
    return Player(Counted(), Hand(), 25.0, until)


def test_time_passes_stands_and_begins_anew():
    one = player()
    acts = {command.label: command.act for command in COMMANDS}
    for _ in range(50):
        one.advance(0.02)
    assert one.frame.time == pytest.approx(1.0, abs=0.05)
    acts["Pause"](one)
    stopped = one.frame.time
    assert (one.advance(0.02), one.stands) == (0.0, True)
    acts["Step"](one)
    acts["Step"](one)
    assert one.advance(0.02) == pytest.approx(2 * STEP)
    acts["Picture"](one)
    one.advance(0.02)
    assert one.frame.time == pytest.approx(stopped + 2 * STEP + 1 / 25)
    acts["Reset"](one)
    assert one.frame.time == 0.0
    acts["Pause"](one)
    acts["Slower"](one)
    acts["Slower"](one)
    assert sum(one.advance(0.02) for _ in range(50)) == pytest.approx(0.25, abs=0.02)
    acts["Faster"](one)
    assert one.pace.speed == 0.5


def test_time_has_an_end():
    one = player(until=0.1)
    for _ in range(50):
        one.advance(0.02)
    assert (one.frame.time, one.ended) == (pytest.approx(0.1), True)
    assert dict(one.figures())["speed"] == "at its end"


def test_a_ball_is_held_where_it_was_touched():
    one = player()
    assert not one.grab(1, np.array([3.0, 1.0]))  # pinned
    assert one.held is None
    assert one.grab(0, np.array([0.05, 1.02]))
    one.pull(np.array([0.5, 2.0]))
    ball, goal = one.held
    assert ball == pytest.approx([0.0, 1.0])
    assert goal == pytest.approx([0.45, 1.98])
    one.reset()
    assert one.held is None
    hand = Hand()
    hand.ready = False
    assert not Player(Counted(), hand, 25.0, None).grab(0, np.zeros(2))  # of a simulation without one


def test_the_window_has_a_key_for_each_command():
    assert {(one.key, one.words) for one in COMMANDS} <= set(window.HELP)
    keys = [key for key, _ in window.HELP]
    assert len(keys) == len(set(keys))
    assert len({one.label for one in COMMANDS}) == len(COMMANDS)


def test_pictures_take_no_more_than_their_share():
    share, now, spent = Share(fps=20.0, part=0.1), 0.0, 0.0
    for _ in range(10_000):
        if share.due(now):
            share.spent(now, now + 0.03)
            now, spent = now + 0.03, spent + 0.03
        now += 0.001
    assert spent / now == pytest.approx(0.1, rel=0.05)
    share, made = Share(fps=20.0, part=0.1), 0
    for now in np.arange(0.0, 10.0, 0.001).tolist():  # quick ones come as often as is asked
        if share.due(now):
            share.spent(now, now + 0.0001)
            made += 1
    assert made == pytest.approx(200, abs=5)


def test_a_plot_spans_all_of_a_long_run():
    history = History(["a", "b"])
    for k in range(7 * MOST_POINTS):
        history.add(0.01 * k, {"a": float(k), "b": -float(k)})
        history.add(0.01 * k, {"a": -1.0})  # the same moment
    times, a = history.columns(["a"])
    assert MOST_POINTS / 2 <= len(times) <= MOST_POINTS
    assert times[0] == 0.0
    assert times[-1] > 0.99 * 0.07 * MOST_POINTS
    assert np.ptp(np.diff(times)) < 1e-9
    assert a == pytest.approx(100 * times)
    history.add(0.5, {"b": 2.0})  # it was put back
    times, a, b = history.columns(["a", "b"])
    assert (times.tolist(), b.tolist()) == ([0.5], [2.0])
    assert np.isnan(a[0])
