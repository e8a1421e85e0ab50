"""A gas in two processes that exchange a halo equals the gas in one: the experiment of docs/scaling.md."""

import pytest
from halo_exchange import BALLS, CUT, LAYERS, RADIUS, RECORD, compared
from physics_support import F64

pytestmark = [pytest.mark.long, pytest.mark.skipif(not F64, reason="equal within rounding is said of double precision")]


def test_two_halves_are_the_whole():
    width = 2.0 * RADIUS * LAYERS
    for one in compared((50, 100), again=True):
        assert one.balls == BALLS
        assert one.x < 1e-12
        assert one.v < 1e-10
        assert abs(one.energy) < 1e-7  # of three at once, beyond what iterations solve
        assert one.momentum < 1e-9
        assert one.sent == pytest.approx(RECORD.itemsize * 0.5 * BALLS * width / CUT, rel=0.1)
        assert one.moved > 1.0


def test_a_halo_of_one_diameter_cuts_clusters():
    (one,) = compared((50,), layers=1)
    assert one.balls == BALLS
    assert one.v > 1e-3
