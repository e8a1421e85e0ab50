"""The benchmark runs, tiny: its tables hold every contestant or say why one is absent, and ours agrees with its peers."""

import re

import numpy as np
import pytest
from physics_support import F64

from taichi_sim.reports import bench


@pytest.mark.slow
@pytest.mark.skipif(F64, reason="the benchmark runs in single precision")
@pytest.mark.parametrize("name", list(bench.CASES))
def test_each_case_runs(name, capsys):
    report = bench.CASES[name](True)
    report.show()
    shown = capsys.readouterr().out
    assert report.rows[0][0] in shown
    for _, seconds, _ in report.rows:
        assert len(seconds) == bench.REPEATS
        assert np.all(np.array(seconds) > 0.0)
    for note in report.notes:
        difference = re.search(r"differs from ours by (\S+) \(position\)", note)
        assert difference is None or float(difference[1]) < 1e-5, note
        same = re.search(r"([\d.]+)% of the balls get the same velocity", note)
        assert same is None or float(same[1]) > 99.0, note


def test_an_unknown_case_is_named():
    with pytest.raises(ValueError, match="'speed' is not a case; there are springs"):
        bench.main(["speed"])
