"""The page of a sweep: when an axis is logarithmic, and what points take."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_sim.sweeps.design import axis_of
from taichi_sim.sweeps.figures import is_logarithmic
from taichi_sim.sweeps.measures import Measures, Number
from taichi_sim.sweeps.page import _about
from taichi_sim.sweeps.points import Point, Row
from taichi_sim.sweeps.sweep import Sweep

pytestmark = pytest.mark.once


@pytest.mark.parametrize(
    ("given", "is_so"),
    [
        ("0:1", False),
        ("1e2:1e4:log", True),
        ("0.01:1:9", False),
        ("1,10,100", True),
        ("1,2,5", False),
        ("1e-9,1e-8,1e-6", True),
        ("-1,10,100", False),
    ],
)
def test_axes_are_logarithmic_where_it_was_said_or_values_lie_far_apart(given, is_so):
    along = axis_of("x", given)
    x = np.array(along.values or [along.at(u) for u in (0.006, 0.3, 0.9)], dtype=float)
    assert is_logarithmic(along, x) == is_so


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (
            [(60.0, True), (2.0, False), (0.1, False), (0.1, False)],
            "62.2 s of work in all, 0.1 s a point of what was compiled",
        ),
        ([(60.0, True)], "60 s of work in all, compiling included"),
    ],
)
def test_what_points_take_is_said_without_compiling(rows, says):
    rows = [SimpleNamespace(wall=wall, compiled=compiled, seed=None) for wall, compiled in rows]
    sweep = SimpleNamespace(rows=rows, points=[], failed=[], axes=[], design=SimpleNamespace(kind="grid"))
    assert list(_about(sweep))[-1].startswith(says)


def test_a_sweep_says_means_with_their_intervals():
    """Three seeds of 2, 3 and 4 N: the mean is off by t s / sqrt(3) = 4.303 / sqrt(3) = 2.48 N at most, in 95 of 100 sweeps."""
    points = [Point({"radius": r}, seed) for r in (0.1, 0.2) for seed in range(3)]
    values = [2.0, 3.0, 4.0, 7.0, 7.0, 7.0]
    rows = {p.key: Row.of(p, measures={"probes.load": value}) for p, value in zip(points, values)}
    measures = Measures([Number("probes.load", "probes.load", "last", "N")], {}, False)
    done = Sweep(SimpleNamespace(name="s"), (), SimpleNamespace(kind="product"), points, rows, {}, measures, None)
    assert list(done.lines()) == [
        "probes.load  3 +- 2 N (mean of 3 seeds, 95% interval) at radius 0.1",
        "probes.load  7 N, exact to rounding at radius 0.2",
    ]
    assert next(done.lines(most=0)) == "probes.load  and 2 combinations more, see the table"
    single = Sweep(SimpleNamespace(name="s"), (), SimpleNamespace(kind="product"), points[:1], rows, {}, measures, None)
    assert list(single.lines()) == ["probes.load  2.00 N at radius 0.1"]


@pytest.mark.parametrize(("statistic", "value"), [("last", 5.0), ("min", -2.0), ("max", 5.0), ("mean", 4 / 3)])
def test_statistics_of_readings_leave_out_those_that_are_not_known(statistic, value):
    number = Number(f"load.{statistic}", "load", statistic)
    assert number.of([math.nan, 1.0, -2.0, 5.0]) == pytest.approx(value)
    assert math.isnan(number.of([math.nan]))
