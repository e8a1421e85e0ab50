"""A user-defined output: no file of the package knows it."""

import textwrap

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.outputs import base


def falling():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0, 1], [1, 2]], radius=0.1)
    return scene


@pytest.mark.slow
@pytest.mark.once
def test_the_example_of_the_docstring_writes_a_table(tmp_path, monkeypatch):
    example = base.__doc__.split(":\n\n", 1)[1].split("\n\nWithout", 1)[0]
    monkeypatch.chdir(tmp_path)
    with ts.Simulation(falling(), dt=1e-3, arch="cpu") as simulation:
        exec(textwrap.dedent(example), {"simulation": simulation, "ts": ts})
    table = np.loadtxt("heights.csv", delimiter=",")
    assert table.shape == (121, 3)
    time = table[:, 0]
    assert time == pytest.approx(np.arange(121) / 60, abs=5.1e-4)  # the nearest steps of 1 ms
    assert table[:, 1] == pytest.approx(1.0 - 5.0 * time**2, abs=1e-3)
    assert table[:, 2] - table[:, 1] == pytest.approx(np.ones(121), abs=1e-5)


class Kept(ts.Output):
    """Remembers what it is asked."""

    needs_image = False

    def __init__(self):
        self.calls = []

    def wants(self, index):
        return index % 2 == 0

    def write(self, index, frame, image):
        if frame is None:
            raise OSError("disk full")
        self.calls.append((index, image))

    def finish(self):
        self.calls.append("finish")

    def discard(self):
        self.calls.append("discard")


@pytest.mark.slow
def test_it_says_which_frames_it_wants_and_is_finished():
    output = Kept()
    with ts.Simulation(falling(), dt=1e-3, arch="cpu") as simulation:
        summary = ts.export(simulation, output, fps=50, duration=0.08)
    assert summary.frames == 5
    assert output.calls == [(0, None), (2, None), (4, None), "finish"]
    assert output.frames == 3


def test_it_needs_no_simulation_and_is_discarded_where_it_fails():
    output = Kept()
    with output:
        output.write(7, ts.Frame(0.0, np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1)), None)
    assert output.calls == [(7, None), "finish"]
    failing = Kept()
    with pytest.raises(OSError, match="disk full"), failing:
        failing.write(0, None, None)
    assert failing.calls == ["discard"]
