"""The page of a sweep: when an axis is logarithmic, and what points take."""

from types import SimpleNamespace

import numpy as np
import pytest

from taichi_sim.sweeps.design import axis_of
from taichi_sim.sweeps.figures import is_logarithmic
from taichi_sim.sweeps.page import _about

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
