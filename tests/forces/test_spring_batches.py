"""SIMD batches of springs do what a sweep does."""

import numpy as np
import pytest

from taichi_sim.forces.spring_batches import batches

pytestmark = pytest.mark.once


def random_pairs(seed):
    rng = np.random.default_rng(seed)
    pairs = rng.integers(0, 30, (200, 2))
    return pairs[pairs[:, 0] != pairs[:, 1]]


@pytest.mark.parametrize("width", [1, 8])
@pytest.mark.parametrize("seed", range(5))
def test_batches_keep_the_order_of_a_sweep(seed, width):
    """Each spring once, no ball twice in a batch, and at every ball the order of the sweep."""
    pairs = random_pairs(seed)
    found = batches(pairs, width)
    flat = found[found >= 0]
    assert sorted(flat.tolist()) == list(range(len(pairs)))
    for batch in found:
        balls = pairs[batch[batch >= 0]].ravel()
        assert len(set(balls.tolist())) == len(balls)
    for ball in range(30):
        own = [e for e in flat.tolist() if ball in pairs[e]]
        assert own == sorted(own)


def test_a_long_chain_fills_no_batch():
    """Each spring waits for the one before it."""
    chain = np.stack([np.arange(10), np.arange(1, 11)], axis=1)
    found = batches(chain, 8)
    assert found.shape == (10, 8)
    assert np.array_equal(found[:, 0], np.arange(10))
    assert np.all(found[:, 1:] == -1)
