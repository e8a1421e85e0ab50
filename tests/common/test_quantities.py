"""Numbers with their uncertainties, in words."""

import math

import pytest

from taichi_sim.common.quantities import measured, percent

pytestmark = pytest.mark.once


@pytest.mark.parametrize(
    ("value", "uncertainty", "unit", "words"),
    [
        (15604.2, 88.0, "N", "15.60 +- 0.09 kN"),
        (15604.2, None, "N", "15.6 kN"),
        (0.0342, 0.00123, "m", "34.2 +- 1.2 mm"),
        (0.7, 2e-15 * 0.7, "m", "700 mm, exact to rounding"),
        (-3.2, 40.0, "J", "0 +- 40 J"),
        (0.0, 2.6e-4, "m", "0 +- 300 µm"),
        (6.95, None, "N", "6.95 N"),
        (0.99965, None, "s", "1.00 s"),
        (-999.7, math.nan, "Pa", "-1.00 kPa"),
        (0.0, None, "N", "0 N"),
        (0.0, 0.0, "m", "0 m, exact to rounding"),
        (12.0, 0.95, "kg", "12.0 +- 0.9 kg"),
        (2.5e7, 3e5, "1/s", "(2.50 +- 0.03)e+07 1/s"),
        (4.0, math.inf, "N", "4.00 N, uncertainty without bound"),
        (math.nan, 0.1, "N", "nan N"),
        (5.0, 0.1, "", "5.00 +- 0.10"),
    ],
)
def test_one_form(value, uncertainty, unit, words):
    assert measured(value, uncertainty, unit) == words


def test_source_and_percent():
    assert measured(1500.0, 20.0, "N", "step") == "1.50 +- 0.02 kN (step)"
    assert percent(0.0054) == "0.54 %"
    assert percent(0.01) == "1.0 %"
