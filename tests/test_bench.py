"""The benchmark runs, tiny: its tables hold every contestant or say why one is absent, and ours agrees with its peers."""

import re

import numpy as np
import pytest
from physics_support import F64

from taichi_sim.reports import bench
from taichi_sim.reports.piles import overlaps


@pytest.mark.slow
@pytest.mark.skipif(F64, reason="the benchmark runs in single precision")
@pytest.mark.parametrize("name", list(bench.CASES))
def test_each_case_runs(name, capsys):
    report = bench.CASES[name](True)
    report.show()
    shown = capsys.readouterr().out
    assert report.rows[0][0] in shown
    for _, seconds, _ in report.rows:
        assert len(seconds) == report.samples
        assert np.all(np.array(seconds) > 0.0)
    for note in report.notes:
        difference = re.search(r"differs from ours by (\S+) \(position\)", note)
        assert difference is None or float(difference[1]) < 1e-5, note
        same = re.search(r"([\d.]+)% of the balls get the same velocity", note)
        assert same is None or float(same[1]) > 99.0, note


def test_overlaps_of_a_pile():
    x = np.array([[0.1, 0.04], [0.1, 0.13], [0.19, 0.13], [0.5, 0.05], [0.97, 0.3], [0.1, 0.5]])
    largest, mean, wall = overlaps(x, radius=0.05, side=1.0)
    assert (largest, mean, wall) == pytest.approx((0.2, 0.2, 0.4))
    assert overlaps(x[3:4], radius=0.05, side=1.0) == (0.0, 0.0, 0.0)
    rng = np.random.default_rng(2)
    x = rng.uniform(0.1, 0.9, (300, 2))
    depth = 0.1 - np.linalg.norm(x[:, None] - x[None], axis=2)[np.triu_indices(300, 1)]
    depth = depth[depth > 0.0] / 0.05
    assert overlaps(x, 0.05, 1.0) == pytest.approx((depth.max(), depth.mean(), 0.0))


def test_an_unknown_case_is_named():
    with pytest.raises(ValueError, match="'speed' is not a case; there are springs"):
        bench.main(["speed"])
