"""A short run of `make kills`: exports that are killed at random moments and resumed, in processes of their own."""

import pytest
from kills import INTERVAL, SLACK, campaign

pytestmark = [pytest.mark.once, pytest.mark.slow]


@pytest.mark.long
def test_killed_exports_come_out_as_undisturbed_ones(tmp_path):
    tallies = campaign(tmp_path, ("x.npz",), kills=3, seed=5)
    for tally in tallies.values():
        assert tally.wrong == []
        assert tally.finished
        assert tally.lost < INTERVAL + 5 * SLACK  # machines that test are busy
