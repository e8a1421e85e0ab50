"""Bounds of extremes between samples, of waves, parabolas and motions that start at rest."""

import numpy as np
import pytest

from taichi_sim.analysis.between_samples import beyond

pytestmark = pytest.mark.once


@pytest.mark.parametrize("samples", [4.1, 7.0, 23.7])
def test_a_wave_keeps_to_the_bound(samples):
    """So many samples a period, in any phase; the bound is not much wider than what is missed at worst."""
    missed, stated = [], []
    for phase in np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 400):
        values = np.sin(2.0 * np.pi * np.arange(int(1.3 * samples) + 2) / samples + phase)
        inside = 1 + int(np.argmax(values[1:-1]))
        missed.append(1.0 - values[inside])
        stated.append(beyond(values, inside))
    assert np.all(np.array(missed) <= stated)
    assert max(stated) < 9.0 * max(missed)


def test_a_parabola_goes_beyond_by_half_the_bound_at_most():
    at = np.arange(7) - 2.5
    assert beyond(-(at**2), 2) == 2.0 * beyond(-(at**2) / 2.0, 2) == pytest.approx(2.0 * 0.25)


@pytest.mark.parametrize("power", [1, 2])
def test_ends_of_a_motion_that_starts_at_rest_or_goes_on_are_its_extremes(power):
    fall = -(np.arange(9.0) ** power)
    assert beyond(fall, 0) == beyond(fall, 8) == 0.0


def test_a_peak_behind_the_first_sample_is_seen():
    thrown = 0.3 * np.arange(9.0) - np.arange(9.0) ** 2 / 2.0
    assert 0.3**2 / 2.0 <= beyond(thrown, 0) <= 0.25


def test_readings_that_are_not_known_are_left_out():
    values = np.array([np.nan, 1.0, 3.0, np.nan, 2.5])
    assert beyond(values, 2) == 0.25 * 2.0
    assert beyond([np.nan, 1.0], 1) == beyond([4.0], 0) == 0.0


def test_what_may_end_at_once_may_have_gone_on_as_far_as_before():
    pull = np.array([0.0, 1.0, 2.1, 3.3, 0.0, 0.0])  # it tears before the fifth sample, at 4.5 at most
    assert beyond(pull, 3) == 0.25 * 3.3
    assert beyond(pull, 3, True) == pytest.approx(1.2)
    assert beyond(-pull, 3, True) == pytest.approx(1.2)
