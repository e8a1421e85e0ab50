"""Springs of one colour share no ball."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.forces.spring_colours import MOST_COLOURS, colours

pytestmark = pytest.mark.once


def cloth():
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, resolution=(17, 12))
    return scene


def jelly():
    scene = ts.Scene(dim=3)
    ts.shapes.jelly(scene, size=(1, 0.8, 0.6), resolution=(7, 6, 5))
    return scene


def check(pairs, found):
    for colour in range(found.max() + 1):
        balls = pairs[found == colour].ravel()
        assert 0 < len(balls) == len(np.unique(balls))


@pytest.mark.parametrize(("build", "number"), [(cloth, 8), (jelly, 26)])
def test_lattices_need_as_many_as_a_ball_has_springs(build, number):
    scene = build()
    found = colours(scene.pairs, scene.n_balls)
    check(scene.pairs, found)
    assert found.max() + 1 == number == np.bincount(scene.pairs.ravel()).max()


@pytest.mark.parametrize("seed", range(5))
def test_random_springs(seed):
    pairs = np.random.default_rng(seed).integers(0, 40, (300, 2))
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    found = colours(pairs, 40)
    check(pairs, found)
    assert found.max() + 1 < 2 * np.bincount(pairs.ravel()).max()


def test_a_hub_has_at_most_as_many_springs_as_there_are_colours():
    spokes = np.stack([np.zeros(MOST_COLOURS + 1, dtype=int), np.arange(1, MOST_COLOURS + 2)], axis=1)
    assert sorted(colours(spokes[:-1], len(spokes) + 1)) == list(range(MOST_COLOURS))
    assert colours(spokes, len(spokes) + 1) is None


def test_no_springs():
    assert colours(np.zeros((0, 2), dtype=np.int32), 3).shape == (0,)
