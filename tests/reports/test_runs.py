"""Progress of a study: runs that are done, and runs that there will be."""

import pytest

from taichi_sim.reports.speed_error.runs import Runs

pytestmark = pytest.mark.once


def test_runs_that_were_expected_and_others():
    runs = Runs()
    runs.expect(5)
    assert runs.line() == "0 of about 5 runs, starting"
    runs("verlet in f64 at 0.001 s")
    assert runs.line() == "0 of about 5 runs, verlet in f64 at 0.001 s, begun 0 s ago"
    runs("rk4 in f64 at 0.001 s")
    runs.expect(-2)  # they would take too long
    assert runs.line().startswith("1 of about 3 runs")
    for _ in range(3):
        runs("xpbd in f64 at 0.002 s")  # two more than expected
    assert runs.line().startswith("4 of about 5 runs")
    runs.expect(4)
    assert runs.total == 9
