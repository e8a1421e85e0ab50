"""Lists stored in slices: every entry has a place of its own, where neighbouring lists have the same entry side by side."""

import numpy as np
import pytest

from taichi_sim.geometry.graph import sliced

pytestmark = pytest.mark.once


@pytest.mark.parametrize("nodes", [1, 31, 32, 33, 200])
def test_slices_hold_all_entries_side_by_side(nodes):
    number = np.random.default_rng(nodes).integers(0, 7, nodes)
    number[0] = 3
    start = np.concatenate([[0], np.cumsum(number)]).astype(np.int32)
    first, place, room = sliced(start, 32)
    assert len(np.unique(place)) == start[-1]
    assert place.min() >= 0
    assert place.max() < room
    for node in range(nodes):
        entries = place[start[node] : start[node + 1]]
        np.testing.assert_array_equal(entries, first[node // 32] + node % 32 + 32 * np.arange(number[node]))
    longest = [number[a : a + 32].max() for a in range(0, nodes, 32)]
    assert room == 32 * sum(longest)


def test_no_list_needs_no_room():
    _, place, room = sliced(np.zeros(41, dtype=np.int32), 32)
    assert (len(place), room) == (0, 0)
